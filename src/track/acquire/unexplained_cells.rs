//! Keeps the square cells of a frame that no followed body explains: which of them form a region,
//! and how long each has waited to be searched.
//!
//! Newly unexplained cells are searched first, because an explained cell changes only if a body or
//! a person comes into view. After that, the cells that have waited longest are searched. Used by
//! `unexplained`; windows come from `search_windows`.

use super::search_windows::{Extent, Window};
use crate::track::acquire::tuning::TUNING;

/// Side of a cell, pixels of the frame. Raised, small props are merged with their surroundings;
/// lowered, a cell has too few pixels to be judged.
pub const CELL_SIDE_PX: u32 = 16;

/// Wait value of an explained cell.
const EXPLAINED_WAIT: u8 = u8::MAX;
/// Label of a cell that is in no region yet.
const UNNUMBERED: u32 = u32::MAX;

/// The cells of a frame; keeps its buffers between frames.
#[derive(Debug, Default)]
pub struct UnexplainedCells {
    /// Cells across and down.
    size: [usize; 2],
    /// 0: explained; otherwise the region's number from 1, or [`UNNUMBERED`] while regions are
    /// being numbered.
    labels: Vec<u32>,
    /// Looks since each cell was searched, or [`EXPLAINED_WAIT`].
    waits: Vec<u8>,
    stack: Vec<usize>,
    /// Number of cells and label of each region.
    regions: Vec<(usize, u32)>,
}

impl UnexplainedCells {
    /// Updates the cells with which of them are unexplained, row by row.
    pub fn renew(&mut self, size: [usize; 2], is_unexplained: impl Iterator<Item = bool>) {
        self.size = size;
        self.waits.resize(size[0] * size[1], EXPLAINED_WAIT);
        self.labels.clear();
        for (wait, is_unexplained) in self.waits.iter_mut().zip(is_unexplained) {
            self.labels.push(if is_unexplained { UNNUMBERED } else { 0 });
            *wait = match (is_unexplained, *wait) {
                (false, _) => EXPLAINED_WAIT,
                (true, EXPLAINED_WAIT) => TUNING.initial_wait,
                (true, wait) => wait.saturating_add(1).min(EXPLAINED_WAIT - 1),
            };
        }
    }

    /// Numbers the regions: cells connected by a common side.
    pub fn number_regions(&mut self) {
        let [across, down] = self.size;
        self.regions.clear();
        for first in 0..self.labels.len() {
            if self.labels[first] != UNNUMBERED {
                continue;
            }
            let number = self.regions.len() as u32 + 1;
            let mut size = 0;
            self.labels[first] = number;
            self.stack.push(first);
            while let Some(cell) = self.stack.pop() {
                size += 1;
                let (column, row) = (cell % across, cell / across);
                let beside = [
                    (column > 0).then(|| cell - 1),
                    (column + 1 < across).then_some(cell + 1),
                    (row > 0).then(|| cell - across),
                    (row + 1 < down).then_some(cell + across),
                ];
                for next in beside.into_iter().flatten() {
                    if self.labels[next] == UNNUMBERED {
                        self.labels[next] = number;
                        self.stack.push(next);
                    }
                }
            }
            self.regions.push((size, number));
        }
        self.regions.retain(|(size, _)| *size >= TUNING.min_region_cells);
        // Largest first; ties in reading order.
        self.regions.sort_unstable_by(|a, b| b.0.cmp(&a.0).then(a.1.cmp(&b.1)));
        self.regions.truncate(TUNING.max_regions);
    }

    /// Returns the number of cells and the label of each region, largest first.
    pub fn regions(&self) -> &[(usize, u32)] {
        &self.regions
    }

    /// Returns the first and end pixels (exclusive) of a region.
    pub fn extent(&self, number: u32) -> Extent {
        let own = (0..self.labels.len()).filter(|cell| self.labels[*cell] == number).map(|cell| self.pixel(cell));
        own.fold([[u32::MAX; 2], [0; 2]], |[low, high], at| {
            [[0, 1].map(|k| low[k].min(at[k])), [0, 1].map(|k| high[k].max(at[k] + CELL_SIDE_PX))]
        })
    }

    /// Appends a row of the region's mask between two columns (end exclusive): 255 inside the
    /// region, 0 elsewhere.
    pub fn push_row(&self, [from, to]: [u32; 2], y: u32, number: u32, row: &mut Vec<u8>) {
        let mut x = from;
        while x < to {
            let next = to.min(x - x % CELL_SIDE_PX + CELL_SIDE_PX);
            row.resize(row.len() + (next - x) as usize, if self.is_in([x, y], number) { 255 } else { 0 });
            x = next;
        }
    }

    /// Whether a pixel of the frame lies in a region.
    fn is_in(&self, [x, y]: [u32; 2], number: u32) -> bool {
        let [column, row] = [x, y].map(|v| (v / CELL_SIDE_PX) as usize);
        column < self.size[0] && self.labels.get(row * self.size[0] + column) == Some(&number)
    }

    /// Returns the first pixel of a cell.
    fn pixel(&self, cell: usize) -> [u32; 2] {
        [cell % self.size[0], cell / self.size[0]].map(|v| v as u32 * CELL_SIDE_PX)
    }

