//! Scans and clouds → one page to hand over, with the same figures as JSON and as a table beside it.
//!
//! [`report`] measures, [`Report`] writes: what is on the page is decided in `page` and `figures`, how a page looks in the crate
//! `uw-report`. Nothing of it depends on a clock or on the number of threads.

pub(crate) mod artefact;
mod calibration;
mod figures;
pub(crate) mod page;
pub(crate) mod plots;
mod record;
mod scan;
mod table;
pub(crate) mod views;

use crate::pipeline::Progress;
use crate::pipeline::reconstruct::{self, Reconstructed, reconstruct};
use crate::{Error, Failure, Notes};
use scan::{Against, Made, Scan};
use std::fs;
use std::path::{Path, PathBuf};
use uw_cloud::NearestOnMesh;
use uw_io::calibration_toml::{self, CalibrationFile};
use uw_io::{Capture, Nominal, Overwrite, Problem, Severity, atomic, clouds, file_hash, meshes};

pub use calibration::{CalibrationReport, PoseRecord, calibration_page, write_calibration_report};
pub use record::{
    CalibrationRecord, DeviationsRecord, FORMAT, FigureRecord, FileRecord, HeadRecord, HistogramRecord,
    ImageRecord, ProbingRecord, Record, RelationRecord, ScanRecord, ShapeRecord, SourceRecord, SpacingRecord,
    VERSION,
};
pub use uw_report::Page;

/// How to report.
#[derive(Debug, Clone, Default)]
pub struct Settings {
    /// The calibration: needed for captures; of a cloud it adds its part of the uncertainty.
    pub calibration: Option<PathBuf>,
    /// How captures are reconstructed.
    pub reconstruct: reconstruct::Settings,
    /// A mesh that the scans are held against.
    pub reference: Option<PathBuf>,
    /// Nominal values of an artefact.
    pub nominal: Option<PathBuf>,
    /// The page's title; `None`: one that says what it is.
    pub title: Option<String>,
    /// When, as the page says it; `None`: it does not.
    pub made: Option<String>,
    /// A folder that files are named from; `None`: they are named as they are given.
    pub named_from: Option<PathBuf>,
}

impl Settings {
    /// A file's or folder's name on the page.
    fn shown(&self, path: &Path) -> String {
        let inside = self.named_from.as_deref().and_then(|folder| path.strip_prefix(folder).ok());
        inside.unwrap_or(path).display().to_string()
    }

    fn hashed(&self, path: &Path) -> Result<FileRecord, Error> {
        Ok(FileRecord { file: self.shown(path), sha256: file_hash(path)? })
    }
}

/// What was measured, ready to be written.
#[derive(Debug)]
pub struct Report {
    /// Its figures.
    pub record: Record,
    /// Warnings about the files, and losses.
    pub problems: Vec<Problem>,
    scans: Vec<Scan>,
}

/// A scan that is at hand already.
#[derive(Debug, Clone, Copy)]
pub struct AtHand<'a> {
    /// Its capture.
    pub capture: &'a Path,
    /// What became of it.
    pub reconstructed: &'a Reconstructed,
    /// How.
    pub settings: &'a reconstruct::Settings,
}

/// Measures scans: capture folders and recordings (with a calibration), and clouds.
///
/// # Errors
/// [`Failure`] where a file is wrong, a capture comes without a calibration, or a scan can't be measured.
pub fn report(scans: &[PathBuf], settings: &Settings, progress: &dyn Progress) -> Result<Report, Failure> {
    run(settings, |bench, notes| {
        for path in scans {
            let measured = bench.scan(path, settings, notes, progress)?;
            bench.scans.push(measured);
        }
        Ok(())
    })
}

/// As [`report`], of scans that were reconstructed already.
///
/// # Errors
/// As [`report`].
pub fn report_at_hand(scans: &[AtHand<'_>], settings: &Settings) -> Result<Report, Failure> {
    run(settings, |bench, notes| {
        for scan in scans {
            let measured = bench.at_hand(scan, settings, notes)?;
            bench.scans.push(measured);
        }
        Ok(())
    })
}

/// What scans are measured with, and those that were.
struct Bench<'a> {
    calibration: Option<&'a CalibrationFile>,
    against: Against<'a>,
    scans: Vec<Scan>,
}

