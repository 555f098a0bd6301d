//! Which views a calibration still lacks, and whether a new one is worth taking.
//!
//! A good set has the board in every part of the picture, tilted to every side, and each view unlike the others. This
//! holds for a clip, from which views are picked, for the closing advice ("take next: …"), and for a live guide. Until the
//! lens is known, a lens of one picture width serves: tilts come out right to a few degrees.

use nalgebra::{Vector2, Vector3};

use super::solve::adjust::Observation;
use super::solve::lens::Lens;
use super::solve::start::{centre, pose_of};

/// Columns of the parts into which the picture is divided: with three rows they are about square. Each has
/// its words for the user. Raised, advice is finer and coverage harder to reach.
pub const PART_COLUMNS: usize = 4;
/// Rows of parts; see [`PART_COLUMNS`].
pub const PART_ROWS: usize = 3;
/// Views of a good set: guides to calibration ask for 10 to 20. Chosen, not tuned. Raised,
/// taking pictures lasts longer for a lens that is hardly surer …
pub const GOOD_VIEWS: usize = 12;
/// … if not more parts of the picture than this are left out: in a corner the whole
/// board often does not fit. Raised, the lens is guessed there.
const PARTS_TO_SPARE: usize = 1;
/// A board counts as tilted from here on, degrees. Chosen, not tuned: perspective tells focal length from distance by the tilt, and the
/// advice asks for 35. Raised, more views are called front-on; lowered, views count that tell next to nothing of it.
pub const TILTED_DEG: f64 = 18.0;

/// Which way the far side of a tilted board lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum TiltSide {
    /// Its left side is farther away.
    Left,
    /// Its right side.
    Right,
    /// Its upper side.
    Top,
    /// Its lower side.
    Bottom,
}

impl TiltSide {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Left, Self::Right, Self::Top, Self::Bottom];

    /// A word for the user.
    pub fn name(self) -> &'static str {
        match self {
            Self::Left => "left",
            Self::Right => "right",
            Self::Top => "upper",
            Self::Bottom => "lower",
        }
    }
}

/// A view as the guide sees it.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewShape {
    /// Where the board's corners lie, as shares of the picture's width and height.
    pub corners: Vec<Vector2<f64>>,
    /// The board's normal, out of its back, camera axes: (0, 0, 1) is front-on.
    pub normal: Vector3<f64>,
}

impl ViewShape {
    /// The shape of a view under a lens, or under a guessed one; `None` for corners that no board can show.
    pub fn new(observations: &[Observation], size: (u32, u32), lens: Option<&Lens>) -> Option<Self> {
        let width = f64::from(size.0.max(size.1));
        let guess = Lens::pinhole([width; 2], centre(size));
        let pose = pose_of(observations, lens.unwrap_or(&guess))?;
        let share = |o: &Observation| Vector2::new((o.pixel.x + 0.5) / f64::from(size.0), (o.pixel.y + 0.5) / f64::from(size.1));
        Some(Self { corners: observations.iter().map(share).collect(), normal: pose.rotation * Vector3::z() })
    }

    /// Angle between the board's normal and the optical axis, degrees.
    pub fn tilt_deg(&self) -> f64 {
        self.normal.z.clamp(-1.0, 1.0).acos().to_degrees()
    }

    /// To which side the board is tilted; `None` where it is not.
    pub fn side(&self) -> Option<TiltSide> {
        if self.tilt_deg() < TILTED_DEG {
            return None;
        }
        // The plane's depth falls along its normal's x: where the normal points right, the right side is nearer.
        Some(match (self.normal.x.abs() > self.normal.y.abs(), self.normal.x > 0.0, self.normal.y > 0.0) {
            (true, true, _) => TiltSide::Left,
            (true, false, _) => TiltSide::Right,
            (false, _, true) => TiltSide::Top,
            (false, _, false) => TiltSide::Bottom,
        })
    }

    fn middle(&self) -> Vector2<f64> {
        self.corners.iter().sum::<Vector2<f64>>() / self.corners.len().max(1) as f64
    }

    fn spread(&self) -> f64 {
        let middle = self.middle();
        (self.corners.iter().map(|c| (c - middle).norm_squared()).sum::<f64>() / self.corners.len().max(1) as f64).sqrt()
    }

