//! Links neighbouring candidates on the board, and collects the resulting lattices.
//!
//! Two candidates are neighbours if an edge of each runs along the line between them, if the
//! colours are swapped from one to the other, and if the picture is dark on one side and light on
//! the other all along that line. A link must hold from both ends. Linked candidates form a
//! lattice, and each member gets integer coordinates.

use std::collections::VecDeque;

use nalgebra::Vector2;

use super::grid::Grid;
use super::lattice::{Cell, Lattice};
use super::level::Level;
use super::saddle::Saddle;

/// Number of nearest candidates among which neighbours are searched: a steeply tilted board has
/// several rows nearer than the next corner along its long side. Raised, crowded pictures take
/// longer; lowered, steep boards fall apart into rows.
const NEAREST: usize = 40;
/// … of which this many are tried first, nearest first, as most corners need no more. It saves time
/// and changes no link. Raised, a plain board takes longer; lowered, more corners are tried twice.
const FIRST: usize = 12;
/// Average number of candidates per bucket: few, so that little more than the nearest are examined.
/// Lowered, more empty buckets are visited.
const CROWD: f64 = 2.0;
/// Cosine of the maximum angle between an edge and the line to the neighbour, 20 degrees. Chosen,
/// not tuned. Raised, links of distorted or noisy boards are lost; lowered, diagonals of steep
/// boards pass for edges.
const ALONG: f64 = 0.94;
/// Cosine of the maximum angle between the crossing edges of two neighbours, 37 degrees: wider than
/// [`ALONG`], as both ends' errors add up. Raised, links of noisy boards are lost; lowered, corners
/// of different objects are linked.
const CROSSING: f64 = 0.8;
/// Minimum number of candidates in a lattice: two thirds of the smallest board, 3 x 3. Raised,
/// small boards with few visible corners are missed; lowered, chance groups are examined.
const MIN_LATTICE: usize = 6;

/// The neighbours in the four ways out of a corner: along edge 0, against it, along edge 1, against
/// it.
type Neighbours = [Option<usize>; 4];

fn outward(saddle: &Saddle, way: usize) -> Vector2<f64> {
    let direction = saddle.edges[way / 2];
    if way.is_multiple_of(2) { direction } else { -direction }
}

/// Returns the way out of `saddle` along `edge` that points towards `d`.
fn way_towards(saddle: &Saddle, edge: usize, d: Vector2<f64>) -> usize {
    2 * edge + usize::from(saddle.edges[edge].dot(&d) < 0.0)
}

/// Returns all lattices among the candidates, largest first.
pub(super) fn lattices(smooth: &Level, saddles: &[Saddle]) -> Vec<Lattice> {
    let buckets = Buckets::new(smooth, saddles);
    let mut near = Vec::new();
    let seen: Vec<Neighbours> = (0..saddles.len()).map(|index| neighbours(smooth, saddles, &buckets, index, &mut near)).collect();
    let mutual = |from: usize, way: usize| {
        let to = seen[from][way]?;
        let back = way_towards(&saddles[to], 1 - way / 2, saddles[from].position - saddles[to].position);
        (seen[to][back] == Some(from)).then_some(to)
    };
    let mut taken = vec![false; saddles.len()];
    let mut found: Vec<Lattice> = Vec::new();
    for root in 0..saddles.len() {
        if !taken[root] && (0..4).any(|way| mutual(root, way).is_some()) {
            let lattice = spread(saddles, root, &mut taken, mutual);
            if lattice.len() >= MIN_LATTICE {
                found.push(lattice);
            }
        }
    }
    found.sort_by_key(|lattice| std::cmp::Reverse(lattice.len()));
    found
}

/// Returns the nearest matching candidate in each of the four ways; `near` is scratch memory.
fn neighbours(smooth: &Level, saddles: &[Saddle], buckets: &Buckets, index: usize, near: &mut Vec<u64>) -> Neighbours {
    let mut found = [None; 4];
    let from = &saddles[index];
    // Most find their neighbours among the nearest few.
    for most in [FIRST, NEAREST] {
        buckets.around(saddles, index, most, near);
        let count = most.min(near.len());
        if count < near.len() {
            near.select_nth_unstable(count);
        }
        near[..count].sort_unstable();
        for key in &near[..count] {
            let other = *key as u32 as usize;
            let to = &saddles[other];
            let along = (to.position - from.position).normalize();
            for edge in 0..2 {
                let forwards = along.dot(&from.edges[edge]);
                let slot = &mut found[2 * edge + usize::from(forwards < 0.0)];
                if forwards.abs() < ALONG || slot.is_some() {
                    continue;
                }
                // Colours are swapped at the neighbour: the edge that starts a dark square here
                // ends one there.
                let parallel = along.dot(&to.edges[1 - edge]).abs() > ALONG;
                let crossing = from.edges[1 - edge].dot(&to.edges[edge]).abs() > CROSSING;
                let alike = to.contrast < 4.0 * from.contrast && from.contrast < 4.0 * to.contrast;
                if parallel && crossing && alike && edge_between(smooth, from, to, edge) {
                    *slot = Some(other);
                }
            }
        }
        if !found.contains(&None) {
            break;
        }
    }
    found
}

