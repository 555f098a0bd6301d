//! Which parts of a frame are searched in its turn, so that no frame takes long.
//!
//! What is unexplained is cut into windows that overlap by half: a picture that is no larger than half a window is whole in one of them. A window is
//! as large as what it holds, and one that holds nothing is left out: people are tall and narrow, and stand in wide rectangles. Each frame takes
//! the most urgent ones, as many as their pixels allow, and all where they are few. The choice depends on nothing but the frames that came before.

/// Side of a window, pixels. Chosen, not tuned: props that are larger have enough features in any part of them. Raised, a slice takes longer; lowered,
/// pictures are cut more often.
const SIDE_PX: u32 = 400;
/// Pixels of a region that is one window, whatever its shape: of what is a little larger than a window each way. People beside the frame are narrow and as high as it.
/// Raised, a slice takes longer; lowered, what is narrow is searched almost twice.
const WHOLE_PX: u64 = ((SIDE_PX + STEP_PX / 2) * (SIDE_PX + STEP_PX / 2)) as u64;
/// From one window to the next: half, see above. Raised, pictures between two windows are cut; lowered, there are more windows.
const STEP_PX: u32 = SIDE_PX / 2;
/// Pixels of a slice at most, if it has more than one window: a whole window and a small one beside it, whose features take one and a half milliseconds. Raised,
/// frames in which a body is missing take longer; lowered, it takes more frames to look everywhere.
const SLICE_PX: u64 = 280_000;

/// A part of a region.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Window {
    /// The region's number.
    pub region: usize,
    /// First column and row in the frame.
    pub origin: [u32; 2],
    /// Columns and rows.
    pub size: [u32; 2],
    /// First and last column and row, the last ones exclusive, of the part that lies nearer the middle of this window than of any other of its region. What
    /// is small and stands there is whole in this window.
    pub own: [[u32; 2]; 2],
}

impl Window {
    /// Its pixels.
    pub fn area(&self) -> u64 {
        self.size.iter().map(|n| u64::from(*n)).product()
    }
}

/// The windows of a frame; keeps its buffers.
#[derive(Debug, Default)]
pub struct SearchWindows {
    all: Vec<(Window, f32)>,
    slice: Vec<Window>,
}

