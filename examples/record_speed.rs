//! How fast frames are recorded, extracted and triangulated together, beside what disk, memory and bare queues do in the same run.
//!
//! `cargo run --release --example record_speed -- CALIBRATION DISK_FOLDER MEMORY_FOLDER [FRAMES]`: the folders hold the recordings, the
//! second on a tmpfs. Frames come from the mock instrument, a ring of a few hundred synthetic images.

#![allow(clippy::print_stdout, reason = "the table of figures is what is asked for")]
#![allow(clippy::unwrap_used, reason = "a bench that can't run says so by stopping")]

mod memory;

use memory::resident_mib;
use rand::{RngExt, SeedableRng, rngs::StdRng};
use std::fs::File;
use std::io::Write;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};
use uwscan::geom::Medium;
use uwscan::hw::interlock::{Interlock, Policy};
use uwscan::hw::mock::Mock;
use uwscan::hw::sweep::{Aim, StepAndSettle};
use uwscan::hw::{Camera, CameraSettings, GuardedGalvo, Limits, Pixels, Timeline, Trigger};
use uwscan::io::calibration_toml::{self, CalibrationFile};
use uwscan::io::recording::{Head, Options, Recorder};
use uwscan::io::{Kind, Overwrite};
use uwscan::pipeline::record::acquire::Acquisition;
use uwscan::pipeline::record::session::{Observer, Pressure, Room, Session, run};
use uwscan::pipeline::record::{Counts, Preview, Tally};
use uwscan::stripe::Method;

const SIZES: [[u32; 2]; 2] = [[768, 576], [1920, 1200]];
/// Bytes of the ring of images: more than the caches hold.
const RING: usize = 128 << 20;
/// A pause of the frames is for the disk; longer means that it is broken.
const PRESSURE: Pressure = Pressure::Wait { each: Duration::from_secs(1), times: 60 };

struct Quiet;
impl Observer for Quiet {}

/// Images of a stripe that wanders, with noise, as many as the ring has room for.
fn ring([width, height]: [u32; 2]) -> Vec<Arc<Vec<u8>>> {
    let mut rng = StdRng::seed_from_u64(1);
    let (width, height) = (width as usize, height as usize);
    let noise: Vec<f64> = (0..1 << 16).map(|_| rng.random_range(-3.0..3.0)).collect();
    let image = |n: usize| {
        let mut pixels = vec![0_u8; width * height];
        for (v, row) in pixels.chunks_mut(width).enumerate() {
            let centre = width as f64 * (0.45 + 0.001 * n as f64) + 20.0 * (v as f64 * 0.01).sin();
            for (u, pixel) in row.iter_mut().enumerate() {
                let off = (u as f64 - centre) / 1.6;
                let stripe = if off.abs() < 6.0 { 150.0 * (-0.5 * off * off).exp() } else { 0.0 };
                *pixel = (12.0 + stripe + noise[(n * 7919 + v * width + u) & 0xffff]) as u8;
            }
        }
        Arc::new(pixels)
    };
    (0..(RING / (width * height)).clamp(16, 300)).map(image).collect()
}

