//! The sensor: converts light to grey levels with shot and read noise.
//!
//! Shot noise grows with the light, and read noise is constant: the variance at grey level g is
//! `read² + shot · g`. Every row of every frame has its own random generator, seeded only by the
//! seed, the frame number and the row number. So a picture does not depend on the order of
//! rendering or on threads.

use std::f32::consts::TAU;

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::light::LightModel;

/// How noisy the sensor is. With linear light, the noise is added to the light, and one level is a
/// 255th of full light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SensorNoise {
    /// Standard deviation in the dark, grey levels.
    pub read: f32,
    /// Variance added per grey level of light, grey levels.
    pub shot: f32,
}

impl SensorNoise {
    /// Returns a sensor without noise.
    pub const fn none() -> Self {
        Self { read: 0.0, shot: 0.0 }
    }

    /// Returns a decent webcam in stage light: 1.7 grey levels in the dark, 2.6 at level 128.
    pub const fn webcam() -> Self {
        Self { read: 1.7, shot: 0.03 }
    }

    /// Returns a decent webcam with linear light: 2.6 grey levels in the dark, 1.6 at level 128.
    pub const fn linear_webcam() -> Self {
        Self { read: 0.2, shot: 0.04 }
    }
}

/// Writes one row of a frame: adds noise to the light (which may exceed 255), converts to grey
/// levels, rounds and clips to 0..=255.
pub(super) fn develop_row(light: &[f32], noise: SensorNoise, model: LightModel, seed: u64, frame: u64, row: u64, out: &mut [u8]) {
    if noise == SensorNoise::none() {
        for (grey, &light) in out.iter_mut().zip(light) {
            *grey = quantise(model.grey_of(light));
        }
        return;
    }
    let mut random = Pcg64Mcg::seed_from_u64(mixed(mixed(mixed(seed) ^ frame) ^ row));
    let sigma = |light: f32| (noise.read * noise.read + noise.shot * light.max(0.0)).sqrt();
    for (greys, lights) in out.chunks_mut(2).zip(light.chunks(2)) {
        let normal = normal_pair(&mut random);
        for ((grey, &light), n) in greys.iter_mut().zip(lights).zip(normal) {
            *grey = quantise(model.grey_of(light + sigma(light) * n));
        }
    }
}

fn quantise(grey: f32) -> u8 {
    // `as` saturates, so it clips to 0..=255; adding a half rounds.
    (grey + 0.5) as u8
}

/// Returns two independent normal numbers (Box-Muller transform).
fn normal_pair(random: &mut Pcg64Mcg) -> [f32; 2] {
    // 1 - [0, 1) is never 0, so the logarithm is finite.
    let radius = (-2.0 * (1.0 - random.random::<f32>()).ln()).sqrt();
    let (sin, cos) = (TAU * random.random::<f32>()).sin_cos();
    [radius * cos, radius * sin]
}

/// Mixes every bit of a number into all others (SplitMix64's finaliser).
fn mixed(x: u64) -> u64 {
    let x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn develop(level: f32, noise: SensorNoise, frame: u64, row: u64) -> Vec<u8> {
        let mut out = vec![0; 40_001];
        develop_row(&vec![level; out.len()], noise, LightModel::GreyAverages, 5, frame, row, &mut out);
        out
    }

    #[test]
    fn noise_has_the_stated_mean_and_variance() {
        let noise = SensorNoise { read: 2.0, shot: 0.05 };
        for level in [30.0_f32, 120.0, 200.0] {
            let rows: Vec<u8> = (0..5).flat_map(|row| develop(level, noise, 3, row)).collect();
            let n = rows.len() as f64;
            let mean = rows.iter().map(|&g| f64::from(g)).sum::<f64>() / n;
            let variance = rows.iter().map(|&g| (f64::from(g) - mean).powi(2)).sum::<f64>() / n;
            let expected = 4.0 + 0.05 * f64::from(level) + 1.0 / 12.0; // rounding adds a twelfth
            assert!((mean - f64::from(level)).abs() < 0.05, "level {level}: mean {mean}");
            assert!((variance / expected - 1.0).abs() < 0.03, "level {level}: variance {variance}, not {expected}");
        }
    }

    #[test]
    fn neighbours_rows_and_frames_are_independent() {
        let noise = SensorNoise::webcam();
        let correlation = |a: &[u8], b: &[u8]| {
            let products: f64 = a.iter().zip(b).map(|(&x, &y)| (f64::from(x) - 100.0) * (f64::from(y) - 100.0)).sum();
            products / a.len() as f64 / 5.9
        };
        let a = develop(100.0, noise, 0, 0);
        assert!(correlation(&a, &develop(100.0, noise, 0, 1)).abs() < 0.03);
        assert!(correlation(&a, &develop(100.0, noise, 1, 0)).abs() < 0.03);
        assert!(correlation(&a, &a[1..]).abs() < 0.03);
        assert_eq!(a, develop(100.0, noise, 0, 0));
    }

    #[test]
    fn without_noise_light_is_rounded_and_clipped() {
        let mut out = [0; 4];
        develop_row(&[-3.0, 12.4, 12.6, 300.0], SensorNoise::none(), LightModel::GreyAverages, 1, 1, 1, &mut out);
        assert_eq!(out, [0, 12, 13, 255]);
    }
}
