//! A scene file → a capture as the instrument would have recorded it, with its truth beside it.

mod bench;
mod instrument;
mod plan;
mod things;
mod truth;

use crate::pipeline::Progress;
use crate::{Error, Failure, Notes};
use rayon::prelude::*;
use std::collections::VecDeque;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use uw_io::recording::{self, Head, Recorder, Through};
use uw_io::truth::{StripePoint, stripes_csv};
use uw_io::{GrayImage, NewFolder, Overwrite, Pixels, Problem, capture, images};
use uw_sim::{Exposed, Picture, Renderer};

pub use bench::{Placement, SimulatedCamera, simulated_camera};
pub(crate) use plan::{Plan, of_scene};

/// What a simulation made.
#[derive(Debug)]
pub struct Simulated {
    /// Images.
    pub frames: usize,
    /// Exact stripe centres.
    pub stripe_points: usize,
    /// Where the truth is.
    pub truth: PathBuf,
    /// Warnings about the files.
    pub problems: Vec<Problem>,
}

/// The truth's folder beside or in a capture.
const TRUTH: &str = "truth";
/// Frames that are rendered together before they are written to a recording, a processor's thread.
const AHEAD: usize = 4;

/// Simulates what a scene file asks for: into a capture folder (its truth in its folder `truth`), or a recording where the name ends in
/// `.mcap` (its truth in a folder `NAME.truth` beside it). Every image follows from the scene alone, on any number of threads. A `rig` replaces the rig file
/// that the scene names.
///
/// # Errors
/// [`Failure`] where a file is wrong, says what can't be, or the output can't be written: then there is none.
pub fn simulate(
    scene: &Path,
    rig: Option<&Path>,
    output: &Path,
    overwrite: Overwrite,
    progress: &dyn Progress,
) -> Result<Simulated, Failure> {
    let mut notes = Notes::default();
    let made =
        Plan::read(scene, rig, &mut notes.problems).and_then(|plan| run(&plan, output, overwrite, progress));
    match made.map_err(of_scene(scene)) {
        Ok((made, _)) => Ok(Simulated { problems: notes.problems, ..made }),
        Err(error) => Err(Failure { error: Box::new(error), notes }),
    }
}

/// Whether an output is to be a recording.
fn is_recording(output: &Path) -> bool {
    output.extension().is_some_and(|ending| ending.eq_ignore_ascii_case(recording::ENDING))
}

/// Renders a plan into its output; gives its exact stripes, too.
pub(crate) fn run(
    plan: &Plan,
    output: &Path,
    overwrite: Overwrite,
    progress: &dyn Progress,
) -> Result<(Simulated, Vec<StripePoint>), Error> {
    let (truth, points) = if is_recording(output) {
        uw_io::atomic::check(output, overwrite)?;
        let truth = NewFolder::begin(&output.with_extension("truth"), overwrite, TRUTH_FILE)?;
        let points = record(plan, output, overwrite, progress)?;
        write_truth(plan, truth.path(), &points).map_err(|error| error.told_by(&truth))?;
        truth.finish()?;
        (output.with_extension("truth"), points)
    } else {
        let folder = NewFolder::begin(output, overwrite, "capture.toml")?;
        let points = fill(plan, folder.path(), progress).map_err(|error| error.told_by(&folder))?;
        folder.finish()?;
        (output.join(TRUTH), points)
    };
    let frames = plan.frames.len();
    Ok((Simulated { frames, stripe_points: points.len(), truth, problems: Vec::new() }, points))
}

const TRUTH_FILE: &str = "truth.json";

fn make(folder: &Path) -> Result<(), Error> {
    Ok(fs::create_dir_all(folder).map_err(uw_io::Error::file(folder, "make the folder"))?)
}

fn write(path: &Path, bytes: impl AsRef<[u8]>) -> Result<(), Error> {
    Ok(fs::write(path, bytes).map_err(uw_io::Error::file(path, "write"))?)
}

fn write_truth(plan: &Plan, folder: &Path, points: &[StripePoint]) -> Result<(), Error> {
    write(&folder.join(TRUTH_FILE), truth::truth(plan).to_json())?;
    write(&folder.join("stripes.csv"), stripes_csv(points))
}

/// Images and exact stripes of a plan's frames, made in parallel.
struct Studio<'p> {
    plan: &'p Plan,
    renderers: Vec<Renderer<'p>>,
    /// Ambient light's part of the last few scenes that stand still: its images are as many as the stripes', and all alike.
    ambient: Mutex<VecDeque<(usize, std::sync::Arc<Option<Exposed>>)>>,
}

/// Scenes whose ambient light is kept.
const KEPT: usize = 4;

impl<'p> Studio<'p> {
    fn new(plan: &'p Plan) -> Result<Self, Error> {
        let renderers = plan.scenes.iter().map(|scene| Renderer::new(&plan.instrument, scene));
        let renderers = renderers.collect::<Result<_, _>>().map_err(Error::Simulation)?;
        Ok(Self { plan, renderers, ambient: Mutex::default() })
    }

    fn ambient(&self, scene: usize, seconds: f64) -> std::sync::Arc<Option<Exposed>> {
        let kept = || self.ambient.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let moves = self.plan.scenes[scene].moves();
        if let Some((_, found)) = kept().iter().find(|(of, _)| *of == scene && !moves) {
            return found.clone();
        }
        let made = std::sync::Arc::new(self.renderers[scene].ambient(seconds));
        if !moves {
            let mut kept = kept();
            kept.push_back((scene, made.clone()));
            if kept.len() > KEPT {
                kept.pop_front();
            }
        }
        made
    }

