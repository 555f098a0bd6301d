//! Hamming distances of binary descriptors: a plain function, and the same function compiled for processors
//! with a population-count instruction (asked at run time).

use crate::features::Descriptor;

/// Bits in which two descriptors differ.
#[inline(always)]
pub fn hamming(a: &Descriptor, b: &Descriptor) -> u32 {
    (a.0[0] ^ b.0[0]).count_ones() + (a.0[1] ^ b.0[1]).count_ones() + (a.0[2] ^ b.0[2]).count_ones() + (a.0[3] ^ b.0[3]).count_ones()
}

/// Calls `visit(index, distance, bar)` for every descriptor nearer than the bar, in order; `visit` may lower the bar.
pub fn scan(query: &Descriptor, all: &[Descriptor], visit: impl FnMut(usize, u32, &mut u32)) {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("popcnt") && std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: the processor has both; the function is safe code compiled for them.
        unsafe { scan_popcnt(query, all, visit) };
        return;
    }
    scan_plain(query, all, visit);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "popcnt,avx2")]
fn scan_popcnt(query: &Descriptor, all: &[Descriptor], visit: impl FnMut(usize, u32, &mut u32)) {
    scan_plain(query, all, visit);
}

/// The plain twin of [`scan`].
#[inline(always)]
pub fn scan_plain(query: &Descriptor, all: &[Descriptor], mut visit: impl FnMut(usize, u32, &mut u32)) {
    let mut bar = u32::MAX;
    for (k, d) in all.iter().enumerate() {
        let distance = hamming(query, d);
        if distance < bar {
            visit(k, distance, &mut bar);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn wide_scan_equals_plain(query in any::<[u64; 4]>(), all in proptest::collection::vec(any::<[u64; 4]>(), 0..50)) {
            let query = Descriptor(query);
            let all: Vec<Descriptor> = all.into_iter().map(Descriptor).collect();
            let run = |wide: bool| {
                let mut seen = Vec::new();
                let visit = |k: usize, d: u32, bar: &mut u32| { seen.push((k, d)); *bar = (*bar).min(d + 10); };
                if wide { scan(&query, &all, visit) } else { scan_plain(&query, &all, visit) }
                seen
            };
            prop_assert_eq!(run(true), run(false));
        }
    }

    #[test]
    fn distance_counts_bits() {
        assert_eq!(hamming(&Descriptor([0; 4]), &Descriptor([u64::MAX; 4])), 256);
        assert_eq!(hamming(&Descriptor([5, 0, 0, 0]), &Descriptor([0, 0, 0, 1])), 3);
    }
}
