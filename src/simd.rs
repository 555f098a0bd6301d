//! Compiles kernels twice: for the baseline registers, and for wider ones that are used if the
//! processor has them.

/// Defines a function that calls `$wide`, compiled for the named x86-64 features, if the processor
/// has them all, and `$plain` otherwise. Both must be `#[inline(always)]` so that they are compiled
/// into the respective variant.
macro_rules! multiversion {
    ($(#[$doc:meta])* $vis:vis fn $name:ident($($arg:ident: $ty:ty),*) $(-> $ret:ty)?; [$($feature:tt)+] => $wide:expr, else $plain:expr) => {
        $(#[$doc])*
        $vis fn $name($($arg: $ty),*) $(-> $ret)? {
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature($(enable = $feature),+)]
                fn wide($($arg: $ty),*) $(-> $ret)? {
                    $wide($($arg),*)
                }
                if $(std::arch::is_x86_feature_detected!($feature))&&+ {
                    // SAFETY: the processor has the features that the function is compiled for.
                    return unsafe { wide($($arg),*) };
                }
            }
            $plain($($arg),*)
        }
    };
}
pub(crate) use multiversion;
