//! Scans on the mock instrument and on replayed ones: the same cloud by whichever way, and nothing lost or left on whatever goes wrong.

#![allow(clippy::print_stderr, reason = "a skipped test says so")]
#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking")]

mod faults;
mod same_cloud;
mod steering;

use std::path::{Path, PathBuf};
use std::sync::{Arc, LazyLock};
use std::time::Duration;
use uwscan::Failure;
use uwscan::hw::interlock::{Interlock, Policy};
use uwscan::hw::mock::{Mock, Shot};
use uwscan::hw::sweep::StepAndSettle;
use uwscan::hw::{CameraSettings, Galvo, GuardedGalvo, Laser, Limits, Pixels, Timeline, Trigger};
use uwscan::io::calibration_toml::CalibrationFile;
use uwscan::io::recording::{Head, Options};
use uwscan::io::{Capture, Expect, Kind, Medium, Overwrite, Reduce, Rig, SaidBy};
use uwscan::pipeline::Silent;
use uwscan::pipeline::calibrate::{self, calibrate};
use uwscan::pipeline::reconstruct;
use uwscan::pipeline::record::session::Observer;
use uwscan::pipeline::record::{Instrument, Motion, Plan, Scanned, Settings, scan};
use uwscan::stripe::Method;

/// Where the mirror is left.
const PARK_V: f64 = -0.5;
/// What each call may take in these tests.
const WITHIN: Duration = Duration::from_millis(40);

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures").join(name)
}

/// A recorded sweep in memory: its voltages, and the image at each.
pub struct Sweep {
    pub volts: Vec<f64>,
    images: Vec<Arc<Vec<u8>>>,
}

impl Sweep {
    /// What a camera sees with the mirror at `volts`: the image recorded there, or the nearest.
    pub fn image(&self, volts: f64) -> Arc<Vec<u8>> {
        let off = |i: &usize| (self.volts[*i] - volts).abs();
        let nearest = (0..self.volts.len()).min_by(|a, b| off(a).total_cmp(&off(b))).unwrap();
        self.images[nearest].clone()
    }

    pub fn size(&self) -> [u32; 2] {
        [768, 576]
    }
}

/// The sweep over the ball.
pub static BALL: LazyLock<Arc<Sweep>> = LazyLock::new(|| {
    let capture = Capture::open(&fixture("ball")).unwrap();
    let rig = capture.rig.as_ref().unwrap();
    let expect = Some(Expect::of(&rig.camera, SaidBy::Rig));
    let mut sweep = Sweep { volts: Vec::new(), images: Vec::new() };
    for frame in capture.present() {
        let path = fixture("ball").join(&frame.file);
        let image = uwscan::io::images::read(&path, Reduce::Luma, expect).unwrap();
        let uwscan::io::Pixels::U8(values) = image.data else { panic!("8 bits") };
        sweep.volts.push(frame.voltage_v.unwrap());
        sweep.images.push(Arc::new(values));
    }
    Arc::new(sweep)
});

/// A calibration from a part of the poses: what it is worth is tested elsewhere.
pub static CALIBRATION: LazyLock<CalibrationFile> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    let parts = ["cal-air", "cal-water"].map(|name| {
        let (from, to) = (fixture(name), folder.path().join(name));
        std::fs::create_dir_all(&to).unwrap();
        std::os::unix::fs::symlink(from.join("images"), to.join("linked")).unwrap();
        for file in ["capture.toml", "rig.toml"] {
            std::fs::copy(from.join(file), to.join(file)).unwrap();
        }
        std::fs::create_dir_all(to.join("images")).unwrap();
        let table = std::fs::read_to_string(from.join("frames.csv")).unwrap();
        let kept = table.lines().enumerate().filter(|(row, text)| {
            let pose = text.split(',').nth(1).and_then(|pose| pose.parse::<usize>().ok());
            pose.is_none_or(|pose| pose < 6) && (*row == 0 || text.contains(",off,") || row.is_multiple_of(3))
        });
        let mut rows = String::new();
        for (row, text) in kept {
            rows += text;
            rows.push('\n');
            if row > 0 {
                let file = text.split(',').next().unwrap();
                std::fs::copy(from.join(file), to.join(file)).unwrap();
            }
        }
        std::fs::remove_file(to.join("linked")).unwrap();
        std::fs::write(to.join("frames.csv"), rows).unwrap();
        to
    });
    let settings = calibrate::Settings { rig: None, method: uwscan::calib::Method::Joint };
    calibrate(&parts, &settings, &Silent).unwrap().file
});

