//! `uwscan scan`.

use std::{
    collections::BTreeMap,
    net::SocketAddr,
    num::NonZeroU32,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use anyhow::Context;
use clap::{ValueEnum, error::ErrorKind};
use serde::Serialize;
use uwscan::{
    hw::interlock::Report,
    io::{
        CalibrationFile, Kind, Medium, Overwrite, Rig, atomic, calibration_toml, clouds, disk,
        recording::{Head, Options},
        vehicle::Vehicle,
    },
    live::{Feed, Mode},
    pipeline::{
        instrument::{self, Opened, Wanted},
        live::{OneScan, Watch, Watched, obey},
        reconstruct,
        record::{Scanned, Settings, Steering, plan::Region, scan, session::Observer},
    },
    stripe::Method,
};

use crate::{
    args::usage_error,
    commands::overwrite,
    console::Console,
    exit::{Outcome, chain},
    listening::{self, Listening, Live},
    output,
    progress::Progress,
    signals,
    text::positive,
};

/// Arguments of `scan`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "The laser is off and the mirror parked on every way out: at the end, after an error, on Ctrl-C and \
    SIGTERM, on a client's word (--live), and where the scan hangs. What was recorded until then is kept, and the exit code is 3. A second Ctrl-C leaves \
    at once."
)]
pub struct Args {
    /// Vehicle file: devices, limits, sweep
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// Recording to write, .mcap; the cloud goes beside it, as .ply [default: the next scan-0001.mcap, scan-0002.mcap, … in disk.folder]
    #[arg(short, long, value_name = "FILE", value_parser = recording)]
    output: Option<PathBuf>,
    /// Calibration file in place of the vehicle file's
    #[arg(short, long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// Sweep so many times
    #[arg(long, value_name = "N", default_value = "1", value_parser = positive::<NonZeroU32>)]
    repeat: NonZeroU32,
    /// Only the voltages from V0 to V1; may be given several times
    #[arg(long, value_name = "V0:V1", value_parser = region, allow_hyphen_values = true)]
    region: Vec<Region>,
    /// A coarse sweep first, then more images where the surface bends by more than a point's standard deviation between two of them
    #[arg(long)]
    adaptive: bool,
    /// How much coarser the first sweep is, with --adaptive
    #[arg(long, value_name = "N", default_value = "8", requires = "adaptive", value_parser = positive::<NonZeroU32>)]
    coarser: NonZeroU32,
    /// What is outside the windows [default: water if the rig file has [water], else air]
    #[arg(long)]
    medium: Option<MediumArg>,
    /// Show the scan in a browser, and let it be steered from there: at this address, or 127.0.0.1:8764
    #[arg(long, value_name = "ADDR", value_parser = listening::address, num_args = 0..=1, default_missing_value = "127.0.0.1:8764")]
    live: Option<SocketAddr>,
    /// Replace the outputs if they exist
    #[arg(long)]
    force: bool,
    /// Print one JSON object instead of text
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    listening: Listening,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum MediumArg {
    /// On land
    Air,
    /// Submerged
    Water,
}

fn recording(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    match path.extension().and_then(|e| e.to_str()) {
        Some(ending) if ending.eq_ignore_ascii_case("mcap") => Ok(path),
        _ => Err("a recording's name ends in .mcap".to_owned()),
    }
}

fn region(text: &str) -> Result<Region, String> {
    let volts = |text: &str| text.trim().parse::<f64>().ok();
    let both = text.split_once(':').and_then(|(a, b)| Region::new(volts(a)?, volts(b)?));
    both.ok_or_else(|| "give two voltages with a colon between them, such as -1.5:0.25".to_owned())
}

/// What `--json` prints.
#[derive(Serialize)]
struct Record<'a> {
    recording: String,
    cloud: Option<String>,
    planned: usize,
    frames: usize,
    lost: &'a BTreeMap<&'static str, usize>,
    duplicated: usize,
    repeated: usize,
    ended: Option<String>,
    points: Option<usize>,
    rejected: Option<&'a BTreeMap<&'static str, usize>>,
    on_the_fly: OnTheFly,
    laser_off: bool,
    parked_v: Option<f64>,
    bytes: Option<u64>,
    longest_queue: usize,
    warnings: &'a [String],
    seconds: f64,
    frames_per_second: f64,
}

