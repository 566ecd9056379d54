//! Images made small enough for a link: sizes and qualities, each compressed once for all who want it.

use std::sync::Arc;
use std::time::{Duration, Instant};

use image::ExtendedColorType;
use image::codecs::jpeg::JpegEncoder;
use tokio::sync::Mutex;
use uw_hw::{Frame, Pixels};

use crate::feed::Picture;

/// An image is shown again from what was compressed this short a time ago, so that many clients cost what one costs.
const SHARED: Duration = Duration::from_millis(90);

/// How small, and how well: every `skip`th row and column (their mean), JPEG quality, and about how many bytes a pixel of the whole image.
struct Tier {
    skip: usize,
    quality: u8,
    bytes_per_pixel: f64,
}

const TIERS: [Tier; 4] = [
    Tier { skip: 1, quality: 80, bytes_per_pixel: 0.15 },
    Tier { skip: 1, quality: 50, bytes_per_pixel: 0.07 },
    Tier { skip: 2, quality: 55, bytes_per_pixel: 0.025 },
    Tier { skip: 4, quality: 45, bytes_per_pixel: 0.006 },
];

/// The best tier whose images have about `most` bytes.
pub(crate) fn tier(size: [u32; 2], most: f64) -> usize {
    let pixels = f64::from(size[0]) * f64::from(size[1]);
    TIERS.iter().position(|tier| pixels * tier.bytes_per_pixel <= most).unwrap_or(TIERS.len() - 1)
}

/// The latest image of each tier.
#[derive(Default)]
pub(crate) struct Jpegs {
    made: [Mutex<Option<Made>>; TIERS.len()],
}

#[derive(Clone)]
pub(crate) struct Made {
    version: u64,
    at: Instant,
    pub shown: crate::feed::Shown,
    pub jpeg: Arc<Vec<u8>>,
}

impl Jpegs {
    /// An image at a tier: this one, or one that is hardly older. `None` where it can't be compressed.
    pub async fn get(&self, tier: usize, version: u64, shown: &crate::feed::Shown) -> Option<Made> {
        let mut made = self.made.get(tier)?.lock().await;
        if let Some(made) = &*made
            && (made.version == version || (made.version < version && made.at.elapsed() < SHARED))
        {
            return Some(made.clone());
        }
        let picture: Arc<Picture> = shown.picture.clone();
        let jpeg = tokio::task::spawn_blocking(move || compress(&picture.image, tier)).await.ok()??;
        let now = Made { version, at: Instant::now(), shown: shown.clone(), jpeg: Arc::new(jpeg) };
        *made = Some(now.clone());
        Some(now)
    }
}

impl Made {
    /// Which image it is.
    pub fn version(&self) -> u64 {
        self.version
    }
}

/// A frame as JPEG.
pub(crate) fn compress(frame: &Frame, tier: usize) -> Option<Vec<u8>> {
    let Tier { skip, quality, .. } = TIERS.get(tier)?;
    let shift = frame.significant_bits().saturating_sub(8);
    let (values, size) = match frame.pixels() {
        Pixels::U8(values) => smaller(values, frame, *skip, |value| u32::from(*value)),
        Pixels::U16(values) => smaller(values, frame, *skip, |value| u32::from(*value) >> shift),
    };
    let mut jpeg = Vec::with_capacity(values.len() / 8);
    let encoder = &mut JpegEncoder::new_with_quality(&mut jpeg, *quality);
    encoder.encode(&values, size[0], size[1], ExtendedColorType::L8).ok()?;
    Some(jpeg)
}

/// Means of blocks.
fn smaller<P>(values: &[P], frame: &Frame, skip: usize, value: impl Fn(&P) -> u32) -> (Vec<u8>, [u32; 2]) {
    let (width, height, stride) = (frame.width() as usize, frame.height() as usize, frame.stride());
    let (columns, rows) = (width.div_ceil(skip), height.div_ceil(skip));
    let mut made = Vec::with_capacity(columns * rows);
    for top in (0..height).step_by(skip) {
        for left in (0..width).step_by(skip) {
            let (mut sum, mut count) = (0, 0);
            for row in top..(top + skip).min(height) {
                let line = &values[row * stride..];
                for pixel in &line[left..(left + skip).min(width)] {
                    sum += value(pixel);
                    count += 1;
                }
            }
            made.push((sum / count.max(1)).min(255) as u8);
        }
    }
    (made, [columns as u32, rows as u32])
}

#[cfg(test)]
mod tests {
    use super::*;
    use uw_hw::Exposure;
    use uw_hw::frame::Layout;

    fn decoded(frame: &Frame, tier: usize) -> image::GrayImage {
        let jpeg = compress(frame, tier).unwrap();
        image::load_from_memory(&jpeg).unwrap().into_luma8()
    }

    #[test]
    fn each_tier_shows_the_image_in_its_size() {
        let exposure = Exposure { stamp_ns: 0, exposure_ns: 0, received_ns: 0 };
        // A gradient of 12 bits with rows that have a gap behind them.
        let values: Vec<u16> = (0..99).flat_map(|_| (0..110_u16).map(|u| u * 40)).collect();
        let layout = Layout { width: 101, height: 99, stride: 110, significant_bits: 12 };
        let frame = Frame::new(Pixels::from(values), layout, 0, exposure).unwrap();
        for (tier, skip) in [(0, 1), (1, 1), (2, 2), (3, 4)] {
            let image = decoded(&frame, tier);
            assert_eq!(image.dimensions(), (101_u32.div_ceil(skip), 99_u32.div_ceil(skip)));
            for u in [0_u32, 40, 80] {
                let expected = f64::from(u + skip / 2) * 40.0 / 16.0;
                let got = f64::from(image.get_pixel(u / skip, 10).0[0]);
                assert!((got - expected).abs() < 12.0, "tier {tier}, column {u}: {got}, not {expected}");
            }
        }
    }

    #[test]
    fn a_thinner_link_gets_smaller_images() {
        let tiers: Vec<usize> = [1e6, 40e3, 15e3, 1e3].iter().map(|most| tier([768, 576], *most)).collect();
        assert_eq!(tiers, [0, 1, 2, 3]);
    }
}
