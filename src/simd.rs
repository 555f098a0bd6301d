//! Kernels compiled twice: for the registers that every processor has, and for wider ones, taken where the processor says it has them.

/// Defines a function whose calls go to `$wide`, compiled for the named features of x86-64, where the processor has them all, and to `$plain`
/// elsewhere. Both must be `#[inline(always)]` to be compiled into the one or the other.
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