/// Whether dark and light lie on the correct sides at three places of the line between two
/// candidates.
// Not inlined, or the compiler moves its work before the cheap tests that most candidates fail.
#[inline(never)]
fn edge_between(smooth: &Level, from: &Saddle, to: &Saddle, edge: usize) -> bool {
    let line = to.position - from.position;
    let mut offset = Vector2::new(-line.y, line.x);
    let length = offset.norm();
    offset *= (0.15 * length).clamp(0.8, 4.0) / length;
    // Towards growing angle from edge 0 it is dark, from edge 1 light; against the edge's direction
    // both the side and the colour swap.
    let sign = if edge == 0 { -1.0 } else { 1.0 };
    let margin = 0.2 * from.contrast.min(to.contrast);
    [0.3, 0.5, 0.7].iter().all(|&t| {
        let middle = from.position + line * t;
        sign * f64::from(smooth.sample(middle + offset) - smooth.sample(middle - offset)) > margin
    })
}

/// Assigns coordinates to everything linked to `root`.
fn spread(saddles: &[Saddle], root: usize, taken: &mut [bool], mutual: impl Fn(usize, usize) -> Option<usize>) -> Lattice {
    let mut cells: Grid<Cell> = Grid::default();
    // Each entry: candidate, its coordinates, and the two ways that lead along +i and +j.
    let mut queue = VecDeque::from([(root, (0, 0), [0, way_at_growing_angle(&saddles[root], 0)])]);
    taken[root] = true;
    while let Some((index, (i, j), [along_i, along_j])) = queue.pop_front() {
        if !cells.contains((i, j)) {
            let Saddle { position, middle, contrast, .. } = saddles[index];
            cells.insert((i, j), Cell { position, middle, contrast, residual: 0.0 });
        }
        let steps = [(along_i, (1, 0)), (along_i ^ 1, (-1, 0)), (along_j, (0, 1)), (along_j ^ 1, (0, -1))];
        for (way, (di, dj)) in steps {
            let Some(to) = mutual(index, way).filter(|&to| !taken[to]) else { continue };
            if cells.contains((i + di, j + dj)) {
                continue;
            }
            taken[to] = true;
            let next = &saddles[to];
            // The edges swap their roles; the axes keep their directions.
            let along_i = way_towards(next, 1 - along_i / 2, outward(&saddles[index], along_i));
            let along_j = way_towards(next, 1 - along_j / 2, outward(&saddles[index], along_j));
            queue.push_back((to, (i + di, j + dj), [along_i, along_j]));
        }
    }
    Lattice::new(cells)
}

/// Returns the way along the other edge that lies clockwise (growing angle, y down) of `way`.
fn way_at_growing_angle(saddle: &Saddle, way: usize) -> usize {
    let (here, other) = (outward(saddle, way), saddle.edges[1 - way / 2]);
    2 * (1 - way / 2) + usize::from(here.perp(&other) < 0.0)
}

/// Candidates in square buckets, for nearest-neighbour queries.
struct Buckets {
    side: f64,
    columns: usize,
    rows: usize,
    members: Vec<Vec<usize>>,
}

impl Buckets {
    fn new(level: &Level, saddles: &[Saddle]) -> Self {
        let area = (level.width * level.height) as f64;
        let side = (area * CROWD / saddles.len().max(1) as f64).sqrt().max(4.0);
        let count = |size: usize| (size as f64 / side) as usize + 1;
        let (columns, rows) = (count(level.width), count(level.height));
        let mut members = vec![Vec::new(); columns * rows];
        for (index, saddle) in saddles.iter().enumerate() {
            let (c, r) = ((saddle.position.x / side) as usize, (saddle.position.y / side) as usize);
            members[r.min(rows - 1) * columns + c.min(columns - 1)].push(index);
        }
        Self { side, columns, rows, members }
    }

    /// Collects at least the `most` nearest other candidates, unordered, each as a number that
    /// sorts by distance and ends in its index. Searches ring by ring, so that crowded places stay
    /// cheap.
    fn around(&self, saddles: &[Saddle], index: usize, most: usize, near: &mut Vec<u64>) {
        near.clear();
        let from = saddles[index].position;
        let (c, r) = ((from.x / self.side) as isize, (from.y / self.side) as isize);
        let mut enough_at = None;
        for ring in 0..=self.columns.max(self.rows) as isize {
            if enough_at.is_some_and(|at| ring > at) {
                break;
            }
            for row in (r - ring).max(0)..=(r + ring).min(self.rows as isize - 1) {
                let whole = (row - r).abs() == ring;
                let step = if whole { 1 } else { (2 * ring).max(1) as usize };
                for column in (c - ring..=c + ring).step_by(step).filter(|&k| k >= 0 && k < self.columns as isize) {
                    let members = &self.members[row as usize * self.columns + column as usize];
                    // The bits of a positive float sort like its value.
                    let key = |m: usize| u64::from(((saddles[m].position - from).norm_squared() as f32).to_bits()) << 32 | m as u64;
                    near.extend(members.iter().filter(|&&m| m != index).map(|&m| key(m)));
                }
            }
            // One more ring: its nearest may be nearer than the farthest of this one.
            if enough_at.is_none() && near.len() >= most {
                enough_at = Some(ring + 1);
            }
        }
    }
}
