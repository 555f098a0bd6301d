//! What is left between two trackers after their alignment.

use nalgebra::Vector3;

use super::align::Alignment;
use super::pairs::Pair;
use crate::calibrate::judge::Verdict;

/// Root mean square of the differences up to which the trackers agree (good), and up to which they
/// show the same scenery (usable): metres and degrees. Chosen: a fifth of what is seen at the edge
/// of a set piece four metres away, and what is plainly seen. Raised, worse agreement passes.
const GOOD: [f64; 2] = [0.005, 0.1];
const USABLE: [f64; 2] = [0.02, 0.5];
/// Scale above which the trackers do not agree on a metre. Raised, a wrong `size_m` passes.
const MAX_SCALE: f64 = 0.01;

/// Size of the differences in one axis: root mean square, the 95th percentile and the maximum of
/// their absolute values.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Spread {
    /// Root mean square.
    pub rms: f64,
    /// 95 of 100 are smaller.
    pub p95: f64,
    /// The largest.
    pub max: f64,
}

impl Spread {
    fn of(values: impl Iterator<Item = f64>) -> Self {
        let mut sizes: Vec<f64> = values.map(f64::abs).collect();
        sizes.sort_by(f64::total_cmp);
        let (Some(max), n) = (sizes.last().copied(), sizes.len()) else { return Self::default() };
        let rms = (sizes.iter().map(|v| v * v).sum::<f64>() / n as f64).sqrt();
        Self { rms, p95: sizes[(n * 95 / 100).min(n - 1)], max }
    }
}

/// The differences of two trackers.
#[derive(Debug, Clone, PartialEq)]
pub struct Differences {
    /// Number of instants.
    pub pairs: usize,
    /// In position along x, y and z of our stage, metres.
    pub position_m: [Spread; 3],
    /// Its length.
    pub distance_m: Spread,
    /// In rotation about our camera's own axes, degrees.
    pub rotation_deg: [Spread; 3],
    /// Its angle.
    pub angle_deg: Spread,
    /// Length of our metre in the other's metres, minus 1.
    pub scale: f64,
}

impl Differences {
    /// Measures them: what the other tracker says of our camera, minus what we say.
    pub fn of(pairs: &[Pair], alignment: &Alignment) -> Self {
        let difference = |pair: &Pair| {
            let others = alignment.apply(&pair.others);
            let rotation = (pair.ours.rotation.inverse() * others.rotation).scaled_axis();
            [others.translation - pair.ours.translation, rotation.map(f64::to_degrees)]
        };
        let all: Vec<[Vector3<f64>; 2]> = pairs.iter().map(difference).collect();
        let axis = |which: usize| [0, 1, 2].map(|axis| Spread::of(all.iter().map(|d| d[which][axis])));
        Self {
            pairs: pairs.len(),
            position_m: axis(0),
            distance_m: Spread::of(all.iter().map(|d| d[0].norm())),
            rotation_deg: axis(1),
            angle_deg: Spread::of(all.iter().map(|d| d[1].norm())),
            scale: scale(pairs, alignment),
        }
    }
}

/// Returns the scale by which the other's path fits ours best, minus 1.
fn scale(pairs: &[Pair], alignment: &Alignment) -> f64 {
    let n = pairs.len().max(1) as f64;
    let both: Vec<[Vector3<f64>; 2]> =
        pairs.iter().map(|pair| [pair.ours.translation, alignment.apply(&pair.others).translation]).collect();
    let middle = |which: usize| both.iter().map(|p| p[which]).sum::<Vector3<f64>>() / n;
    let (ours, others) = (middle(0), middle(1));
    let sum = |f: &dyn Fn(&[Vector3<f64>; 2]) -> f64| both.iter().map(f).sum::<f64>();
    let (along, length) = (sum(&|p| (p[0] - ours).dot(&(p[1] - others))), sum(&|p| (p[0] - ours).norm_squared()));
    if length > 0.0 { along / length - 1.0 } else { 0.0 }
}

/// Returns how far the trackers agree, and why.
pub fn judged(differences: &Differences) -> (Verdict, Vec<String>) {
    let Differences { distance_m, angle_deg, scale, .. } = differences;
    let within = |[metres, degrees]: [f64; 2]| distance_m.rms <= metres && angle_deg.rms <= degrees;
    let mut reasons = Vec::new();
    if scale.abs() > MAX_SCALE {
        reasons.push(format!(
            "the other tracker's metre is {:+.1} % of ours: check `size_m` of the stage, and the other's calibration",
            scale * 100.0
        ));
    }
    let verdict = match () {
        () if within(GOOD) => Verdict::Good,
        () if within(USABLE) => Verdict::Usable,
        () => Verdict::DoNotUse,
    };
    if verdict != Verdict::Good {
        reasons.push(format!(
            "they differ by {:.1} mm and {:.2} degrees (root mean square); {:.0} mm and {} degrees are good, {:.0} mm and {} degrees usable",
            distance_m.rms * 1e3,
            angle_deg.rms,
            GOOD[0] * 1e3,
            GOOD[1],
            USABLE[0] * 1e3,
            USABLE[1]
        ));
    }
    (if scale.abs() > MAX_SCALE { Verdict::DoNotUse } else { verdict }, reasons)
}

#[cfg(test)]
mod tests {
    use super::super::synthetic::moving;
    use super::*;
    use crate::frame::Timestamp;
    use crate::geometry::Pose;

    fn differing(by: impl Fn(f64) -> Vector3<f64>, scale: f64) -> Differences {
        let pair = |k: i32| {
            let (t, ours) = (f64::from(k) / 30.0, moving(f64::from(k) / 30.0));
            let others = Pose::new(ours.rotation, ours.translation * scale + by(t));
            Pair { at: Timestamp::from_seconds(t), ours, others }
        };
        let pairs: Vec<Pair> = (0..300).map(pair).collect();
        Differences::of(&pairs, &Alignment { world: Pose::identity(), sensor: Pose::identity() })
    }

    #[test]
    fn each_axis_is_measured() {
        let found = differing(|t| Vector3::new(0.003 * (20.0 * t).sin(), 0.0, 0.0), 1.0);
        assert!((found.position_m[0].rms - 0.003 * 0.5_f64.sqrt()).abs() < 1e-4 && found.position_m[1].max == 0.0);
        assert!(found.position_m[0].max <= 0.003 && found.angle_deg.max < 1e-9 && found.scale.abs() < 1e-3);
        assert_eq!(judged(&found), (Verdict::Good, Vec::new()));
    }

    #[test]
    fn the_verdict_follows_the_worse_of_both() {
        let (verdict, reasons) = judged(&differing(|t| Vector3::y() * 0.02 * (20.0 * t).sin(), 1.0));
        assert!(verdict == Verdict::Usable && reasons.len() == 1, "{reasons:?}");
        assert_eq!(judged(&differing(|t| Vector3::y() * 0.05 * (20.0 * t).sin(), 1.0)).0, Verdict::DoNotUse);
        let (verdict, reasons) = judged(&differing(|_| Vector3::zeros(), 1.02));
        assert!(verdict == Verdict::DoNotUse && reasons[0].contains("+2.0 %"), "{reasons:?}");
        let mut turned = differing(|_| Vector3::zeros(), 1.0);
        turned.angle_deg.rms = 0.2;
        assert_eq!(judged(&turned).0, Verdict::Usable);
    }
}
