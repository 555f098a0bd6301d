//! Chooses one of a camera's modes and states the reason in a sentence.
//!
//! Anything the config names is binding. The rest is chosen in this order: size (the calibration's,
//! else the nearest of its shape), rate (higher is better, up to 60 per second), layout
//! (uncompressed is exact and needs no decoder; JPEG is preferred over RGB).

use super::camera::PixelLayout;

/// A mode that a camera offers, with an integer rate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Offer {
    /// Layout of the pictures.
    pub layout: PixelLayout,
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Pictures per second.
    pub fps: u32,
}

/// The requested mode; `None` leaves a property open.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Wanted {
    /// Width, pixels.
    pub width: Option<u32>,
    /// Height, pixels.
    pub height: Option<u32>,
    /// Pictures per second.
    pub fps: Option<f64>,
    /// Layout of the pictures.
    pub layout: Option<PixelLayout>,
    /// The calibration's size in pixels. Offers must have its shape, and the nearest size is
    /// preferred.
    pub calibrated: Option<(u32, u32)>,
}

/// Returns the best offer and the reason.
///
/// # Errors
/// Which request is not offered, as a sentence that lists what is.
pub fn choose(offers: &[Offer], wanted: &Wanted) -> Result<(Offer, String), String> {
    let fits = |o: &&Offer| {
        wanted.width.is_none_or(|w| w == o.width)
            && wanted.height.is_none_or(|h| h == o.height)
            && wanted.fps.is_none_or(|fps| (fps - f64::from(o.fps)).abs() < 0.5)
            && wanted.layout.is_none_or(|l| l == o.layout)
            && wanted.calibrated.is_none_or(|size| has_shape(o, size))
    };
    let best = offers.iter().filter(fits).max_by_key(|o| rank(o, wanted.calibrated));
    let Some(best) = best else { return Err(refusal(offers, wanted)) };
    Ok((*best, reason(best, offers, wanted)))
}

fn has_shape(offer: &Offer, (width, height): (u32, u32)) -> bool {
    // Allow one pixel of rounding: 848 x 480 is sold as 16 : 9.
    let (a, b) = (u64::from(offer.width) * u64::from(height), u64::from(offer.height) * u64::from(width));
    a.abs_diff(b) <= u64::from(width.max(height))
}

/// Ranks an offer by size, rate and layout, compared lexicographically; larger is better.
fn rank(offer: &Offer, calibrated: Option<(u32, u32)>) -> (i64, u32, u32) {
    let pixels = i64::from(offer.width) * i64::from(offer.height);
    let wanted = calibrated.map_or(1280 * 720, |(w, h)| i64::from(w) * i64::from(h));
    let layout = match offer.layout {
        PixelLayout::Grey | PixelLayout::Nv12 | PixelLayout::Yuyv => 2,
        PixelLayout::Mjpeg => 1,
        PixelLayout::Rgb | PixelLayout::Bgr => 0,
    };
    (-(pixels - wanted).abs(), offer.fps.min(60), layout)
}

fn reason(best: &Offer, offers: &[Offer], wanted: &Wanted) -> String {
    let size = if wanted.width.or(wanted.height).is_some() {
        "the config's size"
    } else if wanted.calibrated == Some((best.width, best.height)) {
        "the calibration's size"
    } else if wanted.calibrated.is_some() {
        "the size nearest to the calibration's of its shape"
    } else {
        "the size nearest to 1280 x 720"
    };
    let slower = offers.iter().filter(|o| (o.width, o.height) == (best.width, best.height) && o.layout != best.layout);
    let slower = slower.max_by_key(|o| o.fps).filter(|_| wanted.layout.is_none());
    let layout = match slower {
        Some(other) if other.fps < best.fps => format!("{} reaches only {}/s there", other.layout.fourcc(), other.fps),
        Some(other) if best.layout != PixelLayout::Mjpeg => {
            format!("exact grey levels without a decoder, unlike {}", other.layout.fourcc())
        }
        Some(other) => format!("{} would come at {}/s too, with more bytes", other.layout.fourcc(), other.fps),
        None if wanted.layout.is_some() => "the config's format".to_owned(),
        None => "the only format there".to_owned(),
    };
    format!("{size}; {layout}")
}

fn refusal(offers: &[Offer], wanted: &Wanted) -> String {
    let mut asked = Vec::new();
    match (wanted.width, wanted.height, wanted.calibrated) {
        (None, None, Some((w, h))) => asked.push(format!("pictures of the calibration's shape ({w} x {h})")),
        (None, None, None) => {}
        (w, h, _) => asked.push(format!("{} x {} pixels", number(w), number(h))),
    }
    asked.extend(wanted.layout.map(|l| l.fourcc().to_owned()));
    asked.extend(wanted.fps.map(|fps| format!("{fps} pictures a second")));
    let mut there: Vec<String> = offers.iter().map(|o| format!("{} {}x{} {}/s", o.layout.fourcc(), o.width, o.height, o.fps)).collect();
    there.sort();
    there.dedup();
    there.truncate(8);
    let there = if there.is_empty() { "no mode that can be read".to_owned() } else { there.join(", ") };
    format!("the camera does not offer {}; it offers {there}; change width, height, fps or format in [camera]", asked.join(", "))
}

fn number(side: Option<u32>) -> String {
    side.map_or("any".to_owned(), |n| n.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn offer(layout: PixelLayout, width: u32, height: u32, fps: u32) -> Offer {
        Offer { layout, width, height, fps }
    }

    /// A common webcam.
    const WEBCAM: [Offer; 5] = [
        offer(PixelLayout::Yuyv, 640, 480, 30),
        offer(PixelLayout::Mjpeg, 640, 480, 30),
        offer(PixelLayout::Yuyv, 1280, 720, 10),
        offer(PixelLayout::Mjpeg, 1280, 720, 30),
        offer(PixelLayout::Mjpeg, 1920, 1080, 30),
    ];

    #[test]
    fn the_calibration_decides_the_size_the_rate_decides_the_format() {
        let wanted = |calibrated| Wanted { calibrated: Some(calibrated), ..Wanted::default() };
        let (best, why) = choose(&WEBCAM, &wanted((1280, 720))).unwrap();
        assert_eq!(best, WEBCAM[3]);
        assert_eq!(why, "the calibration's size; YUYV reaches only 10/s there");
        let (best, why) = choose(&WEBCAM, &wanted((640, 480))).unwrap();
        assert_eq!(best, WEBCAM[0]);
        assert_eq!(why, "the calibration's size; exact grey levels without a decoder, unlike MJPG");
        assert_eq!(choose(&WEBCAM, &wanted((320, 180))).unwrap().0, WEBCAM[3]);
    }

    #[test]
    fn the_configured_mode_is_used_or_refused_with_alternatives() {
        let wanted = Wanted { width: Some(1280), layout: Some(PixelLayout::Yuyv), ..Wanted::default() };
        assert_eq!(choose(&WEBCAM, &wanted).unwrap(), (WEBCAM[2], "the config's size; the config's format".to_owned()));
        let refusal = choose(&WEBCAM, &Wanted { fps: Some(60.0), ..wanted }).unwrap_err();
        assert!(
            refusal.contains("does not offer 1280 x any pixels, YUYV, 60 pictures a second; it offers MJPG 1280x720 30/s"),
            "{refusal}"
        );
        let refusal = choose(&[], &Wanted { calibrated: Some((4, 3)), ..Wanted::default() }).unwrap_err();
        assert!(refusal.contains("no mode that can be read"), "{refusal}");
    }
}
