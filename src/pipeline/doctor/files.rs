//! Vehicle file, rig file and calibration: each by itself, and whether they are of one instrument.

use super::Findings;
use std::path::{Path, PathBuf};
use uw_calib::Method;
use uw_io::{CalibrationFile, Medium, Problem, Rig, Vehicle, calibration_toml};

/// What could be read.
pub(super) struct Files {
    pub(super) vehicle: Vehicle,
    pub(super) rig: Option<Rig>,
    pub(super) calibration: Option<CalibrationFile>,
    /// All files that were read.
    pub(super) paths: Vec<PathBuf>,
}

/// The vehicle's files; `None` where the vehicle file itself can't be read.
pub(super) fn examine(config: &Path, findings: &mut Findings<'_>) -> Option<Files> {
    findings.about("vehicle file");
    let vehicle = match Vehicle::read(config) {
        Ok((vehicle, problems)) => {
            warn(&problems, findings);
            findings.good(format!("{}: sound", config.display()));
            vehicle
        }
        Err(error) => {
            findings.file(&error);
            return None;
        }
    };
    let mut paths = vec![config.to_owned()];

    findings.about("rig");
    let path = vehicle.resolve(&vehicle.rig);
    let rig = match Rig::read(&path) {
        Ok((rig, problems)) => {
            warn(&problems, findings);
            fits(&vehicle, &rig, &path, findings);
            paths.push(path);
            Some(rig)
        }
        Err(error) => {
            findings.file(&error);
            None
        }
    };

    findings.about("calibration");
    let calibration = match &vehicle.calibration {
        None => {
            let mend = "calibrate (`uwscan capture-calibration`, `uwscan calibrate`), and add a line: calibration = \"calibration.toml\"";
            findings.warning("none is named: scans are recorded, and no points made of them", mend);
            None
        }
        Some(path) => {
            let path = vehicle.resolve(path);
            match calibration_toml::read(&path) {
                Ok((file, problems)) => {
                    warn(&problems, findings);
                    if let Some(rig) = &rig {
                        belongs(&file, rig, &path, findings);
                    }
                    paths.push(path);
                    Some(file)
                }
                Err(error) => {
                    findings.file(&error);
                    None
                }
            }
        }
    };
    Some(Files { vehicle, rig, calibration, paths })
}

fn warn(problems: &[Problem], findings: &mut Findings<'_>) {
    problems.iter().for_each(|problem| findings.warning(problem.to_string(), ""));
}

/// Whether the vehicle's camera and mirror are those of the rig file.
fn fits(vehicle: &Vehicle, rig: &Rig, path: &Path, findings: &mut Findings<'_>) {
    let (c, r) = (&vehicle.camera, &rig.camera);
    let mut fits = true;
    if [c.width, c.height] != [r.width, r.height] {
        fits = false;
        findings.fault(
            format!(
                "[camera] of the vehicle file is set up for {} x {} pixels, {} has {} x {}",
                c.width,
                c.height,
                path.display(),
                r.width,
                r.height
            ),
            "mend width and height in the file that is wrong",
        );
    }
    if c.bits != r.bits {
        fits = false;
        findings.fault(
            format!("camera.bits is {} in the vehicle file and {} in {}", c.bits, r.bits, path.display()),
            "give both the bits that the camera delivers",
        );
    }
    let ([low, high], [rig_low, rig_high]) = (vehicle.galvo.range_v, rig.galvo.range_v);
    if low < rig_low || high > rig_high {
        fits = false;
        findings.fault(
            format!(
                "galvo.range_v is [{low}, {high}] V in the vehicle file, wider than the drive's own [{rig_low}, {rig_high}] V in {}",
                path.display()
            ),
            "narrow galvo.range_v of the vehicle file, or mend the rig file",
        );
    }
    if fits {
        findings.good(format!("{}: sound, and the vehicle's", path.display()));
    }
}

/// Whether a calibration is of this rig, and good for what is outside it.
fn belongs(file: &CalibrationFile, rig: &Rig, path: &Path, findings: &mut Findings<'_>) {
    let differences = file.rig.differences(rig);
    let path = path.display();
    if !differences.is_empty() {
        findings.fault(
            format!("{path} was made with another rig file than the vehicle's: {}", differences.join(", ")),
            "give the calibration of this instrument, or the rig file that it was made with",
        );
    }
    let in_water = file.captures.iter().any(|capture| capture.medium == Medium::Water);
    if rig.water.is_some() && !in_water {
        findings.warning(
            format!("{path} was made on land only, and the rig file has [water]: depths in water are uncertain by some thousandths"),
            "capture 6 to 10 placements of the board in water, and calibrate with both",
        );
    }
    if file.calibration.method == Method::Paper {
        findings.warning(
            format!("{path} was made by the paper's method, which neglects the windows"),
            "calibrate with --method joint",
        );
    }
    if differences.is_empty() {
        findings.good(format!("{path}: sound, and of this rig"));
    }
}
