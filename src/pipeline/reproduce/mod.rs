//! The paper's experiments, simulated with its geometry: its method and ours on the same images, beside what it printed.
//!
//! The instrument is the paper's as far as it is described, and differs from its drawing as a real one does, by what a seed draws from the
//! rig's priors; neither method is told by what. Scenes are in this folder, compiled in; the boards are the demo's.

mod measure;
mod page;
pub mod published;
mod record;
mod scenes;

use crate::pipeline::Progress;
use crate::pipeline::calibrate::{self, calibrate};
use crate::pipeline::reconstruct::{self, Refraction, reconstruct};
use crate::pipeline::report::{HeadRecord, artefact, json, write_all};
use crate::pipeline::simulate::{Plan, run};
use crate::{Error, Failure, Notes};
use measure::{plain, same, six, six_sigmas, three, weighted};
use nalgebra::Vector3;
use scenes::Experiments;
use std::path::{Path, PathBuf};
use uw_calib::Method;
use uw_cloud::{
    Frame, PointCloud, ShapeFit, ShapeOptions, SphereFit, SurfaceOptions, TriangleMesh, find_shapes,
    triangulate,
};
use uw_io::{CalibrationFile, Overwrite};

pub use record::{
    BallFigures, BallRecord, Both, CalibrationInShort, CoverRecord, FORMAT, Record, Summary, ThreeRecord,
    VERSION,
};

/// How to reproduce.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Draws the instrument and all noise.
    pub seed: u64,
    /// When, as the page says it; `None`: it does not.
    pub made: Option<String>,
}

impl Default for Settings {
    fn default() -> Self {
        Self { seed: 1, made: None }
    }
}

/// What came out.
#[derive(Debug)]
pub struct Reproduced {
    /// Its figures.
    pub record: Record,
    cover: PointCloud,
    mesh: TriangleMesh,
}

/// The captures of one method's calibration and how it looks at scans.
struct Way {
    calibration: CalibrationFile,
    settings: reconstruct::Settings,
}

impl Way {
    fn new(captures: &[PathBuf], method: Method, progress: &dyn Progress) -> Result<Self, Failure> {
        let calibration = calibrate(captures, &calibrate::Settings { rig: None, method }, progress)?.file;
        let refraction = match method {
            Method::Joint => Refraction::Exact,
            Method::Paper => Refraction::Paper,
        };
        let settings = reconstruct::Settings { refraction, frame: Frame::Galvo, ..Default::default() };
        Ok(Self { calibration, settings })
    }

    fn scan(&self, capture: &Path, frame: Frame, progress: &dyn Progress) -> Result<PointCloud, Failure> {
        let settings = reconstruct::Settings { frame, ..self.settings };
        Ok(reconstruct(capture, &self.calibration, &settings, progress)?.cloud)
    }

    fn in_short(&self) -> CalibrationInShort {
        let s = &self.calibration.calibration.statistics;
        CalibrationInShort {
            poses_used: s.poses_used,
            reprojection_rms_px: s.reprojection_rms_px,
            stripe_rms_mm: s.stripe_rms_mm,
        }
    }
}

