//! Tiles, into which a level's pixels are grouped, and the nodes of the light grid between them.
//! The pixels of a tile vote together on a pose.

use crate::track::frame::tuning::TUNING;

/// A pixel selected for alignment.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Chosen {
    /// Index of its surface in the body.
    pub surface: u16,
    /// Column and row of the level.
    pub place: [u16; 2],
}

/// The tiles of a body: a grid over the part of the frame that its selected pixels cover.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct TileGrid {
    /// Tiles across and down.
    count: [usize; 2],
    /// First pixel column and row of the level.
    origin: [usize; 2],
    /// Pixels of the level covered, across and down.
    size: [usize; 2],
}

impl TileGrid {
    /// Creates the grid over all selected pixels.
    pub fn covering(chosen: &[Chosen]) -> Self {
        let (mut low, mut high) = ([u16::MAX; 2], [0; 2]);
        for c in chosen {
            for k in 0..2 {
                low[k] = low[k].min(c.place[k]);
                high[k] = high[k].max(c.place[k]);
            }
        }
        let size = [0, 1].map(|k| (usize::from(high[k]) + 1).saturating_sub(usize::from(low[k])).max(1));
        let count = [0, 1].map(|k| (size[k] / TUNING.min_tile_px).clamp(2, TUNING.max_tiles[k]));
        Self { count, origin: low.map(|v| if v == u16::MAX { 0 } else { usize::from(v) }), size }
    }

    /// Writes for each covered column (`axis` 0) or row (1) its tile column or row, and its
    /// position within the cell of two by two tiles, 0 to 1.
    pub fn places(&self, axis: usize, places: &mut Vec<(u16, f32)>) {
        let (count, size) = (self.count[axis], self.size[axis]);
        let cells = count as f32 / 2.0;
        places.clear();
        places.extend((0..size).map(|p| {
            let tile = p * count / size;
            (tile as u16, (p as f32 + 0.5) / size as f32 * cells - (tile / 2) as f32)
        }));
    }

    /// Returns the index of the tile in a column and a row of tiles.
    pub fn tile(&self, column: u16, row: u16) -> usize {
        usize::from(row) * self.count[0] + usize::from(column)
    }

    /// Returns the first pixel column and row of the level.
    pub fn origin(&self) -> [usize; 2] {
        self.origin
    }

    /// Returns the number of tiles.
    pub fn len(&self) -> usize {
        self.count[0] * self.count[1]
    }

    /// Returns the number of light-grid nodes across and down: the corners of the cells.
    pub fn nodes(&self) -> [usize; 2] {
        self.count.map(|c| c.div_ceil(2) + 1)
    }

    /// Returns the light nodes at the corners of a tile's cell: top left, top right, bottom left,
    /// bottom right. Nodes are numbered column by column.
    pub fn nodes_of(&self, tile: usize) -> [usize; 4] {
        let rows = self.nodes()[1];
        let (column, row) = (tile % self.count[0] / 2, tile / self.count[0] / 2);
        let at = |c: usize, r: usize| c * rows + r;
        [at(column, row), at(column + 1, row), at(column, row + 1), at(column + 1, row + 1)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn covering(width: u16, height: u16) -> TileGrid {
        let corner = |x, y| Chosen { surface: 0, place: [x, y] };
        TileGrid::covering(&[corner(40, 30), corner(40 + width - 1, 30 + height - 1)])
    }

    #[test]
    fn a_small_picture_has_as_many_tiles_as_fit() {
        assert_eq!(covering(21, 33).count, [3, 5]);
        assert_eq!(covering(5, 5).count, [2, 2]);
        assert_eq!(covering(900, 700).count, TUNING.max_tiles);
    }

    #[test]
    fn every_tile_has_its_nodes_and_contains_its_positions() {
        for grid in [covering(21, 33), covering(40, 31), covering(900, 700)] {
            let nodes = grid.nodes()[0] * grid.nodes()[1];
            assert!((0..grid.len()).all(|tile| grid.nodes_of(tile).iter().all(|&node| node < nodes)), "{grid:?}");
            let mut places = Vec::new();
            for axis in [0, 1] {
                grid.places(axis, &mut places);
                assert_eq!(places.len(), grid.size[axis]);
                // A pixel on the border of two cells belongs to one of them.
                assert!(places.iter().all(|(tile, at)| usize::from(*tile) < grid.count[axis] && (-0.05..=1.05).contains(at)), "{grid:?}");
            }
        }
    }
}
