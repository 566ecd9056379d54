//! A recorded sweep → points in millimetres, each with its covariance.

use crate::pipeline::Progress;
use crate::pipeline::load::{Reading, by_background};
use crate::pipeline::outline::{self, Seen};
use crate::pipeline::stripes::{Rejects, extract, extractor};
use crate::{Error, Failure, Notes};
use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;
use std::path::Path;
use std::time::{Duration, Instant};
use uw_calib::{Across, Method};
use uw_cloud::{CloudPoint, Frame, PointCloud};
use uw_geom::{GeomError, Medium, Plane, Ray, Scanner, approx};
use uw_io::calibration_toml::CalibrationFile;
use uw_io::{Capture, FrameRecord, GrayImage, Kind, Problem, Rig, SaidBy};

/// How light is traced.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Refraction {
    /// Exactly, through both windows.
    #[default]
    Exact,
    /// By the paper's approximations, Eqs 9 to 14.
    Paper,
    /// Straight, as if there were neither windows nor water.
    None,
}

/// What tells the index of the water of a scan.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum WaterIndex {
    /// The calibration's estimate plus the difference of the scan's nominal index from that of the calibration's water.
    #[default]
    Calibrated,
    /// This index at the laser's wavelength.
    Given(f64),
    /// From temperature, salinity and depth, by Quan and Fry.
    Properties {
        /// Degrees Celsius.
        temperature_c: f64,
        /// Practical salinity.
        salinity_psu: f64,
        /// Metres.
        depth_m: f64,
    },
}

/// How to reconstruct.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Settings {
    /// How light is traced.
    pub refraction: Refraction,
    /// Frame of the points.
    pub frame: Frame,
    /// What is outside the windows; `None`: what the capture says.
    pub medium: Option<uw_io::Medium>,
    /// The water's index.
    pub water: WaterIndex,
}

/// A cloud, and what was left out on the way.
#[derive(Debug)]
pub struct Reconstructed {
    /// The points, in the order of frames and along each stripe.
    pub cloud: PointCloud,
    /// Laser-on images that were used.
    pub frames: usize,
    /// Rows (columns) without a point, by reason.
    pub rejected: Rejects,
    /// Index of refraction used outside the windows.
    pub index: f64,
    /// Warnings about the files, and losses.
    pub problems: Vec<Problem>,
    /// What to know before trusting the cloud.
    pub warnings: Vec<String>,
    /// Where the time went.
    pub spent: Spent,
}

/// Time spent on the images' stages, summed over the threads.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Spent {
    /// Reading and decoding image files.
    pub decode: Duration,
    /// Finding the stripes' centres.
    pub extract: Duration,
    /// Making points of them.
    pub triangulate: Duration,
}

impl Spent {
    fn add(&mut self, other: Self) {
        self.decode += other.decode;
        self.extract += other.extract;
        self.triangulate += other.triangulate;
    }
}

/// The points of a scan.
///
/// # Errors
/// [`Failure`] where a file is wrong, the water's index is not known, or no image gave a point.
pub fn reconstruct(
    path: &Path,
    calibration: &CalibrationFile,
    settings: &Settings,
    progress: &dyn Progress,
) -> Result<Reconstructed, Failure> {
    let mut notes = Notes::default();
    match points(path, calibration, settings, &mut notes, progress) {
        Ok(mut made) => {
            (made.problems, made.warnings) = (notes.problems, notes.warnings);
            Ok(made)
        }
        Err(error) => Err(Failure { error: Box::new(error), notes }),
    }
}

