//! Points of a set that were clicked in frames of a walk, and what was measured of them, as a
//! config states it: they give a map its frame and its scale.

use nalgebra::{Vector2, Vector3};

/// A point of the set, clicked in frames.
#[derive(Debug, Clone, PartialEq)]
pub struct NamedPoint {
    /// Its name.
    pub name: String,
    /// Its place in the config, for messages.
    pub entry: String,
    /// Where frames show it.
    pub seen: Vec<Click>,
    /// Its position in the stage, metres, and one sigma of it along each axis.
    pub position_m: Option<(Vector3<f64>, f64)>,
}

/// A frame in which a point was clicked.
#[derive(Debug, Clone, PartialEq)]
pub struct Click {
    /// The clip's name.
    pub clip: String,
    /// The row in the clip, from 0.
    pub sequence: u64,
    /// The raw pixel.
    pub pixel: Vector2<f64>,
}

/// A measured length between two points.
#[derive(Debug, Clone, PartialEq)]
pub struct NamedDistance {
    /// Its place in the config, for messages.
    pub entry: String,
    /// The points' indices.
    pub between: [usize; 2],
    /// The length, metres.
    pub length_m: f64,
    /// One sigma, metres.
    pub sigma_m: f64,
}

/// All that was measured of a set.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct NamedPoints {
    /// The points.
    pub points: Vec<NamedPoint>,
    /// The lengths between them.
    pub distances: Vec<NamedDistance>,
    /// Indices of three points of the floor: the origin, one along x, one beside.
    pub floor: Option<[usize; 3]>,
}

impl NamedPoints {
    /// Returns all clicks, by the point's index, in order.
    pub fn clicks(&self) -> impl Iterator<Item = (usize, &Click)> {
        self.points.iter().enumerate().flat_map(|(index, point)| point.seen.iter().map(move |click| (index, click)))
    }
}
