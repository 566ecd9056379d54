//! The bench's camera.

use std::{collections::VecDeque, time::Duration};

use super::{Device, Event, Mock, MockFault, identity};
use crate::{
    Camera, CameraSettings, Exposure, Fault, Frame, FrameCounts, Identity, Pixels, Trigger,
    camera::{Ids, Intake},
    clock::nanoseconds,
    frame::Layout,
};

/// One exposure, as the image of it is made from it.
#[derive(Clone, Debug, PartialEq)]
pub struct Shot {
    /// From 0 at arming.
    pub number: u64,
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Start of the exposure, nanoseconds since the Unix epoch.
    pub stamp_ns: i64,
    /// Where the mirror was in the middle of the exposure, V.
    pub volts: f64,
    /// Whether the laser was on.
    pub laser_on: bool,
}

type Image = Box<dyn FnMut(&Shot) -> Pixels + Send>;

/// An exposure that has begun.
#[derive(Clone, Copy, Debug)]
struct Begun {
    number: u64,
    begin_ns: i64,
    laser_on: bool,
    fault: Option<MockFault>,
}

/// A camera whose images a closure makes. It is told only through frames what the other devices of the bench do.
pub struct MockCamera {
    mock: Mock,
    image: Image,
    settings: Option<CameraSettings>,
    armed: Option<Armed>,
    counts: FrameCounts,
}

struct Armed {
    intake: Intake,
    since_ns: i64,
    begun: VecDeque<Begun>,
    next: u64,
    /// A frame that comes a second time.
    again: Option<(u64, Pixels, Layout, Exposure)>,
}

impl std::fmt::Debug for MockCamera {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("MockCamera").field("settings", &self.settings).finish_non_exhaustive()
    }
}

impl MockCamera {
    pub(super) fn new(mock: Mock, image: Image) -> Self {
        Self { mock, image, settings: None, armed: None, counts: FrameCounts::default() }
    }

    fn timeout(&self, waited: Duration) -> Fault {
        let device = identity(Device::Camera).driver;
        Fault::Timeout { device, doing: "a frame".into(), waited, got: String::new() }
    }

    /// Faults of frames are no faults of the camera's control.
    fn control(&self, doing: &str, within: Duration) -> Result<(), Fault> {
        let fault = self.mock.now(Device::Camera).filter(|fault| *fault == MockFault::Unplugged);
        self.mock.answer(Device::Camera, fault, doing, within)
    }

    fn unplugged(doing: &str) -> Fault {
        let device = identity(Device::Camera).driver;
        Fault::Disconnected { device, doing: doing.into(), reason: "unplugged by the script".into() }
    }
}

/// Begins the next exposure.
fn begin(mock: &Mock, armed: &mut Armed, begin_ns: i64) {
    let (_, fault) = mock.call(Device::Camera);
    let mut state = mock.lock();
    let begun = Begun { number: armed.next, begin_ns, laser_on: state.laser_on, fault };
    state.note(begin_ns, Event::Exposed(begun.number));
    armed.begun.push_back(begun);
    armed.next += 1;
}

impl Camera for MockCamera {
    fn identity(&self) -> Identity {
        identity(Device::Camera)
    }

    fn configure(&mut self, wanted: &CameraSettings, within: Duration) -> Result<CameraSettings, Fault> {
        self.control("its settings", within)?;
        self.settings = Some(wanted.clone());
        Ok(wanted.clone())
    }

    fn arm(&mut self, within: Duration) -> Result<(), Fault> {
        let device = identity(Device::Camera).driver;
        let Some(settings) = &self.settings else {
            return Err(Fault::Order { device, doing: "arming", needed: "settings" });
        };
        self.control("arming", within)?;
        let mut intake = Intake::new(device, settings.size, Ids::WIDE);
        intake.expect_first(0);
        let since_ns = self.mock.timeline.stamp_ns();
        self.armed = Some(Armed { intake, since_ns, begun: VecDeque::new(), next: 0, again: None });
        Ok(())
    }

    fn trigger(&mut self, within: Duration) -> Result<(), Fault> {
        let device = identity(Device::Camera).driver;
        let (Some(settings), Some(armed)) = (&self.settings, &mut self.armed) else {
            return Err(Fault::Order { device, doing: "triggering", needed: "arming" });
        };
        if settings.trigger != Trigger::Software {
            let (what, mend) = ("be triggered by software as it is set up", "configure that trigger");
            return Err(Fault::Unsupported { device, what: what.into(), mend: mend.into() });
        }
        if self.mock.now(Device::Camera) == Some(MockFault::Unplugged) {
            return Err(Self::unplugged("a trigger"));
        }
        begin(&self.mock, armed, self.mock.timeline.stamp_ns());
        let latency = self.mock.lock().bench.latency;
        self.mock.timeline.sleep(latency.min(within));
        Ok(())
    }