/// Records `frames` frames, one each `every` (zero: as fast as goes); the seconds it took, and the counts.
fn record(
    images: &[Arc<Vec<u8>>],
    size: [u32; 2],
    path: &Path,
    calibration: Option<&CalibrationFile>,
    frames: u32,
    every: Duration,
    watch: &dyn Observer,
) -> (f64, Counts) {
    let timeline = Timeline::system();
    let mock = Mock::new(timeline.clone());
    mock.keep_no_events();
    let limits = Limits::new([-10.0, 10.0], 1e9, 1e-6).unwrap();
    let galvo = GuardedGalvo::new(Box::new(mock.galvo()), limits, timeline.clone());
    let interlock = Interlock::engage(
        Box::new(mock.laser()),
        galvo,
        Policy { watchdog: None, ..Policy::default() },
        |_| {},
    )
    .unwrap();
    let handle = interlock.handle();
    let shown = images.to_vec();
    let mut camera = mock.camera(move |shot| Pixels::U8(shown[shot.number as usize % shown.len()].clone()));
    let within = Duration::from_secs(1);
    let settings = CameraSettings {
        size,
        pixel_format: None,
        significant_bits: 8,
        exposure: Duration::ZERO,
        gain_db: None,
        trigger: Trigger::Software,
    };
    camera.configure(&settings, within).unwrap();
    camera.arm(within).unwrap();
    let tally = Tally::default();
    let head = Head::new(Kind::Scan, uwscan::io::Medium::Water, None);
    let began_ns = timeline.stamp_ns() as u64;
    let recorder = Recorder::create(path, Overwrite::Replace, &head, began_ns, Options::default()).unwrap();
    let outside = Medium::of_index(1.335);
    let preview = calibration.map(|file| Preview::new(file, outside, 8, Method::Robust).unwrap());
    let session = Session {
        recorder,
        preview,
        preview_every: every.is_zero(),
        pressure: PRESSURE,
        frame_bytes: images[0].len(),
        timeline: &timeline,
        room: Room { path, min_free_bytes: 0 },
        tally: &tally,
        observer: watch,
    };
    let steps = StepAndSettle {
        settle: Duration::ZERO,
        frame_within: within,
        retries: 0,
        stamp_slack: Duration::ZERO,
    };
    let began = Instant::now();
    let (ended, recorded) = run(session, |feed| {
        let mut due = Instant::now();
        let aims = (0..frames).map(|k| {
            due += every;
            std::thread::sleep(due.saturating_duration_since(Instant::now()));
            Aim::lit(-0.5 + 1.0 * f64::from(k % 1000) / 1000.0)
        });
        Acquisition::new(&handle, &mut camera, 0).step(aims, &steps, None, feed)
    });
    let seconds = began.elapsed().as_secs_f64();
    ended.unwrap();
    assert!(recorded.error.is_none(), "{:?}", recorded.error);
    (seconds, tally.counts())
}

/// Seconds for writing so many bytes one after the other, in the recorder's own chunks, made durable at the end.
fn write_speed(path: &Path, image: &[u8], frames: u32) -> f64 {
    let began = Instant::now();
    let mut file = File::create(path).unwrap();
    let chunk: Vec<u8> = image.iter().copied().cycle().take(4 << 20).collect();
    let mut left = image.len() * frames as usize;
    while left > 0 {
        let part = left.min(chunk.len());
        file.write_all(&chunk[..part]).unwrap();
        left -= part;
    }
    file.sync_data().unwrap();
    began.elapsed().as_secs_f64()
}

/// Seconds for copying so many frames in memory.
fn copy_speed(images: &[Arc<Vec<u8>>], frames: u32) -> f64 {
    let mut to = vec![0_u8; images[0].len()];
    let began = Instant::now();
    for k in 0..frames as usize {
        to.copy_from_slice(&images[k % images.len()]);
        std::hint::black_box(&mut to);
    }
    began.elapsed().as_secs_f64()
}

/// Microseconds that a token takes through the same two queues and threads with nothing to do: median and 99 %.
fn bare_queues(times: u32, every: Duration) -> [f64; 2] {
    let (a, from_a) = crossbeam_channel::bounded::<Instant>(4);
    let (b, from_b) = crossbeam_channel::bounded::<Instant>(4);
    let mut late: Vec<f64> = std::thread::scope(|scope| {
        scope.spawn(move || from_a.into_iter().for_each(|sent| b.send(sent).unwrap()));
        let last =
            scope.spawn(move || from_b.into_iter().map(|sent| sent.elapsed().as_secs_f64() * 1e6).collect());
        for _ in 0..times {
            std::thread::sleep(every);
            a.send(Instant::now()).unwrap();
        }
        drop(a);
        last.join().unwrap()
    });
    late.sort_by(f64::total_cmp);
    [0.5, 0.99].map(|share| late[((late.len() - 1) as f64 * share) as usize])
}

