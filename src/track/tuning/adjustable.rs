//! Tuning constants that can be scaled while the program runs, to measure what each of them does.
//! Only built with the feature `tuning`; otherwise they are constants.

use std::ops::Deref;
use std::sync::{PoisonError, RwLock};

/// The constants of one room.
pub trait Constants: Sized {
    /// Their names, in the order in which they are declared.
    const NAMES: &'static [&'static str];

    /// Returns all constants, one of them multiplied by a factor. `None` if none has this name.
    fn scaled(&self, name: &str, factor: f64) -> Option<Self>;

    /// Returns the value of a constant as text. `None` if none has this name.
    fn value(&self, name: &str) -> Option<String>;
}

/// The constants of a room, as declared or as adjusted.
#[derive(Debug)]
pub struct Adjustable<T: 'static> {
    declared: &'static T,
    in_use: RwLock<&'static T>,
}

impl<T> Adjustable<T> {
    /// Starts with the values as declared.
    pub const fn new(declared: &'static T) -> Self {
        Self { declared, in_use: RwLock::new(declared) }
    }

    fn replace(&self, values: &'static T) {
        *self.in_use.write().unwrap_or_else(PoisonError::into_inner) = values;
    }
}

impl<T> Deref for Adjustable<T> {
    type Target = T;

    fn deref(&self) -> &T {
        *self.in_use.read().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A room's constants, whatever their type.
pub trait Adjust: Sync {
    /// Returns the names of the constants.
    fn names(&self) -> &'static [&'static str];

    /// Returns the declared value of a constant as text. `None` if none has this name.
    fn value(&self, name: &str) -> Option<String>;

    /// Multiplies the declared value of a constant by a factor; all others are as declared. Each
    /// call leaks one set of constants, as they are read without a lock's guard. False if no
    /// constant has this name.
    fn scale(&self, name: &str, factor: f64) -> bool;

    /// Uses all constants as declared.
    fn restore(&self);
}

impl<T: Constants + Sync> Adjust for Adjustable<T> {
    fn names(&self) -> &'static [&'static str] {
        T::NAMES
    }

    fn value(&self, name: &str) -> Option<String> {
        self.declared.value(name)
    }

    fn scale(&self, name: &str, factor: f64) -> bool {
        let scaled = self.declared.scaled(name, factor);
        scaled.map(|values| self.replace(Box::leak(Box::new(values)))).is_some()
    }

    fn restore(&self) {
        self.replace(self.declared);
    }
}

/// A value that a factor can be applied to.
pub trait Scale {
    /// Returns the value times a factor; whole numbers are rounded.
    fn scaled(self, factor: f64) -> Self;
}

impl Scale for f64 {
    fn scaled(self, factor: f64) -> Self {
        self * factor
    }
}

impl Scale for f32 {
    fn scaled(self, factor: f64) -> Self {
        (f64::from(self) * factor) as Self
    }
}

macro_rules! scale_whole {
    ($($Whole:ty)*) => {
        $(impl Scale for $Whole {
            fn scaled(self, factor: f64) -> Self {
                // Saturates at the bounds of the type.
                (self as f64 * factor).round() as Self
            }
        })*
    };
}

scale_whole!(u8 u32 u64 i32 i64 usize);

impl<T: Scale, const N: usize> Scale for [T; N] {
    fn scaled(self, factor: f64) -> Self {
        self.map(|value| value.scaled(factor))
    }
}

/// A threshold with a count that belongs to it: the threshold is scaled.
impl Scale for (f64, usize) {
    fn scaled(self, factor: f64) -> Self {
        (self.0 * factor, self.1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, PartialEq)]
    struct Pair {
        length: f64,
        count: usize,
    }

    impl Constants for Pair {
        const NAMES: &'static [&'static str] = &["length", "count"];

        fn scaled(&self, name: &str, factor: f64) -> Option<Self> {
            let Self { length, count } = *self;
            match name {
                "length" => Some(Self { length: length.scaled(factor), count }),
                "count" => Some(Self { length, count: count.scaled(factor) }),
                _ => None,
            }
        }

        fn value(&self, name: &str) -> Option<String> {
            match name {
                "length" => Some(self.length.to_string()),
                "count" => Some(self.count.to_string()),
                _ => None,
            }
        }
    }

    #[test]
    fn one_constant_is_scaled_at_a_time() {
        static PAIR: Adjustable<Pair> = Adjustable::new(&Pair { length: 0.5, count: 5 });
        assert_eq!((PAIR.names(), PAIR.value("count").as_deref()), (&["length", "count"][..], Some("5")));
        assert!(PAIR.scale("length", 2.0) && *PAIR == Pair { length: 1.0, count: 5 });
        assert!(PAIR.scale("count", 0.5) && *PAIR == Pair { length: 0.5, count: 3 });
        assert!(!PAIR.scale("width", 2.0), "no constant has this name");
        PAIR.restore();
        assert_eq!(*PAIR, Pair { length: 0.5, count: 5 });
    }

    #[test]
    fn values_of_every_kind_scale() {
        assert_eq!(([1.0, 4.0].scaled(0.5), [(0.25, 3)].scaled(2.0)), ([0.5, 2.0], [(0.5, 3)]));
        assert_eq!((200_u8.scaled(2.0), (-3_i32).scaled(2.0), 3_usize.scaled(0.5)), (255, -6, 2));
    }
}
