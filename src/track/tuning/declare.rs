//! The macro that declares the tuning constants of a room.

/// Declares a struct of tuning constants, each with its value, and `TUNING` with all of them.
///
/// `TUNING` is a constant: the compiler folds its fields as it would single constants. With the
/// feature `tuning` it is a static whose fields can be scaled, to measure what each constant does.
macro_rules! tuning {
    ($(#[$about:meta])* pub struct $Name:ident { $($(#[$doc:meta])* $field:ident: $kind:ty = $value:expr,)* }) => {
        $(#[$about])*
        #[derive(Clone, Copy, Debug)]
        pub struct $Name { $($(#[$doc])* pub $field: $kind,)* }

        /// The values in use.
        #[cfg(not(feature = "tuning"))]
        pub const TUNING: $Name = $Name { $($field: $value,)* };

        /// The values in use.
        #[cfg(feature = "tuning")]
        pub static TUNING: crate::track::tuning::adjustable::Adjustable<$Name> =
            crate::track::tuning::adjustable::Adjustable::new(&$Name { $($field: $value,)* });

        #[cfg(feature = "tuning")]
        impl crate::track::tuning::adjustable::Constants for $Name {
            /// In the order in which they are declared.
            const NAMES: &'static [&'static str] = &[$(stringify!($field),)*];

            fn scaled(&self, name: &str, factor: f64) -> Option<Self> {
                use crate::track::tuning::adjustable::Scale;
                let mut scaled = *self;
                match name {
                    $(stringify!($field) => scaled.$field = self.$field.scaled(factor),)*
                    _ => return None,
                }
                Some(scaled)
            }

            fn value(&self, name: &str) -> Option<String> {
                match name {
                    $(stringify!($field) => Some(format!("{:?}", self.$field)),)*
                    _ => None,
                }
            }
        }
    };
}
