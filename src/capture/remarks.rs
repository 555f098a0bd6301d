//! Remarks about clips whose pictures need attention: made once per clip, whatever its format.

/// Remarks that the file asks to show its pictures rotated counterclockwise by `degrees`, or
/// mirrored; returns `None` if they are shown as they lie.
pub(super) fn shown_turned(degrees: f64, is_mirrored: bool) -> Option<String> {
    let turn = degrees.rem_euclid(360.0).round();
    let turned = match turn as u32 % 360 {
        0 => String::new(),
        180 => "turned by 180 degrees".to_owned(),
        d if d < 180 => format!("turned by {d} degrees to the left"),
        d => format!("turned by {} degrees to the right", 360 - d),
    };
    // A mirror and a half turn together are the other mirror.
    let words = match (turned.as_str(), is_mirrored) {
        ("", true) | ("turned by 180 degrees", true) => "mirrored".to_owned(),
        ("", false) => return None,
        (_, true) => format!("{turned} and mirrored"),
        (_, false) => turned,
    };
    Some(format!(
        "the file says to show its pictures {words} (display matrix); clips are tracked as stored in the file, which is how the camera is \
         calibrated"
    ))
}

/// Remarks that the pixels are not square.
pub(super) fn pixel_shape((width, height): (u32, u32)) -> String {
    format!(
        "the file says that its pixels are not square, {width}:{height} as wide as high (pixel aspect, SAR); pictures are tracked as \
         stored in the file, so the calibration must be of such pictures too: fx / fy = {:.4}",
        f64::from(height) / f64::from(width)
    )
}

/// Remarks that the pictures hold two fields.
pub(super) fn interlaced(row: u64) -> String {
    format!(
        "row {row}: the video is interlaced: every other line of a picture was taken at another time, which costs accuracy while the camera \
         moves; record progressively, or convert it: ffmpeg -i CLIP -vf bwdif=mode=send_frame -c:v ffv1 NEW.mkv"
    )
}

/// Remarks that the stamps are only derived from a rate.
pub(super) fn rate_made_up(rate: &str) -> String {
    format!("the clip has no time stamps; {rate} frames a second are assumed; give --fps if the camera had another rate")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rotations_and_mirroring_are_described_in_words() {
        let assert_words = |degrees, is_mirrored, words: &str| {
            let said = shown_turned(degrees, is_mirrored).unwrap();
            assert!(said.starts_with(&format!("the file says to show its pictures {words} (display matrix); ")), "{said}");
        };
        assert_words(-180.0, false, "turned by 180 degrees");
        assert_words(90.0, false, "turned by 90 degrees to the left");
        assert_words(-90.0, false, "turned by 90 degrees to the right");
        assert_words(90.0, true, "turned by 90 degrees to the left and mirrored");
        assert_words(-180.0, true, "mirrored");
        assert_words(-0.0, true, "mirrored");
        assert_eq!((shown_turned(0.0, false), shown_turned(360.0, false)), (None, None));
    }

    #[test]
    fn the_pixel_aspect_is_the_inverse_focal_length_ratio() {
        assert!(pixel_shape((4, 3)).ends_with(
            "4:3 as wide as high (pixel aspect, SAR); pictures are tracked as stored in the file, so the calibration must be of such \
             pictures too: fx / fy = 0.7500"
        ));
    }
}
