//! What a sensor makes of light: electrons, read noise, steps, full scale.

use crate::instrument::Sensor;
use crate::speckle::mix;
use rand::SeedableRng;
use rand::rngs::Xoshiro256PlusPlus;
use rand_distr::{Distribution, Poisson, StandardNormal};

/// An image as a camera delivers it. Pixel (0, 0) is the top-left one; pixel (u, v) is at `v * width + u`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// Width, px.
    pub width: u32,
    /// Height, px.
    pub height: u32,
    /// Significant bits of a value.
    pub bits: u8,
    /// The values.
    pub data: Vec<u16>,
}

/// Above this many electrons the Poisson distribution is drawn as a normal one: its skewness is 1/√N.
const MANY_ELECTRONS: f64 = 1e4;

/// The seed of one frame's noise: another for every frame, whoever computes it and in whatever order.
pub(crate) fn frame_seed(scene: u64, frame: u64) -> u64 {
    mix(mix(scene) ^ frame)
}

/// Grey values of expected ones (above darkness). The generator is xoshiro256++, the same on every machine.
pub(crate) fn sense(expected_dn: &[f32], size: [u32; 2], sensor: &Sensor, seed: u64) -> Picture {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    let full = sensor.full_scale();
    let gain = sensor.electrons_per_dn;
    let data = expected_dn
        .iter()
        .map(|&mean| {
            let mean = f64::from(mean.max(0.0));
            let mut value = mean;
            let electrons = mean * gain;
            if electrons > 0.0 {
                let normal: f64 =
                    if electrons > MANY_ELECTRONS { StandardNormal.sample(&mut random) } else { 0.0 };
                value = match Poisson::new(electrons) {
                    Ok(poisson) if electrons <= MANY_ELECTRONS => poisson.sample(&mut random) / gain,
                    _ => mean + normal * electrons.sqrt() / gain,
                };
            }
            if sensor.read_noise_dn > 0.0 {
                let normal: f64 = StandardNormal.sample(&mut random);
                value += sensor.read_noise_dn * normal;
            }
            (value + sensor.offset_dn).round().clamp(0.0, full) as u16
        })
        .collect();
    Picture { width: size[0], height: size[1], bits: sensor.bits, data }
}
