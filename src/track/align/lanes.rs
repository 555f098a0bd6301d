//! Eight numbers at a time: the arithmetic that the alignment kernels are written in, once for AVX2 and once
//! in plain Rust.
//!
//! A kernel is a generic function over [`Lanes`]; which of the two runs is decided at run time. Both do the
//! same steps in the same order, so that the plain one is the other's test.

/// Numbers handled side by side.
pub const LANES: usize = 8;

/// Eight `f32` values with lane-wise arithmetic.
pub trait Lanes: Copy {
    /// Eight `i32` values.
    type Index: Copy;
    /// The same value in every lane.
    fn splat(value: f32) -> Self;
    /// Lane-wise from an array.
    fn load(values: &[f32; LANES]) -> Self;
    /// Into an array.
    fn store(self, values: &mut [f32; LANES]);
    /// `self + other`.
    fn add(self, other: Self) -> Self;
    /// `self - other`.
    fn sub(self, other: Self) -> Self;
    /// `self * other`.
    fn mul(self, other: Self) -> Self;
    /// `self / other`.
    fn div(self, other: Self) -> Self;
    /// `self * factor + summand`.
    fn mul_add(self, factor: Self, summand: Self) -> Self;
    /// The smaller of both.
    fn min(self, other: Self) -> Self;
    /// The larger of both; the other where `self` is not a number.
    fn max(self, other: Self) -> Self;
    /// Largest whole number below or at.
    fn floor(self) -> Self;
    /// log2 of positive normal numbers, straight between the powers of two (continuous, at most 0.09 low).
    fn rough_log2(self) -> Self;
    /// Whole numbers as indices.
    fn to_index(self) -> Self::Index;
    /// One of eight table entries per lane; indices 0 to 7.
    fn lookup(table: &[f32; LANES], index: Self::Index) -> Self;
    /// One of eight table entries per lane; indices 0 to 7.
    fn lookup_index(table: &[i32; LANES], index: Self::Index) -> Self::Index;
    /// `row * stride + column + base`.
    fn address(row: Self::Index, stride: Self::Index, column: Self::Index, base: Self::Index) -> Self::Index;
    /// The bytes at each index, behind it, and both one stride further on; zeros where a read of four bytes would leave `bytes`.
    fn gather_corners(bytes: &[u8], index: Self::Index, stride: Self::Index) -> [Self; 4];
}

/// Plain Rust.
#[derive(Clone, Copy)]
pub struct Plain([f32; LANES]);

impl Plain {
    #[inline(always)]
    fn zip(self, other: Self, f: impl Fn(f32, f32) -> f32) -> Self {
        Self(std::array::from_fn(|k| f(self.0[k], other.0[k])))
    }
}

impl Lanes for Plain {
    type Index = [i32; LANES];