/// The points that were made while scanning.
#[derive(Serialize)]
struct OnTheFly {
    frames: usize,
    skipped: usize,
    points: usize,
    latency_median_ms: Option<f64>,
    latency_99_ms: Option<f64>,
}

struct Quiet;
impl Observer for Quiet {}

/// How long clients get to see how a scan ended.
const GOODBYE: Duration = Duration::from_secs(1);

/// Scans, records and reconstructs.
///
/// # Errors
/// The scan could not begin, nothing was recorded, the laser would not go off, or an output can't be written.
pub fn run(args: &Args, console: &Console) -> anyhow::Result<Outcome> {
    let began = Instant::now();
    if args.live.is_none() && args.listening.is_given() {
        let what = "--foxglove, the tokens' and the certificate's files are of a scan that is shown: give --live, too";
        return Err(usage_error(ErrorKind::MissingRequiredArgument, what));
    }
    let overwrite = overwrite(args.force);
    let setup = Setup::read(&args.config, args.calibration.as_deref(), args.medium, console)?;
    let target = match &args.output {
        Some(path) => path.clone(),
        None => disk::next_recording(&setup.vehicle.resolve(&setup.vehicle.disk.folder))?,
    };
    setup.check(&target, overwrite)?;
    let coarser = args.adaptive.then(|| args.coarser.get());
    let wanted = Wanted { repeat: args.repeat.get(), regions: args.region.clone(), coarser };
    let live = args.live.map(|address| args.listening.start(address, console)).transpose()?;
    let done = match live {
        None => setup.scan(&target, overwrite, &wanted, None, console),
        Some(Live { server, feed, asked }) => {
            let steering = Steering::default();
            let (theirs, shown) = (steering.clone(), feed.clone());
            std::thread::Builder::new()
                .name("uwscan-steer".to_owned())
                .spawn(move || obey(&asked, &theirs, &shown, &mut OneScan))
                .context("cannot start a thread")?;
            let done = setup.scan(&target, overwrite, &wanted, Some((feed, steering, Mode::Scan)), console);
            server.close(GOODBYE);
            done
        }
    };
    let Done { scanned, cloud } = done?;
    let outcome = tell(&scanned, console)?;
    print(args.json, &target, &scanned, cloud.as_deref(), began.elapsed().as_secs_f64())?;
    Ok(outcome)
}

/// What scans are made with.
pub struct Setup {
    pub vehicle: Vehicle,
    rig: Rig,
    calibration: Option<(CalibrationFile, String)>,
    medium: Medium,
}

/// A scan, and its cloud's file where there is one.
pub struct Done {
    pub scanned: Scanned,
    pub cloud: Option<PathBuf>,
}

impl Setup {
    /// Reads the files.
    ///
    /// # Errors
    /// One can't be read.
    pub fn read(
        config: &Path,
        calibration: Option<&Path>,
        medium: Option<MediumArg>,
        console: &Console,
    ) -> anyhow::Result<Self> {
        let (vehicle, problems) = Vehicle::read(config)?;
        console.problems(&problems);
        let (rig, problems) = Rig::read(&vehicle.resolve(&vehicle.rig))?;
        console.problems(&problems);
        let calibration = self::calibration(calibration, &vehicle, console)?;
        if calibration.is_none() {
            console.warn(
                "no calibration is given: the scan is only recorded (add calibration to the vehicle file, or -c)",
            );
        }
        let medium = match medium {
            Some(MediumArg::Air) => Medium::Air,
            Some(MediumArg::Water) => Medium::Water,
            None if rig.water.is_some() => Medium::Water,
            None => Medium::Air,
        };
        Ok(Self { vehicle, rig, calibration, medium })
    }