    fn frame(&self, k: usize) -> Result<(Picture, Vec<StripePoint>), Error> {
        let frame = &self.plan.frames[k];
        let (renderer, scene) = (&self.renderers[frame.scene], &self.plan.scenes[frame.scene]);
        let shot = &frame.shot;
        let lit = if shot.voltage.is_some() { scene.ambient.laser_on } else { scene.ambient.laser_off };
        let ambient =
            if lit > 0.0 { self.ambient(frame.scene, shot.seconds) } else { std::sync::Arc::new(None) };
        let picture = renderer.develop(shot, ambient.as_ref().as_ref()).map_err(Error::Simulation)?;
        let Some(voltage) = shot.voltage else { return Ok((picture, Vec::new())) };
        let curve = renderer.curve(shot.seconds, voltage, self.plan.along).map_err(Error::Simulation)?;
        let points = curve.iter().map(|p| StripePoint {
            frame: frame.record.row,
            uv: [p.pixel.x, p.pixel.y],
            xyz_mm: [p.point_mm.x, p.point_mm.y, p.point_mm.z],
            object: p.object,
        });
        Ok((picture, points.collect()))
    }
}

fn gray(picture: Picture) -> GrayImage {
    let Picture { width, height, bits, data } = picture;
    // A file of up to 8 bits has a byte a pixel.
    let (data, full_scale) = if bits <= 8 {
        (Pixels::U8(data.iter().map(|v| *v as u8).collect()), 0xff)
    } else {
        (Pixels::U16(data), 0xffff)
    };
    GrayImage { width, height, data, full_scale }
}

/// Fills a capture folder, its truth within it.
fn fill(plan: &Plan, folder: &Path, progress: &dyn Progress) -> Result<Vec<StripePoint>, Error> {
    make(&folder.join("images"))?;
    let studio = Studio::new(plan)?;
    progress.begin("images", plan.frames.len());
    let points = plan
        .frames
        .par_iter()
        .enumerate()
        .map(|(k, frame)| {
            if progress.cancelled() {
                return Err(Error::Cancelled);
            }
            let (picture, points) = studio.frame(k)?;
            let path = folder.join(&frame.record.file);
            write(&path, images::encode_png(&gray(picture), &path)?)?;
            progress.step();
            Ok(points)
        })
        .collect::<Result<Vec<_>, Error>>()?;
    let c = &plan.file.capture;
    write(&folder.join("capture.toml"), capture::capture_text(c.kind, c.medium, c.target.as_ref()))?;
    let frames = folder.join("frames.csv");
    let rows = plan.frames.iter().map(|f| (f.record.file.as_str(), &f.record));
    write(&frames, capture::frames_text(rows, &frames)?)?;
    write(&folder.join("rig.toml"), plan.rig.to_toml()?)?;
    let points: Vec<StripePoint> = points.into_iter().flatten().collect();
    let truth = folder.join(TRUTH);
    make(&truth)?;
    write_truth(plan, &truth, &points)?;
    Ok(points)
}

/// Writes a recording, which is there whole or not at all.
fn record(
    plan: &Plan,
    output: &Path,
    overwrite: Overwrite,
    progress: &dyn Progress,
) -> Result<Vec<StripePoint>, Error> {
    uw_io::atomic::write_through(output, overwrite, |file| fill_recording(plan, (output, file), progress))
}

fn fill_recording(
    plan: &Plan,
    (output, file): (&Path, &mut dyn Write),
    progress: &dyn Progress,
) -> Result<Vec<StripePoint>, Error> {
    let c = &plan.file.capture;
    let head = Head {
        scan_id: plan.name.clone(),
        planned_frames: Some(plan.frames.len() as u32),
        rig: Some(plan.rig.to_toml()?),
        ..Head::new(c.kind, c.medium, c.target.clone())
    };
    let options = recording::Options::default();
    let mut recorder = Recorder::new(Through(file), output, &head, c.start_ns, options)?;
    let studio = Studio::new(plan)?;
    progress.begin("images", plan.frames.len());
    let mut all = Vec::new();
    let ahead = AHEAD * rayon::current_num_threads();
    for start in (0..plan.frames.len()).step_by(ahead) {
        let end = (start + ahead).min(plan.frames.len());
        let made = (start..end).into_par_iter().map(|k| {
            if progress.cancelled() {
                return Err(Error::Cancelled);
            }
            let made = studio.frame(k);
            progress.step();
            made
        });
        for (frame, (picture, points)) in
            plan.frames[start..end].iter().zip(made.collect::<Result<Vec<_>, _>>()?)
        {
            let record = &frame.record;
            let shot = recording::Shot {
                number: record.row as u32,
                file: &record.file,
                pose: record.pose,
                laser_on: record.laser_on,
                voltage_v: record.voltage_v,
                stamp_ns: record.stamp_ns,
                bits: picture.bits,
            };
            let image = gray(picture);
            let received_ns = record.stamp_ns + (c.interval_ms * 1e6) as u64;
            recorder.frame(&shot, &recording::Picture::of(&image), received_ns)?;
            all.extend(points);
        }
    }
    recorder.finish()?;
    Ok(all)
}
