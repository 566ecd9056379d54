//! An archive of recordings → a cloud each, restartable: each recording by itself, keyed by what its cloud follows from.
//!
//! A cloud goes to the recording's place in the output folder, with its ending added (`dive/3.mcap` → `dive/3.mcap.ply`), and then a small
//! file beside it that says what it follows from ([`uw_io::batch`]). Both come whole or not at all, the latter last: a second run does what
//! has no such file, an older key, or failed. [`run_one`] serves one recording, in whatever process: [`batch`] on threads here, Python's
//! `uwscan.batch` on a cluster.

use crate::pipeline::reconstruct::{self, Settings, reconstruct};
use crate::pipeline::{Progress, Silent};
use crate::{Error, Failure, Notes};
use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;
use uw_io::batch::{self as results, ResultRecord, Status};
use uw_io::calibration_toml::{self, CalibrationFile};
use uw_io::{Capture, Kind, Overwrite, Problem, Severity, clouds};

/// The table of an archive's results, in the output folder.
pub const TABLE: &str = "table.csv";
/// What is added to a recording's name for its cloud, and for its result.
const CLOUD: &str = ".ply";
const RESULT: &str = ".result.toml";

/// A recording of an archive.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Job {
    /// Its name relative to the archive's folder, with `/` between folders.
    pub name: String,
    /// The capture folder, or the recording's file.
    pub path: PathBuf,
}

/// What every recording of an archive is reconstructed with.
#[derive(Debug)]
pub struct Shared {
    /// The calibration.
    pub calibration: CalibrationFile,
    /// How.
    pub settings: Settings,
    /// What a key says of both, and of this software.
    described: String,
}

impl Shared {
    /// The calibration of a file, and how to reconstruct with it; with warnings about the file.
    ///
    /// # Errors
    /// [`Error::File`] where it can't be read.
    pub fn read(path: &Path, settings: Settings) -> Result<(Self, Vec<Problem>), Error> {
        let text = calibration_toml::text(path)?;
        let (calibration, problems) = calibration_toml::parse(path, &text)?;
        let described = results::key([calibration_toml::SOFTWARE, &text, &format!("{settings:?}")]);
        Ok((Self { calibration, settings, described }, problems))
    }

    /// What a recording's cloud follows from: its content, the calibration, the settings and the software's version.
    ///
    /// # Errors
    /// [`Error::File`] where the recording can't be read.
    pub fn key(&self, capture: &Capture) -> Result<String, Error> {
        Ok(results::key([self.described.as_str(), &capture.content_hash()?]))
    }
}

/// What became of an archive.
#[derive(Debug)]
pub struct Batch {
    /// A result a recording, in the order of their names.
    pub records: Vec<ResultRecord>,
    /// How many of them were there already.
    pub kept: usize,
    /// The table that was written.
    pub table: PathBuf,
    /// Warnings about the calibration's file.
    pub problems: Vec<Problem>,
}

/// The recordings under a folder, in the order of their names: capture folders, and files that end in `.mcap`. A folder below it that can't be
/// listed counts as one: what is in it nobody knows.
///
/// # Errors
/// [`Error::File`] where the folder can't be listed, [`Error::NoRecording`] where there is none.
pub fn jobs(folder: &Path) -> Result<Vec<Job>, Error> {
    let mut found = Vec::new();
    look(folder, "", &mut found)?;
    if found.is_empty() {
        return Err(Error::NoRecording { path: folder.to_owned() });
    }
    found.sort();
    Ok(found)
}

fn look(folder: &Path, prefix: &str, found: &mut Vec<Job>) -> Result<(), Error> {
    for entry in fs::read_dir(folder).map_err(uw_io::Error::file(folder, "list the folder"))? {
        let path = entry.map_err(uw_io::Error::file(folder, "list the folder"))?.path();
        let Some(file_name) = path.file_name().map(|n| n.to_string_lossy().into_owned()) else { continue };
        let name = format!("{prefix}{file_name}");
        let is_recording = path.extension().is_some_and(|e| e.eq_ignore_ascii_case(uw_io::recording::ENDING));
        if path.join("capture.toml").is_file() || (is_recording && path.is_file()) {
            found.push(Job { name, path });
        } else if path.is_dir() && !path.is_symlink() {
            // One that can't be listed is a job that fails by itself: its row of the table says why.
            if look(&path, &format!("{name}/"), found).is_err() {
                found.push(Job { name, path });
            }
        }
    }
    Ok(())
}