fn run(
    settings: &Settings,
    measure: impl FnOnce(&mut Bench<'_>, &mut Notes) -> Result<(), Error>,
) -> Result<Report, Failure> {
    let mut notes = Notes::default();
    match gather(settings, measure, &mut notes) {
        Ok((scans, mut record)) => {
            let problems = notes.problems;
            record.warnings = notes.warnings;
            for problem in &problems {
                match problem.severity {
                    Severity::Loss => record.lost.push(problem.to_string()),
                    _ => record.warnings.push(problem.to_string()),
                }
            }
            Ok(Report { record, problems, scans })
        }
        Err(error) => Err(Failure { error: Box::new(error), notes }),
    }
}

fn gather(
    settings: &Settings,
    measure: impl FnOnce(&mut Bench<'_>, &mut Notes) -> Result<(), Error>,
    notes: &mut Notes,
) -> Result<(Vec<Scan>, Record), Error> {
    let mut noted = |problems: Vec<Problem>| notes.problems.extend(problems);
    let calibration = settings.calibration.as_deref().map(calibration_toml::read).transpose()?;
    let calibration = calibration.map(|(file, problems)| {
        noted(problems);
        file
    });
    let nominal = settings.nominal.as_deref().map(Nominal::read).transpose()?;
    let mesh = settings.reference.as_deref().map(meshes::read).transpose()?;
    let mesh = mesh.map(|(mesh, problems)| {
        noted(problems);
        mesh
    });
    let nearest = match (&mesh, &settings.reference) {
        (Some(mesh), Some(path)) => {
            let empty = || Error::Reference { path: path.clone(), what: "it has no triangles".to_owned() };
            Some((path.as_path(), NearestOnMesh::new(mesh).ok_or_else(empty)?))
        }
        _ => None,
    };
    let mut bench = Bench {
        calibration: calibration.as_ref(),
        against: Against {
            calibration: calibration.as_ref().map(|file| &file.calibration),
            nominal: nominal.as_ref(),
            reference: nearest.as_ref().map(|(path, nearest)| (*path, nearest)),
        },
        scans: Vec::new(),
    };
    measure(&mut bench, notes)?;
    let scans = bench.scans;
    let (probing, spacing) = figures::errors(&scans, nominal.as_ref());
    let record = Record {
        head: HeadRecord::new(FORMAT, VERSION, settings.made.clone()),
        title: settings.title.clone().unwrap_or_else(|| title(&scans)),
        warnings: Vec::new(),
        lost: Vec::new(),
        calibration: match (&calibration, &settings.calibration) {
            (Some(file), Some(path)) => Some(figures::calibration(file, settings.hashed(path)?)),
            _ => None,
        },
        reference: settings.reference.as_deref().map(|path| settings.hashed(path)).transpose()?,
        nominal: settings.nominal.as_deref().map(|path| settings.hashed(path)).transpose()?,
        scans: scans.iter().map(|scan| scan.record.clone()).collect(),
        probing,
        spacing,
    };
    Ok((scans, record))
}

fn title(scans: &[Scan]) -> String {
    match scans {
        [one] => format!("Measurement of {}", one.record.name),
        many => format!("Measurement of {} scans", many.len()),
    }
}

/// A file's or folder's name without its ending.
fn name(path: &Path) -> String {
    let whole = path.canonicalize().ok();
    let named = path.file_stem().or_else(|| whole.as_deref()?.file_stem());
    named.map_or_else(|| path.display().to_string(), |stem| stem.to_string_lossy().into_owned())
}

impl Bench<'_> {
    fn scan(
        &self,
        path: &Path,
        settings: &Settings,
        notes: &mut Notes,
        progress: &dyn Progress,
    ) -> Result<Scan, Error> {
        if clouds::Format::of(path).is_ok() && !path.is_dir() {
            if meshes::is_mesh(path)? {
                return Err(Error::MeshForCloud { path: path.to_owned() });
            }
            let (cloud, problems) = clouds::read(path)?;
            notes.problems.extend(problems);
            let of = (name(path), settings.hashed(path)?);
            return Scan::measure(of, cloud, None, &self.against, &mut notes.warnings);
        }
        // A PLY without faces is a cloud, and was one above.
        if meshes::Format::of(path).is_ok() && path.is_file() {
            return Err(Error::MeshForCloud { path: path.to_owned() });
        }
        // What is no capture is told so before a calibration is asked for.
        Capture::open_noting(path, None, &mut Vec::new())?;
        let calibration =
            self.calibration.ok_or_else(|| Error::CalibrationNeeded { path: path.to_owned() })?;
        let mut made = match reconstruct(path, calibration, &settings.reconstruct, progress) {
            Ok(made) => made,
            Err(Failure { error, notes: more }) => {
                notes.problems.extend(more.problems);
                notes.warnings.extend(more.warnings);
                return Err(*error);
            }
        };
        notes.problems.append(&mut made.problems);
        let made = AtHand { capture: path, reconstructed: &made, settings: &settings.reconstruct };
        self.at_hand(&made, settings, notes)
    }

    fn at_hand(&self, scan: &AtHand<'_>, settings: &Settings, notes: &mut Notes) -> Result<Scan, Error> {
        let AtHand { capture: path, reconstructed, settings: how } = *scan;
        notes.warnings.extend(reconstructed.warnings.iter().cloned());
        let capture = Capture::open_noting(path, None, &mut Vec::new())?;
        let file = FileRecord { file: settings.shown(path), sha256: capture.content_hash()? };
        let medium = how.medium.unwrap_or(capture.medium);
        let made = Made { reconstructed, refraction: how.refraction, medium };
        let cloud = reconstructed.cloud.clone();
        Scan::measure((name(path), file), cloud, Some(&made), &self.against, &mut notes.warnings)
    }
}

impl Report {
    /// The page.
    pub fn page(&self) -> Page {
        page::page(&self.record, &self.scans)
    }

    /// The page's text, one file that asks for no other.
    ///
    /// # Errors
    /// [`Error::Plot`] where there is nothing that an axis could show.
    pub fn html(&self) -> Result<String, Error> {
        self.page().html().map_err(Error::Plot)
    }

    /// Writes the page, and beside it the figures as JSON (`.json`) and as a table (`.csv`); the files that there are then.
    ///
    /// # Errors
    /// [`Error`] where they can't be written, or exist and may not be replaced.
    pub fn write(&self, path: &Path, overwrite: Overwrite) -> Result<[PathBuf; 3], Error> {
        let json = json(&self.record);
        write_all(path, overwrite, [&self.html()?, &json, &table::csv(&self.record)])
    }
}

/// The files of a report: the page, and beside it JSON and table.
pub fn files(page: &Path) -> [PathBuf; 3] {
    [page.to_owned(), page.with_extension("json"), page.with_extension("csv")]
}

/// Whether a report on `inputs` can be written, as far as that can be told before the work.
///
/// # Errors
/// As [`atomic::check`]; [`Error::PageName`] for a name that its companions would take, [`Error::OwnInput`] where one of them is an input.
pub fn check(page: &Path, inputs: &[&Path], overwrite: Overwrite) -> Result<(), Error> {
    let ending = page.extension().map(std::ffi::OsStr::to_ascii_lowercase);
    if !ending.as_ref().is_some_and(|e| e == "html" || e == "htm") {
        return Err(Error::PageName { path: page.to_owned() });
    }
    for path in &files(page) {
        // Whatever may be replaced: a cloud or table of nominal values beside the page is no earlier report.
        if let Ok(target) = path.canonicalize()
            && inputs.iter().any(|input| input.canonicalize().is_ok_and(|input| input == target))
        {
            return Err(Error::OwnInput { path: path.clone() });
        }
        atomic::check(path, overwrite)?;
    }
    Ok(())
}

/// The JSON of a record: what is no finite number is `null` there.
pub(crate) fn json(record: &impl serde::Serialize) -> String {
    // Records of numbers, names and lists always serialise.
    serde_json::to_string_pretty(record).unwrap_or_default() + "\n"
}

/// Writes the texts of [`files`]: the page last, so that where it is, all is. Where that fails, nothing new is left.
pub(crate) fn write_all(page: &Path, overwrite: Overwrite, texts: [&str; 3]) -> Result<[PathBuf; 3], Error> {
    let paths = files(page);
    for (at, (path, text)) in paths.iter().zip(texts).enumerate().rev() {
        let written = atomic::write(path, overwrite, |out| out.write_all(text.as_bytes()));
        if let Err(error) = written {
            // Those that are new here would be in the way of the next try.
            if overwrite == Overwrite::Refuse {
                paths[at + 1..].iter().for_each(|path| drop(fs::remove_file(path)));
            }
            return Err(error.into());
        }
    }
    Ok(paths)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_report_that_cannot_be_written_leaves_nothing_new() {
        let folder = tempfile::tempdir().unwrap();
        let page = folder.path().join("report.html");
        fs::write(&page, "somebody's").unwrap();
        let texts = ["page", "{}", "a,b"];
        assert!(write_all(&page, Overwrite::Refuse, texts).is_err());
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
        let [_, json, table] = write_all(&page, Overwrite::Replace, texts).unwrap();
        assert_eq!(fs::read_to_string(&page).unwrap(), "page");
        assert!(json.exists() && table.exists());
    }
}
