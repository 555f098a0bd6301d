//! The camera's pose relative to a surface while its rows are exposed.
//!
//! With a rolling shutter each row has its own time, so the pose is a polynomial of time, in `f32`
//! as the kernels need it. `pixels::appearance` evaluates it at each pixel's row.

use crate::motion::Motion;
use crate::track::align::lanes::Lanes;
use crate::track::scene::rectangle::Rectangle;

/// The camera's pose in the frame of a surface, as quadratic polynomials of the seconds from the
/// frame's stamp: [entry][power].
pub struct SightPath {
    rotation: [[f32; 3]; 9],
    centre: [[f32; 3]; 3],
}

/// The camera's pose relative to a surface, for several pixels at their times.
#[derive(Clone, Copy)]
pub struct Sight<L> {
    /// The camera's centre in the surface's frame, metres.
    pub centre: [L; 3],
    /// Rotation from camera axes to surface axes, row-major.
    pub rotation: [L; 9],
}

impl SightPath {
    /// Computes the polynomials for a surface and a camera motion.
    pub fn new(rectangle: &Rectangle, motion: &Motion) -> Self {
        let to_surface = rectangle.rotation.transpose();
        let rotation = motion.rotation_polynomial().map(|r| to_surface * r);
        let [p0, p1, p2] = motion.centre_polynomial();
        let from = [to_surface * (p0 - rectangle.centre), to_surface * p1, to_surface * p2];
        Self {
            rotation: std::array::from_fn(|k| std::array::from_fn(|power| rotation[power][(k / 3, k % 3)] as f32)),
            centre: std::array::from_fn(|k| std::array::from_fn(|power| from[power][k] as f32)),
        }
    }

    /// Evaluates them at `t`, seconds from the frame's stamp.
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
    /// Returns the direction of the ray (x, y, 1) in surface axes.
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
