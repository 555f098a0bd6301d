//! The pairs of pixels that the descriptor compares.
//!
//! Drawn at compile time from a seeded generator: both ends isotropic around the corner, dense near
//! it (a sum of uniform numbers with standard deviation 6.5 px, close to what BRIEF's authors found
//! best), within reach of the patch, and no pair shorter than 3 px.

/// Number of comparisons, one bit each, as in BRIEF-32 and ORB. Raised, chance matches get rarer,
/// and matching takes longer.
pub const DESCRIPTOR_BITS: usize = 256;
/// Radius of the disc that determines the orientation, and reach of the comparisons, level pixels:
/// ORB's patch of 31 pixels. Raised, descriptors are more distinctive, and tilts, borders and
/// occluders disturb more of them.
pub const PATCH_RADIUS: i32 = 15;
/// Two pixel offsets (dx, dy) from the corner.
pub type Pair = ((i8, i8), (i8, i8));

/// The comparisons of the descriptor, unrotated.
pub const PAIRS: [Pair; DESCRIPTOR_BITS] = draw();

/// Squared reach of an end: one pixel less than the patch, because rotation rounds.
const REACH_SQUARED: i32 = (PATCH_RADIUS - 1) * (PATCH_RADIUS - 1);

const fn next(state: u64) -> u64 {
    state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407)
}

/// The sum of three uniform numbers in -6..=6: standard deviation 6.5.
const fn coordinate(state: &mut u64) -> i32 {
    let mut sum = 0;
    let mut k = 0;
    while k < 3 {
        *state = next(*state);
        sum += ((*state >> 33) % 13) as i32 - 6;
        k += 1;
    }
    sum
}

const fn end(state: &mut u64) -> (i32, i32) {
    loop {
        let (x, y) = (coordinate(state), coordinate(state));
        if x * x + y * y <= REACH_SQUARED {
            return (x, y);
        }
    }
}

const fn draw() -> [Pair; DESCRIPTOR_BITS] {
    let mut pairs = [((0, 0), (0, 0)); DESCRIPTOR_BITS];
    let mut state = 0x5eed_57a6_e905_e001;
    let mut k = 0;
    while k < DESCRIPTOR_BITS {
        let (a, b) = (end(&mut state), end(&mut state));
        let (dx, dy) = (a.0 - b.0, a.1 - b.1);
        if dx * dx + dy * dy >= 9 {
            pairs[k] = ((a.0 as i8, a.1 as i8), (b.0 as i8, b.1 as i8));
            k += 1;
        }
    }
    pairs
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_stay_within_reach_and_differ() {
        for (k, (a, b)) in PAIRS.iter().enumerate() {
            for (x, y) in [a, b] {
                assert!(i32::from(*x).pow(2) + i32::from(*y).pow(2) <= REACH_SQUARED);
            }
            assert_ne!(a, b);
            assert!(!PAIRS[..k].contains(&(*a, *b)));
        }
    }
}