    /// Returns the cells of a window's region whose first pixels lie in a rectangle (end
    /// exclusive).
    fn cells_of(&self, window: &Window, [from, to]: Extent) -> impl Iterator<Item = usize> + use<'_> {
        let [columns, rows] = [0, 1].map(|k| {
            let [first, end] = [from[k], to[k]].map(|v| (v.div_ceil(CELL_SIDE_PX) as usize).min(self.size[k]));
            first..end
        });
        let number = self.regions.get(window.region).map_or(0, |region| region.1);
        let across = self.size[0];
        rows.flat_map(move |row| columns.clone().map(move |column| row * across + column)).filter(move |cell| self.labels[*cell] == number)
    }

    /// Returns the part of a window that contains its cells, with the margin, and the mean wait of
    /// those cells that are nearest to this window's middle. `None` if there are none of these, or
    /// too few cells in all: a small region is complete in a neighbouring window.
    pub fn content(&self, window: &Window) -> Option<(Window, f32)> {
        let (mut low, mut high, mut cells) = ([u32::MAX; 2], [0; 2], 0);
        for cell in self.cells_of(window, [window.origin, [0, 1].map(|k| window.origin[k] + window.size[k])]) {
            cells += 1;
            let at = self.pixel(cell);
            low = [0, 1].map(|k| low[k].min(at[k]));
            high = [0, 1].map(|k| high[k].max(at[k] + CELL_SIDE_PX));
        }
        let (waited, own) = self.cells_of(window, window.own).fold((0.0, 0), |(sum, n), cell| (sum + f32::from(self.waits[cell]), n + 1));
        if cells < TUNING.min_region_cells || own == 0 {
            return None;
        }
        let origin = [0, 1].map(|k| low[k].saturating_sub(TUNING.region_margin_px).max(window.origin[k]));
        let size = [0, 1].map(|k| (high[k] + TUNING.region_margin_px).min(window.origin[k] + window.size[k]) - origin[k]);
        Some((Window { origin, size, ..*window }, waited / own as f32))
    }

    /// Resets the wait of the cells nearest to the middle of a window that was searched.
    pub fn note_searched(&mut self, window: &Window) {
        let mut waits = std::mem::take(&mut self.waits);
        self.cells_of(window, window.own).for_each(|cell| waits[cell] = 0);
        self.waits = waits;
    }
}

#[cfg(test)]
mod tests {
    use super::super::search_windows::SearchWindows;
    use super::*;

    const SIZE: [usize; 2] = [80, 45];

    /// Updates the cells of a frame that is unexplained in these rectangles of cells: first and end
    /// column and row, exclusive.
    fn look(cells: &mut UnexplainedCells, open: &[[usize; 4]]) {
        let is_open = |cell: usize| {
            let (column, row) = (cell % SIZE[0], cell / SIZE[0]);
            open.iter().any(|[left, top, right, bottom]| (*left..*right).contains(&column) && (*top..*bottom).contains(&row))
        };
        cells.renew(SIZE, (0..SIZE[0] * SIZE[1]).map(is_open));
        cells.number_regions();
    }

    fn whole(region: usize) -> Window {
        Window { region, origin: [0, 0], size: [1280, 720], own: [[0, 0], [1280, 720]] }
    }

    #[test]
    fn new_regions_are_urgent_and_searched_ones_wait() {
        let (person, prop) = ([30, 5, 45, 45], [5, 5, 9, 9]);
        let mut cells = UnexplainedCells::default();
        look(&mut cells, &[person]);
        cells.note_searched(&whole(0));
        look(&mut cells, &[person, prop]);
        let urgency = |cells: &UnexplainedCells, region: usize| cells.content(&whole(region)).expect("cells enough").1;
        assert_eq!([urgency(&cells, 0), urgency(&cells, 1)], [1.0, f32::from(TUNING.initial_wait)]);
        cells.note_searched(&whole(1));
        for _ in 0..3 {
            look(&mut cells, &[person, prop]);
        }
        assert_eq!([urgency(&cells, 0), urgency(&cells, 1)], [4.0, 3.0]);
    }

    /// Every square of half a window's side lies completely in a window that was searched.
    #[test]
    fn an_unexplained_frame_is_searched_completely_in_turns() {
        let (mut cells, mut windows, mut seen) = (UnexplainedCells::default(), SearchWindows::default(), Vec::new());
        for _ in 0..20 {
            look(&mut cells, &[[0, 0, SIZE[0], SIZE[1]]]);
            windows.begin_slice(std::iter::empty(), std::iter::empty(), |_| None);
            let slice = windows.fill_slice([[[0, 0], [1280, 720]]].into_iter(), |window| cells.content(window)).to_vec();
            assert!(!slice.is_empty());
            slice.iter().for_each(|window| cells.note_searched(window));
            seen.extend(slice);
        }
        let side = 200;
        for y in (0..=720 - side).step_by(20) {
            for x in (0..=1280 - side).step_by(20) {
                let holds =
                    |w: &Window| [x, y].iter().enumerate().all(|(k, at)| w.origin[k] <= *at && at + side <= w.origin[k] + w.size[k]);
                assert!(seen.iter().any(holds), "{x} {y}");
            }
        }
    }

    #[test]
    fn a_window_fits_its_content() {
        let mut cells = UnexplainedCells::default();
        look(&mut cells, &[[30, 5, 34, 9]]);
        let content = cells.content(&whole(0)).expect("cells enough").0;
        assert_eq!(
            (content.origin, content.size),
            ([480 - TUNING.region_margin_px, 80 - TUNING.region_margin_px], [64 + 2 * TUNING.region_margin_px; 2])
        );
        assert!(cells.is_in([480, 80], 1) && !cells.is_in([479, 80], 1));
        // A window that contains only two cells is not searched.
        let corner = Window { region: 0, origin: [528, 80], size: [200, 32], own: [[528, 80], [728, 112]] };
        assert!(cells.content(&corner).is_none());
    }
}
