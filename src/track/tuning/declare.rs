//! The macro that declares the tuning constants of a room.

/// Declares a struct of tuning constants, each with its value, and `TUNING` with all of them.
///
/// `TUNING` is a constant: the compiler folds its fields as it would single constants.
macro_rules! tuning {
    ($(#[$about:meta])* pub struct $Name:ident { $($(#[$doc:meta])* $field:ident: $kind:ty = $value:expr,)* }) => {
        $(#[$about])*
        #[derive(Clone, Copy, Debug)]
        pub struct $Name { $($(#[$doc])* pub $field: $kind,)* }

        /// The values in use.
        pub const TUNING: $Name = $Name { $($field: $value,)* };
    };
}