pub fn rig() -> Rig {
    Rig::read(&fixture("ball/rig.toml")).unwrap().0
}

pub const STEPS: StepAndSettle =
    StepAndSettle { settle: Duration::ZERO, frame_within: WITHIN, retries: 2, stamp_slack: Duration::ZERO };

pub fn camera_settings(size: [u32; 2]) -> CameraSettings {
    CameraSettings {
        size,
        pixel_format: None,
        significant_bits: 8,
        exposure: Duration::from_micros(100),
        gain_db: None,
        trigger: Trigger::Software,
    }
}

/// Laser and galvanometer behind an interlock; what takes long is done before, for nobody feeds its watchdog meanwhile.
pub fn interlock(laser: Box<dyn Laser>, galvo: Box<dyn Galvo>, timeline: &Timeline) -> Interlock {
    LazyLock::force(&BALL);
    LazyLock::force(&CALIBRATION);
    let limits = Limits::new([-5.0, 5.0], 1e6, 0.005).unwrap();
    let policy = Policy { park_v: PARK_V, within: WITHIN, ..Policy::default() };
    Interlock::engage(laser, GuardedGalvo::new(galvo, limits, timeline.clone()), policy, |_| {}).unwrap()
}

/// The mock instrument before the ball.
pub fn mock_instrument(mock: &Mock, timeline: &Timeline) -> Instrument {
    let ball = BALL.clone();
    let dark = Arc::new(vec![0_u8; 768 * 576]);
    let size = ball.size();
    let see = move |shot: &Shot| {
        let [width, height] = shot.size;
        let whole = if shot.laser_on { ball.image(shot.volts) } else { dark.clone() };
        if shot.size == ball.size() {
            return Pixels::U8(whole);
        }
        Pixels::U8(Arc::new(vec![0; width as usize * height as usize]))
    };
    Instrument {
        interlock: interlock(Box::new(mock.laser()), Box::new(mock.galvo()), timeline),
        camera: Box::new(mock.camera(see)),
        camera_settings: camera_settings(size),
    }
}

/// One stepped sweep over the voltages of the ball's.
pub fn plan() -> Plan {
    let motion = Motion::Steps { volts: BALL.volts.clone(), settings: STEPS };
    Plan { motion, repeat: 1, adaptive: None, background_every: 0 }
}

pub struct Quiet;
impl Observer for Quiet {}

/// Scans into `path`; with the calibration a cloud is made.
pub fn record(instrument: Instrument, plan: &Plan, path: &Path, calibrated: bool) -> Scanned {
    scan_into(instrument, plan, path, calibrated, 0, &Quiet).unwrap()
}

/// Scans into `path`, without a cloud, watched.
pub fn record_watched(instrument: Instrument, plan: &Plan, path: &Path, observer: &dyn Observer) -> Scanned {
    scan_into(instrument, plan, path, false, 0, observer).unwrap()
}

/// Scans into `path` as long as so many bytes stay free.
pub fn record_leaving(
    instrument: Instrument,
    plan: &Plan,
    path: &Path,
    min_free_bytes: u64,
) -> Result<Scanned, Failure> {
    scan_into(instrument, plan, path, false, min_free_bytes, &Quiet)
}

fn scan_into(
    instrument: Instrument,
    plan: &Plan,
    path: &Path,
    calibrated: bool,
    min_free_bytes: u64,
    observer: &dyn Observer,
) -> Result<Scanned, Failure> {
    let rig = rig();
    let mut head = Head::new(Kind::Scan, Medium::Water, None);
    head.rig = Some(rig.to_toml().unwrap());
    let settings = Settings {
        path,
        overwrite: Overwrite::Refuse,
        recording: Options::default(),
        min_free_bytes,
        head: &head,
        rig: Some(&rig),
        calibration: calibrated.then(|| &*CALIBRATION),
        reconstruct: reconstruct::Settings::default(),
        preview: Method::Robust,
    };
    scan(instrument, plan, &settings, &Silent, observer)
}

/// What a recording holds, by our own reader: numbers and voltages of its images, in order.
pub fn held(path: &Path) -> Vec<(usize, Option<f64>)> {
    let capture = Capture::open(path).unwrap();
    capture.present().map(|frame| (frame.row, frame.voltage_v)).collect()
}
