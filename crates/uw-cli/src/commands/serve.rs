//! `uwscan serve`.

use std::{
    collections::{BTreeMap, BTreeSet},
    net::SocketAddr,
    path::{Path, PathBuf},
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
        mpsc::{RecvTimeoutError, SyncSender, sync_channel},
    },
    time::Duration,
};

use anyhow::Context;
use uwscan::{
    io::{Overwrite, calibration_toml, disk},
    live::{About, Feed, Laser, Level, Mode, Phase, State},
    pipeline::{
        instrument::Wanted,
        live::{Source, Station, obey, replay, without_folders},
        record::{Steering, plan::Region},
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

/// What a station's next scans are made with: a part of the vehicle file's sweep, so that nothing is driven where it does not go by itself.
struct NextScan {
    /// Lowest and highest voltage of the vehicle file's sweep.
    whole_v: [f64; 2],
    from_v: f64,
    to_v: f64,
    repeat: u32,
    /// What was asked for last of each, and by whom.
    said: BTreeMap<String, String>,
}

const FROM: &str = "next.from_v";
const TO: &str = "next.to_v";
const REPEAT: &str = "next.repeat";
/// Most sweeps of one scan.
const MOST_SWEEPS: f64 = 100.0;

impl NextScan {
    fn new([a, b]: [f64; 2]) -> Self {
        let (from_v, to_v) = (a.min(b), a.max(b));
        Self { whole_v: [from_v, to_v], from_v, to_v, repeat: 1, said: BTreeMap::new() }
    }

    fn settings(&self) -> Vec<(String, f64)> {
        let values = [(FROM, self.from_v), (TO, self.to_v), (REPEAT, f64::from(self.repeat))];
        values.map(|(name, value)| (name.to_owned(), value)).into()
    }

    fn set(&mut self, name: &str, value: f64, who: &str) -> Result<(), String> {
        let [low, high] = self.whole_v;
        let (from_v, to_v) = match name {
            FROM => (value, self.to_v),
            TO => (self.from_v, value),
            REPEAT if value.fract() == 0.0 && (1.0..=MOST_SWEEPS).contains(&value) => {
                self.repeat = value as u32;
                (self.from_v, self.to_v)
            }
            REPEAT => return Err(format!("a whole number from 1 to {MOST_SWEEPS}")),
            _ => return Err("there is no such setting".to_owned()),
        };
        if !(low <= from_v && from_v < to_v && to_v <= high) {
            return Err(format!("within the vehicle's sweep, {low} to {high} V, and {FROM} below {TO}"));
        }
        (self.from_v, self.to_v) = (from_v, to_v);
        self.said.insert(name.to_owned(), format!("{name} = {value}, as {who} asked"));
        Ok(())
    }

    fn wanted(&self) -> Wanted {
        // The whole sweep is no region: rounding could leave its ends out.
        let [low, high] = self.whole_v;
        let part = low < self.from_v || self.to_v < high;
        let region = part.then(|| Region::new(self.from_v, self.to_v)).flatten();
        Wanted { repeat: self.repeat, regions: region.into_iter().collect(), ..Wanted::default() }
    }

    /// What was asked for, for the recording.
    fn said(&self) -> Vec<String> {
        self.said.values().cloned().collect()
    }
}

/// A station as its clients ask it.
struct Waiting {
    start: SyncSender<()>,
    busy: Arc<AtomicBool>,
    next: Arc<Mutex<NextScan>>,
    feed: Feed,
}

impl Station for Waiting {
    fn start(&mut self) -> Result<(), String> {
        let runs = || "a scan runs already".to_owned();
        if self.busy.swap(true, Ordering::AcqRel) {
            return Err(runs());
        }
        self.start.try_send(()).map_err(|_| runs())
    }

    fn set(&mut self, name: &str, value: f64, who: &str) -> Result<(), String> {
        let mut next = self.next.lock().unwrap_or_else(PoisonError::into_inner);
        next.set(name, value, who)?;
        self.feed.settings(next.settings());
        Ok(())
    }
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
    let next = NextScan::new([sweep.from_v, sweep.to_v]);
    feed.settings(next.settings());
    let next = Arc::new(Mutex::new(next));
    let (theirs, shown) = (steering.clone(), feed.clone());
    let mut waiting = Waiting { start, busy: busy.clone(), next: next.clone(), feed: feed.clone() };
    let obeying = move || obey(&asked, &theirs, &shown, &mut waiting);
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
            let wanted = {
                let next = next.lock().unwrap_or_else(PoisonError::into_inner);
                steering.say_next(next.said());
                next.wanted()
            };
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recordings_of_one_name_are_told_apart_without_their_folders() {
        let paths = ["a/ball", "/data/b/ball", "c/cover.mcap", "a/ball"].map(PathBuf::from);
        let names: Vec<String> = sources(&paths).into_iter().map(|source| source.name).collect();
        assert_eq!(names, ["ball", "ball (2)", "cover.mcap", "ball (3)"]);
    }

    #[test]
    fn a_part_of_the_sweep_is_scanned_and_never_more() {
        let mut next = NextScan::new([1.0, -1.0]);
        assert!(next.wanted().regions.is_empty() && next.said().is_empty());
        for (name, value) in
            [(FROM, -1.1), (TO, 1.1), (FROM, 1.0), (TO, f64::NAN), (REPEAT, 101.0), ("x", 0.0)]
        {
            assert!(next.set(name, value, "bow").is_err(), "{name} {value}");
        }
        assert!(next.wanted().regions.is_empty() && next.said().is_empty());
        next.set(FROM, -0.5, "bow").unwrap();
        next.set(FROM, 0.5, "stern").unwrap();
        let part = next.wanted().regions[0];
        assert!([0.5, 1.0].iter().all(|volts| part.holds(*volts)) && !part.holds(0.49));
        assert_eq!(next.said(), ["next.from_v = 0.5, as stern asked"]);
        next.set(FROM, -1.0, "bow").unwrap();
        assert!(next.wanted().regions.is_empty());
    }
}
