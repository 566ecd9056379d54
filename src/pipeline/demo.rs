//! A whole job on a simulated instrument: calibrate it, scan with it, measure, and hold what was found against the truth.
//!
//! The instrument differs from its `rig.toml` as a real one does: windows tilted and displaced, another focal length, a mirror whose
//! surface lies beside its axis, water of another index. Nothing of that is told to the calibration. Scenes are in `demo/`, compiled in.

use crate::pipeline::Progress;
use crate::pipeline::calibrate::{Settings as Calibrating, calibrate};
use crate::pipeline::reconstruct::{Reconstructed, Settings as Reconstructing, reconstruct};
use crate::pipeline::report::{self, AtHand, report_at_hand};
use crate::pipeline::simulate::{Plan, run};
use crate::{Error, Failure, Notes};
use nalgebra::{DMatrix, Vector3};
use std::collections::HashMap;
use std::path::Path;
use std::time::{Duration, Instant};
use uw_calib::{GLOBALS, Instrument, Method, Quantity, quantities};
use uw_cloud::{PointCloud, SphereOptions, SurfaceOptions, fit_sphere, triangulate};
use uw_geom::Scanner;
use uw_io::scene::SceneFile;
use uw_io::truth::StripePoint;
use uw_io::{CalibrationFile, Overwrite, Rig, atomic, calibration_toml, clouds, meshes};

const RIG: &str = include_str!("demo/rig.toml");
const VEHICLE: &str = include_str!("demo/vehicle.toml");
pub(crate) const CALIBRATIONS: [(&str, &str); 2] =
    [("cal-air", include_str!("demo/cal-air.toml")), ("cal-water", include_str!("demo/cal-water.toml"))];
const BALL: (&str, &str) = ("ball", include_str!("demo/ball.toml"));
const COVER: (&str, &str) = ("cover", include_str!("demo/cover.toml"));

/// The ball's radius has to come out this near its truth, mm.
pub const BALL_BAR_MM: f64 = 0.03;
/// The cover's points have to lie this near theirs, median, mm.
pub const COVER_BAR_MM: f64 = 0.06;

/// A figure that was found, with its standard deviation and its truth.
#[derive(Clone, Debug, PartialEq)]
pub struct Found {
    /// Its name, unit last.
    pub name: &'static str,
    /// What came out.
    pub value: f64,
    /// Its standard deviation, as predicted.
    pub sigma: f64,
    /// What it is.
    pub truth: f64,
}

/// Points of a cloud against the surface points that the camera saw at their pixels, all of the error, nothing aligned, mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Points {
    /// Points with an exact stripe centre on their row.
    pub compared: usize,
    /// Points without one: there is no stripe.
    pub astray: usize,
    /// Median distance.
    pub median_mm: f64,
    /// 95 % of the distances are less.
    pub most_mm: f64,
}

/// What a demo found.
#[derive(Debug)]
pub struct Demo {
    /// Images that were simulated.
    pub images: usize,
    /// Placements of the board that were used.
    pub poses: usize,
    /// Residual of corners, px.
    pub reprojection_rms_px: f64,
    /// Residual of stripes, px.
    pub stripe_rms_px: f64,
    /// Figures of the instrument.
    pub instrument: Vec<Found>,
    /// The ball: radius and centre.
    pub ball: Vec<Found>,
    /// Points of the ball.
    pub ball_points: Points,
    /// Points of the cover.
    pub cover_points: Points,
    /// Time for the images.
    pub simulating: Duration,
    /// Time for all else: what a job on recorded images takes.
    pub working: Duration,
}

impl Demo {
    /// What missed its bar, said in full; empty when all is well.
    pub fn missed(&self) -> Vec<String> {
        let mut missed = Vec::new();
        let radius = self.ball.iter().find(|f| f.name == "radius_mm").map_or(f64::NAN, |f| f.value - f.truth);
        // NaN misses, too.
        let meets = |off: f64, bar: f64| off.abs() <= bar;
        if !meets(radius, BALL_BAR_MM) {
            missed.push(format!("the ball's radius is {radius:+.4} mm off, more than {BALL_BAR_MM} mm"));
        }
        let median = self.cover_points.median_mm;
        if !meets(median, COVER_BAR_MM) {
            missed.push(format!(
                "half of the cover's points are more than {median:.4} mm off, not {COVER_BAR_MM} mm"
            ));
        }
        missed
    }
}