    /// Whether the outputs may be written.
    ///
    /// # Errors
    /// One exists.
    fn check(&self, target: &Path, overwrite: Overwrite) -> anyhow::Result<()> {
        atomic::check(target, overwrite)?;
        if self.calibration.is_some() {
            atomic::check(&target.with_extension("ply"), overwrite)?;
        }
        Ok(())
    }

    /// Scans once into `target`, shown and steered by `live`.
    ///
    /// # Errors
    /// The scan could not begin, or its cloud can't be written.
    pub fn scan(
        &self,
        target: &Path,
        overwrite: Overwrite,
        wanted: &Wanted,
        live: Option<(Feed, Steering, Mode)>,
        console: &Console,
    ) -> anyhow::Result<Done> {
        let Self { vehicle, rig, calibration, medium } = self;
        let mut head = Head::new(Kind::Scan, *medium, None);
        head.rig = Some(rig.to_toml()?);
        head.calibration = calibration.as_ref().map(|(_, text)| text.clone());
        let alarm = console.clone();
        let on_stop = move |report: &Report| report.alarms().iter().for_each(|text| alarm.error(text));
        let Opened { instrument, recorded, problems, .. } = instrument::open(vehicle, rig, on_stop)?;
        console.problems(&problems);
        // A station listens for signals by itself.
        if live.as_ref().is_none_or(|(_, _, mode)| *mode == Mode::Scan) {
            signals::stop_on_signals(instrument.interlock.handle()).context("cannot listen for Ctrl-C")?;
        }
        let plan = instrument::plan(vehicle, wanted, recorded)?;
        if wanted.coarser.is_some() && (plan.adaptive.is_none() || calibration.is_none()) {
            anyhow::bail!(
                "--adaptive needs a calibration, whose points tell where the surface bends, and a sweep by steps \
                 (sweep.mode = \"step\"): give both, or leave --adaptive out"
            );
        }
        let calibration = calibration.as_ref().map(|(file, _)| file);
        let settings = Settings {
            path: target,
            overwrite,
            recording: Options::default(),
            min_free_bytes: (vehicle.disk.min_free_mb * 1e6) as u64,
            head: &head,
            rig: Some(rig),
            calibration,
            reconstruct: reconstruct::Settings::default(),
            preview: Method::Robust,
        };
        let watch = live.map(|(feed, steering, mode)| {
            let camera = &instrument.camera_settings;
            Watch::new(feed, steering, &Watched { mode, recording: target, plan: &plan, camera, calibration })
        });
        let progress = Progress::new(console);
        let observer: &dyn Observer = watch.as_ref().map_or(&Quiet, |watch| watch);
        let result = scan(instrument, &plan, &settings, &progress, observer);
        drop(progress);
        let done = result.map_err(|failure| console.failure(failure)).and_then(|scanned| {
            let cloud = written(target, overwrite, &scanned)?;
            Ok(Done { scanned, cloud })
        });
        if let Some(watch) = watch {
            match &done {
                Ok(done) => watch.ended(Ok(&done.scanned)),
                Err(error) => watch.ended(Err(&chain(error))),
            }
        }
        done
    }
}

/// Writes the cloud, if there is one, beside the recording.
fn written(target: &Path, overwrite: Overwrite, scanned: &Scanned) -> anyhow::Result<Option<PathBuf>> {
    let Some(Ok(made)) = &scanned.made else { return Ok(None) };
    if scanned.report.laser_off.is_err() || scanned.counts.recorded == 0 {
        return Ok(None);
    }
    let path = target.with_extension("ply");
    clouds::write(&path, overwrite, &made.cloud, clouds::Format::of(&path)?)?;
    Ok(Some(path))
}

/// The calibration and its text, as far as one is named.
fn calibration(
    given: Option<&Path>,
    vehicle: &Vehicle,
    console: &Console,
) -> anyhow::Result<Option<(CalibrationFile, String)>> {
    let named = vehicle.calibration.as_deref().map(|path| vehicle.resolve(path));
    let Some(path) = given.map(Path::to_owned).or(named) else { return Ok(None) };
    let text = calibration_toml::text(&path)?;
    let (file, problems) = calibration_toml::parse(&path, &text)?;
    console.problems(&problems);
    Ok(Some((file, text)))
}