fn beside(output: &Path, job: &Job, ending: &str) -> PathBuf {
    output.join(format!("{}{ending}", job.name))
}

/// The result of a recording that is there already and has this key, with its cloud.
fn kept(output: &Path, job: &Job, key: &str) -> Option<ResultRecord> {
    let record = results::read(&beside(output, job, RESULT)).ok()?;
    let finished = match record.status {
        Status::Done | Status::WithLoss => beside(output, job, CLOUD).is_file(),
        Status::Skipped => true,
        Status::Failed => false,
    };
    (finished && record.key == key).then_some(record)
}

/// Makes one recording's cloud and its result, unless both are there; whether they were. What fails becomes the result, a panic too.
///
/// # Errors
/// [`Error::File`] where the result can't be written; [`Error::Cancelled`].
pub fn run_one(
    job: &Job,
    shared: &Shared,
    output: &Path,
    progress: &dyn Progress,
) -> Result<(ResultRecord, bool), Error> {
    let began = Instant::now();
    // What is known of the key by the time that something fails.
    let mut key = String::new();
    let made = catch_unwind(AssertUnwindSafe(|| make(job, shared, output, progress, &mut key)));
    let mut record = match made {
        Ok(Ok((record, true))) => return Ok((record, true)),
        Ok(Ok((record, false))) => record,
        Ok(Err(Error::Cancelled)) => return Err(Error::Cancelled),
        Ok(Err(error)) => failed(job, key, error.to_string()),
        Err(_) => failed(job, String::new(), "the program failed on it (a panic): report this".to_owned()),
    };
    record.seconds = began.elapsed().as_secs_f64();
    let path = beside(output, job, RESULT);
    parent(&path)?;
    results::write(&path, &record)?;
    Ok((record, false))
}

/// Records that a recording failed for a reason from outside, such as a worker that died on it.
///
/// # Errors
/// [`Error::File`] where the result can't be written.
pub fn record_failure(job: &Job, output: &Path, message: &str) -> Result<ResultRecord, Error> {
    let record = failed(job, String::new(), message.to_owned());
    let path = beside(output, job, RESULT);
    parent(&path)?;
    results::write(&path, &record)?;
    Ok(record)
}

fn failed(job: &Job, key: String, message: String) -> ResultRecord {
    ResultRecord {
        recording: job.name.clone(),
        status: Status::Failed,
        key,
        points: 0,
        frames: 0,
        lost: 0,
        index: 0.0,
        seconds: 0.0,
        message,
    }
}

fn parent(path: &Path) -> Result<(), Error> {
    let folder = path.parent().unwrap_or(Path::new(""));
    Ok(fs::create_dir_all(folder).map_err(uw_io::Error::file(folder, "make the folder"))?)
}

/// Passes on the wish to end, and tells nobody of steps: those of many recordings at once mean nothing.
struct Quiet<'a>(&'a dyn Progress);

impl Progress for Quiet<'_> {
    fn begin(&self, stage: &str, total: usize) {
        Silent.begin(stage, total);
    }
    fn step(&self) {}
    fn cancelled(&self) -> bool {
        self.0.cancelled()
    }
}

fn make(
    job: &Job,
    shared: &Shared,
    output: &Path,
    progress: &dyn Progress,
    key: &mut String,
) -> Result<(ResultRecord, bool), Error> {
    let capture = Capture::open(&job.path)?;
    *key = shared.key(&capture)?;
    if let Some(record) = kept(output, job, key) {
        return Ok((record, true));
    }
    let blank = || failed(job, key.clone(), String::new());
    if capture.kind != Kind::Scan {
        let message = format!("a {}, no scan", capture.kind.name());
        return Ok((ResultRecord { status: Status::Skipped, message, ..blank() }, false));
    }
    drop(capture);
    let reconstruct::Reconstructed { cloud, frames, index, problems, .. } =
        reconstruct(&job.path, &shared.calibration, &shared.settings, &Quiet(progress))
            .map_err(|failure| *failure.error)?;
    let path = beside(output, job, CLOUD);
    parent(&path)?;
    let format = clouds::Format::Ply(uw_io::ply::Encoding::Binary);
    clouds::write(&path, Overwrite::Replace, &cloud, format)?;
    let mut lost = problems.iter().filter(|p| p.severity == Severity::Loss).peekable();
    let message = lost.peek().map_or_else(String::new, ToString::to_string);
    let lost = lost.count();
    let status = if lost > 0 { Status::WithLoss } else { Status::Done };
    let record = ResultRecord { status, points: cloud.len(), frames, lost, index, message, ..blank() };
    Ok((record, false))
}

