//! Maximally stable extremal regions (Matas, Chum, Urban & Pajdla, Robust Wide Baseline Stereo from
//! Maximally Stable Extremal Regions, BMVC 2002): connected sets of pixels darker, or lighter, than
//! everything around them, whose area changes little as the threshold varies. They are covariant
//! with the viewpoint and invariant to lighting.
//!
//! The regions of all thresholds form a tree, built by union-find in order of grey level (Berger,
//! Géraud, Levillain, Widynski, Baillard & Bertin, Effective Component Tree Computation with
//! Application to Pattern Recognition in Astronomical Imaging, ICIP 2007).

use image::GrayImage;
use nalgebra::{Matrix2, Vector2};

use super::{Detector, strongest_first};
use crate::features::two_views::keypoint::{Keypoint, PictureForms, square_root};
use crate::features::two_views::watch::Watch;

/// Criteria of stability, and which regions to keep.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MserDetector {
    /// Maximum number of regions, most stable first. Default 5000: more than a 640x480 picture
    /// usually has. Raised, matching takes quadratically longer.
    pub count: usize,
    /// Change of the threshold over which the area's change is measured, grey levels. Default 5, as
    /// in common programs. Raised, regions must have more contrast.
    pub delta: u8,
    /// Minimum area, pixels. Default 60: a disc 9 pixels across. Raised, small regions, whose shape
    /// is less certain, are dropped.
    pub least_area: usize,
    /// Maximum area as a fraction of the picture. Default 0.25. Raised, regions appear that few
    /// other views show completely.
    pub most_area_share: f64,
    /// Maximum relative growth of the area over `delta` levels. Default 0.25. Raised, less stable
    /// regions are kept.
    pub most_variation: f64,
    /// Minimum relative difference in area of two nested regions. Default 0.2. Raised, fewer
    /// regions at the same place are kept, the most stable ones.
    pub least_diversity: f64,
}

impl Default for MserDetector {
    fn default() -> Self {
        Self { count: 5000, delta: 5, least_area: 60, most_area_share: 0.25, most_variation: 0.25, least_diversity: 0.2 }
    }
}

/// Ratio of a keypoint's sigma to the root of its region's second moments. A disc of radius r has
/// second moments of r²/4, and the Gaussian whose Laplacian responds best to it has a sigma of r /
/// √2. So blobs get the same sigma as from other detectors, and descriptors read as much around
/// them.
const SIGMA_BY_MOMENT: f64 = std::f64::consts::SQRT_2;
/// Second moment of a pixel's own square about its centre, squared pixels.
const PIXEL_MOMENT: f64 = 1.0 / 12.0;

impl Detector for MserDetector {
    fn detect(&self, picture: &PictureForms) -> Vec<Keypoint> {
        let mut found = Vec::new();
        // Dark regions, then light ones, which are dark in the negative.
        for flip in [0, u8::MAX] {
            found.extend(ComponentTree::of(picture.grey, flip, &picture.watch).map_or(Vec::new(), |tree| self.stable(&tree)));
        }
        strongest_first(&mut found);
        found.truncate(self.count);
        found
    }
}

impl MserDetector {
    /// Returns the stable regions of a tree.
    fn stable(&self, tree: &ComponentTree) -> Vec<Keypoint> {
        let largest = (self.most_area_share * tree.pixels as f64).clamp(0.0, tree.pixels as f64) as usize;
        let variations = tree.variations(self.delta);
        let mut candidates: Vec<usize> = local_minima(tree, &variations)
            .filter(|&n| {
                let region = &tree.nodes[n];
                let area = region.area as usize;
                // A region cut off by the border has another shape in another view.
                area >= self.least_area.max(1) && area <= largest && f64::from(variations[n]) <= self.most_variation && !region.at_border
            })
            .collect();
        candidates.sort_by(|a, b| variations[*a].total_cmp(&variations[*b]).then(a.cmp(b)));
        let kept = self.diverse(tree, &candidates);
        kept.into_iter().map(|n| keypoint(&tree.nodes[n], variations[n])).collect()
    }