    /// How unlike two views are: about 1 for another corner of the picture, for 25 degrees of tilt, or for twice the size.
    pub fn distance(&self, other: &Self) -> f64 {
        let place = (self.middle() - other.middle()).norm() / 0.5;
        let tilt = self.normal.angle(&other.normal).to_degrees() / 25.0;
        let size = (self.spread() / other.spread().max(1e-6)).ln().abs() / std::f64::consts::LN_2;
        place.hypot(tilt).hypot(size)
    }
}

/// Views taken so far.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ViewSet {
    shapes: Vec<ViewShape>,
}

/// What a new view would add.
#[derive(Debug, Clone, PartialEq)]
pub struct Worth {
    /// Distance to the view that is most like it (see [`ViewShape::distance`]); infinite for the first.
    pub novelty: f64,
    /// Parts of the picture that no view has reached yet.
    pub new_parts: usize,
    /// Whether it is the first tilted to its side.
    pub new_side: bool,
}

impl Worth {
    /// Whether the view is worth taking.
    pub fn is_worth_it(&self) -> bool {
        self.novelty > 0.6 || (self.novelty > 0.3 && (self.new_parts > 0 || self.new_side))
    }
}

/// What is still missing.
#[derive(Debug, Clone, PartialEq)]
pub struct Missing {
    /// Parts of the picture that no corner has reached, (column, row) of [`PART_COLUMNS`] x [`PART_ROWS`].
    pub parts: Vec<(usize, usize)>,
    /// Sides to which no view is tilted.
    pub sides: Vec<TiltSide>,
}

/// The part of the picture in which a place lies.
fn part_of(share: &Vector2<f64>) -> (usize, usize) {
    let index = |c: f64, count: usize| ((c * count as f64) as usize).min(count - 1);
    (index(share.x, PART_COLUMNS), index(share.y, PART_ROWS))
}

impl ViewSet {
    /// Takes a view in.
    pub fn add(&mut self, shape: ViewShape) {
        self.shapes.push(shape);
    }

    /// How many views there are.
    pub fn len(&self) -> usize {
        self.shapes.len()
    }

    /// The views, in the order they were taken in.
    pub fn shapes(&self) -> &[ViewShape] {
        &self.shapes
    }

    /// What a view would add.
    pub fn worth(&self, shape: &ViewShape) -> Worth {
        let missing = self.missing();
        let mut new: Vec<(usize, usize)> = shape.corners.iter().map(part_of).filter(|part| missing.parts.contains(part)).collect();
        new.sort_unstable();
        new.dedup();
        Worth {
            novelty: self.shapes.iter().map(|s| s.distance(shape)).fold(f64::INFINITY, f64::min),
            new_parts: new.len(),
            new_side: shape.side().is_some_and(|side| missing.sides.contains(&side)),
        }
    }

    /// What no view shows yet.
    pub fn missing(&self) -> Missing {
        let reached: Vec<(usize, usize)> = self.shapes.iter().flat_map(|s| s.corners.iter().map(part_of)).collect();
        let parts = (0..PART_ROWS).flat_map(|r| (0..PART_COLUMNS).map(move |c| (c, r))).filter(|part| !reached.contains(part));
        let sides = TiltSide::ALL.into_iter().filter(|side| !self.shapes.iter().any(|s| s.side() == Some(*side)));
        Missing { parts: parts.collect(), sides: sides.collect() }
    }

    /// The largest angle between two views' normals, degrees.
    pub fn widest_angle_deg(&self) -> f64 {
        let pairs = self.shapes.iter().enumerate().flat_map(|(k, a)| self.shapes[k + 1..].iter().map(move |b| (a, b)));
        pairs.map(|(a, b)| a.normal.angle(&b.normal).to_degrees()).fold(0.0, f64::max)
    }

    /// Whether the views make a good set: enough of them, tilted to every side, in nearly every part of the picture.
    pub fn is_good(&self) -> bool {
        let missing = self.missing();
        self.len() >= GOOD_VIEWS && missing.sides.is_empty() && missing.parts.len() <= PARTS_TO_SPARE
    }

