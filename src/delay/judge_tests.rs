//! The verdict for delays with one fault each.

use super::judge::judge;
use super::measure::{Delay, Rival};
use crate::calibrate::judge::Verdict;

fn good() -> Delay {
    Delay {
        delay_s: 0.041,
        sigma_s: 1e-4,
        unexplained: 1e-3,
        gain: 1.0,
        rotation: None,
        used: 100,
        left_out: 0,
        span_s: 4.0,
        rates: [1.0, 1.0],
        drift_s: Some([2e-4, 2e-4]),
        rivals: vec![Rival { delay_s: 0.9, factor: 200.0 }],
    }
}

#[test]
fn each_fault_has_its_verdict_and_its_sentence() {
    use Verdict::{DoNotUse, Good, Usable};
    assert_eq!(judge(&good()), (Good, vec![]));
    let rival = |factor| vec![Rival { delay_s: -0.9, factor }];
    let faults: [(Delay, Verdict, &str); 12] = [
        (Delay { sigma_s: 0.002, ..good() }, Usable, "known to 2.0 ms only"),
        (Delay { sigma_s: 0.008, ..good() }, DoNotUse, "pan to and fro sharply"),
        (Delay { sigma_s: f64::NAN, ..good() }, DoNotUse, "known to"),
        (Delay { sigma_s: f64::INFINITY, ..good() }, DoNotUse, "known to inf ms only"),
        (Delay { rivals: rival(5.0), ..good() }, Usable, "so -0.900 s would fit nearly as well"),
        (Delay { rivals: rival(1.1), ..good() }, DoNotUse, "the motion repeats itself"),
        (Delay { unexplained: 0.2, ..good() }, Usable, "20 % of the rotation"),
        (Delay { gain: 1.3, ..good() }, Usable, "1.30 times as fast as the first"),
        (Delay { gain: 0.4, ..good() }, DoNotUse, "0.40 times as fast"),
        (Delay { gain: f64::NAN, ..good() }, DoNotUse, "times as fast"),
        (Delay { drift_s: Some([-0.003, 2e-4]), ..good() }, Usable, "changes by -3.0 ms within the clip"),
        (Delay { drift_s: Some([0.02, 2e-4]), ..good() }, DoNotUse, "changes by +20.0 ms"),
    ];
    for (delay, verdict, part) in faults {
        let (judged, reasons) = judge(&delay);
        assert!(judged == verdict && reasons.len() == 1 && reasons[0].contains(part), "{judged}: {reasons:?}");
    }
    // A difference within its own sigma is chance.
    assert_eq!(judge(&Delay { drift_s: Some([0.02, 0.01]), ..good() }).0, Good);
}
