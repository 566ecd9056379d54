//! `uwscan capture-calibration`: placements of the board one after the other, each judged at once.

use std::{
    io::BufRead,
    num::NonZeroU32,
    path::PathBuf,
    sync::mpsc::{Receiver, RecvTimeoutError, channel},
    time::{Duration, Instant},
};

use anyhow::Context;
use clap::ValueEnum;
use serde::Serialize;
use uwscan::{
    hw::interlock::{Handle, Report},
    io::{Medium, Rig, Target, capture::Pattern, vehicle::Vehicle},
    pipeline::{
        capture::{Guide, Kept, Taken, Wanted},
        instrument,
    },
};

use crate::{
    console::Console,
    exit::{Outcome, chain},
    output, signals,
    text::{number, positive},
};

/// How often it is looked whether to go on waiting.
const LOOK: Duration = Duration::from_millis(50);

/// Arguments of `capture-calibration`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Place the board, hold it still, press Enter; q and Enter ends. A placement is kept only if it serves, and what the set \
    still lacks is said after each. The laser is on only while a placement is captured. The folder is whole after each placement: \
    uwscan calibrate takes it at any time."
)]
pub struct Args {
    /// Vehicle file: devices, limits, sweep
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// Capture folder to make
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Inner corners of the chessboard along a row and along a column
    #[arg(long, value_name = "COLUMNSxROWS", value_parser = corners)]
    board: [u32; 2],
    /// Side of a square, mm
    #[arg(long, value_name = "MM", value_parser = |text: &str| number(text, 0.1, 10_000.0, " mm"))]
    square: f64,
    /// Wavelength of the light on the board, nm [default: the laser's]
    #[arg(long, value_name = "NM", value_parser = |text: &str| number(text, 300.0, 1100.0, " nm"))]
    wavelength: Option<f64>,
    /// What is outside the windows
    #[arg(long)]
    medium: MediumArg,
    /// Voltages with a stripe at each placement, from one end of the sweep to the other
    #[arg(long, value_name = "N", default_value = "7", value_parser = clap::value_parser!(u32).range(2..=1000))]
    voltages: u32,
    /// End after so many placements that were kept
    #[arg(long, value_name = "N", value_parser = positive::<NonZeroU32>)]
    poses: Option<NonZeroU32>,
    /// Capture each so many seconds instead of at Enter
    #[arg(long, value_name = "SECONDS", requires = "poses", value_parser = |text: &str| number(text, 0.0, 3600.0, " s"))]
    every: Option<f64>,
    /// Print one JSON object instead of text
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum MediumArg {
    /// On land
    Air,
    /// Submerged
    Water,
}

fn corners(text: &str) -> Result<[u32; 2], String> {
    let side = |text: &str| text.trim().parse::<u32>().ok().filter(|n| (3..=500).contains(n));
    let both = text.split_once(['x', '×']).and_then(|(a, b)| Some([side(a)?, side(b)?]));
    both.ok_or_else(|| "give two numbers with an x between them, such as 11x8".to_owned())
}

#[derive(Serialize)]
struct Record<'a> {
    capture: String,
    poses: usize,
    images: usize,
    placements: &'a [Placement],
    again: usize,
    missing: &'a [String],
    ended: Option<String>,
    laser_off: bool,
}

#[derive(Serialize)]
struct Placement {
    pose: u32,
    corners: usize,
    corner_sigma_px: f64,
    stripes: usize,
    distance_mm: Option<f64>,
    tilt_deg: Option<f64>,
    notes: Vec<String>,
}

