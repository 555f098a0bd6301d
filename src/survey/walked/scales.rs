//! The robust scale of the tiles' residuals, beyond which tiles are outliers, and the support of
//! each surface's pose.

use super::normal_equations::{FrameRows, TileRow};

/// Minimum robust scale of the residuals: smaller ones come from tiles that share the same noise.
const MIN_SCALE: f64 = 0.4;
/// Minimum number of tiles for a surface to determine its own noise; with fewer, its scale is at
/// least that of all surfaces. Raised, a good surface counts for less next to a bad one; lowered, a
/// few tiles that agree by chance count for too much.
const MIN_ROWS: usize = 20;
/// Number of pose parameters of a surface that its own tiles determine: three of position and three
/// of rotation.
const OF_A_PLACE: usize = 6;

/// Returns each surface's robust scale of its residuals, in sigmas; infinite if its tiles determine
/// nothing beyond its pose. `None` if all surfaces together have too few tiles.
///
/// The scale is the median residual relative to that of two-dimensional noise of one sigma. Each
/// surface is judged separately: if one stands elsewhere than in the model, the others' scale would
/// reject all of its tiles. `n` tiles are `2 n` numbers, of which the surface's pose absorbs six.
/// The residuals shrink accordingly, and three tiles leave none.
pub(super) fn robust_scales(frames: &[FrameRows], surfaces: usize) -> Option<Vec<f64>> {
    let mut squares = vec![Vec::new(); surfaces];
    tiles(frames).for_each(|(_, row)| squares[row.surface].push(row.squared_now()));
    let all = Some(squares.concat()).filter(|all| all.len() >= MIN_ROWS).and_then(scale)?;
    let own = squares.into_iter().enumerate().map(|(k, squares)| {
        let numbers = 2 * squares.len();
        // The first surface's pose defines the stage frame.
        let remaining = numbers.saturating_sub(if k == 0 { 0 } else { OF_A_PLACE });
        if remaining == 0 {
            return f64::INFINITY;
        }
        let is_few = squares.len() < MIN_ROWS;
        let own = scale(squares).unwrap_or(all) * (numbers as f64 / remaining as f64).sqrt();
        if is_few { own.max(all) } else { own }
    });
    Some(own.collect())
}

fn scale(mut squares: Vec<f64>) -> Option<f64> {
    squares.sort_by(f64::total_cmp);
    let median = squares.get(squares.len() / 2)?;
    Some((median / (2.0 * 2.0_f64.ln())).sqrt().max(MIN_SCALE))
}

/// Returns all tiles with the index of their frame.
fn tiles(frames: &[FrameRows]) -> impl Iterator<Item = (usize, &TileRow)> {
    frames.iter().enumerate().flat_map(|(k, frame)| frame.rows().iter().map(move |row| (k, row)))
}

/// The support of a surface's pose.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Support {
    /// Number of tiles that agree with it.
    pub tiles: usize,
    /// Number of keyframes with such tiles.
    pub keyframes: usize,
    /// Scatter of its tiles, relative to the median of the surfaces.
    pub scatter: f64,
}

/// Minimum number of keyframes, so that a single wrong one is outvoted. Raised, surfaces that few
/// views show well are doubted.
const MIN_KEYFRAMES: usize = 3;
/// Scatter above which a surface's tiles are doubted. Tiles of a surface that stands elsewhere
/// match look-alikes, and scatter by 2.3 to 2.5 in a set of fifteen panels; correctly placed ones
/// by at most 1.4. Raised, surfaces that were never found pass; lowered, good ones are reported.
const OUTLIER_SCATTER: f64 = 2.0;

impl Support {
    /// Whether a few tiles of something else could have displaced the surface unnoticed.
    pub fn is_little(&self) -> bool {
        self.tiles < MIN_ROWS || self.keyframes < MIN_KEYFRAMES
    }

    /// Whether its tiles scatter so much more than the others' that they may show something else.
    pub fn is_outlier(&self) -> bool {
        self.scatter > OUTLIER_SCATTER
    }
}

