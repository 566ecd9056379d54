//! Stripe extraction against a pure read of the same pixels, in the same run: nothing is faster than reading an image once, except not
//! reading it. `cargo bench --bench stripes` for Criterion's figures; with `-- --ratios` the same kernels alternate with the read, image by
//! image, and the table shows the share of its speed that each reaches: that is steady where the machine is not.

#![allow(clippy::print_stdout, reason = "the table of ratios is what is asked for")]

use criterion::{BenchmarkId, Criterion, Throughput};
use rand::{RngExt, SeedableRng, rngs::StdRng};
use std::hint::black_box;
use std::path::Path;
use std::time::{Duration, Instant};
use uw_io::capture::Capture;
use uw_io::images::{GrayImage, Pixels, Reduce};
use uw_stripe::{Axis, Extractor, Method, NoiseModel, Options, Pixel, Tracking, View, brightest};

const SIZES: [(usize, usize); 2] = [(768, 576), (1920, 1200)];
const AXES: [(Axis, &str); 2] = [(Axis::PerRow, "per_row"), (Axis::PerColumn, "per_column")];
/// Bytes of a ring of images that no cache holds.
const RING: usize = 512 << 20;
/// Pixels that a cache line holds at most; cameras deliver aligned buffers.
const ALIGNMENT: usize = 64;

/// What is timed: a name, and the settings; none for the read.
const KERNELS: [(&str, Option<(Method, bool)>); 7] = [
    ("read", None),
    ("fast", Some((Method::Fast, false))),
    ("robust", Some((Method::Robust, false))),
    ("cog", Some((Method::Cog, false))),
    ("roi", Some((Method::Fast, true))),
    ("ridge", Some((Method::Ridge, false))),
    ("precise", Some((Method::Precise, false))),
];

/// The slow ones' ratios to a read tell nothing.
const QUICK: usize = 5;

/// A camera: noise and a stripe's height and background in it, DN.
struct Camera {
    noise: NoiseModel,
    height: f64,
    background: f64,
}

trait Sample: Pixel + Default {
    const NAME: &'static str;
    const CAMERA: Camera;
    fn of(value: f64) -> Self;
}

impl Sample for u8 {
    const NAME: &'static str = "u8";
    const CAMERA: Camera = Camera {
        noise: NoiseModel {
            gain_e_per_dn: 40.0,
            read_noise_dn: 1.0,
            speckle_contrast: 0.0,
            full_scale_dn: 255.0,
        },
        height: 150.0,
        background: 10.0,
    };
    fn of(value: f64) -> Self {
        value as Self
    }
}

impl Sample for u16 {
    const NAME: &'static str = "u16";
    const CAMERA: Camera = Camera {
        noise: NoiseModel {
            gain_e_per_dn: 2.5,
            read_noise_dn: 2.4,
            speckle_contrast: 0.0,
            full_scale_dn: 4095.0,
        },
        height: 2000.0,
        background: 40.0,
    };
    fn of(value: f64) -> Self {
        value as Self
    }
}

/// Images one after the other, each aligned.
struct Ring<P> {
    pixels: Vec<P>,
    first: usize,
    size: (usize, usize),
    count: usize,
}

impl<P: Sample> Ring<P> {
    /// At least `bytes` of images of a Gaussian stripe, σ = 2 px, that leans and sways a little, with normal noise of the camera's variance.
    fn new(size: (usize, usize), axis: Axis, bytes: usize) -> Self {
        let one = size.0 * size.1;
        let count = bytes.div_ceil(one * size_of::<P>()).max(1);
        let mut pixels = vec![P::default(); one * count + ALIGNMENT];
        let first = pixels.as_ptr().align_offset(ALIGNMENT);
        let image = image::<P>(size, axis);
        for k in 0..count {
            pixels[first + k * one..first + (k + 1) * one].copy_from_slice(&image);
        }
        Self { pixels, first, size, count }
    }

    fn view(&self, k: usize) -> View<'_, P> {
        let one = self.size.0 * self.size.1;
        let from = self.first + (k % self.count) * one;
        View::packed(&self.pixels[from..from + one], self.size.0, self.size.1)
            .expect("as many pixels as the size says")
    }
}

fn image<P: Sample>(size: (usize, usize), axis: Axis) -> Vec<P> {
    let camera = P::CAMERA;
    let mut random = StdRng::seed_from_u64(1);
    let mut image = Vec::with_capacity(size.0 * size.1);
    for y in 0..size.1 {
        for x in 0..size.0 {
            let (line, at, length) = if axis == Axis::PerRow { (y, x, size.0) } else { (x, y, size.1) };
            let line = line as f64;
            let centre = 0.4 * length as f64 + 0.1 * line + 5.0 * (line / 40.0).sin();
            let mean = camera.background + camera.height * (-0.125 * (at as f64 - centre).powi(2)).exp();
            // Box and Muller.
            let (u, v): (f64, f64) = (random.random(), random.random());
            let normal = (-2.0 * (1.0 - u).ln()).sqrt() * (2.0 * std::f64::consts::PI * v).cos();
            let value = mean + camera.noise.variance(mean, 0.0).sqrt() * normal;
            image.push(P::of(value.round().clamp(0.0, f64::from(camera.noise.full_scale_dn))));
        }
    }
    image
}

/// One kernel with all it keeps from image to image.
enum Kernel {
    Read,
    Extract(Box<Extractor>),
}

