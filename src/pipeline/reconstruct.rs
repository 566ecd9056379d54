//! A recorded sweep → points in millimetres, each with its covariance.

use crate::pipeline::Progress;
use crate::pipeline::load::{Reading, by_background};
use crate::pipeline::points::Tracer;
use crate::pipeline::stripes::{self, Rejects, extract};
use crate::pipeline::sweep::{self, Image, Seen, Verdicts};
use crate::{Error, Failure, Notes};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, Instant};
use uw_calib::Method;
use uw_cloud::{CloudPoint, Frame, PointCloud};
use uw_geom::Medium;
use uw_io::calibration_toml::CalibrationFile;
use uw_io::{Capture, FrameRecord, GrayImage, Kind, Problem, Rig, SaidBy};
use uw_stripe::{Extractor, Method as StripeMethod};

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

impl Refraction {
    /// Its name, as options and files have it: `exact`, `paper` or `none`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Exact => "exact",
            Self::Paper => "paper",
            Self::None => "none",
        }
    }
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
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// How a stripe's centre is estimated.
    pub stripe: StripeMethod,
    /// How light is traced.
    pub refraction: Refraction,
    /// Frame of the points.
    pub frame: Frame,
    /// What is outside the windows; `None`: what the capture says.
    pub medium: Option<uw_io::Medium>,
    /// The water's index.
    pub water: WaterIndex,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            stripe: stripes::METHOD,
            refraction: Refraction::default(),
            frame: Frame::default(),
            medium: None,
            water: WaterIndex::default(),
        }
    }
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
    /// The same for each image, in their order.
    pub images: Vec<ImageTally>,
    /// Index of refraction used outside the windows.
    pub index: f64,
    /// Warnings about the files, and losses.
    pub problems: Vec<Problem>,
    /// What to know before trusting the cloud.
    pub warnings: Vec<String>,
    /// Where the time went.
    pub spent: Spent,
}

/// What became of the rows (columns) of one laser-on image.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ImageTally {
    /// Its row in the capture.
    pub row: usize,
    /// Rows (columns) with a point.
    pub points: usize,
    /// Those without, by reason.
    pub rejected: Rejects,
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
        let path = capture.path.clone();
        return Err(Error::Kind { path, needed: "scan", got: "calibration" });
    }
    if !capture.frames.iter().any(|frame| frame.laser_on) {
        return Err(Error::LaserOff { path: capture.path.clone() });
    }
    let nominal = capture.rig.as_ref().and_then(Rig::water_index);
    let medium = outside(capture.medium, nominal, &capture.path, calibration, settings, &mut notes.warnings)?;
    let tracer = Tracer { calibration, refraction: settings.refraction, medium };

    let rig = &calibration.rig;
    let reading = Reading::new(rig, SaidBy::Calibration);
    let across = calibration.calibration.across;
    let groups = by_background(&capture);
    let suits = [StripeMethod::Robust, StripeMethod::Precise].contains(&settings.stripe);
    if !suits && groups.iter().any(|(dark, _)| dark.is_some()) {
        notes.warnings.push(format!(
            "{}: has images with the laser off, and where they are subtracted stripes are measured by the {} method, not by {}",
            capture.path.display(),
            StripeMethod::Precise.name(),
            settings.stripe.name()
        ));
    }
    let options = stripes::settled(settings.stripe, (across, rig.camera.bits), (&capture, reading))?;
    progress.begin("frames", groups.iter().map(|(_, frames)| frames.len()).sum());
    type FrameResult = Result<Stripes, uw_io::Error>;
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
                    || Extractor::new(options.clone()),
                    |extractor, frame| {
                        if progress.cancelled() {
                            return Err(Error::Cancelled);
                        }
                        let path = capture.image_path(frame);
                        let extractor = extractor
                            .as_mut()
                            .map_err(|e| Error::Stripe { path: path.clone(), source: e.clone() })?;
                        let began = Instant::now();
                        let found = match reading.stripe(&capture, frame) {
                            Ok(image) => {
                                let decode = began.elapsed();
                                let mut found = see(extractor, &image, background.as_ref(), frame, &path)?;
                                found.spent.decode = decode;
                                Ok(found)
                            }
                            Err(error) => Err(error),
                        };
                        progress.step();
                        Ok((frame, found))
                    },
                )
                .collect::<Result<Vec<_>, Error>>()?;
            Ok((lost, frames))
        })
        .collect::<Result<_, Error>>()?;

    let (mut images, mut tallies, mut spent) = (Vec::new(), Vec::new(), Spent::default());
    let (mut losses, mut backgrounds) = (Vec::new(), Vec::new());
    for (lost, frames) in made {
        backgrounds.extend(lost);
        for (frame, result) in frames {
            match result {
                Ok(found) => {
                    spent.add(found.spent);
                    tallies.push(ImageTally { row: frame.row, points: 0, rejected: found.rejected });
                    images.extend(found.image.map(|image| (frame, image)));
                }
                Err(error) => losses.push(Problem::loss(frame.row, error)),
            }
        }
    }
    tallies.sort_by_key(|tally: &ImageTally| tally.row);
    if tallies.is_empty() && !losses.is_empty() {
        let first = Box::new(losses.swap_remove(0).error);
        return Err(Error::NothingLeft { path: capture.path, first });
    }
    losses.append(&mut backgrounds);
    notes.problems.append(&mut losses);
    let points = believed(&tracer, images, &mut tallies, &mut spent);
    let mut rejected = Rejects::new();
    for (reason, count) in tallies.iter().flat_map(|tally| &tally.rejected) {
        *rejected.entry(reason).or_default() += count;
    }
    if points.is_empty() {
        return Err(Error::NoPoint { path: capture.path, frames: tallies.len(), rejected });
    }
    let mut cloud = PointCloud::from_points(Frame::Camera, &points);
    if settings.frame == Frame::Galvo {
        let galvo_from_camera = tracer.scanner().camera_from_galvo().inverse();
        cloud = cloud.transformed(Frame::Galvo, &galvo_from_camera.isometry());
    }
    Ok(Reconstructed {
        cloud,
        frames: tallies.len(),
        rejected,
        images: tallies,
        index: medium.index,
        problems: Vec::new(),
        warnings: Vec::new(),
        spent,
    })
}

