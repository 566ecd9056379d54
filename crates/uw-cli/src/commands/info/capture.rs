//! What a capture folder or a recording holds: every image is decoded, as that alone shows whether it is sound.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
};

use anyhow::bail;
use rayon::prelude::*;
use serde::Serialize;
use uwscan::{
    io::{Capture, Error, Expect, Kind, Medium, Problem, Reduce, SaidBy, Severity},
    pipeline::Progress as _,
};

use super::{Content, What, instrument::rig_text};
use crate::{console::Console, progress::Progress};

#[derive(Serialize)]
pub(super) struct Record {
    purpose: &'static str,
    medium: &'static str,
    target: Option<Target>,
    images: usize,
    laser_on: usize,
    laser_off: usize,
    poses: usize,
    voltages: usize,
    voltage_range_v: Option<[f64; 2]>,
    image_size: [u32; 2],
    seconds: f64,
    rig: bool,
    sha256: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    recording: Option<Recording>,
}

/// What only a recording says.
#[derive(Serialize)]
struct Recording {
    scan_id: String,
    software: String,
    planned_frames: Option<u32>,
    notes: BTreeMap<String, String>,
    /// Messages of each.
    topics: BTreeMap<String, u64>,
    calibration: bool,
}

#[derive(Serialize)]
struct Target {
    inner_corners: [u32; 2],
    square_mm: f64,
    wavelength_nm: Option<f64>,
}

pub(super) fn medium_name(medium: Medium) -> &'static str {
    match medium {
        Medium::Air => "air",
        Medium::Water => "water",
    }
}

pub(super) fn look(dir: &Path, noted: &mut Vec<Problem>, console: &Console) -> anyhow::Result<Content> {
    let mut capture = Capture::open_noting(dir, None, noted)?;
    let (image_size, lost) = match decode(&capture, console) {
        Ok(decoded) => decoded,
        Err(error) => {
            noted.append(&mut capture.take_problems());
            return Err(error);
        }
    };
    let record = record(&capture, image_size)?;
    let text = text(&capture, &record);
    let mut problems = capture.take_problems();
    problems.extend(lost);
    let warnings = warnings(&capture, &record, &problems);
    Ok(Content { what: What::Capture(Box::new(record)), text, warnings, problems })
}

/// The images' size, and those that can't be decoded or have another one.
fn decode(capture: &Capture, console: &Console) -> anyhow::Result<([u32; 2], Vec<Problem>)> {
    let expect = capture.rig.as_ref().map(|rig| Expect::of(&rig.camera, SaidBy::Rig));
    let frames: Vec<_> = capture.present().collect();
    let progress = Progress::new(console);
    progress.begin("images", frames.len());
    let decoded: Vec<Result<[u32; 2], Error>> = frames
        .par_iter()
        .map(|frame| {
            let image = capture.image(frame, Reduce::Luma, expect);
            progress.step();
            image.map(|image| [image.width, image.height])
        })
        .collect();
    drop(progress);
    let mut sizes: BTreeMap<[u32; 2], usize> = BTreeMap::new();
    for &size in decoded.iter().flatten() {
        *sizes.entry(size).or_default() += 1;
    }
    let common = sizes.iter().max_by_key(|(_, count)| **count).map(|(size, _)| *size);
    let mut lost = Vec::new();
    for (frame, decoded) in std::iter::zip(&frames, decoded) {
        let error = match (decoded, common) {
            (Err(error), _) => error,
            (Ok(got), Some(needed)) if got != needed => {
                let path = capture.image_path(frame);
                Error::ImageSize { path, needed, got, said_by: SaidBy::Others }
            }
            _ => continue,
        };
        lost.push(Problem::loss(frame.row, error));
    }
    match (common, lost.first()) {
        (Some(size), _) => Ok((size, lost)),
        (None, first) => {
            let first = first.map_or(String::new(), |problem| format!("; the first: {problem}"));
            bail!("{}: none of its {} images can be used{first}", capture.path.display(), frames.len())
        }
    }
}

