//! Captures of a calibration → the calibrated instrument.

use crate::pipeline::Progress;
use crate::pipeline::boards::{self, Boards, name};
use crate::pipeline::load::Reading;
use crate::pipeline::stripes::{direction, extract, extractor};
use crate::{Error, Failure, Notes};
use nalgebra::Vector2;
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use uw_calib::lm::LmError;
use uw_calib::{
    Across, BoardView, CalibError, Method, Observations, Outside, Rejected, StripePoint, StripeView,
    ViewResiduals,
};
use uw_io::calibration_toml::{CalibrationFile, CaptureSource};
use uw_io::{Capture, FrameRecord, Kind, Medium, Problem, Rig, SaidBy};

/// What to calibrate with.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Rig file that replaces the captures' own.
    pub rig: Option<PathBuf>,
    /// How.
    pub method: Method,
}

/// A calibration, and what was lost on the way.
#[derive(Debug)]
pub struct Calibrated {
    /// Ready to be written.
    pub file: CalibrationFile,
    /// What remained of each measurement; empty for the paper's method.
    pub remains: Vec<ViewResiduals>,
    /// Warnings about the files, and losses.
    pub problems: Vec<Problem>,
}

/// What the images of a calibration showed.
#[derive(Debug)]
pub struct Observed {
    /// Corners and stripes.
    pub observations: Observations,
    /// What is known of the instrument: the rig file of the first capture.
    pub rig: Rig,
    /// The captures.
    pub sources: Vec<CaptureSource>,
    /// Images that were left out.
    pub rejected: Vec<Rejected>,
    /// Warnings about the files, and losses.
    pub problems: Vec<Problem>,
}

/// The calibration from one or more capture folders, in air, water or both.
///
/// # Errors
/// [`Failure`] where a file is wrong, no image shows the declared board, or the captures determine no calibration.
pub fn calibrate(
    captures: &[PathBuf],
    settings: &Settings,
    progress: &dyn Progress,
) -> Result<Calibrated, Failure> {
    let Observed { observations, rig, sources, rejected, problems } = observe(captures, settings, progress)?;
    progress.begin("adjustment", 1);
    let solved = rig.to_calib().map_err(CalibError::from).and_then(|known| match settings.method {
        Method::Joint => uw_calib::calibrate_in_full(&observations, &known, &|| progress.cancelled()),
        Method::Paper => uw_calib::calibrate_by_paper(&observations, &known).map(|made| (made, Vec::new())),
    });
    progress.step();
    let (mut calibration, remains) = match solved {
        Ok(made) => made,
        Err(error) => {
            let notes = Notes { problems, rejected, ..Notes::default() };
            let error = match error {
                CalibError::Adjustment(LmError::Stopped) => Error::Cancelled,
                error => error.into(),
            };
            return Err(Failure { error: Box::new(error), notes });
        }
    };
    calibration.statistics.rejected.splice(..0, rejected);
    let software = concat!("uwscan ", env!("CARGO_PKG_VERSION")).to_owned();
    let file = CalibrationFile { calibration, rig, captures: sources, software };
    Ok(Calibrated { file, remains, problems })
}

/// Corners and stripes of one or more capture folders: all of [`calibrate`] that looks at images.
///
/// # Errors
/// [`Failure`] where a file is wrong, or no image shows the declared board.
pub fn observe(
    captures: &[PathBuf],
    settings: &Settings,
    progress: &dyn Progress,
) -> Result<Observed, Failure> {
    let mut notes = Notes::default();
    match look(captures, settings, &mut notes, progress) {
        Ok((observations, rig, sources)) => {
            let Notes { problems, rejected, .. } = notes;
            Ok(Observed { observations, rig, sources, rejected, problems })
        }
        Err(error) => Err(Failure { error: Box::new(error), notes }),
    }
}

fn look(
    captures: &[PathBuf],
    settings: &Settings,
    notes: &mut Notes,
    progress: &dyn Progress,
) -> Result<(Observations, Rig, Vec<CaptureSource>), Error> {
    let captures: Vec<Capture> =
        captures.iter().map(|path| open(path, settings, notes)).collect::<Result<_, _>>()?;
    let rig_of = |c: &Capture| c.rig.clone().ok_or_else(|| Error::NoRig { path: c.path.clone() });
    let rigs: Vec<Rig> = captures.iter().map(rig_of).collect::<Result<_, _>>()?;
    let Some(rig) = rigs.first().cloned() else {
        return Err(CalibError::TooFewPoses { needed: 3, got: 0 }.into());
    };
    let size = |r: &Rig| [r.camera.width, r.camera.height];
    for (capture, other) in std::iter::zip(&captures, &rigs) {
        if size(other) != size(&rig) {
            return Err(Error::ImageSize {
                path: capture.path.clone(),
                needed: size(&rig),
                got: size(other),
            });
        }
    }

    let sources = captures.iter().map(source).collect::<Result<Vec<_>, _>>()?;
    for (i, (capture, own)) in std::iter::zip(&captures, &sources).enumerate() {
        if let Some(k) = sources[..i].iter().position(|other| other.sha256 == own.sha256) {
            return Err(Error::Twice { path: capture.path.clone(), other: captures[k].path.clone() });
        }
    }

    let mut found: Vec<Boards<'_>> = Vec::new();
    for (capture, rig) in std::iter::zip(&captures, &rigs) {
        let target = capture.target.as_ref().ok_or_else(|| wrong_kind(capture))?;
        found.push(boards::find(capture, target, Reading::new(rig, SaidBy::Rig), notes, progress)?);
    }
    let samples: Vec<(&Capture, Reading, u8)> = std::iter::zip(&captures, &rigs)
        .map(|(c, r)| (c, Reading::new(r, SaidBy::Rig), r.camera.bits))
        .collect();
    let across = direction(&samples)?;

    let mut views = Vec::new();
    for ((capture, rig), boards) in std::iter::zip(std::iter::zip(&captures, &rigs), &found) {
        let outside = outside(capture, rig)?;
        let (stripes, lost) = stripes(capture, rig, boards, across, progress)?;
        notes.problems.extend(lost);
        let mut by_pose: Vec<BoardView> = boards
            .seen
            .values()
            .map(|seen| BoardView {
                file: name(capture, seen.frame),
                outside,
                square_mm: boards.square_mm,
                corners: seen.corners.clone(),
                stripes: Vec::new(),
            })
            .collect();
        let poses: Vec<u32> = boards.seen.keys().copied().collect();
        for (frame, stripe) in stripes {
            if let Some(k) = frame.pose.and_then(|p| poses.binary_search(&p).ok()) {
                by_pose[k].stripes.push(stripe);
            }
        }
        let without_board = capture.present().filter(|f| f.laser_on && !boards.shows(f));
        notes.rejected.extend(without_board.map(|frame| Rejected {
            file: name(capture, frame),
            reason: "no image of its pose shows the board".to_owned(),
        }));
        views.extend(by_pose);
    }
    Ok((Observations { across, views }, rig, sources))
}

