//! Arithmetic on eight numbers at a time, in which the alignment kernels are written once: with
//! AVX2 instructions, or in plain Rust. Also the layout of the texture tiles, which
//! [`Lanes::gather_squares`] reads.
//!
//! A kernel is a generic function over [`Lanes`]; which of the two types runs is decided at run
//! time (`dispatch`). Both take the same steps in the same order, so that the plain one tests the
//! other.

/// Numbers handled side by side: as many `f32` as an AVX2 register holds.
pub const LANES: usize = 8;

/// Columns of texels in a tile, which fills a cache line of 64 bytes with its rows. At four, two
/// rows of a quad lie within eight bytes, which one load reads.
pub const TILE_COLUMNS: usize = 4;
/// Rows of texels in a tile. Neighbouring tiles share a column or a row, so that a texel and its
/// right and lower neighbours lie in one tile.
pub const TILE_ROWS: usize = 16;

/// Texels that are close together in a picture, row by row: one cache line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(C, align(64))]
pub struct Tile(pub [u8; TILE_COLUMNS * TILE_ROWS]);

/// Bytes that the load of a quad reads: two rows of four texels, of which it uses two each.
const QUAD_BYTES: usize = 8;

/// Eight `f32` values with lane-wise arithmetic.
pub trait Lanes: Copy {
    /// Eight `i32` values.
    type Index: Copy;
    /// Returns the same value in every lane.
    fn splat(value: f32) -> Self;
    /// Returns the values of an array.
    fn load(values: &[f32; LANES]) -> Self;
    /// Writes the lanes to an array.
    fn store(self, values: &mut [f32; LANES]);
    /// Returns `self + other`.
    fn add(self, other: Self) -> Self;
    /// Returns `self - other`.
    fn sub(self, other: Self) -> Self;
    /// Returns `self * other`.
    fn mul(self, other: Self) -> Self;
    /// Returns `self / other`.
    fn div(self, other: Self) -> Self;
    /// Returns `self * factor + summand`.
    fn mul_add(self, factor: Self, summand: Self) -> Self;
    /// Returns the smaller of both; `other` where either is NaN.
    fn min(self, other: Self) -> Self;
    /// Returns the larger of both; `other` where either is NaN.
    fn max(self, other: Self) -> Self;
    /// Returns the largest whole number at or below each value.
    fn floor(self) -> Self;
    /// Returns the square root.
    fn sqrt(self) -> Self;
    /// Returns log2 of positive normal numbers, linear between powers of two (continuous, at most
    /// 0.09 too low).
    fn rough_log2(self) -> Self;
    /// Returns the sums over the lanes of each value: lane k is the total of `values[k]`.
    fn totals(values: [Self; LANES]) -> Self;
    /// Converts to indices, by truncation.
    fn to_index(self) -> Self::Index;
    /// Returns one of eight table entries per lane; indices are 0 to 7.
    fn lookup(table: &[f32; LANES], index: Self::Index) -> Self;
    /// Returns one of eight table entries per lane; indices are 0 to 7.
    fn lookup_index(table: &[i32; LANES], index: Self::Index) -> Self::Index;
    /// Returns `row * stride + column + base`.
    fn address(row: Self::Index, stride: Self::Index, column: Self::Index, base: Self::Index) -> Self::Index;
    /// Returns each lane's row of a table, transposed: the first result holds the first number of
    /// each row. Rows out of range are clamped to the table; an empty table returns zeros.
    fn gather_rows(table: &[[f32; LANES]], row: Self::Index) -> [Self; LANES];
    /// Returns the squares of the bytes at each address, at the next one, and at both plus
    /// [`TILE_COLUMNS`]: a texel, its right neighbour, the one below, and the one right below. Addresses out of range
    /// are clamped to the tiles; without tiles it returns zeros.
    fn gather_squares(tiles: &[Tile], address: Self::Index) -> [Self; 4];
    /// Prefetches what [`gather_squares`](Self::gather_squares) will read.
    fn prefetch_quads(tiles: &[Tile], address: Self::Index);
}