    fn next_frame(&mut self, within: Duration) -> Result<Frame, Fault> {
        let deadline = self.mock.timeline.deadline(within);
        let device = identity(Device::Camera).driver;
        let (Some(settings), Some(armed)) = (&self.settings, &mut self.armed) else {
            return Err(Fault::Order { device, doing: "a frame", needed: "arming" });
        };
        if let Some(next) = armed.intake.take_pending() {
            return next;
        }
        if let Some((number, pixels, layout, exposure)) = armed.again.take() {
            return armed.intake.admit(number, pixels, layout, exposure);
        }
        let bench = self.mock.lock().bench;
        loop {
            let now = self.mock.timeline.stamp_ns();
            let whole_ns = nanoseconds(settings.exposure + bench.readout);
            if let Trigger::Free { rate_hz } = settings.trigger {
                let period_ns = 1e9 / rate_hz;
                let at = |number: u64| armed.since_ns + (number as f64 * period_ns) as i64;
                let mut due: Vec<i64> = Vec::new();
                let mut next = armed.next;
                while at(next) <= now || (due.is_empty() && armed.begun.is_empty()) {
                    due.push(at(next));
                    next += 1;
                }
                due.into_iter().for_each(|begin_ns| begin(&self.mock, armed, begin_ns));
                // As a camera without room does: the oldest give way.
                while armed.begun.len() as u64 > bench.buffers.max(1) {
                    armed.begun.pop_front();
                }
            }
            let Some(&shot) = armed.begun.front() else {
                self.mock.timeline.sleep(self.mock.timeline.left(deadline).unwrap_or_default());
                return Err(self.timeout(within));
            };
            let slow = if let Some(MockFault::Slow(by)) = shot.fault { by } else { Duration::ZERO };
            let ready_ns = shot.begin_ns.saturating_add(whole_ns).saturating_add(nanoseconds(slow));
            if ready_ns > now {
                let wait = Duration::from_nanos(ready_ns.abs_diff(now));
                match self.mock.timeline.left(deadline) {
                    Some(left) if left >= wait => self.mock.timeline.sleep(wait),
                    left => {
                        self.mock.timeline.sleep(left.unwrap_or_default());
                        return Err(self.timeout(within));
                    }
                }
                continue;
            }
            armed.begun.pop_front();
            match shot.fault {
                Some(MockFault::Unplugged) => return Err(Self::unplugged("a frame")),
                // Neither comes; the frames after them show the gap.
                Some(MockFault::Silent | MockFault::Dropped) => continue,
                _ => {}
            }
            let exposure_ns = u64::try_from(settings.exposure.as_nanos()).unwrap_or(u64::MAX);
            let received_ns = self.mock.timeline.stamp_ns();
            let exposure = Exposure { stamp_ns: shot.begin_ns, exposure_ns, received_ns };
            let volts = self.mock.lock().volts_at(exposure.middle_ns());
            let [width, height] = settings.size;
            let size =
                if shot.fault == Some(MockFault::WrongSize) { [width + 1, height] } else { settings.size };
            let Begun { number, begin_ns: stamp_ns, laser_on, .. } = shot;
            let mut pixels = (self.image)(&Shot { number, size, stamp_ns, volts, laser_on });
            if shot.fault == Some(MockFault::Torn) {
                pixels = torn(&pixels);
            }
            let layout = Layout::packed(size[0], size[1], settings.significant_bits);
            if shot.fault == Some(MockFault::Duplicated) {
                armed.again = Some((number, pixels.clone(), layout, exposure));
            }
            return armed.intake.admit(number, pixels, layout, exposure);
        }
    }

    fn disarm(&mut self, within: Duration) -> Result<(), Fault> {
        self.counts = self.counts();
        self.armed = None;
        self.control("disarming", within)
    }

    fn counts(&self) -> FrameCounts {
        self.armed.as_ref().map_or(self.counts, |armed| armed.intake.counts())
    }
}

fn torn(pixels: &Pixels) -> Pixels {
    match pixels {
        Pixels::U8(values) => values[..values.len() / 2].to_vec().into(),
        Pixels::U16(values) => values[..values.len() / 2].to_vec().into(),
    }
}