    /// The picture to take next, in words; `None` where nothing is missing.
    pub fn next_picture(&self) -> Option<String> {
        let missing = self.missing();
        let side = missing.sides.first().map(|side| format!("with its {} side about 35 degrees away from the camera", side.name()));
        let part = farthest_part(&missing.parts).map(|part| format!("in the {} of the picture", part_name(part)));
        match (part, side) {
            (Some(part), Some(side)) => Some(format!("hold the board {part}, {side}")),
            (Some(one), None) | (None, Some(one)) => Some(format!("hold the board {one}")),
            (None, None) => None,
        }
    }
}

/// The missing part nearest to a picture's corner: the lens is least known there.
fn farthest_part(parts: &[(usize, usize)]) -> Option<(usize, usize)> {
    let off = |(c, r): (usize, usize)| {
        let axis = |k: usize, count: usize| ((k as f64 + 0.5) / count as f64 - 0.5).abs();
        axis(c, PART_COLUMNS) + axis(r, PART_ROWS)
    };
    parts.iter().copied().max_by(|&a, &b| off(a).total_cmp(&off(b)))
}

fn part_name((column, row): (usize, usize)) -> String {
    let vertical = ["top", "middle", "bottom"][row.min(2)];
    let horizontal = ["far left", "left half", "right half", "far right"][column.min(3)];
    match (row, column) {
        (0 | 2, 0) => format!("{vertical} left corner"),
        (0 | 2, 3) => format!("{vertical} right corner"),
        _ => format!("{vertical}, {horizontal}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::board::Board;
    use nalgebra::UnitQuaternion;

    fn view(axis: Vector3<f64>, tilt_deg: f64, x_m: f64) -> ViewShape {
        let board = Board::new(7, 5, 0.03).unwrap();
        let lens = Lens::pinhole([640.0; 2], centre((640, 480)));
        let turn = UnitQuaternion::from_scaled_axis(axis * tilt_deg.to_radians());
        let seen = |k: usize| {
            let p = turn * (board.corner(k) - Vector2::new(0.09, 0.06)).push(0.0) + Vector3::new(x_m, 0.0, 0.5);
            Observation { board_m: board.corner(k), pixel: lens.project(p.xy() / p.z) }
        };
        ViewShape::new(&(0..35).map(seen).collect::<Vec<_>>(), (640, 480), None).unwrap()
    }

    #[test]
    fn tilts_have_their_side_and_size() {
        // About +y the right side goes away from the camera (z grows for negative angles about y).
        let right = view(Vector3::y(), -30.0, 0.0);
        assert!((right.tilt_deg() - 30.0).abs() < 0.5, "{}", right.tilt_deg());
        assert_eq!(right.side(), Some(TiltSide::Right));
        assert_eq!(view(Vector3::y(), 30.0, 0.0).side(), Some(TiltSide::Left));
        assert_eq!(view(Vector3::x(), -30.0, 0.0).side(), Some(TiltSide::Top));
        assert_eq!(view(Vector3::x(), 30.0, 0.0).side(), Some(TiltSide::Bottom));
        assert_eq!(view(Vector3::x(), 5.0, 0.0).side(), None);
    }

    #[test]
    fn the_same_view_again_is_worth_nothing_and_another_is() {
        let mut set = ViewSet::default();
        assert!(set.worth(&view(Vector3::y(), 20.0, 0.0)).is_worth_it());
        set.add(view(Vector3::y(), 20.0, 0.0));
        assert!(!set.worth(&view(Vector3::y(), 21.0, 0.002)).is_worth_it());
        assert!(set.worth(&view(Vector3::y(), -20.0, 0.0)).is_worth_it());
        assert!(set.worth(&view(Vector3::y(), 20.0, 0.15)).is_worth_it());
    }

    #[test]
    fn advice_names_what_is_missing() {
        let mut set = ViewSet::default();
        set.add(view(Vector3::y(), 30.0, 0.0));
        let missing = set.missing();
        assert!(!missing.sides.contains(&TiltSide::Left) && missing.sides.len() == 3);
        assert!(missing.parts.contains(&(0, 0)) && !missing.parts.contains(&(1, 1)));
        let next = set.next_picture().unwrap();
        assert!(next.contains("corner") && next.contains("right side"), "{next}");
    }
}
