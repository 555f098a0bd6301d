//! Generated timecode for tests: an encoder of linear timecode with any speed, direction, noise and
//! waveform.

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

use super::code::Timecode;
use super::rate::TimecodeRate;

/// What to generate.
#[derive(Debug, Clone)]
pub struct LtcSignal {
    /// Samples per second.
    pub sample_rate: u32,
    /// The timecode's rate.
    pub rate: TimecodeRate,
    /// How much faster than its rate it is played; negative plays it backwards.
    pub speed: f64,
    /// Its first timecode; played backwards, the one after the first.
    pub first: Timecode,
    /// Number of frames.
    pub frames: usize,
    /// Peak of the signal, 1 for full scale; negative inverts it.
    pub amplitude: f32,
    /// Standard deviation of the noise, as a fraction of the amplitude.
    pub noise: f32,
    /// Silence before it, samples; also fractions of one.
    pub lead: f64,
    /// Seed of the noise and of the user bits.
    pub seed: u64,
}

impl LtcSignal {
    /// Returns samples, and for every frame in order its timecode and the sample of its beginning.
    pub fn samples(&self) -> (Vec<f32>, Vec<(Timecode, f64)>) {
        let mut random = Pcg64::seed_from_u64(self.seed);
        let bit = f64::from(self.sample_rate) / (80.0 * self.rate.fps() * self.speed.abs());
        let first = i64::from(self.first.number(self.rate));
        let (mut changes, mut frames, mut at) = (vec![self.lead], Vec::new(), self.lead);
        for k in 0..self.frames as i64 {
            let is_reverse = self.speed < 0.0;
            let code = Timecode::of_number(if is_reverse { first - 1 - k } else { first + k }, self.rate);
            let mut bits = word(code, random.random());
            if is_reverse {
                bits = bits.reverse_bits() >> 48;
            }
            frames.push((code, if is_reverse { at + 80.0 * bit } else { at }));
            for k in 0..80 {
                if bits >> k & 1 == 1 {
                    changes.push(at + 0.5 * bit);
                }
                at += bit;
                changes.push(at);
            }
        }
        (self.wave(&changes, at, bit, &mut random), frames)
    }

    /// Returns a wave with rounded edges that changes its sign at these places.
    fn wave(&self, changes: &[f64], end: f64, bit: f64, random: &mut Pcg64) -> Vec<f32> {
        // A change takes 8 % of a bit: 40 µs at 25 frames per second, as ST 12-1 wants.
        let rise = (0.04 * bit).max(1.0);
        let mut next = 0;
        (0..(end + 2.0 * bit).ceil() as usize)
            .map(|k| {
                let at = k as f64;
                while next < changes.len() && changes[next] < at {
                    next += 1;
                }
                let sign = if next % 2 == 0 { -1.0 } else { 1.0 };
                let near = |index: Option<&f64>| index.map_or(f64::INFINITY, |change| (at - change).abs());
                let distance = near(next.checked_sub(1).and_then(|last| changes.get(last))).min(near(changes.get(next)));
                let silent = next == 0 || at > end + bit;
                let level = if silent { 0.0 } else { sign * (distance / rise).min(1.0) as f32 };
                // The sum of twelve uniform numbers is close to normal.
                let noise = (0..12).map(|_| random.random::<f32>() - 0.5).sum::<f32>();
                self.amplitude * (level + self.noise * noise)
            })
            .collect()
    }
}

/// Returns the word of a timecode: bit k of the frame at bit k.
fn word(code: Timecode, user: u32) -> u128 {
    let mut bits = 0_u128;
    let mut put = |at: u32, value: u8| bits |= u128::from(value) << at;
    for (at, value) in [(0, code.frames), (16, code.seconds), (32, code.minutes), (48, code.hours)] {
        put(at, value % 10);
        put(at + 8, value / 10);
    }
    put(10, u8::from(code.is_drop));
    (0..8).for_each(|k| put(4 + 8 * k, (user >> (4 * k) & 0xF) as u8));
    // The synchronisation word, with its first bit lowest.
    bits | 0b1011_1111_1111_1100 << 64
}

/// Returns a WAV file with 16-bit samples of one channel.
pub fn wav(sample_rate: u32, samples: &[f32]) -> Vec<u8> {
    let bytes = 2 * samples.len() as u32;
    let mut file = Vec::with_capacity(44 + bytes as usize);
    file.extend(b"RIFF");
    file.extend((36 + bytes).to_le_bytes());
    file.extend(b"WAVEfmt ");
    file.extend(16_u32.to_le_bytes());
    file.extend([1, 0, 1, 0]);
    file.extend(sample_rate.to_le_bytes());
    file.extend((2 * sample_rate).to_le_bytes());
    file.extend([2, 0, 16, 0]);
    file.extend(b"data");
    file.extend(bytes.to_le_bytes());
    samples.iter().for_each(|sample| file.extend(((sample.clamp(-1.0, 1.0) * 32_767.0).round() as i16).to_le_bytes()));
    file
}
