//! Determines which views a calibration still lacks, and whether a new view is worth taking.
//!
//! A good set shows the board in every part of the picture and tilted to every side, and its views
//! differ from each other. The guide is used for picking views from a clip, for the closing advice
//! ("take next: …"), and for live guidance. Until the lens is known, a focal length of one picture
//! width is assumed, which gives tilts to a few degrees.

use nalgebra::{Vector2, Vector3};

use super::solve::adjust::Observation;
use super::solve::lens::Lens;
use super::solve::start::{centre, pose_of};

/// Number of columns of parts into which the picture is divided; with three rows the parts are
/// about square. Each has its words for the user. Raised, advice is finer and coverage harder to
/// reach.
pub const PART_COLUMNS: usize = 4;
/// Number of rows of parts; see [`PART_COLUMNS`].
pub const PART_ROWS: usize = 3;
/// Number of views in a good set: calibration guides ask for 10 to 20. Chosen, not tuned. Raised,
/// taking pictures takes longer and hardly improves the lens …
pub const GOOD_VIEWS: usize = 12;
/// … if at most this many parts of the picture are missing: in a corner the whole board often does
/// not fit. Raised, the lens is extrapolated there.
const PARTS_TO_SPARE: usize = 1;
/// Minimum tilt, degrees, of a board that counts as tilted. Chosen, not tuned: only tilt separates
/// focal length from distance, and the advice asks for 35. Raised, more views are called front-on;
/// lowered, views count that hardly separate them.
pub const TILTED_DEG: f64 = 18.0;

/// The side of a tilted board that is farther away.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum TiltSide {
    /// The left side is farther away.
    Left,
    /// The right side is farther away.
    Right,
    /// The upper side is farther away.
    Top,
    /// The lower side is farther away.
    Bottom,
}

impl TiltSide {
    /// All sides.
    pub const ALL: [Self; 4] = [Self::Left, Self::Right, Self::Top, Self::Bottom];

    /// Returns a word for the user.
    pub fn name(self) -> &'static str {
        match self {
            Self::Left => "left",
            Self::Right => "right",
            Self::Top => "upper",
            Self::Bottom => "lower",
        }
    }
}

/// The properties of a view that the guide uses.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewShape {
    /// The board's corners, as fractions of the picture's width and height.
    pub corners: Vec<Vector2<f64>>,
    /// The board's normal, out of its back, in camera axes: (0, 0, 1) is front-on.
    pub normal: Vector3<f64>,
}

impl ViewShape {
    /// Computes the shape of a view with a lens, or with an assumed one; `None` for corners that no
    /// board can show.
    pub fn new(observations: &[Observation], size: (u32, u32), lens: Option<&Lens>) -> Option<Self> {
        let width = f64::from(size.0.max(size.1));
        let guess = Lens::pinhole([width; 2], centre(size));
        let pose = pose_of(observations, lens.unwrap_or(&guess))?;
        let share = |o: &Observation| Vector2::new((o.pixel.x + 0.5) / f64::from(size.0), (o.pixel.y + 0.5) / f64::from(size.1));
        Some(Self { corners: observations.iter().map(share).collect(), normal: pose.rotation * Vector3::z() })
    }

    /// Returns the angle between the board's normal and the optical axis, degrees.
    pub fn tilt_deg(&self) -> f64 {
        self.normal.z.clamp(-1.0, 1.0).acos().to_degrees()
    }