/// Makes the clouds of all recordings under a folder, as many at a time as rayon has threads, each on one; then the table.
///
/// # Errors
/// [`Failure`] where the calibration can't be read, there is no recording, or results can't be written. A recording that fails is none: its
/// row says why.
pub fn batch(
    folder: &Path,
    calibration: &Path,
    output: &Path,
    settings: Settings,
    progress: &dyn Progress,
) -> Result<Batch, Failure> {
    all(folder, calibration, output, settings, progress)
        .map_err(|error| Failure { error: Box::new(error), notes: Notes::default() })
}

fn all(
    folder: &Path,
    calibration: &Path,
    output: &Path,
    settings: Settings,
    progress: &dyn Progress,
) -> Result<Batch, Error> {
    let (shared, problems) = Shared::read(calibration, settings)?;
    let jobs = jobs(folder)?;
    parent(&output.join(TABLE))?;
    progress.begin("recordings", jobs.len());
    let (next, done) = (AtomicUsize::new(0), Mutex::new(Vec::with_capacity(jobs.len())));
    let work = || -> Result<(), Error> {
        // One thread a recording: images of several recordings at once would cost more memory, and are no faster.
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build();
        while let Some(job) = jobs.get(next.fetch_add(1, Ordering::Relaxed)) {
            if progress.cancelled() {
                return Err(Error::Cancelled);
            }
            let one = || run_one(job, &shared, output, progress);
            let made = match &pool {
                Ok(pool) => pool.install(one),
                Err(_) => one(),
            }?;
            done.lock().unwrap_or_else(PoisonError::into_inner).push(made);
            progress.step();
        }
        Ok(())
    };
    let threads = rayon::current_num_threads().clamp(1, jobs.len());
    std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads).map(|_| scope.spawn(work)).collect();
        let ends = workers.into_iter().map(|worker| worker.join().unwrap_or(Err(Error::Cancelled)));
        ends.collect::<Vec<_>>().into_iter().collect::<Result<(), Error>>()
    })?;
    let mut done = done.into_inner().unwrap_or_else(PoisonError::into_inner);
    done.sort_by(|(a, _), (b, _)| a.recording.cmp(&b.recording));
    let kept = done.iter().filter(|(_, kept)| *kept).count();
    let records: Vec<ResultRecord> = done.into_iter().map(|(record, _)| record).collect();
    let table = write_table(output, &records)?;
    Ok(Batch { records, kept, table, problems })
}

/// Writes the table of an archive's results; where it is.
///
/// # Errors
/// [`Error::File`] where it can't be written.
pub fn write_table(output: &Path, records: &[ResultRecord]) -> Result<PathBuf, Error> {
    let path = output.join(TABLE);
    results::write_table(&path, records)?;
    Ok(path)
}

/// The results of recordings that have one, in the order of `jobs`.
pub fn recorded(jobs: &[Job], output: &Path) -> Vec<ResultRecord> {
    jobs.iter().filter_map(|job| results::read(&beside(output, job, RESULT)).ok()).collect()
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;

    #[test]
    fn a_folder_that_cannot_be_listed_fails_by_itself() {
        let archive = tempfile::tempdir().unwrap();
        for name in ["one", "lost+found"] {
            fs::create_dir(archive.path().join(name)).unwrap();
        }
        fs::write(archive.path().join("one/capture.toml"), "").unwrap();
        let locked = archive.path().join("lost+found");
        fs::set_permissions(&locked, fs::Permissions::from_mode(0o000)).unwrap();
        // Nothing is locked before root: then it is a folder with nothing in it.
        let names: Vec<String> = jobs(archive.path()).unwrap().into_iter().map(|job| job.name).collect();
        match fs::read_dir(&locked) {
            Ok(_) => assert_eq!(names, ["one"]),
            Err(_) => assert_eq!(names, ["lost+found", "one"]),
        }
    }
}
