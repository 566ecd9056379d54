//! How fast a recording is written beside the bare speed of memory and of the disk, in turn in the same run:
//! `recording_speed FOLDER [ROUNDS]`, with a folder in memory (/dev/shm) or on the disk to be measured.
#![allow(clippy::print_stdout)]

use std::{
    env,
    fs::{self, File},
    io::{self, Write},
    path::{Path, PathBuf},
    time::Instant,
};

use uw_io::{
    Kind, Medium, Overwrite,
    recording::{Head, Options, Picture, Recorder, Shot},
};

/// Bytes of images a round: more than any cache of the processor or the disk holds back.
const BYTES: u64 = 400 << 20;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = env::args_os().skip(1);
    let usage = "usage: recording_speed FOLDER [ROUNDS]";
    let folder =
        PathBuf::from(args.next().ok_or_else(|| io::Error::new(io::ErrorKind::InvalidInput, usage))?);
    let rounds = args.next().and_then(|n| n.to_str()?.parse().ok()).unwrap_or(5);
    for [width, height] in [[768_u32, 576_u32], [1920, 1200]] {
        let pixels: Vec<u8> =
            (0..width * height).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
        let frames = (BYTES / pixels.len() as u64) as u32;
        let [mut copies, mut plain, mut recorded] = [const { Vec::new() }; 3];
        for _ in 0..rounds {
            copies.push(copy(&pixels, frames));
            plain.push(write(&folder.join("plain.bin"), &pixels, frames)?);
            recorded.push(record(&folder.join("speed.mcap"), [width, height], &pixels, frames)?);
        }
        let [copy, plain, recorded] = [median(copies), median(plain), median(recorded)];
        let images = recorded * 1e6 / pixels.len() as f64;
        println!(
            "{width} x {height}: recorded {recorded:.0} MB/s ({images:.0} images a second), written {plain:.0} MB/s, copied in memory \
             {copy:.0} MB/s; recorded to written {:.2}",
            recorded / plain
        );
    }
    Ok(())
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

/// Megabytes a second.
fn rate(began: Instant, frames: u32, pixels: &[u8]) -> f64 {
    f64::from(frames) * pixels.len() as f64 * 1e-6 / began.elapsed().as_secs_f64()
}

fn copy(pixels: &[u8], frames: u32) -> f64 {
    let mut to = vec![0; pixels.len()];
    let began = Instant::now();
    for _ in 0..frames {
        to.copy_from_slice(std::hint::black_box(pixels));
        std::hint::black_box(&mut to);
    }
    rate(began, frames, pixels)
}

/// The same bytes in one file, made durable at the end.
fn write(path: &Path, pixels: &[u8], frames: u32) -> io::Result<f64> {
    let mut file = File::create(path)?;
    let began = Instant::now();
    for _ in 0..frames {
        file.write_all(pixels)?;
    }
    file.sync_data()?;
    let rate = rate(began, frames, pixels);
    fs::remove_file(path)?;
    Ok(rate)
}

fn record(
    path: &Path,
    [width, height]: [u32; 2],
    pixels: &[u8],
    frames: u32,
) -> Result<f64, Box<dyn std::error::Error>> {
    let head = Head::new(Kind::Scan, Medium::Water, None);
    let began = Instant::now();
    let mut recorder = Recorder::create(path, Overwrite::Replace, &head, 0, Options::default())?;
    for number in 0..frames {
        let stamp_ns = u64::from(number) * 2_000_000;
        let shot =
            Shot { number, file: "", pose: None, laser_on: true, voltage_v: Some(0.5), stamp_ns, bits: 8 };
        recorder.frame(&shot, &Picture::U8 { width, height, pixels }, stamp_ns)?;
    }
    recorder.finish()?;
    let rate = rate(began, frames, pixels);
    fs::remove_file(path)?;
    Ok(rate)
}