/// Eight numbers in plain Rust.
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
    fn sqrt(self) -> Self {
        Self(self.0.map(f32::sqrt))
    }
    #[inline(always)]
    fn rough_log2(self) -> Self {
        Self(self.0.map(|v| v.to_bits() as i32 as f32 * MANTISSA_STEP - 127.0))
    }
    #[inline(always)]
    fn totals(values: [Self; LANES]) -> Self {
        Self(values.map(|Self([a, b, c, d, e, f, g, h])| ((a + b) + (c + d)) + ((e + f) + (g + h))))
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
    fn gather_rows(table: &[[f32; LANES]], row: Self::Index) -> [Self; LANES] {
        let last = table.len().saturating_sub(1);
        let rows = row.map(|k| table.get(usize::try_from(k).unwrap_or(0).min(last)).copied().unwrap_or_default());
        std::array::from_fn(|column| Self(rows.map(|row| row[column])))
    }
    #[inline(always)]
    fn gather_squares(tiles: &[Tile], address: Self::Index) -> [Self; 4] {
        let last = size_of_val(tiles).saturating_sub(QUAD_BYTES);
        let byte = |at: i32, offset: usize| {
            let at = usize::try_from(at).unwrap_or(0).min(last) + offset;
            tiles.get(at / size_of::<Tile>()).map_or(0.0, |tile| f32::from(tile.0[at % size_of::<Tile>()]))
        };
        [0, 1, TILE_COLUMNS, TILE_COLUMNS + 1].map(|offset| Self(address.map(|at| byte(at, offset).powi(2))))
    }
    #[inline(always)]
    fn prefetch_quads(_: &[Tile], _: Self::Index) {}
}

/// Resizes a list of pixels. When it grows, it reserves an eighth more, because the number of
/// pixels, with tiles padded to whole lanes, varies a little from frame to frame.
pub fn resize_with_room<T: Copy>(list: &mut Vec<T>, n: usize, value: T) {
    if n > list.capacity() {
        list.reserve(n + n / 8 - list.len());
    }
    list.resize(n, value);
}

/// Loads [`LANES`] values from the `k`th on.
#[inline(always)]
pub fn load_at<L: Lanes>(values: &[f32], k: usize) -> L {
    let mut chunk = [0.0; LANES];
    chunk.copy_from_slice(&values[k..k + LANES]);
    L::load(&chunk)
}

/// Stores `v` to the [`LANES`] values from the `k`th on.
#[inline(always)]
pub fn store_at<L: Lanes>(values: &mut [f32], k: usize, v: L) {
    let mut chunk = [0.0; LANES];
    v.store(&mut chunk);
    values[k..k + LANES].copy_from_slice(&chunk);
}

/// Returns the sum of all lanes.
#[inline(always)]
pub fn total<L: Lanes>(v: L) -> f32 {
    let mut lanes = [0.0; LANES];
    v.store(&mut lanes);
    ((lanes[0] + lanes[4]) + (lanes[2] + lanes[6])) + ((lanes[1] + lanes[5]) + (lanes[3] + lanes[7]))
}

/// Unit of an `f32` mantissa: 2^-23 (IEEE 754).
const MANTISSA_STEP: f32 = 1.0 / 8_388_608.0;