/// Runs the demo in a folder, which then holds the scene files and captures with their truth, `calibration.toml`, `ball.ply`, `cover.ply`,
/// `cover-mesh.ply`, `report.html` with its figures beside it, and a `vehicle.toml` of the same instrument to scan with.
///
/// # Errors
/// [`Failure`] where a file can't be written, or the job has no result.
pub fn demo(folder: &Path, progress: &dyn Progress) -> Result<Demo, Failure> {
    let fail = |error: Error| Failure { error: Box::new(error), notes: Notes::default() };
    let began = Instant::now();
    write_files(folder).map_err(|e| fail(e.into()))?;
    let mut images = 0;
    let mut shoot = |(name, text): (&str, &str)| {
        let plan = plan(name, text)?;
        let (made, points) = run(&plan, &folder.join(name), Overwrite::Refuse, progress)?;
        images += made.frames;
        Ok((plan, points))
    };
    let [air, water] = CALIBRATIONS.map(&mut shoot);
    let ((plan, _), _) = (air.map_err(fail)?, water.map_err(fail)?);
    let (ball_plan, ball_truth) = shoot(BALL).map_err(fail)?;
    let (_, cover_truth) = shoot(COVER).map_err(fail)?;
    let simulating = began.elapsed();

    let began = Instant::now();
    let captures = CALIBRATIONS.map(|(name, _)| folder.join(name)).to_vec();
    let mut calibrated =
        calibrate(&captures, &Calibrating { rig: None, method: Method::Joint }, progress)?.file;
    name_from(folder, &mut calibrated);
    calibration_toml::write(&folder.join("calibration.toml"), Overwrite::Refuse, &calibrated)
        .map_err(|e| fail(e.into()))?;
    let scan = |name: &str| -> Result<Reconstructed, Failure> {
        let made = reconstruct(&folder.join(name), &calibrated, &Reconstructing::default(), progress)?;
        let path = folder.join(name).with_extension("ply");
        clouds::Format::of(&path)
            .and_then(|format| clouds::write(&path, Overwrite::Refuse, &made.cloud, format))
            .map_err(|e| fail(e.into()))?;
        Ok(made)
    };
    let (ball_scan, cover_scan) = (scan(BALL.0)?, scan(COVER.0)?);
    let (ball_cloud, cover_cloud) = (&ball_scan.cloud, &cover_scan.cloud);
    let ball = measure(ball_cloud, &ball_plan).map_err(fail)?;
    mesh(folder, cover_cloud).map_err(fail)?;
    hand_over(folder, [(BALL.0, &ball_scan), (COVER.0, &cover_scan)], &ball)?;
    let statistics = &calibrated.calibration.statistics;
    Ok(Demo {
        images,
        poses: statistics.poses_used,
        reprojection_rms_px: statistics.reprojection_rms_px,
        stripe_rms_px: statistics.stripe_rms_px,
        instrument: instrument(&calibrated, &plan.instrument.scanner, ball_plan.scenes[0].water.laser.index),
        ball,
        ball_points: compare(ball_cloud, &ball_truth),
        cover_points: compare(cover_cloud, &cover_truth),
        simulating,
        working: began.elapsed(),
    })
}

/// Gives captures and images of a calibration the names that they have from a folder: it may be moved, or put in place only at the end.
fn name_from(folder: &Path, file: &mut CalibrationFile) {
    let statistics = &mut file.calibration.statistics;
    let images = statistics.rejected.iter_mut().map(|image| &mut image.file);
    let images = images.chain(statistics.worst.iter_mut().map(|image| &mut image.file));
    for name in images.chain(file.captures.iter_mut().map(|capture| &mut capture.name)) {
        if let Ok(inside) = Path::new(name.as_str()).strip_prefix(folder) {
            *name = inside.display().to_string();
        }
    }
}

/// What the demo is made from, so that anybody can go on from there.
fn write_files(folder: &Path) -> Result<(), uw_io::Error> {
    let write = |name: &str, text: &str| {
        let path = folder.join(name).with_extension("toml");
        std::fs::write(&path, text).map_err(uw_io::Error::file(&path, "write"))
    };
    let [air, water] = CALIBRATIONS;
    [("rig", RIG), ("vehicle", VEHICLE), air, water, BALL, COVER]
        .iter()
        .try_for_each(|(name, text)| write(name, text))
}

/// Writes the cover's surface.
fn mesh(folder: &Path, cover: &PointCloud) -> Result<(), Error> {
    let path = folder.join("cover-mesh.ply");
    let surface = triangulate(cover, &SurfaceOptions::default())
        .map_err(|source| Error::Surface { path: path.clone(), source })?;
    let format = meshes::Format::of(&path)?;
    Ok(meshes::write(&path, Overwrite::Refuse, &surface.mesh, format)?)
}

