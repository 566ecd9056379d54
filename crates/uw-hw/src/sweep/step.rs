//! Step, settle, expose.

use std::{ops::ControlFlow, time::Duration};

use super::Aim;
use crate::{Camera, Deadline, Fault, Frame, clock::nanoseconds, interlock::Handle};

/// How a stepped sweep goes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepAndSettle {
    /// How long to wait after a move before the exposure, measured on this instrument ([`measure_settling`](super::measure_settling)).
    pub settle: Duration,
    /// How long a frame may take from its trigger.
    pub frame_within: Duration,
    /// How often a frame that did not come, or came unusable, is exposed again.
    pub retries: u32,
    /// By how much a frame's stamp may be wrong: a frame stamped earlier than this before its trigger is an older one, and left out.
    pub stamp_slack: Duration,
}

/// A frame and where the mirror was.
#[derive(Clone, Debug, PartialEq)]
pub struct Exposed {
    /// Where the mirror was sent, V.
    pub commanded_v: f64,
    /// Where it was, V: read back after settling (stepped), or interpolated to the middle of the exposure (continuous).
    pub volts: f64,
    /// Whether the mirror stood still.
    pub settled: bool,
    /// Whether the laser was on.
    pub laser_on: bool,
    /// The image.
    pub frame: Frame,
}

/// What happens in a sweep.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// A frame.
    Exposed(Exposed),
    /// A frame that is lost, or came twice; the sweep goes on, and exposes again where it can.
    Lost {
        /// Where the mirror was sent, V.
        commanded_v: f64,
        /// What happened.
        fault: Fault,
    },
}

/// Goes through all positions: laser on or off, mirror there and settled, read back, exposure. `each` is told of everything and may
/// end the sweep. The camera is armed, with [`Trigger::Software`](crate::Trigger::Software); it stays so. Feeds the watchdog.
///
/// # Errors
/// The first fault that is not about one frame; a frame that did not come in any of its tries.
pub fn step_and_settle(
    handle: &Handle,
    camera: &mut dyn Camera,
    aims: impl IntoIterator<Item = Aim>,
    settings: &StepAndSettle,
    mut each: impl FnMut(Event) -> ControlFlow<()>,
) -> Result<(), Fault> {
    let mut laser_on = None;
    for aim in aims {
        handle.feed();
        if laser_on != Some(aim.laser_on) {
            if aim.laser_on {
                handle.laser_on()?;
            } else {
                handle.laser_off()?;
            }
            laser_on = Some(aim.laser_on);
        }
        handle.set(aim.volts)?;
        handle.rest(settings.settle)?;
        let volts = handle.confirm()?.volts;
        let mut lost = |fault| each(Event::Lost { commanded_v: aim.volts, fault });
        let frame = match expose(handle, camera, settings, &mut lost)? {
            ControlFlow::Continue(frame) => frame,
            ControlFlow::Break(()) => return Ok(()),
        };
        let (commanded_v, laser_on) = (aim.volts, aim.laser_on);
        let exposed = Exposed { commanded_v, volts, settled: true, laser_on, frame };
        if each(Event::Exposed(exposed)).is_break() {
            return Ok(());
        }
    }
    Ok(())
}

/// A frame that was exposed from now on, tried as often as the settings allow.
fn expose(
    handle: &Handle,
    camera: &mut dyn Camera,
    settings: &StepAndSettle,
    lost: &mut dyn FnMut(Fault) -> ControlFlow<()>,
) -> Result<ControlFlow<(), Frame>, Fault> {
    let timeline = handle.timeline();
    let (mut tries, mut unanswered) = (0, 0);
    loop {
        handle.feed();
        if let Some(reason) = handle.reason() {
            return Err(Fault::Stopped { reason: reason.to_string() });
        }
        let earliest_ns = timeline.stamp_ns().saturating_sub(nanoseconds(settings.stamp_slack));
        let deadline = timeline.deadline(settings.frame_within);
        let answered = camera
            .trigger(settings.frame_within)
            .and_then(|()| answer(handle, camera, earliest_ns, deadline, lost));
        let fault = match answered {
            Ok(answer) => {
                let_pass(handle, camera, unanswered, settings.frame_within);
                return Ok(answer);
            }
            Err(fault) => fault,
        };
        let silent = matches!(fault, Fault::Timeout { .. });
        tries += 1;
        if !(silent || fault.is_passing()) || tries > settings.retries {
            return Err(fault);
        }
        unanswered += u32::from(silent);
        if lost(fault).is_break() {
            return Ok(ControlFlow::Break(()));
        }
    }
}

/// The first frame that was not exposed before `earliest_ns`.
fn answer(
    handle: &Handle,
    camera: &mut dyn Camera,
    earliest_ns: i64,
    deadline: Deadline,
    lost: &mut dyn FnMut(Fault) -> ControlFlow<()>,
) -> Result<ControlFlow<(), Frame>, Fault> {
    loop {
        // A deadline that has passed is the camera's to tell: with a last look at what came.
        let passing = match camera.next_frame(handle.timeline().left(deadline).unwrap_or_default()) {
            Ok(frame) if frame.exposure().stamp_ns >= earliest_ns => return Ok(ControlFlow::Continue(frame)),
            Ok(frame) => {
                let device = crate::limits::name(&camera.identity());
                let reason = "it was exposed before it was asked for, with the mirror elsewhere".into();
                Fault::FrameContent { device, id: frame.id(), reason }
            }
            Err(fault @ (Fault::DroppedFrames { .. } | Fault::DuplicateFrame { .. })) => fault,
            Err(fault) => return Err(fault),
        };
        if lost(passing).is_break() {
            return Ok(ControlFlow::Break(()));
        }
    }
}

/// Lets frames pass that may still come of triggers which were not answered in time: after the mirror's next move they would be taken for
/// what it shows then.
fn let_pass(handle: &Handle, camera: &mut dyn Camera, unanswered: u32, within: Duration) {
    for _ in 0..unanswered {
        handle.feed();
        // What is wrong with the camera the next exposure tells.
        if let Err(Fault::Timeout { .. }) = camera.next_frame(within) {
            return;
        }
    }
}