    /// Keeps the first of nested regions that hardly differ.
    fn diverse(&self, tree: &ComponentTree, candidates: &[usize]) -> Vec<usize> {
        let (mut kept, mut is_kept, mut holds_kept) = (Vec::new(), vec![false; tree.nodes.len()], vec![false; tree.nodes.len()]);
        for &candidate in candidates {
            let area = f64::from(tree.nodes[candidate].area);
            let alike = |node: &usize| 1.0 - area / f64::from(tree.nodes[*node].area) < self.least_diversity;
            if holds_kept[candidate] || tree.above(candidate).take_while(alike).any(|n| is_kept[n]) {
                continue;
            }
            kept.push(candidate);
            is_kept[candidate] = true;
            tree.above(candidate).take_while(alike).for_each(|n| holds_kept[n] = true);
        }
        kept
    }
}

/// Returns the ellipse of a region's moments.
fn keypoint(region: &Region, variation: f32) -> Keypoint {
    let area = f64::from(region.area);
    let mean = region.first / area;
    let [xx, xy, yy] = region.second.map(|v| v / area);
    let covariance = Matrix2::new(xx, xy, xy, yy) - mean * mean.transpose() + Matrix2::identity() * PIXEL_MOMENT;
    let shape = square_root(&covariance) * SIGMA_BY_MOMENT;
    Keypoint { position: mean + region.origin, shape, response: 1.0 / (1.0 + variation) }
}

/// Returns nodes with less variation than the region around them, and no more than any inside them.
fn local_minima<'a>(tree: &'a ComponentTree, variations: &'a [f32]) -> impl Iterator<Item = usize> + 'a {
    let mut least_inside = vec![f32::INFINITY; tree.nodes.len()];
    for (n, node) in tree.nodes.iter().enumerate().skip(1) {
        let parent = &mut least_inside[node.parent as usize];
        *parent = parent.min(variations[n]);
    }
    (1..tree.nodes.len()).filter(move |&n| variations[n] < variations[tree.nodes[n].parent as usize] && variations[n] <= least_inside[n])
}

/// A connected set of pixels up to a grey level.
#[derive(Debug, Clone, Copy)]
struct Region {
    /// The smallest larger region, at the next higher level at which pixels join; the root's is
    /// itself.
    parent: u32,
    /// Grey level of its lightest pixels.
    level: u8,
    at_border: bool,
    /// Number of pixels.
    area: u32,
    /// Origin of the sums: the picture's centre.
    origin: Vector2<f64>,
    /// Sums of x and y.
    first: Vector2<f64>,
    /// Sums of x², xy and y².
    second: [f64; 3],
}

/// All regions of a picture, each after its parent; the first is the whole picture.
struct ComponentTree {
    nodes: Vec<Region>,
    pixels: usize,
}

impl ComponentTree {
    /// Builds the tree of the grey levels, each exclusive-or `flip`; `None` if there are no pixels
    /// or the work was stopped.
    fn of(picture: &GrayImage, flip: u8, watch: &Watch) -> Option<Self> {
        let (width, pixels) = (picture.width() as usize, picture.as_raw().len());
        // Pixels are counted by u32, like a picture's sides; no picture in memory has more.
        if pixels == 0 || u32::try_from(pixels).is_err() {
            return None;
        }
        let levels: Vec<u8> = picture.as_raw().iter().map(|v| v ^ flip).collect();
        let order = by_level(&levels);
        let parents = parents(&levels, &order, width, watch)?;
        Some(Self { nodes: regions(&levels, &order, &parents, width, watch)?, pixels })
    }

