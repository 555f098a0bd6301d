//! How often a clip's frames come.

use crate::capture::FrameSource;

/// So many rows tell it; more take longer to read, fewer are at the mercy of a single gap.
const ROWS: usize = 31;

/// Frames a second by the median interval of the clip's first rows; none of fewer than two.
pub(super) fn frames_per_s(source: &mut dyn FrameSource) -> Option<f64> {
    let stamps: Vec<i64> = std::iter::from_fn(|| source.next_row()).take(ROWS).map(|row| row.timestamp_ns).collect();
    // Rows that are out of order are skipped, with their intervals.
    let mut intervals: Vec<i64> = stamps.windows(2).map(|pair| pair[1].saturating_sub(pair[0])).filter(|ns| *ns > 0).collect();
    intervals.sort_unstable();
    intervals.get(intervals.len() / 2).map(|ns| 1e9 / *ns as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::{Row, RowContent};

    struct Stamps(std::vec::IntoIter<i64>);

    impl FrameSource for Stamps {
        fn next_row(&mut self) -> Option<Row> {
            let timestamp_ns = self.0.next()?;
            Some(Row {
                sequence: 0,
                timestamp_ns,
                content: RowContent::Undecodable(String::new()),
                decode: std::time::Duration::ZERO,
                received: None,
            })
        }

        fn size(&self) -> (u32, u32) {
            (1, 1)
        }

        fn rows(&self) -> Option<u64> {
            None
        }
    }

    #[test]
    fn a_gap_and_a_row_out_of_order_change_nothing() {
        let rate = |stamps: &[i64]| frames_per_s(&mut Stamps(Vec::from(stamps).into_iter()));
        assert_eq!(rate(&[0, 40_000_000, 80_000_000, 900_000_000, 900_000_000, 100_000_000, 140_000_000]), Some(25.0));
        assert_eq!((rate(&[]), rate(&[7]), rate(&[7, 7])), (None, None, None));
    }
}
