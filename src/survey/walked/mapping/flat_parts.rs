//! Finds the flat parts of a set: planes on which many of its points lie, by region growing.
//!
//! Each point proposes the plane that most of its neighbours lie on. The best supported proposal
//! grows from neighbour to neighbour, is fitted again, and takes its points away; then the next.

use nalgebra::{Matrix3, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

/// Number of neighbours that propose a plane. Raised, proposals mix two faces of a crate; lowered,
/// noise tilts them.
const NEIGHBOURS: usize = 40;
/// Number of planes tried among a point's neighbours: with half of them on another face, one in
/// four is right. Raised, it takes longer.
const TRIES: usize = 40;
/// Distance from a plane within which a point lies on it, in sigmas of its depth, and at least,
/// metres. Raised, low steps vanish; lowered, planes fall to pieces.
const ON_PLANE: f64 = 2.5;
const MIN_ON_PLANE_M: f64 = 5e-4;
/// Minimum number of points of a part. Raised, small faces are lost; lowered, chance planes pass.
const MIN_POINTS: usize = 12;
/// Minimum number of a point's neighbours on the plane that it proposes.
const MIN_NEIGHBOURS: usize = 12;
/// Number of times a part grows and is fitted again. Raised, nothing is gained.
const GROWTHS: usize = 12;
/// Seed of the planes tried: the result is the same every time.
const SEED: u64 = 0x6d61_7073;

/// A flat part of the set.
#[derive(Debug, Clone, PartialEq)]
pub struct FlatPart {
    /// A point of its plane: the middle of its points, metres in the stage.
    pub centre: Vector3<f64>,
    /// Its normal, of unit length, towards the cameras.
    pub normal: Vector3<f64>,
    /// Its points' indices.
    pub members: Vec<usize>,
}

/// A plane: a point of it and its normal.
#[derive(Debug, Clone, Copy)]
struct Plane {
    centre: Vector3<f64>,
    normal: Vector3<f64>,
}

impl Plane {
    /// Fits a plane to points, given each with its sigma: the direction in which they scatter least
    /// is its normal.
    fn fitted(points: &[(Vector3<f64>, f64)]) -> Option<Self> {
        if points.len() < 3 {
            return None;
        }
        let weight = |sigma: &f64| 1.0 / (sigma * sigma + MIN_ON_PLANE_M * MIN_ON_PLANE_M);
        let total: f64 = points.iter().map(|(_, sigma)| weight(sigma)).sum();
        let centre = points.iter().map(|(p, sigma)| p * weight(sigma)).sum::<Vector3<f64>>() / total;
        let scatter = points.iter().map(|(p, sigma)| (p - centre) * (p - centre).transpose() * weight(sigma)).sum::<Matrix3<f64>>();
        let eigen = scatter.symmetric_eigen();
        let normal = eigen.eigenvectors.column(eigen.eigenvalues.imin()).normalize();
        normal.iter().all(|v| v.is_finite()).then_some(Self { centre, normal })
    }

    /// Whether a point with this sigma may lie on it.
    fn carries(&self, point: &Vector3<f64>, sigma_m: f64) -> bool {
        self.normal.dot(&(point - self.centre)).abs() < (ON_PLANE * sigma_m).max(MIN_ON_PLANE_M)
    }
}

/// Returns the flat parts, the largest first. `sigmas_m` has one sigma of each point's depth,
/// `step_m` the largest distance from one point of a part to the next, and `facing` each point's
/// mean direction to the cameras.
pub fn flat_parts(points: &[Vector3<f64>], sigmas_m: &[f64], step_m: f64, facing: &[Vector3<f64>]) -> Vec<FlatPart> {
    let neighbours: Vec<Vec<usize>> = (0..points.len()).into_par_iter().map(|k| nearest(points, k)).collect();
    let proposed: Vec<Option<(usize, Plane)>> =
        neighbours.par_iter().enumerate().map(|(k, near)| proposal(points, sigmas_m, k, near)).collect();
    let mut order: Vec<(usize, usize)> = proposed.iter().enumerate().filter_map(|(k, found)| Some((found.as_ref()?.0, k))).collect();
    order.sort_by(|a, b| b.0.cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut is_free = vec![true; points.len()];
    let mut parts = Vec::new();
    for (_, seed) in order {
        let Some((_, plane)) = proposed[seed].filter(|_| is_free[seed]) else { continue };
        let Some(part) = grown(points, sigmas_m, step_m, &is_free, seed, plane) else { continue };
        part.members.iter().for_each(|k| is_free[*k] = false);
        let towards = part.members.iter().map(|k| facing[*k]).sum::<Vector3<f64>>();
        let normal = if part.normal.dot(&towards) < 0.0 { -part.normal } else { part.normal };
        parts.push(FlatPart { normal, ..part });
    }
    parts.sort_by_key(|part| std::cmp::Reverse(part.members.len()));
    parts
}

fn nearest(points: &[Vector3<f64>], k: usize) -> Vec<usize> {
    let mut others: Vec<(f64, usize)> =
        points.iter().enumerate().filter(|(n, _)| *n != k).map(|(n, p)| ((p - points[k]).norm_squared(), n)).collect();
    let by_distance = |a: &(f64, usize), b: &(f64, usize)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
    if others.len() > NEIGHBOURS {
        others.select_nth_unstable_by(NEIGHBOURS, by_distance);
        others.truncate(NEIGHBOURS);
    }
    others.sort_by(by_distance);
    others.into_iter().map(|(_, n)| n).collect()
}

/// Returns the plane through a point that most of its neighbours lie on, and their number.
fn proposal(points: &[Vector3<f64>], sigmas_m: &[f64], k: usize, near: &[usize]) -> Option<(usize, Plane)> {
    if near.len() < MIN_NEIGHBOURS {
        return None;
    }
    let mut random = Pcg64Mcg::seed_from_u64(SEED ^ k as u64);
    let mut best: Option<(usize, Plane)> = None;
    for _ in 0..TRIES {
        let [a, b] = [(); 2].map(|()| points[near[random.random_range(0..near.len())]]);
        let normal = (a - points[k]).cross(&(b - points[k]));
        if normal.norm() < f64::EPSILON {
            continue;
        }
        let plane = Plane { centre: points[k], normal: normal.normalize() };
        let count = near.iter().filter(|n| plane.carries(&points[**n], sigmas_m[**n])).count();
        if best.is_none_or(|(most, _)| count > most) {
            best = Some((count, plane));
        }
    }
    let (count, plane) = best.filter(|(count, _)| *count >= MIN_NEIGHBOURS)?;
    let on_it = near.iter().chain([&k]).map(|n| (points[*n], sigmas_m[*n])).filter(|(p, sigma_m)| plane.carries(p, *sigma_m));
    Some((count, Plane::fitted(&on_it.collect::<Vec<_>>())?))
}

/// Grows a part from its seed; `None` if it stays too small.
fn grown(points: &[Vector3<f64>], sigmas_m: &[f64], step_m: f64, is_free: &[bool], seed: usize, start: Plane) -> Option<FlatPart> {
    let mut plane = start;
    let mut members = vec![seed];
    for _ in 0..GROWTHS {
        let on_plane: Vec<usize> = (0..points.len()).filter(|k| is_free[*k] && plane.carries(&points[*k], sigmas_m[*k])).collect();
        let joined = joined(points, step_m, &on_plane, seed);
        let has_settled = joined == members;
        members = joined;
        if members.len() < MIN_POINTS || has_settled {
            break;
        }
        plane = Plane::fitted(&members.iter().map(|k| (points[*k], sigmas_m[*k])).collect::<Vec<_>>())?;
    }
    let part = FlatPart { centre: plane.centre, normal: plane.normal, members };
    (part.members.len() >= MIN_POINTS).then_some(part)
}

/// Returns those of the candidates that the seed reaches in short steps, in order.
fn joined(points: &[Vector3<f64>], step_m: f64, candidates: &[usize], seed: usize) -> Vec<usize> {
    let mut left: Vec<usize> = candidates.iter().copied().filter(|k| *k != seed).collect();
    let (mut found, mut at) = (vec![seed], 0);
    while let Some(from) = found.get(at).copied() {
        left.retain(|k| {
            let is_near = (points[*k] - points[from]).norm() < step_m;
            if is_near {
                found.push(*k);
            }
            !is_near
        });
        at += 1;
    }
    found.sort_unstable();
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two walls that meet at a right angle, seen from 3 m, with 1 mm of noise, and some points
    /// that lie on neither.
    fn corner_of_a_room() -> Vec<Vector3<f64>> {
        let mut random = Pcg64Mcg::seed_from_u64(7);
        let mut noisy = |v: Vector3<f64>| v + Vector3::from_fn(|_, _| 0.001 * random.random_range(-1.0..1.0));
        let grid = (0..20).flat_map(|i| (0..20).map(move |j| (0.05 * f64::from(i) + 0.02, 0.05 * f64::from(j))));
        let mut points: Vec<_> = grid.clone().map(|(a, b)| noisy(Vector3::new(a, b, 0.0))).collect();
        points.extend(grid.map(|(a, b)| noisy(Vector3::new(0.0, b, a))));
        points.extend(
            (0..15).map(|k| noisy(Vector3::new(0.3 + 0.04 * f64::from(k % 4), 0.2 + 0.05 * f64::from(k), 0.3 + 0.05 * f64::from(k % 3)))),
        );
        points
    }

    #[test]
    fn two_walls_are_two_parts_that_face_the_cameras() {
        let points = corner_of_a_room();
        let (sigmas, facing) = (vec![6e-4; points.len()], vec![Vector3::new(1.0, 0.2, 1.0).normalize(); points.len()]);
        let parts = flat_parts(&points, &sigmas, 0.2, &facing);
        assert_eq!(parts.len(), 2, "{parts:?}");
        let mut normals: Vec<Vector3<f64>> = parts.iter().map(|part| part.normal).collect();
        normals.sort_by(|a, b| a.x.total_cmp(&b.x));
        assert!(normals[0].angle(&Vector3::z()) < 0.003 && normals[1].angle(&Vector3::x()) < 0.003, "{normals:?}");
        assert!(parts.iter().all(|part| part.members.len() > 360), "{:?}", parts.iter().map(|p| p.members.len()).collect::<Vec<_>>());
    }

    #[test]
    fn scattered_points_have_no_flat_part() {
        let mut random = Pcg64Mcg::seed_from_u64(9);
        let points: Vec<Vector3<f64>> = (0..300).map(|_| Vector3::from_fn(|_, _| random.random_range(-1.0..1.0))).collect();
        assert!(flat_parts(&points, &[6e-4; 300], 0.2, &[Vector3::z(); 300]).is_empty());
        assert!(flat_parts(&[], &[], 0.2, &[]).is_empty());
    }
}