    /// Returns the regions that contain a node, smallest first.
    fn above(&self, node: usize) -> impl Iterator<Item = usize> + '_ {
        let parent = |n: usize| (n != 0).then(|| self.nodes[n].parent as usize);
        std::iter::successors(parent(node), move |n| parent(*n))
    }

    /// Returns the relative growth of each region over `delta` levels.
    fn variations(&self, delta: u8) -> Vec<f32> {
        let growth = |n: usize| {
            let node = &self.nodes[n];
            let within = |m: &usize| self.nodes[*m].level <= node.level.saturating_add(delta);
            let grown = self.above(n).take_while(within).last().unwrap_or(n);
            (self.nodes[grown].area - node.area) as f32 / node.area as f32
        };
        (0..self.nodes.len()).map(growth).collect()
    }
}

/// Returns pixel indices sorted by level, within a level in reading order.
fn by_level(levels: &[u8]) -> Vec<u32> {
    let mut next = [0u32; 257];
    levels.iter().for_each(|v| next[usize::from(*v) + 1] += 1);
    for k in 1..next.len() {
        next[k] += next[k - 1];
    }
    let mut order = vec![0; levels.len()];
    for (pixel, level) in (0u32..).zip(levels) {
        let place = &mut next[usize::from(*level)];
        order[*place as usize] = pixel;
        *place += 1;
    }
    order
}

/// Pixels between two calls of the watch: a few hundredths of a second. Raised, an interrupt takes
/// longer; lowered to some hundred, the calls take time themselves.
const BETWEEN_LOOKS: usize = 1 << 18;

/// Marks a pixel that has not been visited.
const NONE: u32 = u32::MAX;

/// Returns for each pixel the representative of the set it joined: pixels of one level and set
/// share one, whose own is that of the next level. The last pixel in order is its own. `None` if
/// the work was stopped.
fn parents(levels: &[u8], order: &[u32], width: usize, watch: &Watch) -> Option<Vec<u32>> {
    // `roots` leads to the last pixel of each set so far, with path compression.
    let (mut parents, mut roots) = (vec![NONE; levels.len()], vec![NONE; levels.len()]);
    for (k, &pixel) in order.iter().enumerate() {
        if k % BETWEEN_LOOKS == 0 && !watch.goes_on() {
            return None;
        }
        let at = pixel as usize;
        (parents[at], roots[at]) = (pixel, pixel);
        for neighbour in neighbours(at, width, levels.len()) {
            if roots[neighbour] == NONE {
                continue;
            }
            let root = root_of(&mut roots, neighbour as u32);
            if root != pixel {
                (parents[root as usize], roots[root as usize]) = (pixel, pixel);
            }
        }
    }
    // From the whole to its parts: a pixel whose parent has a same-level parent takes that
    // representative.
    for &pixel in order.iter().rev() {
        let parent = parents[pixel as usize];
        let above = parents[parent as usize];
        if levels[above as usize] == levels[parent as usize] {
            parents[pixel as usize] = above;
        }
    }
    Some(parents)
}

/// Returns the pixels beside, above and below one.
fn neighbours(at: usize, width: usize, pixels: usize) -> impl Iterator<Item = usize> {
    let column = at % width;
    let sides = [
        (column > 0, at.wrapping_sub(1)),
        (column + 1 < width, at + 1),
        (at >= width, at.wrapping_sub(width)),
        (at + width < pixels, at + width),
    ];
    sides.into_iter().filter_map(|(inside, place)| inside.then_some(place))
}

/// Finds the root, halving the path for the next time.
fn root_of(roots: &mut [u32], mut at: u32) -> u32 {
    loop {
        let next = roots[at as usize];
        if next == at {
            return at;
        }
        roots[at as usize] = roots[next as usize];
        at = next;
    }
}