fn open(path: &Path, settings: &Settings, notes: &mut Notes) -> Result<Capture, Error> {
    let rig = settings.rig.as_deref();
    // Warnings of one rig file given for all captures are said once.
    let told = notes.problems.iter().any(|p| Some(p.error.path()) == rig);
    let mut noticed = Vec::new();
    let opened = Capture::open_noting(path, rig, &mut noticed).map(|mut capture| {
        noticed = capture.take_problems();
        capture
    });
    notes.problems.extend(noticed.into_iter().filter(|p| !(told && Some(p.error.path()) == rig)));
    let capture = opened?;
    if capture.kind == Kind::Calibration { Ok(capture) } else { Err(wrong_kind(&capture)) }
}

/// What a calibration file says of a capture that it came from.
fn source(capture: &Capture) -> Result<CaptureSource, uw_io::Error> {
    Ok(CaptureSource {
        name: capture.path.display().to_string(),
        sha256: capture.content_hash()?,
        medium: capture.medium,
    })
}

fn wrong_kind(capture: &Capture) -> Error {
    Error::Kind { path: capture.path.clone(), needed: "calibration", got: "scan" }
}

fn outside(capture: &Capture, rig: &Rig) -> Result<Outside, Error> {
    match capture.medium {
        Medium::Air => Ok(Outside::Air),
        Medium::Water => {
            let unknown = || Error::NoWaterIndex { path: capture.path.clone() };
            let laser_index = rig.water_index().ok_or_else(unknown)?;
            let lit = capture.target.as_ref().and_then(|t| t.wavelength_nm);
            let board_index = lit.and_then(|nm| rig.water_index_at(nm)).unwrap_or(laser_index);
            Ok(Outside::Water { laser_index, board_index })
        }
    }
}

type Stripes<'c> = Vec<(&'c FrameRecord, StripeView)>;

/// The stripes of a capture's laser-on images, in the order of capture.
fn stripes<'c>(
    capture: &'c Capture,
    rig: &Rig,
    boards: &Boards<'_>,
    across: Across,
    progress: &dyn Progress,
) -> Result<(Stripes<'c>, Vec<Problem>), Error> {
    let reading = Reading::new(rig, SaidBy::Rig);
    let frames: Vec<&FrameRecord> = capture.present().filter(|f| f.laser_on && boards.shows(f)).collect();
    progress.begin("stripes", frames.len());
    let make = || extractor(across, rig.camera.bits, true);
    let extracted: Vec<Result<Result<StripeView, uw_io::Error>, Error>> = frames
        .par_iter()
        .map_init(make, |extractor, frame| {
            if progress.cancelled() {
                return Err(Error::Cancelled);
            }
            let path = capture.image_path(frame);
            let extractor =
                extractor.as_mut().map_err(|e| Error::Stripe { path: path.clone(), source: e.clone() })?;
            let image = match reading.stripe(capture, frame) {
                Ok(image) => image,
                Err(error) => return Ok(Err(error)),
            };
            let stripe = extract(extractor, &image, None, &path)?;
            let points = stripe
                .measurements()
                .map(|m| StripePoint {
                    pixel: Vector2::from(stripe.axis.uv(m.line, m.position_px)),
                    sigma_px: m.sigma_px,
                    width_px: f64::from(stripe.width_px[m.line]),
                })
                .collect();
            progress.step();
            let voltage_v = frame.voltage_v.unwrap_or(f64::NAN);
            Ok(Ok(StripeView { file: name(capture, frame), voltage_v, points }))
        })
        .collect();
    let (mut kept, mut lost) = (Vec::new(), Vec::new());
    for (frame, result) in std::iter::zip(frames, extracted) {
        match result? {
            Ok(stripe) if stripe.voltage_v.is_finite() => kept.push((frame, stripe)),
            Ok(_) => {}
            Err(error) => lost.push(Problem::loss(frame.row, error)),
        }
    }
    Ok((kept, lost))
}