    #[inline(always)]
    fn splat(value: f32) -> Self {
        Self([value; LANES])
    }
    #[inline(always)]
    fn load(values: &[f32; LANES]) -> Self {
        Self(*values)
    }
    #[inline(always)]
    fn store(self, values: &mut [f32; LANES]) {
        *values = self.0;
    }
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.zip(other, |a, b| a + b)
    }
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.zip(other, |a, b| a - b)
    }
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.zip(other, |a, b| a * b)
    }
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        self.zip(other, |a, b| a / b)
    }
    #[inline(always)]
    fn mul_add(self, factor: Self, summand: Self) -> Self {
        Self(std::array::from_fn(|k| self.0[k] * factor.0[k] + summand.0[k]))
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        self.zip(other, |a, b| if a < b { a } else { b })
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        self.zip(other, |a, b| if a > b { a } else { b })
    }
    #[inline(always)]
    fn floor(self) -> Self {
        Self(self.0.map(f32::floor))
    }
    #[inline(always)]
    fn rough_log2(self) -> Self {
        Self(self.0.map(|v| v.to_bits() as i32 as f32 * MANTISSA_STEP - 127.0))
    }
    #[inline(always)]
    fn to_index(self) -> Self::Index {
        self.0.map(|v| v as i32)
    }
    #[inline(always)]
    fn lookup(table: &[f32; LANES], index: Self::Index) -> Self {
        Self(index.map(|k| table[(k & 7) as usize]))
    }
    #[inline(always)]
    fn lookup_index(table: &[i32; LANES], index: Self::Index) -> Self::Index {
        index.map(|k| table[(k & 7) as usize])
    }
    #[inline(always)]
    fn address(row: Self::Index, stride: Self::Index, column: Self::Index, base: Self::Index) -> Self::Index {
        std::array::from_fn(|k| row[k].wrapping_mul(stride[k]).wrapping_add(column[k]).wrapping_add(base[k]))
    }
    #[inline(always)]
    fn gather_corners(bytes: &[u8], index: Self::Index, stride: Self::Index) -> [Self; 4] {
        let pair = |k: i32| {
            let at = usize::try_from(k).ok().filter(|k| k + 4 <= bytes.len());
            at.map_or([0.0; 2], |k| [f32::from(bytes[k]), f32::from(bytes[k + 1])])
        };
        let upper = index.map(pair);
        let lower: [[f32; 2]; LANES] = std::array::from_fn(|k| pair(index[k].wrapping_add(stride[k])));
        [upper.map(|p| p[0]), upper.map(|p| p[1]), lower.map(|p| p[0]), lower.map(|p| p[1])].map(Self)
    }
}

/// One step of an `f32` mantissa.
const MANTISSA_STEP: f32 = 1.0 / 8_388_608.0;