#[cfg(target_arch = "x86_64")]
pub use avx2::Avx2;

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use std::arch::x86_64::*;

    use super::{LANES, Lanes, MANTISSA_STEP, QUAD_BYTES, Tile};

    /// Wraps intrinsics of AVX2 and FMA.
    macro_rules! avx2 {
        ($($work:tt)*) => {
            // SAFETY: only `dispatch` names `Avx2` (tests/structure checks that), in functions
            // compiled for AVX2 and FMA that only run where both were detected. Memory that is read
            // or written is given by references, or by an address clamped to the slice beside it.
            unsafe { $($work)* }
        };
    }

    /// AVX2 with FMA. Only name it inside functions that are compiled for both, and called where
    /// the processor has them.
    #[derive(Clone, Copy)]
    pub struct Avx2(__m256);

    impl Lanes for Avx2 {
        type Index = __m256i;

        #[inline(always)]
        fn splat(value: f32) -> Self {
            avx2! { Self(_mm256_set1_ps(value)) }
        }
        #[inline(always)]
        fn load(values: &[f32; LANES]) -> Self {
            avx2! { Self(_mm256_loadu_ps(values.as_ptr())) }
        }
        #[inline(always)]
        fn store(self, values: &mut [f32; LANES]) {
            avx2! { _mm256_storeu_ps(values.as_mut_ptr(), self.0) }
        }
        #[inline(always)]
        fn add(self, other: Self) -> Self {
            avx2! { Self(_mm256_add_ps(self.0, other.0)) }
        }
        #[inline(always)]
        fn sub(self, other: Self) -> Self {
            avx2! { Self(_mm256_sub_ps(self.0, other.0)) }
        }
        #[inline(always)]
        fn mul(self, other: Self) -> Self {
            avx2! { Self(_mm256_mul_ps(self.0, other.0)) }
        }
        #[inline(always)]
        fn div(self, other: Self) -> Self {
            avx2! { Self(_mm256_div_ps(self.0, other.0)) }
        }
        #[inline(always)]
        fn mul_add(self, factor: Self, summand: Self) -> Self {
            avx2! { Self(_mm256_fmadd_ps(self.0, factor.0, summand.0)) }
        }
        #[inline(always)]
        fn min(self, other: Self) -> Self {
            avx2! { Self(_mm256_min_ps(self.0, other.0)) }
        }
        #[inline(always)]
        fn max(self, other: Self) -> Self {
            avx2! { Self(_mm256_max_ps(self.0, other.0)) }
        }
        #[inline(always)]
        fn floor(self) -> Self {
            avx2! { Self(_mm256_floor_ps(self.0)) }
        }
        #[inline(always)]
        fn sqrt(self) -> Self {
            avx2! { Self(_mm256_sqrt_ps(self.0)) }
        }
        #[inline(always)]
        fn rough_log2(self) -> Self {
            avx2! {
                let bits = _mm256_cvtepi32_ps(_mm256_castps_si256(self.0));
                Self(_mm256_sub_ps(_mm256_mul_ps(bits, _mm256_set1_ps(MANTISSA_STEP)), _mm256_set1_ps(127.0)))
            }
        }
        #[inline(always)]
        fn totals(values: [Self; LANES]) -> Self {
            let [a, b, c, d, e, f, g, h] = values;
            avx2! {
                // Four sums of four lanes in each half.
                let of_four = |a: Self, b: Self, c: Self, d: Self| _mm256_hadd_ps(_mm256_hadd_ps(a.0, b.0), _mm256_hadd_ps(c.0, d.0));
                let (first, last) = (of_four(a, b, c, d), of_four(e, f, g, h));
                let (low, high) = (_mm256_permute2f128_ps::<0x20>(first, last), _mm256_permute2f128_ps::<0x31>(first, last));
                Self(_mm256_add_ps(low, high))
            }
        }
        #[inline(always)]
        fn to_index(self) -> Self::Index {
            avx2! { _mm256_cvttps_epi32(self.0) }
        }
        #[inline(always)]
        fn lookup(table: &[f32; LANES], index: Self::Index) -> Self {
            avx2! { Self(_mm256_permutevar8x32_ps(_mm256_loadu_ps(table.as_ptr()), index)) }
        }
        #[inline(always)]
        fn lookup_index(table: &[i32; LANES], index: Self::Index) -> Self::Index {
            avx2! { _mm256_permutevar8x32_epi32(_mm256_loadu_si256(table.as_ptr().cast()), index) }
        }
        #[inline(always)]
        fn address(row: Self::Index, stride: Self::Index, column: Self::Index, base: Self::Index) -> Self::Index {
            avx2! { _mm256_add_epi32(_mm256_add_epi32(_mm256_mullo_epi32(row, stride), column), base) }
        }
        #[inline(always)]
        fn gather_rows(table: &[[f32; LANES]], row: Self::Index) -> [Self; LANES] {
            let Some(last) = table.len().checked_sub(1) else { return [Self::splat(0.0); LANES] };
            let mut indices = [0i32; LANES];
            avx2! { _mm256_storeu_si256(indices.as_mut_ptr().cast(), _mm256_max_epi32(row, _mm256_setzero_si256())) }
            let mut rows = [&table[0]; LANES];
            for lane in 0..LANES {
                rows[lane] = &table[(indices[lane] as usize).min(last)];
            }
            let ([a, b, c, d], [e, f, g, h]) = (four_columns(&rows, 0), four_columns(&rows, LANES / 2));
            [a, b, c, d, e, f, g, h]
        }
        #[inline(always)]
        fn gather_squares(tiles: &[Tile], address: Self::Index) -> [Self; 4] {
            if tiles.is_empty() {
                return [Self::splat(0.0); 4];
            }
            let last = i32::try_from(size_of_val(tiles) - QUAD_BYTES).unwrap_or(i32::MAX);
            let first = tiles.as_ptr().cast::<u8>();
            // Separate loads: the gather instruction takes several times as long.
            avx2! {
                let address = _mm256_min_epi32(_mm256_max_epi32(address, _mm256_setzero_si256()), _mm256_set1_epi32(last));
                let (low, high) = (_mm256_castsi256_si128(address), _mm256_extracti128_si256::<1>(address));
                let pair = |addresses: i64| {
                    // Each half is at least 0 and at most `last`.
                    let at = |k: i64| first.add(k as u32 as usize);
                    let one = _mm_load_sd(at(addresses).cast());
                    _mm_castpd_si128(_mm_loadh_pd(one, at(addresses >> 32).cast()))
                };
                let quads = [
                    pair(_mm_cvtsi128_si64(low)),
                    pair(_mm_extract_epi64::<1>(low)),
                    pair(_mm_cvtsi128_si64(high)),
                    pair(_mm_extract_epi64::<1>(high)),
                ];
                // Lanes 0, 1, 4, 5 and 2, 3, 6, 7: in this order the shuffles put the halves in
                // place.
                let a = _mm256_castsi256_ps(_mm256_inserti128_si256::<1>(_mm256_castsi128_si256(quads[0]), quads[2]));
                let b = _mm256_castsi256_ps(_mm256_inserti128_si256::<1>(_mm256_castsi128_si256(quads[1]), quads[3]));
                let upper = _mm256_castps_si256(_mm256_shuffle_ps::<0x88>(a, b));
                let lower = _mm256_castps_si256(_mm256_shuffle_ps::<0xdd>(a, b));
                // Of each row the first two bytes, as two numbers of 16 bits, which hold their
                // squares.
                let two = _mm256_set_epi8(
                    -1, 13, -1, 12, -1, 9, -1, 8, -1, 5, -1, 4, -1, 1, -1, 0, -1, 13, -1, 12, -1, 9, -1, 8, -1, 5, -1, 4, -1, 1, -1, 0,
                );
                let squares = |row| {
                    let roots = _mm256_shuffle_epi8(row, two);
                    _mm256_mullo_epi16(roots, roots)
                };
                let (upper, lower) = (squares(upper), squares(lower));
                let low = _mm256_set1_epi32(0xffff);
                let left = |v| Self(_mm256_cvtepi32_ps(_mm256_and_si256(v, low)));
                let right = |v| Self(_mm256_cvtepi32_ps(_mm256_srli_epi32::<16>(v)));
                [left(upper), right(upper), left(lower), right(lower)]
            }
        }
        #[inline(always)]
        fn prefetch_quads(tiles: &[Tile], address: Self::Index) {
            let first = tiles.as_ptr().cast::<i8>();
            // A prefetch reads nothing, so any address is allowed.
            avx2! {
                let (low, high) = (_mm256_castsi256_si128(address), _mm256_extracti128_si256::<1>(address));
                let pairs = [_mm_cvtsi128_si64(low), _mm_extract_epi64::<1>(low), _mm_cvtsi128_si64(high), _mm_extract_epi64::<1>(high)];
                for pair in pairs {
                    for address in [pair, pair >> 32] {
                        _mm_prefetch::<_MM_HINT_T0>(first.wrapping_add(address as u32 as usize));
                    }
                }
            }
        }
    }

    /// Returns four columns of eight rows, from column `from`.
    #[inline(always)]
    fn four_columns(rows: &[&[f32; LANES]; LANES], from: usize) -> [Avx2; 4] {
        // Rows 0 to 3 in the lower halves, 4 to 7 in the upper.
        let (a, b, c, d) = (halves(rows, 0, from), halves(rows, 1, from), halves(rows, 2, from), halves(rows, 3, from));
        avx2! {
            let (ab, cd) = (_mm256_unpacklo_ps(a, b), _mm256_unpacklo_ps(c, d));
            let (ab_high, cd_high) = (_mm256_unpackhi_ps(a, b), _mm256_unpackhi_ps(c, d));
            [
                Avx2(_mm256_shuffle_ps::<0x44>(ab, cd)),
                Avx2(_mm256_shuffle_ps::<0xee>(ab, cd)),
                Avx2(_mm256_shuffle_ps::<0x44>(ab_high, cd_high)),
                Avx2(_mm256_shuffle_ps::<0xee>(ab_high, cd_high)),
            ]
        }
    }

    /// Returns four numbers of row `k` (lower half) and of the fourth row after it (upper half),
    /// from column `from`.
    #[inline(always)]
    fn halves(rows: &[&[f32; LANES]; LANES], k: usize, from: usize) -> __m256 {
        let (low, high) = (&rows[k][from..from + LANES / 2], &rows[k + LANES / 2][from..from + LANES / 2]);
        avx2! { _mm256_insertf128_ps::<1>(_mm256_castps128_ps256(_mm_loadu_ps(low.as_ptr())), _mm_loadu_ps(high.as_ptr())) }
    }
}

/// Defines a kernel's public function, which runs `$lanes`, generic over [`Lanes`], with AVX2 where
/// the processor has it, else in plain Rust.
macro_rules! dispatch {
    ($(#[$doc:meta])* $name:ident, $lanes:ident, ($($arg:ident: $ty:ty),*) $(-> $ret:ty)?) => {
        $crate::simd::multiversion! {
            $(#[$doc])* pub fn $name($($arg: $ty),*) $(-> $ret)?;
            ["avx2" "fma"] => $lanes::<$crate::track::align::lanes::Avx2>, else $lanes::<$crate::track::align::lanes::Plain>
        }
    };
}
pub(in crate::track::align) use dispatch;
