//! Progress and cancellation of slow work: a detector may take many seconds on a large picture.

/// Progress of work that is done in parts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Share {
    /// Number of parts done.
    pub done: usize,
    /// Total number of parts: the simulated views of `asift`; 1 if there are none.
    pub of: usize,
}

impl Share {
    /// No progress, in work without parts.
    pub const NOTHING: Self = Self { done: 0, of: 1 };
}

/// Checks whether to continue, at least every few hundred thousand pixels and at every keypoint.
/// Results of stopped work are useless.
#[derive(Clone, Copy)]
pub(super) struct Watch<'a> {
    goes_on: Option<&'a dyn Fn(Share) -> bool>,
    share: Share,
}

impl<'a> Watch<'a> {
    /// No callback: the work always continues.
    pub const NONE: Self = Self { goes_on: None, share: Share::NOTHING };

    /// Creates a watch. `goes_on` receives the progress; returning false stops the work, and it
    /// must keep returning false.
    pub fn new(goes_on: &'a dyn Fn(Share) -> bool) -> Self {
        Self { goes_on: Some(goes_on), share: Share::NOTHING }
    }

    /// Returns the watch for another part of the work.
    pub fn at(self, share: Share) -> Self {
        Self { share, ..self }
    }

    /// Whether to continue.
    pub fn goes_on(&self) -> bool {
        self.goes_on.is_none_or(|goes_on| goes_on(self.share))
    }

    /// Iterates until the work is stopped.
    pub fn over<I: IntoIterator>(self, items: I) -> impl Iterator<Item = I::Item> {
        items.into_iter().take_while(move |_| self.goes_on())
    }
}

impl std::fmt::Debug for Watch<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Watch").field("share", &self.share).finish_non_exhaustive()
    }
}