#[cfg(target_arch = "x86_64")]
pub use avx2::Avx2;

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use std::arch::x86_64::*;

    use super::{LANES, Lanes, MANTISSA_STEP};

    /// AVX2 with FMA. Only to be named inside functions compiled for both, called where the processor has them.
    #[derive(Clone, Copy)]
    pub struct Avx2(__m256);

    // SAFETY of all below: whoever names `Avx2` is compiled for AVX2 and FMA and runs only where both were detected.
    impl Lanes for Avx2 {
        type Index = __m256i;

        #[inline(always)]
        fn splat(value: f32) -> Self {
            unsafe { Self(_mm256_set1_ps(value)) }
        }
        #[inline(always)]
        fn load(values: &[f32; LANES]) -> Self {
            unsafe { Self(_mm256_loadu_ps(values.as_ptr())) }
        }
        #[inline(always)]
        fn store(self, values: &mut [f32; LANES]) {
            unsafe { _mm256_storeu_ps(values.as_mut_ptr(), self.0) }
        }
        #[inline(always)]
        fn add(self, other: Self) -> Self {
            unsafe { Self(_mm256_add_ps(self.0, other.0)) }
        }
        #[inline(always)]
        fn sub(self, other: Self) -> Self {
            unsafe { Self(_mm256_sub_ps(self.0, other.0)) }
        }
        #[inline(always)]
        fn mul(self, other: Self) -> Self {
            unsafe { Self(_mm256_mul_ps(self.0, other.0)) }
        }
        #[inline(always)]
        fn div(self, other: Self) -> Self {
            unsafe { Self(_mm256_div_ps(self.0, other.0)) }
        }
        #[inline(always)]
        fn mul_add(self, factor: Self, summand: Self) -> Self {
            unsafe { Self(_mm256_fmadd_ps(self.0, factor.0, summand.0)) }
        }
        #[inline(always)]
        fn min(self, other: Self) -> Self {
            unsafe { Self(_mm256_min_ps(self.0, other.0)) }
        }
        #[inline(always)]
        fn max(self, other: Self) -> Self {
            unsafe { Self(_mm256_max_ps(self.0, other.0)) }
        }
        #[inline(always)]
        fn floor(self) -> Self {
            unsafe { Self(_mm256_floor_ps(self.0)) }
        }
        #[inline(always)]
        fn rough_log2(self) -> Self {
            unsafe {
                let bits = _mm256_cvtepi32_ps(_mm256_castps_si256(self.0));
                Self(_mm256_sub_ps(_mm256_mul_ps(bits, _mm256_set1_ps(MANTISSA_STEP)), _mm256_set1_ps(127.0)))
            }
        }
        #[inline(always)]
        fn to_index(self) -> Self::Index {
            unsafe { _mm256_cvttps_epi32(self.0) }
        }
        #[inline(always)]
        fn lookup(table: &[f32; LANES], index: Self::Index) -> Self {
            unsafe { Self(_mm256_permutevar8x32_ps(_mm256_loadu_ps(table.as_ptr()), index)) }
        }
        #[inline(always)]
        fn lookup_index(table: &[i32; LANES], index: Self::Index) -> Self::Index {
            unsafe { _mm256_permutevar8x32_epi32(_mm256_loadu_si256(table.as_ptr().cast()), index) }
        }
        #[inline(always)]
        fn address(row: Self::Index, stride: Self::Index, column: Self::Index, base: Self::Index) -> Self::Index {
            unsafe { _mm256_add_epi32(_mm256_add_epi32(_mm256_mullo_epi32(row, stride), column), base) }
        }
        #[inline(always)]
        fn gather_corners(bytes: &[u8], index: Self::Index, stride: Self::Index) -> [Self; 4] {
            let [a, b] = pair(bytes, index);
            let [c, d] = pair(bytes, unsafe { _mm256_add_epi32(index, stride) });
            [a, b, c, d]
        }
    }

    /// The bytes at and behind each index.
    #[inline(always)]
    fn pair(bytes: &[u8], index: __m256i) -> [Avx2; 2] {
        unsafe {
            // Lanes whose four bytes do not lie inside are masked off and read nothing.
            let last = _mm256_set1_epi32(i32::try_from(bytes.len()).unwrap_or(i32::MAX) - 4);
            let outside = _mm256_or_si256(_mm256_cmpgt_epi32(_mm256_setzero_si256(), index), _mm256_cmpgt_epi32(index, last));
            let inside = _mm256_xor_si256(outside, _mm256_set1_epi32(-1));
            let found = _mm256_mask_i32gather_epi32::<1>(_mm256_setzero_si256(), bytes.as_ptr().cast(), index, inside);
            let low = _mm256_set1_epi32(0xff);
            [
                Avx2(_mm256_cvtepi32_ps(_mm256_and_si256(found, low))),
                Avx2(_mm256_cvtepi32_ps(_mm256_and_si256(_mm256_srli_epi32::<8>(found), low))),
            ]
        }
    }
}

/// Whether kernels may be run with [`Avx2`].
pub fn has_avx2() -> bool {
    #[cfg(target_arch = "x86_64")]
    return std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma");
    #[cfg(not(target_arch = "x86_64"))]
    false
}

/// Makes a kernel's public function: `$lanes`, generic over [`Lanes`], with AVX2 where the processor has it, else in plain Rust.
macro_rules! dispatch {
    ($(#[$doc:meta])* $name:ident, $avx2:ident, $lanes:ident, ($($arg:ident : $ty:ty),*) $(-> $ret:ty)?) => {
        #[cfg(target_arch = "x86_64")]
        #[target_feature(enable = "avx2,fma")]
        fn $avx2($($arg: $ty),*) $(-> $ret)? {
            $lanes::<$crate::track::align::lanes::Avx2>($($arg),*)
        }

        $(#[$doc])*
        pub fn $name($($arg: $ty),*) $(-> $ret)? {
            #[cfg(target_arch = "x86_64")]
            if $crate::track::align::lanes::has_avx2() {
                // SAFETY: the processor has AVX2 and FMA.
                return unsafe { $avx2($($arg),*) };
            }
            $lanes::<$crate::track::align::lanes::Plain>($($arg),*)
        }
    };
}
pub(super) use dispatch;
