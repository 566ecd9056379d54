//! Prints each method's speed on the frames of `benches/peers`, as that script takes it:
//! `cargo run --release -p uw-stripe --example speed > ours.csv`, then `peers.py --ours ours.csv`. Names of methods as arguments: only those.

#![allow(clippy::print_stdout, reason = "printing is what this example is for")]

use rand::{SeedableRng, rngs::StdRng};
use rand_distr::{Distribution, Normal};
use std::error::Error;
use std::time::{Duration, Instant};
use uw_stripe::{Axis, Extractor, Method, Options, Pixel, View};

const SIZES: [(usize, usize); 2] = [(768, 576), (1920, 1200)];
/// Standard deviation of the stripe, px.
const SIGMA_PX: f64 = 2.0;
/// Time spent on each figure, and runs at least.
const BUDGET: Duration = Duration::from_secs(1);
const LEAST_RUNS: usize = 20;

fn main() -> Result<(), Box<dyn Error>> {
    let only: Vec<String> = std::env::args().skip(1).collect();
    println!("kernel,pixel,frame,mpx_per_s");
    for size in SIZES {
        let words = frame(size, (4095.0, 2.5, 2.4))?;
        let bytes: Vec<u8> = frame(size, (255.0, 40.0, 1.0))?.iter().map(|v| *v as u8).collect();
        let wanted = |method: &Method| only.is_empty() || only.iter().any(|name| name == method.name());
        for method in Method::ALL.into_iter().filter(wanted) {
            for (pixel, seconds) in
                [("u8", best(method, &bytes, size)?), ("u16", best(method, &words, size)?)]
            {
                let mpx = (size.0 * size.1) as f64 / seconds / 1e6;
                println!("{},{pixel},{}x{},{mpx:.0}", method.name(), size.0, size.1);
            }
        }
    }
    Ok(())
}

/// Shortest time of an image, s; noise and width are learned before the clock starts. The image begins with a cache line, as cameras deliver it.
fn best<P: Pixel>(method: Method, pixels: &[P], size: (usize, usize)) -> Result<f64, Box<dyn Error>> {
    const ALIGNMENT: usize = 64;
    let mut room = vec![pixels[0]; pixels.len() + ALIGNMENT];
    let first = room.as_ptr().align_offset(ALIGNMENT);
    room[first..first + pixels.len()].copy_from_slice(pixels);
    let view = View::packed(&room[first..first + pixels.len()], size.0, size.1)?;
    let mut extractor = Extractor::new(Options { method, axis: Axis::PerColumn, ..Options::default() })?;
    extractor.extract(view, None)?;
    let (start, mut best, mut runs) = (Instant::now(), f64::INFINITY, 0);
    while runs < LEAST_RUNS || start.elapsed() < BUDGET {
        let begun = Instant::now();
        std::hint::black_box(extractor.extract(std::hint::black_box(view), None)?);
        best = best.min(begun.elapsed().as_secs_f64());
        runs += 1;
    }
    Ok(best)
}

/// A stripe in every column, as `peers.py` draws it, for a camera of full scale (DN), gain (e⁻/DN) and read noise (DN).
fn frame(size: (usize, usize), (full, gain, read): (f64, f64, f64)) -> Result<Vec<u16>, Box<dyn Error>> {
    let mut rng = StdRng::seed_from_u64(1);
    let standard = Normal::new(0.0, 1.0)?;
    let (width, height) = (size.0 as f64, size.1 as f64);
    let mut pixels = Vec::with_capacity(size.0 * size.1);
    for y in 0..size.1 {
        for x in 0..size.0 {
            let centre = 0.5 * height + 0.15 * height * (2.0 * std::f64::consts::PI * x as f64 / width).sin();
            let t = (y as f64 - centre) / SIGMA_PX.hypot((1.0f64 / 12.0).sqrt());
            let mean = full * (4.0 / 255.0 + 0.6 * (-0.5 * t * t).exp());
            let noise = (mean / gain + read * read).sqrt() * standard.sample(&mut rng);
            pixels.push((mean + noise).round().clamp(0.0, full) as u16);
        }
    }
    Ok(pixels)
}