/// Writes the page to hand over, with the ball's true radius as the nominal one.
fn hand_over(folder: &Path, scans: [(&str, &Reconstructed); 2], ball: &[Found]) -> Result<(), Failure> {
    let fail = |error: Error| Failure { error: Box::new(error), notes: Notes::default() };
    let nominal = folder.join("nominal.csv");
    let radius = ball.iter().find(|f| f.name == "radius_mm").map_or(f64::NAN, |f| f.truth);
    let text = format!("kind,a,b,value_mm\nradius,ball,,{radius}\n");
    atomic::write(&nominal, Overwrite::Refuse, |out| out.write_all(text.as_bytes()))
        .map_err(|e| fail(e.into()))?;
    let captures = scans.map(|(name, _)| folder.join(name));
    let how = Reconstructing::default();
    let at_hand: Vec<AtHand<'_>> = captures
        .iter()
        .zip(scans)
        .map(|(capture, (_, reconstructed))| AtHand { capture, reconstructed, settings: &how })
        .collect();
    let settings = report::Settings {
        calibration: Some(folder.join("calibration.toml")),
        nominal: Some(nominal),
        title: Some("A ball and a cover, measured in simulated water".to_owned()),
        named_from: Some(folder.to_owned()),
        ..report::Settings::default()
    };
    let made = report_at_hand(&at_hand, &settings)?;
    made.write(&folder.join("report.html"), Overwrite::Refuse).map_err(fail)?;
    Ok(())
}

fn plan(name: &str, text: &str) -> Result<Plan, Error> {
    let path = Path::new(name).with_extension("toml");
    let (file, _) = SceneFile::parse(&path, text)?;
    let (rig, _) = Rig::parse(Path::new("rig.toml"), RIG)?;
    Plan::new(name, file, rig, None, Path::new(""), &mut Vec::new())
}

/// The figures of a calibration that a person looks at first, beside the true instrument's.
fn instrument(file: &CalibrationFile, scanner: &Scanner, water_index: f64) -> Vec<Found> {
    const SHOWN: [&str; 9] = [
        "camera.fx_px",
        "camera.fy_px",
        "camera.cx_px",
        "camera.cy_px",
        "camera.port.distance_mm",
        "camera.port.normal_x",
        "camera.port.normal_y",
        "galvo.degrees_per_volt",
        "water.index_offset",
    ];
    let nominal = file.calibration.nominal_water_index.unwrap_or(water_index);
    let truth = Instrument { scanner: *scanner, water_offset: water_index - nominal, dispersion_offset: 0.0 };
    let truth = quantities(&truth, &DMatrix::zeros(GLOBALS, GLOBALS));
    let found = file.calibration.quantities();
    let of = |all: &[Quantity], name: &str| all.iter().find(|q| q.name == name).copied();
    let one = |name| {
        let (found, truth) = (of(&found, name)?, of(&truth, name)?);
        Some(Found { name: found.name, value: found.value, sigma: found.sigma, truth: truth.value })
    };
    SHOWN.into_iter().filter_map(one).collect()
}

fn measure(cloud: &PointCloud, plan: &Plan) -> Result<Vec<Found>, Error> {
    let fit = fit_sphere(cloud, &SphereOptions::default()).map_err(Error::Fit)?;
    let ball = &plan.scenes[0].objects[0];
    let radius = match ball.shape {
        uw_sim::Shape::Sphere { radius_mm } => radius_mm,
        _ => f64::NAN,
    };
    let centre = ball.camera_from_body.translation_mm();
    let radius = Found { name: "radius_mm", value: fit.radius_mm, sigma: fit.sigma_radius_mm, truth: radius };
    let centres = ["x_mm", "y_mm", "z_mm"].into_iter().enumerate().map(|(i, name)| Found {
        name,
        value: fit.center_mm[i],
        sigma: fit.sigma_center_mm[i],
        truth: centre[i],
    });
    Ok(std::iter::once(radius).chain(centres).collect())
}

/// Farther than this from any stripe on its row, a point is astray, px.
const ASTRAY_PX: f64 = 2.0;

/// A cloud's points against the surface points that are truly seen on their rows.
fn compare(cloud: &PointCloud, truth: &[StripePoint]) -> Points {
    let mut rows: HashMap<(usize, i64), Vec<&StripePoint>> = HashMap::new();
    for point in truth {
        rows.entry((point.frame, point.uv[1].round() as i64)).or_default().push(point);
    }
    let (frames, pixels) = (cloud.frame_rows().unwrap_or_default(), cloud.pixels().unwrap_or_default());
    let (mut distances, mut astray) = (Vec::new(), 0);
    for ((position, frame), [u, v]) in cloud.positions_mm().iter().zip(frames).zip(pixels) {
        let row = rows.get(&(*frame as usize, v.round() as i64));
        let away = |p: &&&StripePoint| (p.uv[0] - f64::from(*u)).abs();
        let nearest = row.and_then(|row| row.iter().min_by(|a, b| away(a).total_cmp(&away(b))));
        match nearest.filter(|p| away(p) < ASTRAY_PX) {
            Some(p) => distances.push((Vector3::from(*position) - Vector3::from(p.xyz_mm)).norm()),
            None => astray += 1,
        }
    }
    distances.sort_by(f64::total_cmp);
    let at =
        |share: f64| distances.get((share * distances.len() as f64) as usize).copied().unwrap_or(f64::NAN);
    Points { compared: distances.len(), astray, median_mm: at(0.5), most_mm: at(0.95) }
}
