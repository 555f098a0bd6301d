//! Which parts of a frame are searched in its turn, so that no frame takes long.
//!
//! What is unexplained is cut into windows that overlap by half: a picture that is no larger than half a window is whole in one of them. Each frame takes
//! the next few, as many as their pixels allow, and all where they are few. The choice depends on nothing but the frames that came before.

/// Side of a window, pixels. Chosen, not tuned: props that are larger have enough features in any part of them. Raised, a slice takes longer; lowered,
/// pictures are cut more often.
const SIDE_PX: u32 = 400;
/// From one window to the next: half, see above. Raised, pictures between two windows are cut; lowered, there are more windows.
const STEP_PX: u32 = SIDE_PX / 2;
/// Pixels of a slice at most, if it has more than one window: features of as many are found in about a millisecond. Raised, frames in which a body is missing
/// take longer; lowered, it takes more frames to look everywhere.
const SLICE_PX: u64 = 200_000;

/// A part of a region.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Window {
    /// The region's number.
    pub region: usize,
    /// First column and row in the frame.
    pub origin: [u32; 2],
    /// Columns and rows.
    pub size: [u32; 2],
}

impl Window {
    /// Its pixels.
    pub fn area(&self) -> u64 {
        self.size.iter().map(|n| u64::from(*n)).product()
    }
}

/// The windows of a frame, and whose turn it is; keeps its buffers.
#[derive(Debug, Default)]
pub struct SearchWindows {
    all: Vec<Window>,
    slice: Vec<Window>,
    next: usize,
}

impl SearchWindows {
    /// The windows of this frame's turn; `regions`: first column and row, and size, of each.
    pub fn next_slice(&mut self, regions: impl Iterator<Item = ([u32; 2], [u32; 2])>) -> &[Window] {
        self.all.clear();
        self.slice.clear();
        for (region, (origin, size)) in regions.enumerate() {
            let [across, down] = size.map(Pieces::of);
            for row in 0..down.count {
                for column in 0..across.count {
                    let origin = [origin[0] + across.start(column), origin[1] + down.start(row)];
                    self.all.push(Window { region, origin, size: [across.length, down.length] });
                }
            }
        }
        let mut pixels = 0;
        for k in 0..self.all.len() {
            let window = self.all[(self.next + k) % self.all.len()];
            pixels += window.area();
            if k > 0 && pixels > SLICE_PX {
                break;
            }
            self.slice.push(window);
        }
        self.next = (self.next + self.slice.len()) % self.all.len().max(1);
        &self.slice
    }
}

/// An axis of a region, cut into pieces of one length that overlap.
struct Pieces {
    count: u32,
    length: u32,
    whole: u32,
}

impl Pieces {
    fn of(whole: u32) -> Self {
        // A little more than a window is not worth two.
        let count = if whole <= SIDE_PX + STEP_PX / 2 { 1 } else { (whole - SIDE_PX).div_ceil(STEP_PX) + 1 };
        Self { count, length: if count == 1 { whole } else { SIDE_PX }, whole }
    }

    fn start(&self, k: u32) -> u32 {
        if self.count == 1 { 0 } else { (self.whole - self.length) * k / (self.count - 1) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_few_props_are_all_searched_in_every_frame() {
        let props = [([100, 100], [150, 200]), ([600, 300], [200, 200]), ([1000, 20], [120, 90])];
        let mut windows = SearchWindows::default();
        for _ in 0..3 {
            let slice = windows.next_slice(props.into_iter()).to_vec();
            let mut regions: Vec<usize> = slice.iter().map(|w| w.region).collect();
            regions.sort_unstable();
            assert_eq!(regions, [0, 1, 2]);
            assert!(slice.iter().all(|w| (w.origin, w.size) == props[w.region]));
        }
    }

    #[test]
    fn a_frame_that_nothing_explains_is_searched_in_turns_that_miss_nothing() {
        let mut windows = SearchWindows::default();
        let mut seen: Vec<Window> = Vec::new();
        let mut turns = 0;
        while turns == 0 || seen.len() < windows.all.len() {
            let slice = windows.next_slice([([0, 0], [1280, 720])].into_iter()).to_vec();
            assert!(!slice.is_empty() && (slice.len() == 1 || slice.iter().map(Window::area).sum::<u64>() <= SLICE_PX));
            seen.extend(slice);
            turns += 1;
        }
        assert!(turns <= 20, "{turns}");
        // Every square of half a window is whole in one.
        for y in (0..=720 - STEP_PX).step_by(20) {
            for x in (0..=1280 - STEP_PX).step_by(20) {
                let holds =
                    |w: &Window| [x, y].iter().enumerate().all(|(k, at)| w.origin[k] <= *at && at + STEP_PX <= w.origin[k] + w.size[k]);
                assert!(seen.iter().any(holds), "{x} {y}");
            }
        }
    }

    #[test]
    fn where_nothing_is_left_to_search_there_are_no_windows() {
        let mut windows = SearchWindows::default();
        windows.next_slice([([0, 0], [1280, 720])].into_iter());
        assert!(windows.next_slice(std::iter::empty()).is_empty());
        assert_eq!(windows.next_slice([([5, 5], [60, 60])].into_iter()).len(), 1);
    }
}