/// Looks at the memory after each thousand frames.
#[derive(Default)]
struct Memory(std::sync::Mutex<Vec<f64>>);

impl Observer for Memory {
    fn recorded(&self, tally: &Tally) {
        if tally.counts().recorded.is_multiple_of(1000) {
            self.0.lock().unwrap().push(resident_mib());
        }
    }
}

fn main() {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [calibration, disk, memory] = args.get(..3).and_then(|a| <&[String; 3]>::try_from(a).ok()).unwrap();
    let frames: u32 = args.get(3).map_or(2000, |n| n.parse().unwrap());
    let (calibration, _) = calibration_toml::read(Path::new(calibration)).unwrap();
    let image_s = |frames: u32, seconds: f64| f64::from(frames) / seconds;
    println!("frames a second, {frames} frames; shares of the sequential write in the same run");
    println!("size        to       copy   write  record        + extract + triangulate");
    for size in SIZES {
        let images = ring(size);
        // About as many bytes at each size.
        let n = (u64::from(frames) * 442_368 / images[0].len() as u64) as u32;
        for (name, folder) in [("disk", disk), ("memory", memory)] {
            let path = Path::new(folder).join("record-speed.mcap");
            let copy = image_s(n, copy_speed(&images, n));
            let write = image_s(n, write_speed(&path, &images[0], n));
            let (seconds, _) = record(&images, size, &path, None, n, Duration::ZERO, &Quiet);
            let alone = image_s(n, seconds);
            let (seconds, counts) =
                record(&images, size, &path, Some(&calibration), n, Duration::ZERO, &Quiet);
            let all = image_s(n, seconds);
            assert_eq!(counts.previewed, n as usize);
            println!(
                "{:4} x {:4} {name:6} {copy:8.0} {write:7.0} {alone:7.0} ({:.2}) {all:9.0} ({:.2})",
                size[0],
                size[1],
                alone / write,
                all / write
            );
            std::fs::remove_file(&path).unwrap();
        }
    }

    let images = ring(SIZES[0]);
    let path = Path::new(memory).join("record-speed.mcap");
    let (seconds, counts) =
        record(&images, SIZES[0], &path, Some(&calibration), 2500, Duration::from_millis(2), &Quiet);
    println!(
        "500 Hz asked, 768 x 576 to memory: {:.1} Hz, {} of {} recorded, {} without points on the fly, at most {} waiting",
        2500.0 / seconds,
        counts.recorded,
        counts.acquired,
        counts.skipped,
        counts.longest_queue
    );
    let pace = Duration::from_millis(10);
    let (_, counts) = record(&images, SIZES[0], &path, Some(&calibration), 1000, pace, &Quiet);
    let [middle, late] = counts.latency_us.unwrap();
    let [bare, bare_late] = bare_queues(1000, pace);
    println!(
        "exposure to points at 100 Hz: median {:.2} ms, 99 % {:.2} ms ({} of 1000); bare queues {:.3} and {:.3} ms",
        middle as f64 * 1e-3,
        late as f64 * 1e-3,
        counts.previewed,
        bare * 1e-3,
        bare_late * 1e-3
    );
    let watch = Memory::default();
    let (_, counts) = record(&images, SIZES[0], &path, Some(&calibration), 10_000, Duration::ZERO, &watch);
    let seen = watch.0.into_inner().unwrap();
    println!(
        "10 000 frames: {:.0} MiB after the first thousand, {:.0} after the last, {:.0} at most; at most {} frames waiting",
        seen[0],
        seen[seen.len() - 1],
        seen.iter().fold(0.0, |a: f64, b| a.max(*b)),
        counts.longest_queue
    );
    std::fs::remove_file(&path).unwrap();
}
