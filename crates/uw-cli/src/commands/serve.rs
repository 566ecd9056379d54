//! `uwscan serve`.

use std::{
    collections::BTreeSet,
    net::SocketAddr,
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
        mpsc::{RecvTimeoutError, sync_channel},
    },
    time::Duration,
};

use anyhow::Context;
use uwscan::{
    io::{Overwrite, calibration_toml, disk},
    live::{About, Laser, Level, Mode, Phase, State},
    pipeline::{
        instrument::Wanted,
        live::{Source, obey, replay, without_folders},
        record::Steering,
    },
};

use crate::{
    commands::scan::{MediumArg, Setup, tell},
    console::Console,
    exit::{Outcome, chain},
    listening::{self, Listening, Live},
    signals,
};

/// Arguments of `serve`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "With recordings: they are shown with a time line. With --config: the vehicle waits, and scans when a client asks \
    for it; each scan is scan-0001.mcap, scan-0002.mcap, … with its cloud beside it. Ends on Ctrl-C. On other addresses than this \
    machine's own, clients need a token: one to watch, one to steer."
)]
pub struct Args {
    /// Recordings or capture folders to show
    #[arg(value_name = "CAPTURE", required_unless_present = "config", conflicts_with_all = ["config", "output", "medium"])]
    captures: Vec<PathBuf>,
    /// Address to listen on
    #[arg(long, value_name = "ADDR", value_parser = listening::address, default_value = "127.0.0.1:8764")]
    listen: SocketAddr,
    /// Vehicle file of a station that scans when it is asked to
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Folder for its recordings and clouds, made if it is missing [default: disk.folder of the vehicle file]
    #[arg(short, long, value_name = "FOLDER", requires = "config")]
    output: Option<PathBuf>,
    /// Calibration file [default: the recording's own, or the vehicle file's]
    #[arg(short, long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// What is outside the windows, with --config [default: water if the rig file has [water], else air]
    #[arg(long)]
    medium: Option<MediumArg>,
    #[command(flatten)]
    listening: Listening,
}

/// How often a station looks whether it is to end.
const LOOK: Duration = Duration::from_millis(100);
/// How long clients get to see how it ended.
const GOODBYE: Duration = Duration::from_millis(300);

/// Serves until it is told to end.
///
/// # Errors
/// A file can't be read, or the address can't be had.
pub fn run(args: &Args, console: &Console) -> anyhow::Result<Outcome> {
    match &args.config {
        Some(config) => station(args, config, console),
        None => show(args, console),
    }
}

/// Shows recordings.
fn show(args: &Args, console: &Console) -> anyhow::Result<Outcome> {
    let sources = sources(&args.captures);
    let calibration = match &args.calibration {
        Some(path) => {
            let (file, problems) = calibration_toml::read(path)?;
            console.problems(&problems);
            Some(file)
        }
        None => None,
    };
    let ending = signals::end_on_signals(Steering::default()).context("cannot listen for Ctrl-C")?;
    let Live { server, feed, asked } = args.listening.start(args.listen, console)?;
    replay(&sources, calibration.as_ref(), &feed, &asked, &|| ending.load(Ordering::Acquire))?;
    server.close(GOODBYE);
    Ok(Outcome::Done)
}

/// Recordings by names that tell them apart, and no folders: where they are is not their viewers' to know.
fn sources(paths: &[PathBuf]) -> Vec<Source> {
    let mut taken = BTreeSet::new();
    paths
        .iter()
        .map(|path| {
            let own = path.file_name().map(|name| name.to_string_lossy().into_owned());
            let own = own.unwrap_or_else(|| path.display().to_string());
            let numbered = (2..).map(|number| format!("{own} ({number})"));
            let mut names = std::iter::once(own.clone()).chain(numbered);
            let name = names.find(|name| taken.insert(name.clone())).unwrap_or(own);
            Source { name, path: path.clone() }
        })
        .collect()
}

/// Scans whenever a client asks for it.
fn station(args: &Args, config: &Path, console: &Console) -> anyhow::Result<Outcome> {
    let setup = Setup::read(config, args.calibration.as_deref(), args.medium, console)?;
    let folder = match &args.output {
        Some(folder) => {
            std::fs::create_dir_all(folder)
                .with_context(|| format!("{}: cannot make the folder", folder.display()))?;
            folder.clone()
        }
        // Not made: the disk that it is on may be missing.
        None => setup.vehicle.resolve(&setup.vehicle.disk.folder),
    };
    // Told now, not when somebody far away asks for the first scan.
    disk::next_recording(&folder)?;
    let steering = Steering::default();
    let ending = signals::end_on_signals(steering.clone()).context("cannot listen for Ctrl-C")?;
    let Live { server, feed, asked } = args.listening.start(args.listen, console)?;
    let (camera, sweep) = (&setup.vehicle.camera, &setup.vehicle.sweep);
    feed.about(About {
        mode: Mode::Station,
        image_size: [camera.width, camera.height],
        volts: Some([sweep.from_v.min(sweep.to_v), sweep.from_v.max(sweep.to_v)]),
        ..About::default()
    });
    feed.state(State { phase: Phase::Idle, laser: Laser::Unknown, ..State::default() });
    let (start, to_start) = sync_channel::<()>(1);
    let busy = Arc::new(AtomicBool::new(false));
    let (theirs, shown, working) = (steering.clone(), feed.clone(), busy.clone());
    let obeying = move || {
        let mut begin = || {
            let runs = || "a scan runs already".to_owned();
            if working.swap(true, Ordering::AcqRel) {
                return Err(runs());
            }
            start.try_send(()).map_err(|_| runs())
        };
        obey(&asked, &theirs, &shown, &mut begin);
    };
    std::thread::Builder::new()
        .name("uwscan-steer".to_owned())
        .spawn(obeying)
        .context("cannot start a thread")?;
    let mut outcome = Outcome::Done;
    while !ending.load(Ordering::Acquire) {
        match to_start.recv_timeout(LOOK) {
            // Opening devices takes a while.
            Ok(()) => feed.state(State { phase: Phase::Starting, ..State::default() }),
            Err(RecvTimeoutError::Timeout) => continue,
            Err(RecvTimeoutError::Disconnected) => break,
        }
        let scanned = disk::next_recording(&folder).map_err(anyhow::Error::from).and_then(|target| {
            let wanted = Wanted { repeat: 1, ..Wanted::default() };
            let live = Some((feed.clone(), steering.clone(), Mode::Station));
            let done = setup.scan(&target, Overwrite::Refuse, &wanted, live, console)?;
            let told = tell(&done.scanned, console)?;
            console.line(format_args!("{}: {} images", target.display(), done.scanned.counts.recorded));
            Ok(told)
        });
        match scanned {
            Ok(Outcome::Done) => {}
            Ok(Outcome::WithLoss) => outcome = Outcome::WithLoss,
            Err(error) => {
                // The next scan may do better: the station stays.
                outcome = Outcome::WithLoss;
                let why = chain(&error);
                console.error(&why);
                let why = without_folders(&why, &folder.join("scan"));
                feed.note(Level::Error, why.clone());
                feed.state(State { phase: Phase::Failed, ended: Some(why), ..State::default() });
            }
        }
        busy.store(false, Ordering::Release);
    }
    server.close(GOODBYE);
    Ok(outcome)
}
