//! The camera: settings in force, a frame in time, and the stripe in it.

use super::{Findings, SETUP, ms};
use crate::pipeline::stripes::extractor;
use std::time::Duration;
use uw_calib::Across;
use uw_hw::interlock::Handle;
use uw_hw::{Camera, CameraSettings, Fault, Frame, Pixels, Timeline, Trigger};
use uw_io::vehicle::Vehicle;
use uw_io::{CalibrationFile, Rig};
use uw_stripe::View;

/// An exposure in force may differ by this share from what was asked for.
const EXPOSURE: f64 = 0.05;
/// Images that a camera which runs by itself is watched for.
const WATCHED: u32 = 5;
/// A rate may differ by this share.
const RATE: f64 = 0.1;
/// An image without the laser is too bright where half of it is brighter than this share of full scale.
const BRIGHT: f64 = 0.5;
/// A stripe that shows on a smaller share of the lines of an image is none.
const SEEN: f64 = 0.02;
/// A stripe is too bright where a larger share of its lines holds a pixel at full scale.
const CLIPPED: f64 = 0.2;

const NO_FRAME: &str = "check its cable and trigger, or raise camera.timeout_ms; with GigE Vision also the network's packet size and firewall";

/// What a camera is looked at with.
pub(super) struct Setting<'a> {
    pub(super) vehicle: &'a Vehicle,
    pub(super) rig: &'a Rig,
    pub(super) calibration: Option<&'a CalibrationFile>,
    pub(super) timeline: &'a Timeline,
}

/// Looks at a camera with the laser off; its settings in force where it gives images, and is armed.
pub(super) fn examine(
    camera: &mut dyn Camera,
    setting: &Setting<'_>,
    findings: &mut Findings<'_>,
) -> Option<CameraSettings> {
    let wanted = setting.vehicle.camera_settings();
    let in_force = match camera.configure(&wanted, SETUP) {
        Ok(in_force) => in_force,
        Err(fault) => {
            let mend =
                "give the vehicle file what the camera can: its width, height, bits, exposure and trigger";
            findings.device(&fault, mend);
            return None;
        }
    };
    let id = camera.identity();
    let who = [id.vendor, id.model, id.place]
        .into_iter()
        .filter(|part| !part.is_empty())
        .collect::<Vec<_>>()
        .join(", ");
    let who = if who.is_empty() { id.driver } else { who };
    let (asked, got) = (wanted.exposure.as_secs_f64(), in_force.exposure.as_secs_f64());
    if (got - asked).abs() > EXPOSURE * asked {
        findings.warning(
            format!(
                "{who}: exposes for {} where camera.exposure_ms asks for {}",
                ms(in_force.exposure),
                ms(wanted.exposure)
            ),
            "give an exposure that the camera has",
        );
    }
    if let Err(fault) = camera.arm(SETUP) {
        findings.device(&fault, "close other programs that use the camera");
        return None;
    }
    let dark = match take(camera, setting, &in_force) {
        Ok((frame, took)) => {
            let format = in_force.pixel_format.as_deref().map(|name| format!(", {name}")).unwrap_or_default();
            findings.good(format!(
                "{who}: {} x {} pixels of {} bits{format}, {} after its trigger",
                frame.width(),
                frame.height(),
                frame.significant_bits(),
                ms(took)
            ));
            Some(frame)
        }
        Err(Fault::Timeout { .. }) if in_force.trigger == Trigger::Hardware => {
            findings.warning(
                format!("{who}: no pulse came on its input"),
                "start what triggers it, and run doctor again",
            );
            None
        }
        Err(fault) => {
            let mend = match &fault {
                Fault::FrameSize { .. } => "give the size that it delivers, to vehicle and rig file",
                _ => NO_FRAME,
            };
            findings.device(&fault, mend);
            None
        }
    };
    let dark = dark?;
    if let Trigger::Free { rate_hz } = in_force.trigger {
        rate(camera, setting, rate_hz, findings);
    }
    let middle = share_above(&dark, BRIGHT);
    if middle > 0.5 {
        findings.warning(
            format!(
                "{:.0} % of the image is brighter than half of full scale with the laser off",
                middle * 100.0
            ),
            "expose shorter, or keep other light away",
        );
    }
    Some(in_force)
}

/// One frame, and how long it took; one that came twice or was dropped before it is no fault of it.
fn take(
    camera: &mut dyn Camera,
    setting: &Setting<'_>,
    settings: &CameraSettings,
) -> Result<(Frame, Duration), Fault> {
    let began = setting.timeline.since_start();
    if settings.trigger == Trigger::Software {
        camera.trigger(setting.vehicle.frame_within())?;
    }
    let deadline = setting.timeline.deadline(setting.vehicle.frame_within());
    loop {
        match camera.next_frame(setting.timeline.left(deadline).unwrap_or_default()) {
            Ok(frame) => return Ok((frame, setting.timeline.since_start().saturating_sub(began))),
            Err(Fault::DroppedFrames { .. } | Fault::DuplicateFrame { .. }) => {}
            Err(fault) => return Err(fault),
        }
    }
}