impl SearchWindows {
    /// The most urgent windows of a frame; `regions`: first column and row, and size, of each. `content`: the part of a window that is worth a search, and how urgent it is.
    pub fn next_slice(
        &mut self,
        regions: impl Iterator<Item = ([u32; 2], [u32; 2])>,
        content: impl Fn(&Window) -> Option<(Window, f32)>,
    ) -> &[Window] {
        self.all.clear();
        self.slice.clear();
        for (region, (origin, size)) in regions.enumerate() {
            let is_whole = size.iter().map(|n| u64::from(*n)).product::<u64>() <= WHOLE_PX;
            let [across, down] = size.map(|length| if is_whole { Pieces::one(length) } else { Pieces::of(length) });
            for row in 0..down.count {
                for column in 0..across.count {
                    let at = |places: [u32; 2]| [origin[0] + places[0], origin[1] + places[1]];
                    let (own_columns, own_rows) = (across.own(column), down.own(row));
                    self.all.extend(content(&Window {
                        region,
                        origin: at([across.start(column), down.start(row)]),
                        size: [across.length, down.length],
                        own: [at([own_columns[0], own_rows[0]]), at([own_columns[1], own_rows[1]])],
                    }));
                }
            }
        }
        // Where two are equal, the first one.
        let first = |w: &Window| (w.region, w.origin[1], w.origin[0]);
        self.all.sort_unstable_by(|a, b| b.1.total_cmp(&a.1).then_with(|| first(&a.0).cmp(&first(&b.0))));
        // What does not fit beside more urgent ones waits; smaller ones do not wait with it.
        let mut pixels = 0;
        for (window, _) in &self.all {
            if self.slice.is_empty() || pixels + window.area() <= SLICE_PX {
                pixels += window.area();
                self.slice.push(*window);
            }
        }
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
    fn one(whole: u32) -> Self {
        Self { count: 1, length: whole, whole }
    }

    fn of(whole: u32) -> Self {
        // A little more than a window is not worth two.
        let count = if whole <= SIDE_PX + STEP_PX / 2 { 1 } else { (whole - SIDE_PX).div_ceil(STEP_PX) + 1 };
        Self { count, length: if count == 1 { whole } else { SIDE_PX }, whole }
    }

    fn start(&self, k: u32) -> u32 {
        if self.count == 1 { 0 } else { (self.whole - self.length) * k / (self.count - 1) }
    }

    /// First and last place, exclusive, of what lies nearer the middle of this piece than of its neighbours.
    fn own(&self, k: u32) -> [u32; 2] {
        let border = |k: u32| (self.start(k - 1) + self.start(k) + self.length) / 2;
        [if k == 0 { 0 } else { border(k) }, if k + 1 == self.count { self.whole } else { border(k + 1) }]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PROPS: [([u32; 2], [u32; 2]); 3] = [([100, 100], [150, 200]), ([600, 300], [200, 200]), ([1000, 20], [120, 90])];

    #[test]
    fn a_few_props_are_all_searched_in_every_frame() {
        let slice = SearchWindows::default().next_slice(PROPS.into_iter(), |w| Some((*w, 1.0))).to_vec();
        let regions: Vec<usize> = slice.iter().map(|w| w.region).collect();
        assert_eq!(regions, [0, 1, 2]);
        assert!(slice.iter().all(|w| (w.origin, w.size) == PROPS[w.region]));
    }

    #[test]
    fn the_urgent_ones_are_the_first() {
        let urgent = |w: &Window| Some((*w, [1.0, 5.0, 3.0][w.region]));
        let mut windows = SearchWindows::default();
        let regions = windows.next_slice(PROPS.into_iter(), urgent).iter().map(|w| w.region).collect::<Vec<_>>();
        assert_eq!(regions, [1, 2, 0]);
        let wide = [([0, 0], [1280, 720]), ([600, 300], [200, 200])];
        let slice = windows.next_slice(wide.into_iter(), |w| Some((*w, w.region as f32)));
        assert_eq!((slice[0].region, slice.len()), (1, 2));
    }

    #[test]
    fn what_is_narrow_is_one_window() {
        let strip = ([0, 0], [240, 720]);
        let slice = SearchWindows::default().next_slice([strip].into_iter(), |w| Some((*w, 1.0))).to_vec();
        assert_eq!(slice.iter().map(|w| (w.origin, w.size)).collect::<Vec<_>>(), [strip]);
    }

    #[test]
    fn what_is_small_is_searched_beside_a_window_though_the_next_one_does_not_fit() {
        let (person, prop) = (([200, 0], [400, 720]), ([800, 100], [200, 300]));
        let urgency = |w: &Window| Some((*w, [5.0, 1.0][w.region]));
        let slice = SearchWindows::default().next_slice([person, prop].into_iter(), urgency).to_vec();
        assert_eq!(slice.iter().map(|w| w.region).collect::<Vec<_>>(), [0, 1]);
    }

    #[test]
    fn what_holds_nothing_is_left_out() {
        // Of a frame that is unexplained all over, a person's place is worth a search.
        let person = |window: &Window| {
            let (first, end) = (window.origin[0].max(500), (window.origin[0] + window.size[0]).min(620));
            (first < end).then(|| (Window { origin: [first, window.origin[1]], size: [end - first, window.size[1]], ..*window }, 1.0))
        };
        let mut windows = SearchWindows::default();
        let slice = windows.next_slice([([0, 0], [1280, 720])].into_iter(), person).to_vec();
        assert!(slice.len() >= 3 && slice.iter().all(|w| w.origin[0] >= 500 && w.origin[0] + w.size[0] <= 620), "{slice:?}");
        assert!(windows.next_slice(std::iter::empty(), person).is_empty());
    }

    #[test]
    fn the_windows_miss_nothing() {
        let mut windows = SearchWindows::default();
        let slice = windows.next_slice([([0, 0], [1280, 720])].into_iter(), |w| Some((*w, 1.0))).to_vec();
        assert!(slice.len() == 1 || slice.iter().map(Window::area).sum::<u64>() <= SLICE_PX);
        // Every square of half a window is whole in one.
        for y in (0..=720 - STEP_PX).step_by(20) {
            for x in (0..=1280 - STEP_PX).step_by(20) {
                let holds =
                    |w: &Window| [x, y].iter().enumerate().all(|(k, at)| w.origin[k] <= *at && at + STEP_PX <= w.origin[k] + w.size[k]);
                assert!(windows.all.iter().any(|(w, _)| holds(w)), "{x} {y}");
            }
        }
    }
}
