use super::*;
use crate::timecode::synthetic::wav;

/// Returns a WAV file of this form with these bytes as samples.
fn file(tag: u16, bits: u16, channels: u16, sample_rate: u32, data: &[u8]) -> Vec<u8> {
    let mut file = b"RIFF\0\0\0\0WAVEjunk\x03\0\0\0abc\0fmt ".to_vec();
    let inner = if tag == EXTENSIBLE { 1_u16 } else { tag };
    file.extend(40_u32.to_le_bytes());
    for word in [tag, channels, sample_rate as u16, (sample_rate >> 16) as u16, 0, 0, 0, bits, 22, bits, 3, 0, inner] {
        file.extend(word.to_le_bytes());
    }
    file.extend([0; 14]);
    file.extend(b"data");
    file.extend((data.len() as u32).to_le_bytes());
    file.extend(data);
    file
}

fn samples(bytes: &[u8], raw: Option<RawFormat>, channel: u16) -> Result<Vec<f32>, SoundError> {
    let (mut sound, mut samples) = (Sound::open(bytes, raw, channel)?, Vec::new());
    while sound.read(&mut samples)? {}
    Ok(samples)
}

#[test]
fn samples_of_every_form_are_read() {
    for (tag, bits, data, wanted) in [
        (1, 8, vec![0, 255, 192, 128], vec![-1.0, 0.5]),
        (1, 16, vec![0, 0x80, 1, 2, 0, 0x40, 3, 4], vec![-1.0, 0.5]),
        (EXTENSIBLE, 16, vec![0, 0x80, 1, 2, 0, 0x40, 3, 4], vec![-1.0, 0.5]),
        (1, 24, vec![0, 0, 0x80, 1, 2, 3, 0, 0, 0x40, 4, 5, 6], vec![-1.0, 0.5]),
        (1, 32, [i32::MIN, 7, 1 << 30, 9].iter().flat_map(|v| v.to_le_bytes()).collect(), vec![-1.0, 0.5]),
        (3, 32, [-1.0_f32, 0.1, 0.5, 0.2].iter().flat_map(|v| v.to_le_bytes()).collect(), vec![-1.0, 0.5]),
    ] {
        assert_eq!(samples(&file(tag, bits, 2, 48_000, &data), None, 1).unwrap(), wanted, "{tag} {bits}");
    }
    assert_eq!(
        samples(&wav(48_000, &[0.5, -0.25]), None, 1).unwrap().iter().map(|v| (v * 100.0).round()).collect::<Vec<_>>(),
        [50.0, -25.0]
    );
}

#[test]
fn raw_samples_need_their_format() {
    let raw = RawFormat { sample_rate: 48_000, channels: 2 };
    let bytes = [0, 0x40, 0, 0x80, 0, 0x20, 0, 0, 1];
    assert_eq!(samples(&bytes, Some(raw), 2).unwrap(), [-1.0, 0.0]);
    assert_eq!(samples(&bytes[..3], Some(raw), 2).unwrap(), Vec::<f32>::new());
    assert!(matches!(samples(&bytes, None, 1), Err(SoundError::NotWav)));
}

#[test]
fn a_length_that_a_pipe_does_not_know_reads_to_the_end() {
    let mut bytes = wav(48_000, &[0.5; 10]);
    for unknown in [0_u32, u32::MAX] {
        bytes[40..44].copy_from_slice(&unknown.to_le_bytes());
        assert_eq!(samples(&bytes, None, 1).unwrap().len(), 10);
    }
    // What follows the samples is no sound.
    bytes[40..44].copy_from_slice(&8_u32.to_le_bytes());
    assert_eq!(samples(&bytes, None, 1).unwrap().len(), 4);
}

#[test]
fn bad_files_are_refused_with_the_fix() {
    let good = file(1, 16, 2, 48_000, &[0; 8]);
    for cut in 0..good.len() - 8 {
        assert!(samples(&good[..cut], None, 1).is_err(), "{cut}");
    }
    for (bytes, channel, part) in [
        (b"fLaC".to_vec(), 1, "ffmpeg"),
        (file(1, 12, 2, 48_000, &[]), 1, "form 0x0001 with 12 bits"),
        (file(85, 16, 2, 48_000, &[]), 1, "ffmpeg"),
        (file(1, 16, 2, 0, &[]), 1, "0 samples per second"),
        (file(1, 16, 2, 4_000_000_000, &[]), 1, "samples per second"),
        (file(1, 16, 0, 48_000, &[]), 1, "0 channels"),
        (file(1, 16, 2, 48_000, &[]), 3, "channel 3"),
        (file(1, 16, 2, 48_000, &[]), 0, "channel 0"),
        (b"RIFF\0\0\0\0WAVEdata\0\0\0\0".to_vec(), 1, "how the samples are stored"),
    ] {
        let message = samples(&bytes, None, channel).unwrap_err().to_string();
        assert!(message.contains(part), "{message}");
    }
}