/// [`reconstruct`], with what is to be said besides the points in `notes`.
fn points(
    path: &Path,
    calibration: &CalibrationFile,
    settings: &Settings,
    notes: &mut Notes,
    progress: &dyn Progress,
) -> Result<Reconstructed, Error> {
    match (calibration.calibration.method, settings.refraction) {
        (Method::Paper, Refraction::Exact) => return Err(Error::PaperCalibration),
        (Method::Joint, Refraction::Paper) => notes.warnings.push(
            "the paper's refraction on a joint calibration: its windows' distances and its planes are taken, their tilt and the \
             fan's curvature are neglected"
                .to_owned(),
        ),
        _ => {}
    }
    let mut capture = Capture::open_noting(path, None, &mut notes.problems)?;
    notes.problems.extend(capture.take_problems());
    if capture.kind != Kind::Scan {
        let path = capture.dir.clone();
        return Err(Error::Kind { path, needed: "scan", got: "calibration" });
    }
    if !capture.frames.iter().any(|frame| frame.laser_on) {
        return Err(Error::LaserOff { path: capture.dir.clone() });
    }
    let medium = medium(&capture, calibration, settings, &mut notes.warnings)?;
    let tracer = Tracer { calibration, refraction: settings.refraction, medium };

    let rig = &calibration.rig;
    let reading = Reading::new(rig, SaidBy::Calibration);
    let across = calibration.calibration.across;
    let groups = by_background(&capture);
    progress.begin("frames", groups.iter().map(|(_, frames)| frames.len()).sum());
    type FrameResult = Result<Points, uw_io::Error>;
    type Group<'c> = (Option<Problem>, Vec<(&'c FrameRecord, FrameResult)>);
    let made: Vec<Group<'_>> = groups
        .into_par_iter()
        .map(|(dark, frames)| {
            let (background, lost) = match dark.map(|d| (d, reading.stripe(&capture, d))) {
                Some((_, Ok(background))) => (Some(background), None),
                Some((d, Err(error))) => (None, Some(Problem::loss(d.row, error))),
                None => (None, None),
            };
            let frames = frames
                .into_par_iter()
                .map_init(
                    || extractor(across, rig.camera.bits, false),
                    |extractor, frame| {
                        let path = capture.image_path(frame);
                        let extractor = extractor
                            .as_mut()
                            .map_err(|e| Error::Stripe { path: path.clone(), source: e.clone() })?;
                        let began = Instant::now();
                        let points = match reading.stripe(&capture, frame) {
                            Ok(image) => {
                                let decode = began.elapsed();
                                let mut points =
                                    tracer.points(extractor, &image, background.as_ref(), frame, &path)?;
                                points.spent.decode = decode;
                                Ok(points)
                            }
                            Err(error) => Err(error),
                        };
                        progress.step();
                        Ok((frame, points))
                    },
                )
                .collect::<Result<Vec<_>, Error>>()?;
            Ok((lost, frames))
        })
        .collect::<Result<_, Error>>()?;

    let (mut images, mut rejected, mut spent) = (Vec::new(), Rejects::new(), Spent::default());
    let (mut losses, mut backgrounds) = (Vec::new(), Vec::new());
    for (lost, frames) in made {
        backgrounds.extend(lost);
        for (frame, result) in frames {
            match result {
                Ok(found) => {
                    spent.add(found.spent);
                    for (&reason, &count) in &found.rejected {
                        *rejected.entry(reason).or_default() += count;
                    }
                    images.push((frame, found));
                }
                Err(error) => losses.push(Problem::loss(frame.row, error)),
            }
        }
    }
    let used = images.len();
    if used == 0 && !losses.is_empty() {
        let first = Box::new(losses.swap_remove(0).error);
        return Err(Error::NothingLeft { path: capture.dir, first });
    }
    losses.append(&mut backgrounds);
    notes.problems.append(&mut losses);
    let points = believed(images, &mut rejected);
    if points.is_empty() {
        return Err(Error::NoPoint { path: capture.dir, frames: used, rejected });
    }
    let mut cloud = PointCloud::from_points(Frame::Camera, &points);
    if settings.frame == Frame::Galvo {
        let galvo_from_camera = tracer.scanner().camera_from_galvo().inverse();
        cloud = cloud.transformed(Frame::Galvo, &galvo_from_camera.isometry());
    }
    Ok(Reconstructed {
        cloud,
        frames: used,
        rejected,
        index: medium.index,
        problems: Vec::new(),
        warnings: Vec::new(),
        spent,
    })
}