/// Tells what went wrong; what that makes of the command's end.
pub fn tell(scanned: &Scanned, console: &Console) -> anyhow::Result<Outcome> {
    scanned.warnings.iter().for_each(|warning| console.warn(warning));
    if let Some(error) = &scanned.recording_error {
        console.warn(format_args!("the recording was cut off: {error}"));
    }
    if let Some(ended) = &scanned.ended {
        console.warn(format_args!("the scan ended early: {ended}"));
    }
    for (why, count) in &scanned.counts.lost {
        console.warn(format_args!("lost: {count} images: {why}"));
    }
    match &scanned.made {
        Some(Ok(made)) => made.warnings.iter().for_each(|warning| console.warn(warning)),
        Some(Err(failure)) => console.warn(format_args!("no cloud: {failure}")),
        None => {}
    }
    if scanned.report.laser_off.is_err() {
        anyhow::bail!("{}", scanned.report.alarms().join("; "));
    }
    if scanned.counts.recorded == 0 {
        anyhow::bail!("no image was recorded: {}", why_nothing(scanned));
    }
    Ok(if scanned.whole() { Outcome::Done } else { Outcome::WithLoss })
}

fn why_nothing(scanned: &Scanned) -> String {
    let ended = scanned.ended.as_ref().map(|ended| chain(&anyhow::Error::new(ended.clone())));
    let recording = scanned.recording_error.as_ref().map(ToString::to_string);
    recording.or(ended).unwrap_or_else(|| "the plan has none".to_owned())
}

fn print(
    as_json: bool,
    target: &Path,
    scanned: &Scanned,
    cloud: Option<&Path>,
    seconds: f64,
) -> anyhow::Result<()> {
    let counts = &scanned.counts;
    let made = scanned.made.as_ref().and_then(|made| made.as_ref().ok());
    let ms = |us: u64| us as f64 * 1e-3;
    let record = Record {
        recording: target.display().to_string(),
        cloud: cloud.map(|path| path.display().to_string()),
        planned: counts.planned,
        frames: counts.recorded,
        lost: &counts.lost,
        duplicated: counts.duplicated,
        repeated: counts.repeated,
        ended: scanned.ended.as_ref().map(ToString::to_string),
        points: made.map(|made| made.cloud.len()),
        rejected: made.map(|made| &made.rejected),
        on_the_fly: OnTheFly {
            frames: counts.previewed,
            skipped: counts.skipped,
            points: counts.points,
            latency_median_ms: counts.latency_us.map(|[middle, _]| ms(middle)),
            latency_99_ms: counts.latency_us.map(|[_, late]| ms(late)),
        },
        laser_off: scanned.report.laser_off.is_ok(),
        parked_v: scanned.report.parked.as_ref().ok().copied(),
        bytes: scanned.recorded.map(|recorded| recorded.bytes),
        longest_queue: counts.longest_queue,
        warnings: &scanned.warnings,
        seconds,
        frames_per_second: scanned.frames_per_second(),
    };
    if as_json {
        return output::json(&record);
    }
    let mut text = format!(
        "{}: {} of {} images, {:.1} per second\n",
        record.recording, record.frames, record.planned, record.frames_per_second
    );
    if let (Some(cloud), Some(points)) = (&record.cloud, record.points) {
        text += &format!("{cloud}: {points} points\n");
    }
    if let (Some(middle), Some(late)) = (record.on_the_fly.latency_median_ms, record.on_the_fly.latency_99_ms)
    {
        let OnTheFly { frames, points, .. } = record.on_the_fly;
        text += &format!(
            "on the fly: {points} points of {frames} images, {middle:.1} ms after the exposure (99 %: {late:.1} ms)\n"
        );
    }
    output::print(text)
}
