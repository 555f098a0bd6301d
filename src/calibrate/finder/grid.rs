//! Values at integer places of the plane, in one block of memory. A lattice queries its
//! neighbourhood all the time, and a search tree would take longer than the corner fits.

/// Coordinates along i and j.
pub(crate) type Place = (i32, i32);

/// Maximum coordinate: twice the largest board
/// ([`Board::new`](crate::calibrate::board::Board::new)), since the root may be any of its corners.
/// Raised, a lattice that grew wrong takes more memory.
const REACH: i32 = 200;
/// Free places kept beyond a new one when the block grows. Raised, blocks hold more empty places;
/// lowered, they are copied more often.
const ROOM: i32 = 3;

/// Values by their places, iterated along j first.
#[derive(Debug, Clone)]
pub(crate) struct Grid<T> {
    low: Place,
    /// Number of places along i and along j.
    size: (i32, i32),
    slots: Vec<Option<T>>,
}

impl<T> Default for Grid<T> {
    fn default() -> Self {
        Self { low: (0, 0), size: (0, 0), slots: Vec::new() }
    }
}

impl<T: Copy> Grid<T> {
    pub fn len(&self) -> usize {
        self.slots.iter().flatten().count()
    }

    fn slot(&self, (i, j): Place) -> Option<usize> {
        let (a, b) = (i - self.low.0, j - self.low.1);
        ((0..self.size.0).contains(&a) && (0..self.size.1).contains(&b)).then(|| (a * self.size.1 + b) as usize)
    }

    fn place(&self, slot: usize) -> Place {
        (self.low.0 + slot as i32 / self.size.1, self.low.1 + slot as i32 % self.size.1)
    }

    pub fn get(&self, at: Place) -> Option<&T> {
        self.slots.get(self.slot(at)?)?.as_ref()
    }

    pub fn contains(&self, at: Place) -> bool {
        self.get(at).is_some()
    }

    /// Sets the value at a place and returns the previous one; ignores places too far away for any
    /// board.
    pub fn insert(&mut self, at: Place, value: T) -> Option<T> {
        if at.0.abs() > REACH || at.1.abs() > REACH {
            return None;
        }
        if self.slot(at).is_none() {
            self.grow(at);
        }
        let slot = self.slot(at)?;
        self.slots[slot].replace(value)
    }

    pub fn remove(&mut self, at: Place) -> Option<T> {
        let slot = self.slot(at)?;
        self.slots[slot].take()
    }

    /// Grows the block to include `at`.
    fn grow(&mut self, at: Place) {
        let (mut low, mut high) = (at, at);
        if !self.slots.is_empty() {
            let last = (self.low.0 + self.size.0 - 1, self.low.1 + self.size.1 - 1);
            low = (low.0.min(self.low.0), low.1.min(self.low.1));
            high = (high.0.max(last.0), high.1.max(last.1));
        }
        (low, high) = ((low.0 - ROOM, low.1 - ROOM), (high.0 + ROOM, high.1 + ROOM));
        let size = (high.0 - low.0 + 1, high.1 - low.1 + 1);
        let mut grown = Self { low, size, slots: vec![None; (size.0 * size.1) as usize] };
        for (place, value) in self.iter() {
            if let Some(slot) = grown.slot(place) {
                grown.slots[slot] = Some(*value);
            }
        }
        *self = grown;
    }

    pub fn iter(&self) -> impl Iterator<Item = (Place, &T)> {
        self.slots.iter().enumerate().filter_map(|(slot, value)| Some((self.place(slot), value.as_ref()?)))
    }

    /// Returns the values at most `reach` places away along either axis.
    pub fn around(&self, (i, j): Place, reach: i32) -> impl Iterator<Item = &T> {
        let rows = (i - reach - self.low.0).max(0)..(i + reach + 1 - self.low.0).min(self.size.0);
        let [first, last] = [j - reach, j + reach + 1].map(|end| (end - self.low.1).clamp(0, self.size.1) as usize);
        rows.flat_map(move |row| self.slots[(row * self.size.1) as usize..][first..last].iter().flatten())
    }

    /// Maps the values to others at the same places, or to none.
    pub fn filter_map<U: Copy>(&self, mut to: impl FnMut(Place, &T) -> Option<U>) -> Grid<U> {
        let other = |(slot, value): (usize, &Option<T>)| value.as_ref().and_then(|value| to(self.place(slot), value));
        Grid { low: self.low, size: self.size, slots: self.slots.iter().enumerate().map(other).collect() }
    }

    /// Keeps the values for which `keep` is true.
    pub fn retain(&mut self, mut keep: impl FnMut(Place, &T) -> bool) {
        *self = self.filter_map(|place, value| keep(place, value).then_some(*value));
    }
}

impl<T: Copy> FromIterator<(Place, T)> for Grid<T> {
    fn from_iter<I: IntoIterator<Item = (Place, T)>>(values: I) -> Self {
        let mut grid = Self::default();
        for (at, value) in values {
            grid.insert(at, value);
        }
        grid
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn grid_equals_a_search_tree(steps in proptest::collection::vec(((-12..12_i32, -12..12_i32), any::<u8>(), any::<bool>()), 0..80)) {
            let (mut grid, mut tree) = (Grid::default(), BTreeMap::new());
            for (at, value, insert) in steps {
                if insert {
                    prop_assert_eq!(grid.insert(at, value), tree.insert(at, value));
                } else {
                    prop_assert_eq!(grid.remove(at), tree.remove(&at));
                }
                prop_assert_eq!(grid.len(), tree.len());
                prop_assert_eq!(grid.get(at), tree.get(&at));
            }
            let near: Vec<_> = (-1..=3).flat_map(|i| (-4..=0).map(move |j| (i, j))).filter_map(|at| tree.get(&at)).collect();
            prop_assert_eq!(grid.around((1, -2), 2).collect::<Vec<_>>(), near);
            let mapped = grid.filter_map(|at, value| (value % 2 == 0).then_some((at, *value)));
            prop_assert_eq!(mapped.len(), tree.values().filter(|value| *value % 2 == 0).count());
            prop_assert!(mapped.iter().all(|(at, (from, value))| at == *from && tree.get(&at) == Some(value)));
            grid.retain(|at, value| (at.0 + i32::from(*value)) % 3 != 0);
            tree.retain(|at, value| (at.0 + i32::from(*value)) % 3 != 0);
            prop_assert_eq!(grid.iter().collect::<Vec<_>>(), tree.iter().map(|(at, value)| (*at, value)).collect::<Vec<_>>());
        }
    }

    #[test]
    fn grid_ignores_cells_beyond_any_board() {
        let mut grid = Grid::default();
        assert_eq!(grid.insert((REACH + 1, 0), 1), None);
        assert_eq!(grid.len(), 0);
        grid.insert((-REACH, REACH), 2);
        assert_eq!(grid.get((-REACH, REACH)), Some(&2));
    }
}