fn record(capture: &Capture, image_size: [u32; 2]) -> Result<Record, Error> {
    let volts = || capture.frames.iter().filter_map(|f| f.voltage_v);
    let range = volts().fold(None, |range: Option<[f64; 2]>, v| {
        Some(range.map_or([v, v], |[low, high]| [low.min(v), high.max(v)]))
    });
    let stamps = || capture.frames.iter().map(|f| f.stamp_ns);
    let duration_ns = stamps().max().unwrap_or_default() - stamps().min().unwrap_or_default();
    let laser_on = capture.frames.iter().filter(|f| f.laser_on).count();
    Ok(Record {
        purpose: match capture.kind {
            Kind::Calibration => "calibration",
            Kind::Scan => "scan",
        },
        medium: medium_name(capture.medium),
        target: capture.target.as_ref().map(|t| Target {
            inner_corners: t.inner_corners,
            square_mm: t.square_mm,
            wavelength_nm: t.wavelength_nm,
        }),
        images: capture.frames.len(),
        laser_on,
        laser_off: capture.frames.len() - laser_on,
        poses: capture.frames.iter().filter_map(|f| f.pose).collect::<BTreeSet<_>>().len(),
        voltages: volts().map(f64::to_bits).collect::<BTreeSet<_>>().len(),
        voltage_range_v: range,
        image_size,
        seconds: duration_ns as f64 * 1e-9,
        rig: capture.rig.is_some(),
        sha256: capture.content_hash()?,
        recording: capture.head().map(|head| Recording {
            scan_id: head.scan_id.clone(),
            software: head.software.clone(),
            planned_frames: head.planned_frames,
            notes: head.notes.clone(),
            topics: capture.topics().map(|(name, topic)| (name.to_owned(), topic.messages)).collect(),
            calibration: head.calibration.is_some(),
        }),
    })
}

/// What makes a capture useless for its purpose though each of its files is sound.
fn warnings(capture: &Capture, record: &Record, problems: &[Problem]) -> Vec<String> {
    let dir = capture.path.display();
    let mut said = Vec::new();
    if record.laser_on == 0 {
        said.push(format!("{dir}: no image has the laser on: there is no stripe in it"));
    }
    if record.laser_off == 0 && capture.kind == Kind::Calibration {
        said.push(format!("{dir}: no image has the laser off: the board is found in such images only"));
    }
    if capture.rig.is_none() && capture.kind == Kind::Calibration {
        said.push(format!("{dir}: there is no rig.toml: calibrate needs --rig FILE"));
    }
    if problems.iter().any(|p| p.severity == Severity::Loss) && record.laser_on > 0 {
        said.push(format!("{dir}: the figures count all rows, those of lost images too"));
    }
    said
}

fn text(capture: &Capture, record: &Record) -> String {
    let mut text = format!("capture of a {} in {}\n", record.purpose, record.medium);
    if let Some(target) = &record.target {
        let [columns, rows] = target.inner_corners;
        text += &format!(
            "  target      chessboard, {columns} x {rows} inner corners, {} mm squares, {} poses\n",
            target.square_mm, record.poses
        );
    }
    let [width, height] = record.image_size;
    text += &format!(
        "  images      {} of {width} x {height} px: {} with the laser on, {} with it off, in {:.1} s\n",
        record.images, record.laser_on, record.laser_off, record.seconds
    );
    if let Some([low, high]) = record.voltage_range_v {
        text += &format!("  voltages    {} from {low} to {high} V\n", record.voltages);
    }
    if let Some(recording) = &record.recording {
        let topics: Vec<String> =
            recording.topics.iter().map(|(name, count)| format!("{name} {count}")).collect();
        text += &format!("  recorded    by {}, scan {}\n", recording.software, recording.scan_id);
        text += &format!("  messages    {}\n", topics.join(", "));
        if recording.calibration {
            text += "  calibration attached\n";
        }
    }
    text += &format!("  sha256      {}\n", record.sha256);
    match &capture.rig {
        Some(rig) => text += &rig_text(rig),
        None => text += "  rig         none\n",
    }
    text
}