/// Whether a camera that runs by itself keeps its pace.
fn rate(camera: &mut dyn Camera, setting: &Setting<'_>, rate_hz: f64, findings: &mut Findings<'_>) {
    let mut stamps = Vec::new();
    for _ in 0..=WATCHED {
        match camera.next_frame(setting.vehicle.frame_within()) {
            Ok(frame) => stamps.push(frame.exposure().stamp_ns),
            Err(fault) if fault.is_passing() => {}
            Err(fault) => return findings.device(&fault, NO_FRAME),
        }
    }
    let (Some(first), Some(last)) = (stamps.first(), stamps.last()) else { return };
    // One image has no rate, nor have images of one moment.
    if last <= first {
        return;
    }
    let got = (stamps.len() - 1) as f64 / ((last - first) as f64 * 1e-9);
    if (got - rate_hz).abs() > RATE * rate_hz {
        let what = format!("{got:.1} images a second come where camera.rate_hz asks for {rate_hz}");
        findings.warning(what, "expose shorter, check the link's speed, or give the rate that comes");
    } else {
        findings.good(format!("{got:.1} images a second"));
    }
}

/// Whether the stripe shows at some voltage of the sweep: its middle and its quarters. The laser is on for as long as that takes.
pub(super) fn stripe(
    camera: &mut dyn Camera,
    setting: &Setting<'_>,
    settings: &CameraSettings,
    handle: &Handle,
    findings: &mut Findings<'_>,
) {
    let sweep = &setting.vehicle.sweep;
    let mut best: Option<(f64, Seen)> = None;
    for share in [0.5, 0.25, 0.75] {
        let volts = sweep.from_v + (sweep.to_v - sweep.from_v) * share;
        handle.feed();
        let lit = handle.set(volts).and_then(|_| handle.laser_on());
        let taken = lit.and_then(|()| handle.rest(setting.vehicle.settle())).and_then(|()| {
            // What a camera that runs by itself exposed before is not meant.
            while settings.trigger != Trigger::Software && camera.next_frame(Duration::ZERO).is_ok() {}
            take(camera, setting, settings)
        });
        let off = handle.laser_off();
        let frame = match taken {
            Ok((frame, _)) => frame,
            Err(fault) => return findings.device(&fault, NO_FRAME),
        };
        if let Err(fault) = off {
            return findings.device(&fault, "cut the laser's power");
        }
        let seen = look(&frame, setting);
        handle.feed();
        if let Some(seen) = seen
            && best.as_ref().is_none_or(|(_, other)| other.share < seen.share)
        {
            best = Some((volts, seen));
        }
    }
    match best {
        Some((volts, seen)) if seen.share > SEEN => {
            let what = format!("the stripe shows on {:.0} % of the image's lines at {volts:.4} V", seen.share * 100.0);
            if seen.clipped > CLIPPED {
                let what = format!("{what}, and is at full scale on {:.0} % of them", seen.clipped * 100.0);
                findings.warning(what, "expose shorter, or lower laser.power");
            } else {
                findings.good(what);
            }
        }
        _ => findings.fault(
            "no stripe shows in the middle of the sweep, nor at its quarters, with the laser on",
            "check that the beam leaves its window, that something stands before the instrument, the laser's power, and the exposure",
        ),
    }
}

/// A stripe: the share of lines that it shows on, and of those the share that holds a pixel at full scale.
struct Seen {
    share: f64,
    clipped: f64,
}

fn look(frame: &Frame, setting: &Setting<'_>) -> Option<Seen> {
    let known = setting.calibration.map(|file| file.calibration.across);
    let across = known.map_or(vec![Across::U, Across::V], |across| vec![across]);
    let (width, height) = (frame.width() as usize, frame.height() as usize);
    let each = across.into_iter().filter_map(|across| {
        let mut extractor = extractor(across, setting.rig.camera.bits, false).ok()?;
        let found = match frame.pixels() {
            Pixels::U8(values) => {
                extractor.extract(View::new(values, width, height, frame.stride()).ok()?, None).ok()?.found()
            }
            Pixels::U16(values) => {
                extractor.extract(View::new(values, width, height, frame.stride()).ok()?, None).ok()?.found()
            }
        };
        let lines = if across == Across::U { height } else { width };
        Some((found, lines))
    });
    let (found, lines) = each.max_by_key(|(found, _)| *found)?;
    let full = share_above(frame, 1.0) * (width * height) as f64;
    Some(Seen { share: found as f64 / lines as f64, clipped: (full / found.max(1) as f64).min(1.0) })
}

/// The share of pixels at or above a share of full scale.
fn share_above(frame: &Frame, share: f64) -> f64 {
    let level = ((1_u32 << frame.significant_bits()) - 1) as f64 * share;
    let (width, height, stride) = (frame.width() as usize, frame.height() as usize, frame.stride());
    let rows = |row: usize| row * stride..row * stride + width;
    let above = match frame.pixels() {
        Pixels::U8(v) => {
            (0..height).map(|r| v[rows(r)].iter().filter(|x| f64::from(**x) >= level).count()).sum::<usize>()
        }
        Pixels::U16(v) => {
            (0..height).map(|r| v[rows(r)].iter().filter(|x| f64::from(**x) >= level).count()).sum()
        }
    };
    above as f64 / (width * height) as f64
}