/// Returns the support of each surface's pose.
pub(super) fn supports(frames: &[FrameRows], scales: &[f64]) -> Vec<Support> {
    let mut supports = vec![(Support::default(), None); scales.len()];
    for (frame, row) in tiles(frames).filter(|(_, row)| row.weight(scales[row.surface]) > 0.0) {
        let (support, last) = &mut supports[row.surface];
        support.tiles += 1;
        support.keyframes += usize::from(last.replace(frame) != Some(frame));
    }
    let mut sorted: Vec<f64> = scales.iter().copied().filter(|scale| scale.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    // Of two surfaces, the better one's.
    let usual = sorted.get(sorted.len().saturating_sub(1) / 2).copied().unwrap_or(f64::INFINITY);
    let with_scatter = |((support, _), scale): ((Support, _), &f64)| Support { scatter: scale / usual, ..support };
    supports.into_iter().zip(scales).map(with_scatter).collect()
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;

    use super::*;
    use crate::camera::CameraModel;
    use crate::motion::Motion;
    use crate::survey::walked::stage_model::StageModel;
    use crate::survey::walked::synthetic::{LENS, camera_poses, observed, stage};

    /// Rows of a walk that shows `count` tiles of the flat, at most `most` per frame, each shifted
    /// by `shift_px` of its index.
    fn rows([count, most]: [usize; 2], shift_px: impl Fn(usize) -> f64) -> Vec<FrameRows> {
        let model = StageModel::new(CameraModel::new(LENS).unwrap(), &stage(), false, false);
        let motions: Vec<Motion> = camera_poses(12).into_iter().map(Motion::still).collect();
        let mut shown = 0;
        let mut frames = observed(&model, &model, &motions, 0.01, 1);
        for frame in &mut frames {
            let mut in_frame = 0;
            frame.tiles.retain(|tile| {
                let is_shown = tile.surface == 0 || shown < count && in_frame < most;
                let of_flat = usize::from(is_shown && tile.surface == 1);
                (shown, in_frame) = (shown + of_flat, in_frame + of_flat);
                is_shown
            });
        }
        let flat = frames.iter_mut().flat_map(|frame| &mut frame.tiles).filter(|tile| tile.surface == 1);
        flat.enumerate().for_each(|(n, tile)| tile.shift_px += Vector2::new(shift_px(n), 0.0));
        assert_eq!(shown, count, "the walk shows no more");
        frames.iter().map(|frame| FrameRows::new(frame, &model, 3.0, |_| false)).collect()
    }

    #[test]
    fn a_surface_with_few_tiles_uses_its_own_residual_scale() {
        let all = robust_scales(&rows([10, 2], |_| 0.0), 2).unwrap();
        // As good as the others, apart from its own tiles' noise.
        assert!(all[1] >= all[0] && all[1] < 4.0 * all[0], "{all:?}");
        // Ten tiles of a flat that stands elsewhere, and ten that contradict each other: none is
        // rejected.
        for shift_px in [|_| 8.0, |n: usize| 8.0 * (1.7 * n as f64).sin()] {
            let rows = rows([10, 2], shift_px);
            let scales = robust_scales(&rows, 2).unwrap();
            assert!(scales[1] > 20.0 * all[0], "{scales:?}");
            assert_eq!(supports(&rows, &scales)[1].tiles, 10, "{scales:?}");
        }
    }

    #[test]
    fn too_few_tiles_for_a_placement_yield_an_infinite_scale() {
        for few in 0..=3 {
            let rows = rows([few, 2], |_| 0.0);
            let scales = robust_scales(&rows, 2).unwrap();
            assert!(scales[0].is_finite() && scales[1].is_infinite(), "{few}: {scales:?}");
            assert!(supports(&rows, &scales)[1].is_little());
        }
        let four = robust_scales(&rows([4, 2], |_| 0.0), 2).unwrap();
        assert!(four[1].is_finite() && four[1] > four[0], "{four:?}");
    }

    #[test]
    fn tiles_scattering_more_than_others_are_marked_stray() {
        let of = |shift_px: fn(usize) -> f64| {
            let rows = rows([48, 4], shift_px);
            supports(&rows, &robust_scales(&rows, 2).unwrap())
        };
        let [good, outliers] = [of(|_| 0.0), of(|n| 0.5 * (1.7 * n as f64).sin())];
        assert!(good.iter().all(|support| !support.is_outlier()), "{good:?}");
        assert!(outliers[1].is_outlier() && !outliers[1].is_little() && !outliers[0].is_outlier(), "{outliers:?}");
    }

    #[test]
    fn a_surface_in_few_keyframes_has_little_support() {
        let supports_of = |shown| {
            let rows = rows(shown, |_| 0.0);
            supports(&rows, &robust_scales(&rows, 2).unwrap())
        };
        let [few_tiles, few_keyframes, many] = [[12, 3], [40, 20], [48, 4]].map(supports_of);
        assert!(few_tiles[1].is_little() && few_tiles[1].tiles == 12 && few_tiles[1].keyframes == 4, "{few_tiles:?}");
        assert!(few_keyframes[1].is_little() && few_keyframes[1].keyframes == 2, "{few_keyframes:?}");
        assert!(!many[1].is_little() && many[1].keyframes == 12, "{many:?}");
        assert!(!few_tiles[0].is_little() && few_tiles[0].keyframes == 12, "{few_tiles:?}");
    }
}
