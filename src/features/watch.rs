//! Slow work that is heard of while it runs, and that can be ended: in a large picture a detector may take many seconds.

/// How far work is that is done in parts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Share {
    /// Parts that are done.
    pub done: usize,
    /// Parts in all: the simulated views of `asift`; 1 where there are none.
    pub of: usize,
}

impl Share {
    /// Nothing of work that has no parts.
    pub const NOTHING: Self = Self { done: 0, of: 1 };
}

/// Asks whether work goes on, at least every few hundred thousand pixels and at every keypoint. Work that is ended gives something of no use.
#[derive(Clone, Copy)]
pub(super) struct Watch<'a> {
    goes_on: Option<&'a dyn Fn(Share) -> bool>,
    share: Share,
}

impl<'a> Watch<'a> {
    /// Nobody hears of the work, and it goes on.
    pub const NONE: Self = Self { goes_on: None, share: Share::NOTHING };

    /// `goes_on` hears how far the work is; false ends it, and must stay false.
    pub fn new(goes_on: &'a dyn Fn(Share) -> bool) -> Self {
        Self { goes_on: Some(goes_on), share: Share::NOTHING }
    }

    /// The same at another part of the work.
    pub fn at(self, share: Share) -> Self {
        Self { share, ..self }
    }

    /// Whether the work goes on.
    pub fn goes_on(&self) -> bool {
        self.goes_on.is_none_or(|goes_on| goes_on(self.share))
    }

    /// These, until the work is ended.
    pub fn over<I: IntoIterator>(self, items: I) -> impl Iterator<Item = I::Item> {
        items.into_iter().take_while(move |_| self.goes_on())
    }
}

impl std::fmt::Debug for Watch<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Watch").field("share", &self.share).finish_non_exhaustive()
    }
}