/// Captures placement after placement.
///
/// # Errors
/// The capture could not begin, no placement was kept, the laser would not go off, or standard output can't be written.
pub fn run(args: &Args, console: &Console) -> anyhow::Result<Outcome> {
    let (vehicle, problems) = Vehicle::read(&args.config)?;
    console.problems(&problems);
    let (rig, problems) = Rig::read(&vehicle.resolve(&vehicle.rig))?;
    console.problems(&problems);
    let alarm = console.clone();
    let on_stop = move |report: &Report| report.alarms().iter().for_each(|text| alarm.error(text));
    let opened = instrument::open(&vehicle, &rig, on_stop)?;
    console.problems(&opened.problems);
    signals::stop_on_signals(opened.instrument.interlock.handle()).context("cannot listen for Ctrl-C")?;
    let medium = match args.medium {
        MediumArg::Air => Medium::Air,
        MediumArg::Water => Medium::Water,
    };
    let target = Target {
        pattern: Pattern::Chessboard,
        inner_corners: args.board,
        square_mm: args.square,
        wavelength_nm: args.wavelength,
    };
    let wanted = Wanted { target, medium, voltages: args.voltages as usize };
    let mut guide = Guide::begin(opened, &vehicle, &rig, wanted, &args.output)?;
    let handle = guide.handle();
    let mut pace = Pace::new(args.every.map(Duration::from_secs_f64));
    let (mut placements, mut again, mut ended) = (Vec::new(), 0, None);
    while args.poses.is_none_or(|most| guide.kept() < most.get() as usize) {
        // A timed capture has nobody to answer: it gives up where a board is not there as often as it was to be.
        if args.every.is_some() && again > args.poses.map_or(0, |most| 2 * most.get() as usize) {
            ended = Some("too many placements did not serve".to_owned());
            break;
        }
        if !pace.next(&handle, guide.kept(), console) {
            ended = handle.reason().map(|reason| reason.to_string());
            break;
        }
        match guide.take() {
            Ok(Taken::Kept(kept)) => {
                console.line(line(&kept));
                placements.push(placement(kept));
                guide.missing().iter().for_each(|what| console.line(format_args!("    missing: {what}")));
            }
            Ok(Taken::Again(why)) => {
                again += 1;
                console.line(format_args!("not kept: {why}"));
            }
            Err(error) => {
                ended = Some(chain(&anyhow::Error::new(error)));
                break;
            }
        }
    }
    let (missing, poses, images) = (guide.missing(), guide.kept(), guide.images());
    let report = guide.finish();
    if let Some(ended) = &ended {
        console.warn(format_args!("the capture ended early: {ended}"));
    }
    if report.laser_off.is_err() {
        anyhow::bail!("{}", report.alarms().join("; "));
    }
    if poses == 0 {
        anyhow::bail!("{}: no placement was kept", args.output.display());
    }
    let record = Record {
        capture: args.output.display().to_string(),
        poses,
        images,
        placements: &placements,
        again,
        missing: &missing,
        ended,
        laser_off: report.laser_off.is_ok(),
    };
    if args.json {
        output::json(&record)?;
    } else {
        output::print(text(&record))?;
    }
    Ok(if record.ended.is_some() { Outcome::WithLoss } else { Outcome::Done })
}

/// When the next placement is captured.
enum Pace {
    /// At Enter.
    Enter(Receiver<String>),
    /// Each so often.
    Every(Duration),
}

impl Pace {
    fn new(every: Option<Duration>) -> Self {
        if let Some(every) = every {
            return Self::Every(every);
        }
        let (lines, typed) = channel();
        // Ends with standard input, or with the process: what it waits for can't be called off.
        std::thread::spawn(move || {
            for line in std::io::stdin().lock().lines() {
                let Ok(line) = line else { break };
                if lines.send(line).is_err() {
                    break;
                }
            }
        });
        Self::Enter(typed)
    }

    /// Waits for the next placement; false where there is none. The watchdog is fed: somebody who places a board does not hang.
    fn next(&mut self, handle: &Handle, kept: usize, console: &Console) -> bool {
        let began = Instant::now();
        if matches!(self, Self::Enter(_)) && console.shows_progress() {
            console.line(format_args!(
                "placement {}: hold the board still, then press Enter (q and Enter ends)",
                kept + 1
            ));
        }
        loop {
            handle.feed();
            if handle.reason().is_some() {
                return false;
            }
            match self {
                Self::Every(every) => match every.checked_sub(began.elapsed()) {
                    Some(left) if !left.is_zero() => std::thread::sleep(left.min(LOOK)),
                    _ => return true,
                },
                Self::Enter(typed) => match typed.recv_timeout(LOOK) {
                    Ok(line) => return !line.trim().eq_ignore_ascii_case("q"),
                    Err(RecvTimeoutError::Disconnected) => return false,
                    Err(RecvTimeoutError::Timeout) => {}
                },
            }
        }
    }
}

fn placement(kept: Kept) -> Placement {
    let Kept { pose, corners: [corners, _], sharp_px, stance, stripes, notes } = kept;
    let (distance_mm, tilt_deg) = stance.map(|s| (s.distance_mm, s.tilt_deg)).unzip();
    Placement { pose, corners, corner_sigma_px: sharp_px, stripes, distance_mm, tilt_deg, notes }
}

/// A placement that was kept, on a line.
fn line(kept: &Kept) -> String {
    let [seen, all] = kept.corners;
    let mut line = format!("kept {}: {seen} of {all} corners, ±{:.3} px", kept.pose + 1, kept.sharp_px);
    if let Some(stance) = &kept.stance {
        line += &format!(", about {:.0} mm away, tilted by {:.0}°", stance.distance_mm, stance.tilt_deg);
    }
    line += &format!("; a stripe on it at {} voltages", kept.stripes);
    kept.notes.iter().for_each(|note| line += &format!("; {note}"));
    line
}

fn text(record: &Record<'_>) -> String {
    let mut text = format!("{}: {} placements, {} images\n", record.capture, record.poses, record.images);
    for missing in record.missing {
        text += &format!("missing: {missing}\n");
    }
    text += &format!("next: uwscan calibrate {} -o calibration.toml\n", record.capture);
    text
}

#[cfg(test)]
mod tests {
    use super::corners;

    #[test]
    fn a_board_is_two_counts() {
        assert_eq!(corners("11x8"), Ok([11, 8]));
        assert_eq!(corners(" 7 × 5"), Ok([7, 5]));
        for bad in ["", "11", "11x", "2x8", "11x8x3", "11x501", "-3x4"] {
            assert!(corners(bad).is_err(), "{bad}");
        }
    }
}