    /// Returns the side to which the board is tilted; `None` if it is not tilted.
    pub fn side(&self) -> Option<TiltSide> {
        if self.tilt_deg() < TILTED_DEG {
            return None;
        }
        // Depth falls along the normal's x: if the normal points right, the right side is nearer.
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

    /// Returns how much two views differ: about 1 for another corner of the picture, for 25 degrees
    /// of tilt, or for twice the size.
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
    /// Distance to the view that is most like it (see [`ViewShape::distance`]); infinite for the
    /// first.
    pub novelty: f64,
    /// Number of parts of the picture that no earlier view has reached.
    pub new_parts: usize,
    /// Whether it is the first view tilted to its side.
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
    /// Parts of the picture without corners, (column, row) of [`PART_COLUMNS`] x [`PART_ROWS`].
    pub parts: Vec<(usize, usize)>,
    /// Sides to which no view is tilted.
    pub sides: Vec<TiltSide>,
}

/// Returns the part of the picture that contains a position.
fn part_of(share: &Vector2<f64>) -> (usize, usize) {
    let index = |c: f64, count: usize| ((c * count as f64) as usize).min(count - 1);
    (index(share.x, PART_COLUMNS), index(share.y, PART_ROWS))
}

impl ViewSet {
    /// Adds a view.
    pub fn add(&mut self, shape: ViewShape) {
        self.shapes.push(shape);
    }

    /// Returns the number of views.
    pub fn len(&self) -> usize {
        self.shapes.len()
    }

    /// Returns the views in the order they were added.
    pub fn shapes(&self) -> &[ViewShape] {
        &self.shapes
    }

    /// Returns what a view would add.
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

    /// Returns what no view shows yet.
    pub fn missing(&self) -> Missing {
        let reached: Vec<(usize, usize)> = self.shapes.iter().flat_map(|s| s.corners.iter().map(part_of)).collect();
        let parts = (0..PART_ROWS).flat_map(|r| (0..PART_COLUMNS).map(move |c| (c, r))).filter(|part| !reached.contains(part));
        let sides = TiltSide::ALL.into_iter().filter(|side| !self.shapes.iter().any(|s| s.side() == Some(*side)));
        Missing { parts: parts.collect(), sides: sides.collect() }
    }

    /// Returns the largest angle between two views' normals, degrees.
    pub fn widest_angle_deg(&self) -> f64 {
        let pairs = self.shapes.iter().enumerate().flat_map(|(k, a)| self.shapes[k + 1..].iter().map(move |b| (a, b)));
        pairs.map(|(a, b)| a.normal.angle(&b.normal).to_degrees()).fold(0.0, f64::max)
    }

    /// Whether the views make a good set: enough of them, tilted to every side, in nearly every
    /// part of the picture.
    pub fn is_good(&self) -> bool {
        let missing = self.missing();
        self.len() >= GOOD_VIEWS && missing.sides.is_empty() && missing.parts.len() <= PARTS_TO_SPARE
    }

    /// Describes the picture to take next; `None` if nothing is missing.
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

/// Returns the missing part nearest to a picture's corner, where the lens is least known.
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
        let rotation = UnitQuaternion::from_scaled_axis(axis * tilt_deg.to_radians());
        let seen = |k: usize| {
            let p = rotation * (board.corner(k) - Vector2::new(0.09, 0.06)).push(0.0) + Vector3::new(x_m, 0.0, 0.5);
            Observation { board_m: board.corner(k), pixel: lens.project(p.xy() / p.z) }
        };
        ViewShape::new(&(0..35).map(seen).collect::<Vec<_>>(), (640, 480), None).unwrap()
    }

    #[test]
    fn tilts_report_side_and_angle() {
        // About +y the right side moves away from the camera (z grows for negative angles about y).
        let right = view(Vector3::y(), -30.0, 0.0);
        assert!((right.tilt_deg() - 30.0).abs() < 0.5, "{}", right.tilt_deg());
        assert_eq!(right.side(), Some(TiltSide::Right));
        assert_eq!(view(Vector3::y(), 30.0, 0.0).side(), Some(TiltSide::Left));
        assert_eq!(view(Vector3::x(), -30.0, 0.0).side(), Some(TiltSide::Top));
        assert_eq!(view(Vector3::x(), 30.0, 0.0).side(), Some(TiltSide::Bottom));
        assert_eq!(view(Vector3::x(), 5.0, 0.0).side(), None);
    }

    #[test]
    fn only_a_new_view_is_worth_taking() {
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
