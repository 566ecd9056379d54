//! A sweep that doesn't stop: the mirror moves on while the camera runs by itself, and each frame gets the voltage of its middle.

use std::{collections::VecDeque, ops::ControlFlow, time::Duration};

use super::{Event, Exposed, VoltageTrack};
use crate::{Camera, Fault, Frame, clock::nanoseconds, interlock::Handle};

/// How a continuous sweep goes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Continuous {
    /// Where it begins, V.
    pub from_v: f64,
    /// Where it ends, V.
    pub to_v: f64,
    /// How fast, V/s; positive, and not more than the limits' slew.
    pub rate_v_per_s: f64,
    /// How often the drive is sent on.
    pub command_every: Duration,
    /// How long to wait at the start for the mirror to settle.
    pub settle: Duration,
    /// By how much the mirror's light lags behind what is read back, measured on this instrument: zero where a position is read back,
    /// the mirror's own lag where the drive only repeats the command.
    pub lag: Duration,
    /// How long the camera may be silent.
    pub frame_within: Duration,
}

/// The camera gets this long at least between two commands.
const SOONEST: Duration = Duration::from_micros(100);

/// Sweeps once from `from_v` to `to_v` with the laser on. The camera is armed, and runs by itself ([`Trigger::Free`](crate::Trigger::Free))
/// or by pulses; frames exposed before the sweep's start or after its end are left out. `each` is told of everything and may end the
/// sweep. Feeds the watchdog.
///
/// # Errors
/// [`Fault::OutOfRange`] for a rate above the limits' slew or a voltage outside their range; the first fault that is not about one frame.
pub fn continuous(
    handle: &Handle,
    camera: &mut dyn Camera,
    settings: &Continuous,
    mut each: impl FnMut(Event) -> ControlFlow<()>,
) -> Result<(), Fault> {
    let timeline = handle.timeline().clone();
    let slew = handle.limits().slew_v_per_s();
    let rate = settings.rate_v_per_s;
    if !(rate > 0.0 && rate <= slew) {
        let (device, unit, allowed) = ("the sweep".into(), "V/s", [0.0, slew]);
        return Err(Fault::OutOfRange { device, quantity: "rate", unit, value: rate, allowed });
    }
    let lag_ns = nanoseconds(settings.lag);
    let mut track = VoltageTrack::default();
    let mut waiting: VecDeque<(Frame, f64)> = VecDeque::new();

    handle.set(settings.from_v)?;
    handle.laser_on()?;
    handle.rest(settings.settle)?;
    track.add(handle.confirm()?);
    // What waits since before is not of this sweep, nor are the gaps in it.
    while camera.next_frame(Duration::ZERO).map_or_else(|fault| fault.is_passing(), |_| true) {}
    let begin_ns = timeline.stamp_ns();
    let span = settings.to_v - settings.from_v;
    let length_ns = (span.abs() / rate * 1e9) as i64;
    let mut heard = timeline.since_start();
    let mut end_ns = None;
    loop {
        handle.feed();
        // On with the mirror, as far as the time since the start says.
        let into_ns = timeline.stamp_ns().saturating_sub(begin_ns);
        let share = if length_ns > 0 { (into_ns as f64 / length_ns as f64).min(1.0) } else { 1.0 };
        let commanded_v = if share < 1.0 { settings.from_v + span * share } else { settings.to_v };
        track.add(handle.set(commanded_v)?.read_back);
        if share >= 1.0 && end_ns.is_none() {
            end_ns = Some(timeline.stamp_ns());
        }
        // Frames until the next command is due.
        let due = timeline.deadline(settings.command_every.max(SOONEST));
        while let Some(left) = timeline.left(due) {
            match camera.next_frame(left) {
                Ok(frame) => {
                    heard = timeline.since_start();
                    waiting.push_back((frame, commanded_v));
                }
                Err(Fault::Timeout { waited, got, device, doing }) => {
                    let silent = timeline.since_start().saturating_sub(heard);
                    if silent > settings.frame_within {
                        return Err(Fault::Timeout { device, doing, waited: silent.max(waited), got });
                    }
                    break;
                }
                Err(fault) if fault.is_passing() => {
                    heard = timeline.since_start();
                    if each(Event::Lost { commanded_v, fault }).is_break() {
                        return Ok(());
                    }
                }
                Err(fault) => return Err(fault),
            }
        }
        // Frames whose middle the track has passed.
        while let Some((frame, _)) = waiting.front() {
            let at_ns = frame.exposure().middle_ns().saturating_sub(lag_ns);
            if track.last_ns().is_none_or(|last_ns| last_ns < at_ns) {
                break;
            }
            let Some((frame, commanded_v)) = waiting.pop_front() else { break };
            let exposure = frame.exposure();
            let over = |end_ns| exposure.stamp_ns.saturating_add(exposure.exposure_ns as i64) > end_ns;
            if exposure.stamp_ns < begin_ns || end_ns.is_some_and(over) {
                continue;
            }
            let Some(volts) = track.volts_at(at_ns) else { continue };
            let exposed = Exposed { commanded_v, volts, settled: false, laser_on: true, frame };
            if each(Event::Exposed(exposed)).is_break() {
                return Ok(());
            }
        }
        // The last frames come after the end; what comes then was exposed behind it.
        let past = |end_ns: i64| {
            let newest = waiting.back().map(|(frame, _)| frame.exposure().stamp_ns);
            newest.is_some_and(|stamp_ns| stamp_ns > end_ns)
                || timeline.stamp_ns() > end_ns.saturating_add(nanoseconds(settings.frame_within))
        };
        if end_ns.is_some_and(past)
            && waiting.front().is_none_or(|(f, _)| Some(f.exposure().stamp_ns) > end_ns)
        {
            return Ok(());
        }
    }
}
