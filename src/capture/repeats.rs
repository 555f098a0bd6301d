//! Whether a picture is the one before once more: a capture card that has no new one, or a driver
//! that hands out a buffer twice.
//!
//! Two pictures of a camera differ by their noise at least, however still it stands. Where the
//! first pictures of a source are all the same, it is a still picture or a drawing, and nothing is
//! said to repeat until one differs. Video that is coded from picture to picture repeats them where
//! nothing moves, so its pictures are never asked.

/// Compares each picture with the last one, byte for byte.
#[derive(Debug, Default)]
pub(crate) struct Repeats {
    last: Vec<u8>,
    has_changed: bool,
}

impl Repeats {
    /// Takes the next picture, as it came from the file or the driver; whether it is the last one
    /// once more.
    pub fn is_repeat(&mut self, bytes: Vec<u8>) -> bool {
        let is_same = self.last == bytes;
        self.has_changed |= !is_same && !self.last.is_empty();
        self.last = bytes;
        is_same && self.has_changed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn repeats(pictures: &str) -> Vec<bool> {
        let mut repeats = Repeats::default();
        pictures.bytes().map(|b| repeats.is_repeat(vec![b; 4])).collect()
    }

    #[test]
    fn a_picture_that_comes_twice_is_a_repeat_once_pictures_have_changed() {
        assert_eq!(repeats("abbbcb"), [false, false, true, true, false, false]);
    }

    #[test]
    fn a_still_picture_never_repeats() {
        assert!(repeats("aaaaa").iter().all(|is_repeat| !is_repeat));
    }
}
