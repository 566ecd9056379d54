//! What a scene file asks for, worked out: instrument, scenes, shots.

use crate::Error;
use crate::pipeline::simulate::instrument::{Placement, drawn, instrument};
use crate::pipeline::simulate::things::{board, objects};
use nalgebra::Vector3;
use std::path::Path;
use uw_geom::Medium;
use uw_io::scene::SceneFile;
use uw_io::{CalibrationFile, FrameRecord, Kind, Problem, Rig, calibration_toml};
use uw_sim::{Along, Ambient, Instrument, Scene, Shot, Water};

/// All that a simulation takes, ready to be rendered.
#[derive(Debug)]
pub(crate) struct Plan {
    pub(crate) name: String,
    pub(crate) file: SceneFile,
    /// Drawing values, which go with the images.
    pub(crate) rig: Rig,
    pub(crate) instrument: Instrument,
    /// One in a scan, one a placement in a calibration.
    pub(crate) scenes: Vec<Scene>,
    pub(crate) frames: Vec<Planned>,
    pub(crate) along: Along,
}

/// One image.
#[derive(Debug)]
pub(crate) struct Planned {
    pub(crate) record: FrameRecord,
    /// Number of its scene.
    pub(crate) scene: usize,
    pub(crate) shot: Shot,
}

impl Plan {
    /// The plan of a scene file, with the rig of another file where one is given.
    ///
    /// # Errors
    /// [`Error`] where a file is wrong, or says what can't be.
    pub(crate) fn read(
        path: &Path,
        given: Option<&Path>,
        problems: &mut Vec<Problem>,
    ) -> Result<Self, Error> {
        let (file, warnings) = SceneFile::read(path)?;
        problems.extend(warnings);
        let folder = path.parent().unwrap_or(Path::new(""));
        let beside = |name: &Option<String>| name.as_ref().map(|name| folder.join(name));
        let calibration =
            beside(&file.instrument.calibration).map(|p| calibration_toml::read(&p)).transpose()?;
        let calibration = calibration.map(|(calibration, warnings)| {
            problems.extend(warnings);
            calibration
        });
        let beside_it = if calibration.is_none() { beside(&file.instrument.rig) } else { None };
        let rig = match (&calibration, given.map(Path::to_owned).or(beside_it)) {
            (Some(calibration), None) => calibration.rig.clone(),
            (_, Some(path)) => {
                let (rig, warnings) = Rig::read(&path)?;
                problems.extend(warnings);
                rig
            }
            (None, None) => unreachable_instrument()?,
        };
        let name = path.file_stem().map_or("scene".into(), |stem| stem.to_string_lossy().into_owned());
        Self::new(&name, file, rig, calibration.as_ref(), folder, problems)
    }

    /// The plan of a scene that was read already.
    ///
    /// # Errors
    /// As [`Plan::read`].
    pub(crate) fn new(
        name: &str,
        file: SceneFile,
        rig: Rig,
        calibration: Option<&CalibrationFile>,
        folder: &Path,
        problems: &mut Vec<Problem>,
    ) -> Result<Self, Error> {
        let i = &file.instrument;
        let place = match (i.axis_point_mm, i.axis_direction, i.beam_direction) {
            (Some(point), Some(axis), Some(beam)) => {
                Some(Placement { axis_point_mm: point.into(), axis: axis.into(), beam: Vector3::from(beam) })
            }
            _ => None,
        };
        let truth = match (calibration, &place) {
            (Some(file), _) => file.calibration.instrument,
            (None, Some(place)) => drawn(&rig, place, i.differs_by_seed)?,
            (None, None) => unreachable_instrument()?,
        };
        let instrument = instrument(truth.scanner, &rig, place.as_ref().map(|p| &p.beam), &file)?;
        let water = water(&file, &rig, &truth)?;
        let scenes = scenes(&file, water, folder, problems)?;
        scenes.iter().try_for_each(Scene::check).map_err(Error::Simulation)?;
        let frames = frames(&file);
        let sheet = instrument.scanner.sheet(rig.galvo.reference_v, water.laser);
        let along = if sheet.normal.x.abs() > sheet.normal.y.abs() { Along::Rows } else { Along::Columns };
        Ok(Self { name: name.to_owned(), file, rig, instrument, scenes, frames, along })
    }
}