/// Returns the regions, from the whole to its parts, with sums over their pixels. `None` if the
/// work was stopped.
fn regions(levels: &[u8], order: &[u32], parents: &[u32], width: usize, watch: &Watch) -> Option<Vec<Region>> {
    let height = levels.len() / width;
    let origin = Vector2::new((width / 2) as f64, (height / 2) as f64);
    // Index of the region that each pixel belongs to.
    let (mut numbers, mut nodes) = (vec![0u32; levels.len()], Vec::new());
    for (k, &pixel) in order.iter().rev().enumerate() {
        if k % BETWEEN_LOOKS == 0 && !watch.goes_on() {
            return None;
        }
        let at = pixel as usize;
        let parent = parents[at];
        let stands = parent == pixel || levels[parent as usize] != levels[at];
        numbers[at] = if stands { nodes.len() as u32 } else { numbers[parent as usize] };
        if stands {
            let empty = Region {
                parent: numbers[parent as usize],
                level: levels[at],
                at_border: false,
                area: 0,
                origin,
                first: Vector2::zeros(),
                second: [0.0; 3],
            };
            nodes.push(empty);
        }
        let (x, y) = (at % width, at / width);
        let [u, v] = [x as f64 - origin.x, y as f64 - origin.y];
        let node = &mut nodes[numbers[at] as usize];
        node.area += 1;
        node.at_border |= x == 0 || y == 0 || x + 1 == width || y + 1 == height;
        node.first += Vector2::new(u, v);
        node.second = [node.second[0] + u * u, node.second[1] + u * v, node.second[2] + v * v];
    }
    for n in (1..nodes.len()).rev() {
        let part = nodes[n];
        let whole = &mut nodes[part.parent as usize];
        whole.area += part.area;
        whole.at_border |= part.at_border;
        whole.first += part.first;
        whole.second.iter_mut().zip(part.second).for_each(|(sum, v)| *sum += v);
    }
    Some(nodes)
}

#[cfg(test)]
mod tests {
    use image::Luma;

    use super::*;
    use crate::features::test_pictures::{DEGENERATE, Ellipse, Painting, noise, rendered, view};
    use crate::features::two_views::repeatability::repeatability;

    fn detect(picture: &GrayImage) -> Vec<Keypoint> {
        MserDetector::default().detect(&PictureForms::new(picture))
    }

    #[test]
    fn ellipses_are_found_with_their_place_and_shape() {
        for contrast in [-90.0, 90.0] {
            for (k, axes) in [[8.0, 8.0], [18.0, 9.0], [25.0, 7.5], [12.0, 11.0]].into_iter().enumerate() {
                let middle = Vector2::new(48.3 + 0.37 * k as f64, 50.8 - 0.21 * k as f64);
                let ellipse = Ellipse { middle, axes, angle: 0.4 + k as f64 };
                let edge = |p| 1.0 / (1.0 + ((ellipse.distance(p) - 1.0) * axes[1] * 4.0).exp());
                let found = detect(&rendered(100, 96, |p| 128.0 + contrast * edge(p)));
                // The slope of the edge may hold another, less stable one.
                assert!((1..4).contains(&found.len()), "{ellipse:?}: {found:?}");
                assert!((found[0].position - middle).norm() < 0.1, "{ellipse:?}: {found:?}");
                // Its sigma is the radius divided by √2.
                let ratio = ellipse.shape().try_inverse().unwrap() * found[0].shape * std::f64::consts::SQRT_2;
                assert!((ratio - Matrix2::identity()).amax() < 0.05, "{ellipse:?}: {ratio}");
            }
        }
    }

    #[test]
    fn the_component_tree_matches_flood_fills_at_each_level() {
        // Few levels, so that sets are large.
        let picture = noise(23, 17);
        let picture = GrayImage::from_fn(23, 17, |x, y| Luma([picture.get_pixel(x, y).0[0] / 32]));
        let tree = ComponentTree::of(&picture, 0, &Watch::NONE).unwrap();
        let mut flooded: Vec<(u8, u32, u32)> = Vec::new();
        for level in 0..8 {
            let mut open: Vec<bool> = picture.as_raw().iter().map(|v| *v <= level).collect();
            for start in 0..open.len() {
                let (mut front, mut pixels) = (Vec::new(), Vec::new());
                if std::mem::take(&mut open[start]) {
                    front.push(start);
                }
                while let Some(at) = front.pop() {
                    pixels.push(at);
                    front.extend(neighbours(at, 23, open.len()).filter(|n| std::mem::take(&mut open[*n])));
                }
                // A set without a pixel of the level belongs to a lower one.
                if pixels.iter().any(|p| picture.as_raw()[*p] == level) {
                    flooded.push((level, pixels.len() as u32, pixels.iter().map(|p| (p % 23) as u32).sum()));
                }
            }
        }
        let sum_x = |n: &Region| (n.first.x + f64::from(n.area) * n.origin.x).round() as u32;
        let mut nodes: Vec<(u8, u32, u32)> = tree.nodes.iter().map(|n| (n.level, n.area, sum_x(n))).collect();
        flooded.sort_unstable();
        nodes.sort_unstable();
        assert_eq!(nodes, flooded);
        for (n, node) in tree.nodes.iter().enumerate().skip(1) {
            let parent = &tree.nodes[node.parent as usize];
            assert!((node.parent as usize) < n && parent.level > node.level && parent.area > node.area);
        }
    }