/// The points of all images without those that the sweep as a whole tells against, counted in `rejected`.
fn believed(mut images: Vec<(&FrameRecord, Points)>, rejected: &mut Rejects) -> Vec<CloudPoint> {
    let voltage = |frame: &FrameRecord| frame.voltage_v.unwrap_or(f64::INFINITY);
    images.sort_by(|(a, _), (b, _)| voltage(a).total_cmp(&voltage(b)));
    let reasons = outline::judge(&images.iter().map(|(_, found)| found.seen.as_slice()).collect::<Vec<_>>());
    let mut kept: Vec<(usize, Vec<CloudPoint>)> = Vec::with_capacity(images.len());
    for ((frame, found), reasons) in images.into_iter().zip(reasons) {
        let sound = |(point, reason): (CloudPoint, Option<&'static str>)| match reason {
            Some(reason) => {
                *rejected.entry(reason).or_default() += 1;
                None
            }
            None => Some(point),
        };
        kept.push((frame.row, found.points.into_iter().zip(reasons).filter_map(sound).collect()));
    }
    kept.sort_by_key(|(row, _)| *row);
    kept.into_iter().flat_map(|(_, points)| points).collect()
}

/// Lowest and highest index of water, relative to air, that a mistake is not likelier than.
const LIKELY_WATER: [f64; 2] = [1.30, 1.38];

/// What is outside the windows during the scan (FORMATS §2).
fn medium(
    capture: &Capture,
    file: &CalibrationFile,
    settings: &Settings,
    warnings: &mut Vec<String>,
) -> Result<Medium, Error> {
    let dir = capture.dir.display();
    let given = settings.water != WaterIndex::Calibrated;
    if settings.medium.unwrap_or(capture.medium) == uw_io::Medium::Air {
        if given {
            warnings.push(format!(
                "{dir}: captured in air, so the index given for the water is not used; if it was captured in water, give --medium \
                 water or mend medium in capture.toml"
            ));
        }
        return Ok(Medium::air());
    }
    if given && settings.refraction == Refraction::None {
        warnings.push("without refraction, the index given for the water is not used".to_owned());
    }
    let wavelength = file.rig.laser.wavelength_nm;
    let medium = match settings.water {
        WaterIndex::Given(index) => Medium::of_index(index),
        WaterIndex::Properties { temperature_c, salinity_psu, depth_m } => {
            Medium::of_index(uw_geom::water::index(temperature_c, salinity_psu, wavelength, depth_m))
        }
        WaterIndex::Calibrated => {
            let of_scan = capture.rig.as_ref().and_then(Rig::water_index);
            let nominal = of_scan.or(file.calibration.nominal_water_index).or_else(|| file.rig.water_index());
            let unknown = || Error::NoWaterIndex { path: capture.dir.clone() };
            file.calibration.water(nominal.ok_or_else(unknown)?)
        }
    };
    let [low, high] = LIKELY_WATER;
    if !(low..=high).contains(&medium.index) {
        warnings.push(format!(
            "{dir}: an index of {:.5} is unusual for water ({low} to {high}): check [water] in rig.toml, or what was given",
            medium.index
        ));
    }
    Ok(medium)
}

/// What one image gave.
struct Points {
    points: Vec<CloudPoint>,
    /// The centre in the image of each point.
    seen: Vec<Seen>,
    rejected: Rejects,
    spent: Spent,
}

/// From stripes to points, for one scan.
struct Tracer<'a> {
    calibration: &'a CalibrationFile,
    refraction: Refraction,
    medium: Medium,
}

/// A point and its derivative by the measured coordinate, mm and mm per px.
type PointAndSlope = (Vector3<f64>, Vector3<f64>);