/// Simulates the experiments into `captures` and measures them both ways. The same seed gives the same figures, on any number of threads.
///
/// # Errors
/// [`Failure`] where a file can't be written, or a method has no result.
pub fn reproduce(
    captures: &Path,
    settings: &Settings,
    progress: &dyn Progress,
) -> Result<Reproduced, Failure> {
    let fail = |error: Error| Failure { error: Box::new(error), notes: Notes::default() };
    let experiments = Experiments::new(settings.seed).map_err(fail)?;
    let mut images = 0;
    let mut shoot = |plan: &Plan| -> Result<PathBuf, Failure> {
        let folder = captures.join(&plan.name);
        images += run(plan, &folder, Overwrite::Refuse, progress).map_err(fail)?.0.frames;
        Ok(folder)
    };
    let boards = [shoot(&experiments.air)?, shoot(&experiments.water)?];
    let ways = Both {
        paper: Way::new(&boards[..1], Method::Paper, progress)?,
        ours: Way::new(&boards, Method::Joint, progress)?,
    };
    let mut warnings = Vec::new();

    let mut fits = Vec::new();
    for plan in &experiments.balls {
        let capture = shoot(plan)?;
        let cloud = |way: &Way| way.scan(&capture, Frame::Galvo, progress);
        let paper = plain(&cloud(&ways.paper)?).map_err(fail)?;
        let ours = weighted(&cloud(&ways.ours)?, &ways.ours.calibration.calibration).map_err(fail)?;
        fits.push((center(plan), Both { paper: (paper, None), ours: (ours.0, Some(ours.1)) }));
    }
    let balls = ball_records(&fits);
    let figure_10 = Both {
        paper: (&fits[published::FIGURE_10.0].1.paper.0.deviations.histogram).into(),
        ours: (&fits[published::FIGURE_10.0].1.ours.0.deviations.histogram).into(),
    };

    let mut three_balls = Vec::new();
    for (at, plan) in experiments.three.iter().enumerate() {
        let capture = shoot(plan)?;
        let cloud = |way: &Way| way.scan(&capture, Frame::Galvo, progress);
        let (paper, ours) = (cloud(&ways.paper)?, cloud(&ways.ours)?);
        three_balls.extend(three_records(at, &paper, &ours, &ways.ours, &mut warnings).map_err(fail)?);
    }

    let capture = shoot(&experiments.cover)?;
    let cover = ways.ours.scan(&capture, Frame::Camera, progress)?;
    let surface = triangulate(&cover, &SurfaceOptions::default())
        .map_err(|source| fail(Error::Surface { path: capture.clone(), source }))?;
    let record = Record {
        head: HeadRecord::new(FORMAT, VERSION, settings.made.clone()),
        seed: settings.seed,
        images,
        warnings,
        calibrations: Both { paper: ways.paper.in_short(), ours: ways.ours.in_short() },
        summary: Both {
            paper: summary(&balls, |b| &b.found.paper, &three_balls, |t| t.paper_error_mm),
            ours: summary(&balls, |b| &b.found.ours, &three_balls, |t| t.ours_error_mm),
        },
        balls,
        three_balls,
        figure_10,
        cover: CoverRecord {
            images: experiments.cover.frames.len(),
            points: cover.len(),
            published_points: published::COVER_POINTS,
            vertices: surface.mesh.vertices_mm().len(),
            triangles: surface.mesh.triangles().len(),
        },
    };
    Ok(Reproduced { record, cover, mesh: surface.mesh })
}

impl Reproduced {
    /// Writes the page, and its figures beside it as JSON and CSV; the files that there are then.
    ///
    /// # Errors
    /// [`Error`] where they can't be written, or exist and may not be replaced.
    pub fn write(&self, path: &Path, overwrite: Overwrite) -> Result<[PathBuf; 3], Error> {
        let page = page::page(&self.record, &self.cover, &self.mesh).html().map_err(Error::Plot)?;
        write_all(path, overwrite, [&page, &json(&self.record), &self.record.csv()])
    }
}

fn center(plan: &Plan) -> Vector3<f64> {
    plan.scenes[0].objects[0].camera_from_body.translation_mm()
}

type Fitted = (SphereFit, Option<f64>);

fn ball_records(fits: &[(Vector3<f64>, Both<Fitted>)]) -> Vec<BallRecord> {
    let Some((first, fitted_first)) = fits.first() else { return Vec::new() };
    let figures = |(fit, sigma_mm): &Fitted, (first_fit, _): &Fitted, truth: f64| {
        let from_first = (Vector3::from(fit.center_mm) - Vector3::from(first_fit.center_mm)).norm();
        BallFigures {
            center_mm: fit.center_mm,
            radius_mm: fit.radius_mm,
            error_mm: fit.radius_mm - published::BALL_RADIUS_MM,
            sigma_mm: *sigma_mm,
            points: fit.deviations.points,
            max_outside_mm: fit.deviations.max_outside_mm,
            max_inside_mm: fit.deviations.max_inside_mm,
            from_first_error_mm: from_first - truth,
        }
    };
    let rows = fits.iter().zip(published::BALLS).enumerate();
    rows.map(|(at, ((center, found), row))| {
        let true_from_first_mm = (center - first).norm();
        BallRecord {
            position: at + 1,
            published_z_mm: row.center_mm[2],
            published_error_mm: row.radius_mm - published::BALL_RADIUS_MM,
            published_points: row.points,
            true_from_first_mm,
            found: Both {
                paper: figures(&found.paper, &fitted_first.paper, true_from_first_mm),
                ours: figures(&found.ours, &fitted_first.ours, true_from_first_mm),
            },
        }
    })
    .collect()
}

