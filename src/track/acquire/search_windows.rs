//! Chooses which unexplained parts of a frame are searched in this frame, so that no frame takes
//! long.
//!
//! Each unexplained region is cut into windows that overlap by half, so any picture up to half a
//! window in size lies completely within one. A window shrinks to its content, and an empty one is
//! skipped: people are tall and narrow, and their bounding boxes are wide. Each frame searches one
//! window at the predicted place of a body, if one was lost just now, and the most urgent other
//! windows, up to a limit of pixels. The choice depends only on earlier frames, so it is
//! reproducible.

use crate::track::acquire::tuning::TUNING;

/// Side of a window, pixels. Raised, a slice takes longer; lowered, pictures are cut more often.
const WINDOW_SIDE_PX: u32 = 400;
/// Maximum area of a region that becomes one window, whatever its shape, pixels. Raised, a slice
/// takes longer; lowered, narrow regions are searched almost twice.
const MAX_SINGLE_WINDOW_PX: u64 = ((WINDOW_SIDE_PX + WINDOW_STEP_PX / 2) * (WINDOW_SIDE_PX + WINDOW_STEP_PX / 2)) as u64;
/// Step between windows, pixels: half a window. Raised, pictures between two windows are cut;
/// lowered, there are more windows.
const WINDOW_STEP_PX: u32 = WINDOW_SIDE_PX / 2;

/// A rectangle of a frame: first column and row, then the end column and row, exclusive.
pub type Extent = [[u32; 2]; 2];

/// A part of a region.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Window {
    /// The region's number.
    pub region: usize,
    /// First column and row in the frame.
    pub origin: [u32; 2],
    /// Columns and rows.
    pub size: [u32; 2],
    /// The part of the window that is nearer to its middle than to that of any other window of its
    /// region. A small picture there lies completely in this window.
    pub own: Extent,
}

impl Window {
    /// Returns its area, pixels.
    pub fn area(&self) -> u64 {
        self.size.iter().map(|n| u64::from(*n)).product()
    }
}

/// The windows of a frame; keeps its buffers between frames.
#[derive(Debug, Default)]
pub struct SearchWindows {
    all: Vec<(Window, f32)>,
    slice: Vec<Window>,
}

impl SearchWindows {
    /// Starts a slice with the most urgent window at a predicted place. `regions`: unexplained
    /// regions of the frame; `places`: where bodies are predicted; `content`: returns the part of a
    /// window worth searching, and its urgency.
    pub fn begin_slice(
        &mut self,
        regions: impl Iterator<Item = Extent>,
        places: impl Iterator<Item = Extent> + Clone,
        content: impl Fn(&Window) -> Option<(Window, f32)>,
    ) -> &[Window] {
        self.all.clear();
        self.slice.clear();
        for (region, whole) in regions.enumerate() {
            for place in places.clone() {
                let [columns, rows] = [0, 1].map(|k| shortened([place[0][k], place[1][k]], [whole[0][k], whole[1][k]]));
                let (Some(columns), Some(rows)) = (columns, rows) else { continue };
                let origin = [columns[0], rows[0]];
                let end = [columns[1], rows[1]];
                self.all.extend(content(&Window { region, origin, size: [0, 1].map(|k| end[k] - origin[k]), own: [origin, end] }));
            }
        }
        self.sort();
        self.slice.extend(self.all.first().map(|(window, _)| *window));
        &self.slice
    }