/// Adds the scene file's name to an error about what it asks for; one about a file has that file's.
pub(crate) fn of_scene(path: &Path) -> impl Fn(Error) -> Error {
    move |error| match error {
        Error::Simulation(_) | Error::Scene { .. } | Error::SceneWithoutIndex => {
            Error::SceneFile { path: path.to_owned(), source: Box::new(error) }
        }
        other => other,
    }
}

/// A scene file without an instrument is refused when it is read.
fn unreachable_instrument<T>() -> Result<T, Error> {
    let what = "the instrument's place";
    Err(Error::Simulation(uw_sim::SimError::Invalid { what, needed: "given", got: f64::NAN }))
}

/// The scene's water: the rig's nominal one, and what the instrument's truth adds to its index.
fn water(file: &SceneFile, rig: &Rig, truth: &uw_calib::Instrument) -> Result<Water, Error> {
    if file.capture.medium == uw_io::Medium::Air {
        return Ok(Water::air());
    }
    let laser = rig.water_index().ok_or(Error::SceneWithoutIndex)?;
    let board = file.capture.target.as_ref().and_then(|t| t.wavelength_nm);
    let ambient = board.and_then(|nm| rig.water_index_at(nm)).unwrap_or(laser);
    Ok(Water {
        laser: Medium::of_index(laser + truth.water_offset),
        ambient: Medium::of_index(ambient + truth.water_offset + truth.dispersion_offset),
        attenuation_per_mm: file.water.attenuation_per_m / 1000.0,
        backscatter_per_mm: file.water.backscatter_per_m / 1000.0,
    })
}

fn scenes(
    file: &SceneFile,
    water: Water,
    folder: &Path,
    problems: &mut Vec<Problem>,
) -> Result<Vec<Scene>, Error> {
    let mut things = Vec::new();
    for record in &file.objects {
        things.extend(objects(record, folder, problems)?);
    }
    let scene = Scene {
        objects: things,
        water,
        ambient: Ambient { laser_off: file.ambient.laser_off, laser_on: file.ambient.laser_on },
        instrument_velocity_mm_s: file.instrument.velocity_mm_s.into(),
        seed: file.seed,
    };
    let target = file.capture.target.as_ref().filter(|_| file.capture.kind == Kind::Calibration);
    let Some(target) = target else { return Ok(vec![scene]) };
    let with_board = |pose| {
        let mut scene = scene.clone();
        scene.objects.insert(0, board(target, pose));
        scene
    };
    Ok(file.poses.iter().map(with_board).collect())
}

/// The images in the order of capture: a scan's voltages; of each placement first the target, then its stripes.
fn frames(file: &SceneFile) -> Vec<Planned> {
    let capture = &file.capture;
    let voltages = capture.voltages();
    let mut frames = Vec::new();
    let mut add = |scene: usize, pose: Option<u32>, voltage_v: Option<f64>| {
        let row = frames.len();
        let began_s = row as f64 * capture.interval_ms / 1000.0;
        let record = FrameRecord {
            row,
            line: row as u32 + 2,
            file: format!("images/{row:05}.png"),
            pose,
            laser_on: voltage_v.is_some(),
            voltage_v,
            stamp_ns: capture.start_ns.saturating_add((began_s * 1e9).round() as u64),
        };
        let seconds = began_s + 0.5 * capture.exposure_ms / 1000.0;
        frames.push(Planned { record, scene, shot: Shot { frame: row as u64, seconds, voltage: voltage_v } });
    };
    match capture.kind {
        Kind::Scan => voltages.iter().for_each(|v| add(0, None, Some(*v))),
        Kind::Calibration => {
            for scene in 0..file.poses.len() {
                add(scene, Some(scene as u32), None);
                voltages.iter().for_each(|v| add(scene, Some(scene as u32), Some(*v)));
            }
        }
    }
    frames
}