impl Tracer<'_> {
    fn scanner(&self) -> &Scanner {
        self.calibration.calibration.scanner()
    }

    fn points(
        &self,
        extractor: &mut uw_stripe::Extractor,
        image: &GrayImage,
        background: Option<&GrayImage>,
        frame: &FrameRecord,
        path: &Path,
    ) -> Result<Points, Error> {
        let mut spent = Spent::default();
        let began = Instant::now();
        let stripe = extract(extractor, image, background, path)?;
        spent.extract = began.elapsed();
        let mut rejected: Rejects = stripe.rejected().map(|(reason, count)| (reason.name(), count)).collect();
        let began = Instant::now();
        let Some(voltage_v) = frame.voltage_v else {
            return Ok(Points { points: Vec::new(), seen: Vec::new(), rejected, spent });
        };
        let across = self.calibration.calibration.across;
        let sheet = self.scanner().sheet(voltage_v, self.medium);
        let exposure = self.scanner().exposure(voltage_v, self.medium);
        let plane = approx::planar_sheet(&sheet);
        let mut points = Vec::with_capacity(stripe.found());
        let mut seen = Vec::with_capacity(stripe.found());
        for m in stripe.measurements() {
            let pixel = Vector2::from(stripe.axis.uv(m.line, m.position_px));
            let traced = match (self.refraction, plane) {
                (Refraction::Exact, _) => exposure.as_ref().map_err(|error| *error).and_then(|exposure| {
                    let t = exposure.triangulate_with_derivatives(&pixel)?;
                    Ok((t.point_mm, if across == Across::U { t.per_u } else { t.per_v }))
                }),
                (_, Err(error)) => Err(error),
                (Refraction::Paper, Ok(plane)) => central(&pixel, across, |pixel| {
                    let ray = approx::scaled_pixel_ray(&self.scanner().camera, pixel, self.medium)?;
                    approx::intersect_plane(&ray, &plane)
                }),
                (Refraction::None, Ok(_)) => central(&pixel, across, |pixel| {
                    let plane = Plane::through(&sheet.apex_mm, &sheet.normal)?;
                    let direction = self.scanner().camera.unproject(pixel)?;
                    approx::intersect_plane(&Ray { origin: Vector3::zeros(), direction }, &plane)
                }),
            };
            match traced {
                Ok((point, slope)) => {
                    points.push(cloud_point(point, slope * m.sigma_px, &m, frame, &pixel));
                    let width_px = stripe.width_px[m.line];
                    seen.push(Seen {
                        line: m.line,
                        position_px: m.position_px as f32,
                        width_px,
                        flux: m.amplitude as f32 * width_px,
                    });
                }
                Err(_) => *rejected.entry("no_intersection").or_default() += 1,
            }
        }
        spent.triangulate = began.elapsed();
        Ok(Points { points, seen, rejected, spent })
    }
}

/// A point and its slope by central differences, for models without derivatives of their own.
fn central(
    pixel: &Vector2<f64>,
    across: Across,
    trace: impl Fn(&Vector2<f64>) -> Result<Vector3<f64>, GeomError>,
) -> Result<PointAndSlope, GeomError> {
    const HALF_STEP_PX: f64 = 0.5;
    let at = |by: f64| {
        let mut moved = *pixel;
        moved[across.index()] += by;
        trace(&moved)
    };
    Ok((trace(pixel)?, (at(HALF_STEP_PX)? - at(-HALF_STEP_PX)?) / (2.0 * HALF_STEP_PX)))
}

/// `along` is the point's standard deviation as a vector: the stripe's error moves it along the sheet.
fn cloud_point(
    point: Vector3<f64>,
    along: Vector3<f64>,
    m: &uw_stripe::Measurement,
    frame: &FrameRecord,
    pixel: &Vector2<f64>,
) -> CloudPoint {
    let covariance = along * along.transpose();
    CloudPoint {
        position_mm: point.into(),
        intensity: m.amplitude as f32,
        frame_row: frame.row as u32,
        pixel: [pixel.x as f32, pixel.y as f32],
        sigma_mm: along.norm() as f32,
        covariance_mm2: [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)].map(|at| covariance[at] as f32),
    }
}