    /// Fills the slice with the most urgent windows of the regions and returns the whole slice. See
    /// [`begin_slice`](Self::begin_slice).
    pub fn fill_slice(&mut self, regions: impl Iterator<Item = Extent>, content: impl Fn(&Window) -> Option<(Window, f32)>) -> &[Window] {
        self.all.clear();
        for (region, [origin, end]) in regions.enumerate() {
            let size = [0, 1].map(|k| end[k] - origin[k]);
            let is_whole = size.iter().map(|n| u64::from(*n)).product::<u64>() <= MAX_SINGLE_WINDOW_PX;
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
        self.sort();
        // A window too large for the rest of the slice waits; smaller, less urgent ones may still
        // fit.
        let mut pixels = self.slice.iter().map(Window::area).sum::<u64>();
        let least_urgency = if self.slice.is_empty() { 0.0 } else { TUNING.min_joining_wait };
        for (window, _) in self.all.iter().take_while(|(_, urgency)| *urgency >= least_urgency) {
            if self.slice.is_empty() || pixels + window.area() <= TUNING.max_slice_px {
                pixels += window.area();
                self.slice.push(*window);
            }
        }
        &self.slice
    }

    /// Sorts by descending urgency; ties by position in the frame.
    fn sort(&mut self) {
        let first = |w: &Window| (w.region, w.origin[1], w.origin[0]);
        self.all.sort_unstable_by(|a, b| b.1.total_cmp(&a.1).then_with(|| first(&a.0).cmp(&first(&b.0))));
    }
}

/// Returns the part of a place along an axis that lies within a region, limited to the middle
/// `max_predicted_window_px`; `None` if it lies outside.
fn shortened([from, to]: [u32; 2], [first, end]: [u32; 2]) -> Option<[u32; 2]> {
    let spare = to.saturating_sub(from).saturating_sub(TUNING.max_predicted_window_px);
    let [from, to] = [(from + spare / 2).max(first), (to - spare.div_ceil(2)).min(end)];
    (from < to).then_some([from, to])
}

/// An axis of a region, cut into overlapping pieces of equal length.
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
        // A region slightly longer than a window is not worth two.
        let count = if whole <= WINDOW_SIDE_PX + WINDOW_STEP_PX / 2 { 1 } else { (whole - WINDOW_SIDE_PX).div_ceil(WINDOW_STEP_PX) + 1 };
        Self { count, length: if count == 1 { whole } else { WINDOW_SIDE_PX }, whole }
    }

    fn start(&self, k: u32) -> u32 {
        if self.count == 1 { 0 } else { (self.whole - self.length) * k / (self.count - 1) }
    }

    /// Returns the first and end place (exclusive) of what is nearer to the middle of this piece
    /// than to its neighbours'.
    fn own(&self, k: u32) -> [u32; 2] {
        let border = |k: u32| (self.start(k - 1) + self.start(k) + self.length) / 2;
        [if k == 0 { 0 } else { border(k) }, if k + 1 == self.count { self.whole } else { border(k + 1) }]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PROPS: [Extent; 3] = [[[100, 100], [250, 300]], [[600, 300], [800, 500]], [[1000, 20], [1120, 110]]];
    const FRAME: Extent = [[0, 0], [1280, 720]];

    /// Returns a slice without predicted places.
    fn slice(regions: &[Extent], content: impl Fn(&Window) -> Option<(Window, f32)>) -> Vec<Window> {
        SearchWindows::default().fill_slice(regions.iter().copied(), content).to_vec()
    }

    fn extent(w: &Window) -> Extent {
        [w.origin, [0, 1].map(|k| w.origin[k] + w.size[k])]
    }

    #[test]
    fn a_few_props_are_all_searched_in_every_frame() {
        assert_eq!(slice(&PROPS, |w| Some((*w, 1.0))).iter().map(extent).collect::<Vec<_>>(), PROPS);
    }

    #[test]
    fn the_most_urgent_windows_come_first() {
        let urgent = |w: &Window| Some((*w, [1.0, 5.0, 3.0][w.region]));
        assert_eq!(slice(&PROPS, urgent).iter().map(|w| w.region).collect::<Vec<_>>(), [1, 2, 0]);
        let slice = slice(&[FRAME, PROPS[1]], |w| Some((*w, w.region as f32)));
        assert_eq!((slice[0].region, slice.len()), (1, 2));
    }

    #[test]
    fn a_narrow_region_is_one_window() {
        let strip = [[0, 0], [240, 720]];
        assert_eq!(slice(&[strip], |w| Some((*w, 1.0))).iter().map(extent).collect::<Vec<_>>(), [strip]);
    }

    #[test]
    fn small_regions_share_a_slice_with_a_window() {
        let (person, prop) = ([[200, 0], [600, 720]], [[800, 100], [1000, 400]]);
        let urgency = |w: &Window| Some((*w, [5.0, 1.0][w.region]));
        assert_eq!(slice(&[person, prop], urgency).iter().map(|w| w.region).collect::<Vec<_>>(), [0, 1]);
    }

    #[test]
    fn windows_without_content_are_skipped() {
        // The whole frame is unexplained, but only the person's place is worth searching.
        let person = |window: &Window| {
            let (first, end) = (window.origin[0].max(500), (window.origin[0] + window.size[0]).min(620));
            (first < end).then(|| (Window { origin: [first, window.origin[1]], size: [end - first, window.size[1]], ..*window }, 1.0))
        };
        let found = slice(&[FRAME], person);
        assert!(found.len() >= 3 && found.iter().all(|w| w.origin[0] >= 500 && w.origin[0] + w.size[0] <= 620), "{found:?}");
        assert!(slice(&[], person).is_empty());
    }

    #[test]
    fn an_expected_position_is_searched_beside_the_urgent_window() {
        let mut windows = SearchWindows::default();
        let urgency = |w: &Window| Some((*w, if w.origin[0] > 700 { 8.0 } else { 1.0 }));
        let place = [[100, 90], [600, 190]];
        // Takes the middle of a long place, and the more urgent of two.
        let begun = windows.begin_slice([FRAME].into_iter(), [place, [[720, 0], [800, 80]]].into_iter(), urgency).to_vec();
        assert_eq!(begun.iter().map(extent).collect::<Vec<_>>(), [[[720, 0], [800, 80]]]);
        let begun = windows.begin_slice([FRAME].into_iter(), [place].into_iter(), urgency).to_vec();
        assert_eq!(begun.iter().map(extent).collect::<Vec<_>>(), [[[180, 90], [520, 190]]]);
        let all = windows.fill_slice([FRAME].into_iter(), urgency);
        assert!(all.len() == 2 && all[0] == begun[0] && all[1].origin[0] > 700, "{all:?}");
        // A window that was searched two looks ago does not share the slice.
        windows.begin_slice([FRAME].into_iter(), [place].into_iter(), urgency);
        assert_eq!(windows.fill_slice([FRAME].into_iter(), |w| Some((*w, 2.0))), begun);
        // Nothing is searched where everything is explained.
        assert!(windows.begin_slice(PROPS.into_iter(), [[[300, 0], [500, 90]]].into_iter(), urgency).is_empty());
    }

    #[test]
    fn the_windows_miss_nothing() {
        let mut windows = SearchWindows::default();
        let slice = windows.fill_slice([FRAME].into_iter(), |w| Some((*w, 1.0))).to_vec();
        assert!(slice.len() == 1 || slice.iter().map(Window::area).sum::<u64>() <= TUNING.max_slice_px);
        // Every square of half a window's side lies completely in one window.
        for y in (0..=720 - WINDOW_STEP_PX).step_by(20) {
            for x in (0..=1280 - WINDOW_STEP_PX).step_by(20) {
                let holds = |w: &Window| {
                    [x, y].iter().enumerate().all(|(k, at)| w.origin[k] <= *at && at + WINDOW_STEP_PX <= w.origin[k] + w.size[k])
                };
                assert!(windows.all.iter().any(|(w, _)| holds(w)), "{x} {y}");
            }
        }
    }
}
