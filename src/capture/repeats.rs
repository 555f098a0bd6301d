//! Detects that a picture repeats the previous one: a capture card had no new picture, or a driver
//! delivered a buffer twice.
//!
//! Two camera pictures differ at least by their noise, however still the camera stands. If all
//! pictures of a source so far are the same, it is a still picture or a drawing, so repeats are
//! reported only after one picture has differed. Inter-frame video codecs repeat pictures where
//! nothing moves, so their pictures are never checked.

/// Compares each picture with the last one, byte for byte.
#[derive(Debug, Default)]
pub(crate) struct Repeats {
    last: Vec<u8>,
    has_changed: bool,
}

impl Repeats {
    /// Takes the next picture as it came from the file or the driver; returns whether it repeats
    /// the last one.
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
    fn a_duplicate_is_a_repeat_only_after_pictures_changed() {
        assert_eq!(repeats("abbbcb"), [false, false, true, true, false, false]);
    }

    #[test]
    fn a_still_picture_never_repeats() {
        assert!(repeats("aaaaa").iter().all(|is_repeat| !is_repeat));
    }
}