/// What one image showed; no `image` without a voltage.
struct Stripes {
    image: Option<Image>,
    rejected: Rejects,
    spent: Spent,
}

/// The stripe of one image.
fn see(
    extractor: &mut Extractor,
    image: &GrayImage,
    background: Option<&GrayImage>,
    frame: &FrameRecord,
    path: &Path,
) -> Result<Stripes, Error> {
    let began = Instant::now();
    let method = extractor.options().method;
    let stripe = extract(extractor, image, background, path)?;
    let spent = Spent { extract: began.elapsed(), ..Spent::default() };
    let rejected = stripe.rejected().map(|(reason, count)| (reason.name(), count)).collect();
    let image = frame.voltage_v.map(|voltage_v| Image { voltage_v, seen: Seen::of(stripe, method) });
    Ok(Stripes { image, rejected, spent })
}

/// Images in sweeps that visit no voltage twice: a voltage's second image belongs to the second sweep, and so on. Each is judged by
/// itself, for neighbours at one voltage show nothing of how the surface goes on.
fn passes(images: Vec<(&FrameRecord, Image)>) -> Vec<Vec<(&FrameRecord, Image)>> {
    let (mut seen, mut passes) = (BTreeMap::<u64, usize>::new(), Vec::<Vec<_>>::new());
    for (frame, image) in images {
        let pass = seen.entry(image.voltage_v.to_bits()).or_default();
        if passes.len() == *pass {
            passes.push(Vec::new());
        }
        passes[*pass].push((frame, image));
        *pass += 1;
    }
    passes
}

/// The points of all images, in the order of the frames; they, and what the sweep as a whole tells against, are counted in `tallies`,
/// which are in that order, too.
fn believed(
    tracer: &Tracer<'_>,
    images: Vec<(&FrameRecord, Image)>,
    tallies: &mut [ImageTally],
    spent: &mut Spent,
) -> Vec<CloudPoint> {
    let mut judged: Vec<(&FrameRecord, f64, Verdicts)> = Vec::new();
    for mut pass in passes(images) {
        pass.sort_by(|(_, a), (_, b)| a.voltage_v.total_cmp(&b.voltage_v));
        let (frames, images): (Vec<&FrameRecord>, Vec<Image>) = pass.into_iter().unzip();
        let verdicts = frames.into_iter().zip(&images).zip(sweep::judge(&images));
        judged.extend(verdicts.map(|((frame, image), verdicts)| (frame, image.voltage_v, verdicts)));
    }
    judged.sort_by_key(|(frame, ..)| frame.row);
    let made: Vec<_> = judged
        .into_par_iter()
        .map(|(frame, voltage_v, verdicts)| {
            let began = Instant::now();
            let points = tracer.points(frame.row as u32, voltage_v, verdicts);
            (frame.row, points, began.elapsed())
        })
        .collect();
    let mut all = Vec::new();
    for (row, (points, reasons), took) in made {
        spent.triangulate += took;
        if let Ok(at) = tallies.binary_search_by_key(&row, |tally| tally.row) {
            tallies[at].points = points.len();
            for reason in reasons {
                *tallies[at].rejected.entry(reason).or_default() += 1;
            }
        }
        all.extend(points);
    }
    all
}

/// Lowest and highest index of water, relative to air, that a mistake is not likelier than.
const LIKELY_WATER: [f64; 2] = [1.30, 1.38];

/// What is outside the windows during a scan in `medium`, the index of its water `nominal` where that is known (FORMATS §2).
pub(crate) fn outside(
    medium: uw_io::Medium,
    nominal: Option<f64>,
    scan: &Path,
    file: &CalibrationFile,
    settings: &Settings,
    warnings: &mut Vec<String>,
) -> Result<Medium, Error> {
    let dir = scan.display();
    let given = settings.water != WaterIndex::Calibrated;
    if settings.medium.unwrap_or(medium) == uw_io::Medium::Air {
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
            let nominal = nominal.or(file.calibration.nominal_water_index).or_else(|| file.rig.water_index());
            let unknown = || Error::NoWaterIndex { path: scan.to_owned() };
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
