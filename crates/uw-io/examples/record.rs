//! Records something on every topic, for readers that are not ours: `record OUT.mcap [CALIBRATION.toml]`.
#![allow(clippy::print_stdout)]

use std::{env, fs, io, path::PathBuf};

use uw_calib::Across;
use uw_cloud::{CloudPoint, Frame, PointCloud};
use uw_io::{
    Kind, Medium, Overwrite,
    recording::{Environment, GalvoState, Head, Level, Options, Picture, Pose, Recorder, Shot, Stripe},
};

const BEGAN_NS: u64 = 1_700_000_000_000_000_000;
const FRAMES: u32 = 20;
const SIZE: [u32; 2] = [64, 48];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = env::args_os().skip(1).map(PathBuf::from);
    let usage = "usage: record OUT.mcap [CALIBRATION.toml]";
    let out = args.next().ok_or_else(|| io::Error::new(io::ErrorKind::InvalidInput, usage))?;
    let calibration = args.next().map(fs::read_to_string).transpose()?;
    let mut head =
        Head { scan_id: "example".to_owned(), calibration, ..Head::new(Kind::Scan, Medium::Water, None) };
    head.planned_frames = Some(FRAMES);
    head.notes.insert("water_index".to_owned(), "1.3351".to_owned());
    let mut recorder = Recorder::create(&out, Overwrite::Replace, &head, BEGAN_NS, Options::default())?;
    recorder.environment(
        &Environment {
            stamp_ns: BEGAN_NS,
            temperature_c: Some(12.0),
            salinity_psu: Some(35.0),
            depth_m: Some(20.0),
            index: Some(1.3351),
        },
        BEGAN_NS,
    )?;
    let [width, height] = SIZE;
    for number in 0..FRAMES {
        let stamp_ns = BEGAN_NS + u64::from(number) * 10_000_000;
        let received_ns = stamp_ns + 4_000_000;
        let volts = 0.25 * f64::from(number);
        let state = GalvoState {
            stamp_ns,
            frame: Some(number),
            commanded_v: Some(volts),
            readback_v: Some(volts + 1e-3),
            settled: Some(true),
        };
        recorder.galvo(&state, received_ns)?;
        let shot =
            Shot { number, file: "", pose: None, laser_on: true, voltage_v: Some(volts), stamp_ns, bits: 12 };
        // Pixel (u, v) of image n is n + u + 64 v, so that a reader's mistake shows.
        let pixels: Vec<u16> = (0..width * height).map(|i| (number + i) as u16).collect();
        recorder.frame(&shot, &Picture::U16 { width, height, pixels: &pixels }, received_ns)?;
        let stripe = Stripe {
            stamp_ns,
            frame: number,
            across: Across::U,
            lines: &[3, 4],
            position_px: &[31.25 + volts, 31.5 + volts],
            sigma_px: &[0.05, 0.06],
            width_px: &[1.5, 1.5],
            amplitude: &[900.0, 910.0],
        };
        recorder.stripe(&stripe, received_ns)?;
        let point = CloudPoint {
            position_mm: [1.5, -2.5, 1000.0 + f64::from(number)],
            intensity: 900.0,
            frame_row: number,
            pixel: [31.25, 3.0],
            sigma_mm: 0.02,
            covariance_mm2: [1e-4, 0.0, 0.0, 2e-4, 0.0, 4e-4],
            shared_mm: Some([1e-3, 2e-3, -3e-3]),
        };
        recorder.points(&PointCloud::from_points(Frame::Camera, &[point]), stamp_ns, received_ns)?;
        let pose = Pose {
            stamp_ns,
            parent: "world",
            child: "vehicle",
            position_mm: [1000.0 * f64::from(number), 0.0, -20_000.0],
            rotation_xyzw: [0.0, 0.0, 0.0, 1.0],
        };
        recorder.vehicle(&pose, received_ns)?;
        recorder.transform(&pose, received_ns)?;
    }
    recorder.log(Level::Warning, "an example of a warning", BEGAN_NS + 1_000_000_000)?;
    let counts = recorder.finish()?;
    println!("{}: {} messages, {} bytes", out.display(), counts.messages, counts.bytes);
    Ok(())
}