/// The six figures of one orientation. The balls' points are found in our cloud; the paper's method gets the same measurements.
fn three_records(
    at: usize,
    paper: &PointCloud,
    ours: &PointCloud,
    way: &Way,
    warnings: &mut Vec<String>,
) -> Result<Vec<ThreeRecord>, Error> {
    let nominal = three();
    // The camera stands beside the galvanometer, whose frame this is.
    let sensor = way.calibration.calibration.scanner().camera_from_galvo().inverse().translation_mm();
    let options = ShapeOptions { sensor_mm: sensor.into(), ..ShapeOptions::default() };
    let shapes = find_shapes(ours, &options).map_err(Error::Fit)?.shapes;
    let balls = artefact::matched(&nominal, &shapes);
    let lacking = balls.iter().filter(|ball| ball.is_none()).count();
    if lacking > 0 {
        warnings.push(format!("{lacking} of the three balls were not found in orientation {}", at + 1));
    }
    let of = |ball: usize| balls.get(ball).copied().flatten().map(|at| &shapes[at]);
    let our_ball = |ball: usize| match &of(ball)?.fit {
        ShapeFit::Sphere(fit) => Some((fit.center_mm, fit.radius_mm)),
        _ => None,
    };
    let their_ball = |ball: usize| -> Result<Option<([f64; 3], f64)>, Error> {
        let Some(shape) = of(ball) else { return Ok(None) };
        let fit = plain(&same(ours, shape, paper))?;
        Ok(Some((fit.center_mm, fit.radius_mm)))
    };
    let found = six([our_ball(0), our_ball(1), our_ball(2)]);
    let theirs = six([their_ball(0)?, their_ball(1)?, their_ball(2)?]);
    let sigmas = six_sigmas(ours, &shapes, &balls, &way.calibration.calibration)?;
    let record = |k: usize| {
        let nominal_mm = published::THREE_NOMINAL_MM[k];
        ThreeRecord {
            orientation: at + 1,
            quantity: published::THREE_NAMES[k],
            nominal_mm,
            published_error_mm: published::THREE_MEASURED_MM[at][k] - nominal_mm,
            paper_error_mm: theirs[k].map(|v| v - nominal_mm),
            ours_error_mm: found[k].map(|v| v - nominal_mm),
            ours_sigma_mm: sigmas[k],
        }
    };
    Ok((0..6).map(record).collect())
}

fn summary(
    balls: &[BallRecord],
    ball: fn(&BallRecord) -> &BallFigures,
    three: &[ThreeRecord],
    error: fn(&ThreeRecord) -> Option<f64>,
) -> Summary {
    let errors = || balls.iter().map(|b| ball(b).error_mm);
    let largest = |of: &mut dyn Iterator<Item = f64>| of.map(f64::abs).fold(0.0, f64::max);
    let of_three = |distances: bool| {
        let mut some =
            three.iter().filter(move |t| t.quantity.contains(" to ") == distances).filter_map(error);
        largest(&mut some)
    };
    Summary {
        ball_radius_mm: [errors().fold(f64::INFINITY, f64::min), errors().fold(f64::NEG_INFINITY, f64::max)],
        ball_places_mm: largest(&mut balls.iter().map(|b| ball(b).from_first_error_mm)),
        three_radius_mm: of_three(false),
        three_distance_mm: of_three(true),
    }
}