    #[test]
    fn regions_repeat_across_views() {
        let painting = Painting::new();
        let first = detect(&painting.seen(&view(0.0, 0.0, 1.0)));
        assert!(first.len() > 50, "{}", first.len());
        for (rotation, tilt, scale) in [(0.7, 0.0, 1.0), (0.0, 0.52, 1.0), (0.0, 0.0, 0.6), (1.9, 0.52, 0.8)] {
            let known = view(rotation, tilt, scale);
            // Skip what is too small to be found in the second picture.
            let large: Vec<Keypoint> = first.iter().filter(|k| k.scale() * scale > 4.0).copied().collect();
            let found = repeatability(&large, &detect(&painting.seen(&known)), &known, [(300, 300); 2]);
            assert!(found.share > 0.6 && found.error_px.unwrap() < 0.4, "{rotation} {tilt} {scale}: {found:?} of {}", large.len());
        }
    }

    #[test]
    fn regions_are_invariant_to_lighting() {
        let picture = Painting::new().seen(&view(0.0, 0.0, 1.0));
        let darker = GrayImage::from_fn(300, 300, |x, y| Luma([20 + picture.get_pixel(x, y).0[0] / 2]));
        let still = view(0.0, 0.0, 1.0);
        let found = repeatability(&detect(&picture), &detect(&darker), &still, [(300, 300); 2]);
        assert!(found.share > 0.8, "{found:?}");
    }

    #[test]
    fn one_of_two_similar_regions_is_kept() {
        let picture = Painting::new().seen(&view(0.0, 0.0, 1.0));
        let kept = |least_diversity| MserDetector { least_diversity, ..MserDetector::default() }.detect(&PictureForms::new(&picture)).len();
        assert!(kept(0.0) >= kept(0.2) && kept(0.2) > kept(0.9), "{} {} {}", kept(0.0), kept(0.2), kept(0.9));
        assert_eq!(MserDetector { count: 7, ..MserDetector::default() }.detect(&PictureForms::new(&picture)).len(), 7);
    }

    #[test]
    fn detection_is_repeatable_and_finds_nothing_in_blank_pictures() {
        let picture = noise(200, 150);
        assert_eq!(detect(&picture), detect(&picture));
        for (width, height) in DEGENERATE {
            for level in [0, 128, 255] {
                assert!(detect(&GrayImage::from_pixel(width, height, Luma([level]))).is_empty());
            }
            detect(&noise(width, height)).iter().for_each(|k| assert!(k.shape.iter().all(|v| v.is_finite())));
        }
        let odd = MserDetector {
            count: 9,
            delta: 255,
            least_area: 0,
            most_area_share: f64::NAN,
            most_variation: f64::NAN,
            least_diversity: f64::NAN,
        };
        assert!(odd.detect(&PictureForms::new(&picture)).is_empty());
        let all =
            MserDetector { delta: 0, least_area: 0, most_area_share: 9.0, most_variation: 1e9, least_diversity: -1.0, count: usize::MAX };
        assert!(all.detect(&PictureForms::new(&picture)).iter().all(|k| k.shape.determinant() > 0.0));
    }
}
