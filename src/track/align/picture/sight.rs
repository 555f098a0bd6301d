//! How the camera sees a surface while its rows are exposed, in the numbers of the kernels.

use crate::motion::Motion;
use crate::track::align::lanes::Lanes;
use crate::track::scene::rectangle::Rectangle;

/// A surface's sights over time, as polynomials: [entry][power].
pub struct SightPath {
    rotation: [[f32; 3]; 9],
    centre: [[f32; 3]; 3],
}

/// How a few pixels see a surface at a time.
#[derive(Clone, Copy)]
pub struct Sight<L> {
    /// The camera's centre in the surface's frame, metres.
    pub centre: [L; 3],
    /// From rays to the surface's axes, row by row.
    pub rotation: [L; 9],
}

impl SightPath {
    /// Of a surface from a motion.
    pub fn new(rectangle: &Rectangle, motion: &Motion) -> Self {
        let to_surface = rectangle.rotation.transpose();
        let turn = motion.rotation_polynomial().map(|r| to_surface * r);
        let [p0, p1, p2] = motion.centre_polynomial();
        let from = [to_surface * (p0 - rectangle.centre), to_surface * p1, to_surface * p2];
        Self {
            rotation: std::array::from_fn(|k| std::array::from_fn(|power| turn[power][(k / 3, k % 3)] as f32)),
            centre: std::array::from_fn(|k| std::array::from_fn(|power| from[power][k] as f32)),
        }
    }

    /// At time `t`.
    #[inline(always)]
    pub fn at<L: Lanes>(&self, t: L) -> Sight<L> {
        let (mut centre, mut rotation) = ([t; 3], [t; 9]);
        for n in 0..3 {
            centre[n] = polynomial(&self.centre[n], t);
        }
        for n in 0..9 {
            rotation[n] = polynomial(&self.rotation[n], t);
        }
        Sight { centre, rotation }
    }
}

impl<L: Lanes> Sight<L> {
    /// Where a ray leads, in the surface's axes.
    #[inline(always)]
    pub fn direction(&self, x: L, y: L) -> [L; 3] {
        let mut direction = [x; 3];
        for r in 0..3 {
            direction[r] = self.rotation[3 * r].mul_add(x, self.rotation[3 * r + 1].mul_add(y, self.rotation[3 * r + 2]));
        }
        direction
    }
}

#[inline(always)]
fn polynomial<L: Lanes>(c: &[f32; 3], t: L) -> L {
    L::splat(c[2]).mul_add(t, L::splat(c[1])).mul_add(t, L::splat(c[0]))
}