impl Kernel {
    /// Ready to run: width and noise, where it wants them, learned from `view`.
    fn new<P: Sample>(settings: Option<(Method, bool)>, axis: Axis, view: View<'_, P>) -> Self {
        let Some((method, tracked)) = settings else { return Self::Read };
        let options = Options { method, axis, track: tracked.then(Tracking::default), ..Options::default() };
        let mut extractor = Extractor::new(options).expect("settings in range");
        extractor.extract(view, None).expect("an image without a region");
        Self::Extract(Box::new(extractor))
    }

    fn run<P: Sample>(&mut self, view: View<'_, P>) {
        match self {
            Self::Read => {
                black_box(brightest(black_box(&view)));
            }
            Self::Extract(extractor) => {
                black_box(extractor.extract(black_box(view), None).expect("an image without a region"));
            }
        }
    }
}

fn group<P: Sample>(c: &mut Criterion) {
    for (axis, direction) in AXES {
        for size in SIZES {
            for (bytes, place) in [(1, "cache"), (RING, "memory")] {
                let ring = Ring::<P>::new(size, axis, bytes);
                let name = format!("stripes/{}/{}x{}/{place}/{direction}", P::NAME, size.0, size.1);
                let mut group = c.benchmark_group(name);
                group.throughput(Throughput::Elements((size.0 * size.1) as u64));
                for (name, settings) in KERNELS {
                    let mut kernel = Kernel::new(settings, axis, ring.view(0));
                    let mut next = 0;
                    group.bench_function(BenchmarkId::from_parameter(name), |b| {
                        b.iter(|| {
                            next += 1;
                            kernel.run(ring.view(next));
                        });
                    });
                }
                group.finish();
            }
        }
    }
}

/// The table of ratios: speed by that of the read, of the best run of each and in the median over the rounds.
fn ratios<P: Sample>(size: (usize, usize)) {
    const ROUNDS: usize = 300;
    for (bytes, place) in [(1, "cache"), (RING, "memory")] {
        for (axis, direction) in AXES {
            let ring = Ring::<P>::new(size, axis, bytes);
            let mut kernels: Vec<Kernel> =
                KERNELS[..QUICK].iter().map(|(_, s)| Kernel::new(*s, axis, ring.view(0))).collect();
            let mut times = vec![Vec::new(); QUICK];
            let mut next = 0;
            for _ in 0..ROUNDS {
                for (kernel, times) in kernels.iter_mut().zip(&mut times) {
                    // In memory every kernel has an image of its own; in the cache all have the same.
                    next += 1;
                    let view = ring.view(next);
                    let start = Instant::now();
                    kernel.run(view);
                    times.push(start.elapsed().as_secs_f64());
                }
            }
            let best = |k: usize| times[k].iter().copied().fold(f64::INFINITY, f64::min);
            let pixels = (size.0 * size.1) as f64;
            print!("{:<4}{place:<7}{direction:<11}read {:>6.1} µs", P::NAME, best(0) * 1e6);
            for k in 1..QUICK {
                let mut each: Vec<f64> = times[0].iter().zip(&times[k]).map(|(r, t)| r / t).collect();
                each.sort_unstable_by(f64::total_cmp);
                let (name, mpx) = (KERNELS[k].0, pixels / best(k) / 1e6);
                print!("  {name} {:.2} ({:.2}) {mpx:.0} Mpx/s", best(0) / best(k), each[ROUNDS / 2]);
            }
            println!();
        }
    }
}

/// The same of a scan, whose stripes end, are shaded, clipped and bent, as those above are not: time an image, of the best of some runs of each.
fn scan_ratios() {
    const RUNS: usize = 30;
    let capture = Capture::open(Path::new("fixtures/ball")).expect("the repository's own capture");
    let read = |frame| capture.image(frame, Reduce::Luma, None).expect("a sound image");
    let images: Vec<GrayImage> = capture.present().map(read).collect();
    let mut times = [0.0; QUICK];
    for ((_, settings), time) in KERNELS[..QUICK].iter().zip(&mut times) {
        // In the middle of the sweep the ball is widest.
        let mut kernel = Kernel::new(*settings, Axis::PerRow, packed(&images[images.len() / 2]));
        for image in &images {
            let run = |_| {
                let start = Instant::now();
                kernel.run(packed(image));
                start.elapsed().as_secs_f64()
            };
            *time += (0..RUNS).map(run).fold(f64::INFINITY, f64::min) / images.len() as f64;
        }
    }
    print!("{} images of fixtures/ball in cache: read {:.1} µs", images.len(), times[0] * 1e6);
    for ((name, _), time) in KERNELS.iter().zip(times).skip(1) {
        print!("  {name} {:.1} µs ({:.2})", time * 1e6, times[0] / time);
    }
    println!();
}

fn packed(image: &GrayImage) -> View<'_, u8> {
    let Pixels::U8(pixels) = &image.data else { unreachable!("the capture has 8 bits") };
    View::packed(pixels, image.width as usize, image.height as usize)
        .expect("as many pixels as the size says")
}

fn main() {
    if std::env::args().any(|a| a == "--ratios") {
        for size in SIZES {
            println!("{} x {}, speed by that of a pure read: best runs (median of rounds)", size.0, size.1);
            ratios::<u8>(size);
            ratios::<u16>(size);
        }
        scan_ratios();
        return;
    }
    let mut criterion = Criterion::default()
        .sample_size(10)
        .warm_up_time(Duration::from_millis(200))
        .measurement_time(Duration::from_millis(600))
        .configure_from_args();
    group::<u8>(&mut criterion);
    group::<u16>(&mut criterion);
    criterion.final_summary();
}
