//! Cameras and grabbers by Video4Linux (feature `v4l2`, on Linux). Not tried on hardware: nobody here has such a device.
//!
//! They run by themselves; none can be triggered by software. Drivers do the nearest thing to what they are asked, silently: here that is
//! a fault, but for the exposure, which is told as it is. Frames that the driver dropped show as gaps in its numbers. A grabber's image of
//! two fields is refused as a whole image, and taken as its top field where an image of half the height is asked for.
//!
//! Setting up takes as long as the driver lets its calls take: their deadlines are the kernel's. Frames have ours.
//!
//! The bindings panic where a driver says what they have no name for; that is a [`Fault`] here.

mod format;
mod reader;
mod stamp;

use std::{
    io,
    panic::{AssertUnwindSafe, catch_unwind},
    path::PathBuf,
    time::Duration,
};

use moq_v4l::{
    Control, Device, Fraction,
    buffer::Flags,
    capability,
    control::Value,
    video::{Capture, capture::Parameters},
};

use super::{CameraInfo, Ids, Intake};
use crate::{Camera, CameraSettings, Fault, Frame, FrameCounts, Identity, Timeline, Trigger, frame::Layout};
use format::{Taking, negotiate, packings};
use reader::Reader;
use stamp::Stamps;

/// `V4L2_CID_EXPOSURE_AUTO`, and its value for an exposure that is given.
const EXPOSURE_AUTO: (u32, i64) = (0x009a_0901, 1);
/// `V4L2_CID_EXPOSURE_ABSOLUTE`, in units of 100 µs.
const EXPOSURE: u32 = 0x009a_0902;
const EXPOSURE_UNIT: Duration = Duration::from_micros(100);
/// A rate may differ by this share: 29.97 is 30.
const RATE: f64 = 0.01;
/// `EINVAL` and `ENOTTY`: the device has no such control or setting.
const NONE_SUCH: [i32; 2] = [22, 25];

const NO_CAMERA: &str = "check that it is plugged in and captures video, and that you may read and write it (group video); \
                         `uwscan devices` lists cameras";

/// How to scan with a camera that can't be triggered.
const RUN_FREE: &str = "write camera.trigger = \"free\", a rate_hz, and sweep.mode = \"continuous\"";

/// The devices that capture video and can be opened, in the order of their numbers.
pub fn cameras() -> Vec<CameraInfo> {
    let Ok(files) = std::fs::read_dir("/dev") else { return Vec::new() };
    let number = |name: &str| name.strip_prefix("video")?.parse::<u32>().ok();
    let mut files: Vec<(u32, PathBuf)> = files
        .filter_map(Result::ok)
        .filter_map(|file| Some((number(file.file_name().to_str()?)?, file.path())))
        .collect();
    files.sort();
    let info = |(_, path): &(u32, PathBuf)| {
        let id = path.to_str()?;
        let (_, about) = captures(id).ok()?;
        let capability::Capabilities { card, driver, bus, .. } = about;
        Some(CameraInfo { id: id.into(), about: format!("{card}, {driver}"), address: bus })
    };
    files.iter().filter_map(info).collect()
}

/// Opens a device file that captures video.
fn captures(id: &str) -> Result<(Device, capability::Capabilities), Fault> {
    let fault =
        |reason: String| Fault::Open { device: format!("camera {id}"), reason, mend: NO_CAMERA.into() };
    // The bindings take it for granted that a path has no zero.
    if id.contains('\0') {
        return Err(fault("no file has such a name".into()));
    }
    let device = Device::with_path(id).map_err(|e| fault(e.to_string()))?;
    let about = ask(|| device.query_caps()).map_err(|e| fault(e.to_string()))?;
    let needed = capability::Flags::VIDEO_CAPTURE | capability::Flags::STREAMING;
    if !about.capabilities.contains(needed) {
        return Err(fault("it does not stream video".into()));
    }
    Ok((device, about))
}

/// What the driver answers; an answer that the bindings have no name for is an error.
fn ask<T>(what: impl FnOnce() -> io::Result<T>) -> io::Result<T> {
    catch_unwind(AssertUnwindSafe(what)).unwrap_or_else(|_| {
        Err(io::Error::new(io::ErrorKind::InvalidData, "the driver's answer is not understood"))
    })
}

/// An answer of the driver, `None` where the device has nothing of that kind.
fn if_any<T>(answer: io::Result<T>) -> io::Result<Option<T>> {
    match answer {
        Ok(answer) => Ok(Some(answer)),
        Err(e) if e.raw_os_error().is_some_and(|code| NONE_SUCH.contains(&code)) => Ok(None),
        Err(e) => Err(e),
    }
}

/// A V4L2 device.
pub struct V4l2Camera {
    device: Device,
    identity: Identity,
    timeline: Timeline,
    set_up: Option<SetUp>,
    armed: Option<Armed>,
    counts: FrameCounts,
}

struct SetUp {
    settings: CameraSettings,
    taking: Taking,
    interval: Duration,
}

struct Armed {
    reader: Reader,
    intake: Intake,
    stamps: Stamps,
}

impl std::fmt::Debug for V4l2Camera {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let settings = self.set_up.as_ref().map(|set_up| &set_up.settings);
        f.debug_struct("V4l2Camera")
            .field("identity", &self.identity)
            .field("settings", &settings)
            .field("armed", &self.armed.is_some())
            .finish_non_exhaustive()
    }
}

impl V4l2Camera {
    /// The camera at this device file; the first there is where `id` is `None`.
    ///
    /// # Errors
    /// [`Fault::Open`].
    pub fn open(id: Option<&str>, timeline: Timeline) -> Result<Self, Fault> {
        let place = match id {
            Some(id) => id.to_owned(),
            None => match cameras().into_iter().next() {
                Some(first) => first.id,
                None => {
                    return Err(Fault::Open {
                        device: "camera".into(),
                        reason: "no device file captures video".into(),
                        mend: "plug it in, and load its driver".into(),
                    });
                }
            },
        };
        let (device, about) = captures(&place)?;
        let identity = Identity {
            driver: "v4l2".into(),
            place,
            vendor: about.driver,
            model: about.card,
            ..Identity::default()
        };
        Ok(Self { device, identity, timeline, set_up: None, armed: None, counts: FrameCounts::default() })
    }

    fn name(&self) -> String {
        crate::limits::name(&self.identity)
    }

    fn unsupported(&self, what: String, mend: &str) -> Fault {
        Fault::Unsupported { device: self.name(), what, mend: mend.into() }
    }

    fn refused(&self, doing: &str, reason: &io::Error) -> Fault {
        Fault::Refused { device: self.name(), doing: doing.into(), reason: reason.to_string() }
    }

    /// The rate that is then in force: that which was asked for, where the device has none to set.
    fn set_rate(&self, rate_hz: f64) -> Result<f64, Fault> {
        let refused = |e: io::Error| self.refused("its frame rate", &e);
        let asked = Parameters::new(interval(rate_hz));
        let got = if_any(ask(|| self.device.set_params(&asked))).map_err(refused)?;
        let got_hz = got.and_then(|parameters| rate_of(parameters.interval)).unwrap_or(rate_hz);
        if (got_hz - rate_hz).abs() > RATE * rate_hz {
            let what = format!("give {rate_hz} images a second: it gives {got_hz:.3}");
            return Err(self.unsupported(what, "give camera.rate_hz that rate, or a size that comes faster"));
        }
        Ok(got_hz)
    }

    /// The exposure that is then in force: that which was asked for, where the device has none to set.
    fn set_exposure(&self, exposure: Duration) -> Result<Duration, Fault> {
        let refused = |e: io::Error| self.refused("its exposure", &e);
        let read = || if_any(ask(|| self.device.control(EXPOSURE))).map_err(refused);
        if read()?.is_none() {
            return Ok(exposure);
        }
        let set = |id, value| ask(|| self.device.set_control(Control { id, value: Value::Integer(value) }));
        let (auto, by_hand) = EXPOSURE_AUTO;
        if_any(set(auto, by_hand)).map_err(refused)?;
        set(EXPOSURE, units(exposure)).map_err(refused)?;
        Ok(match read()?.map(|control| control.value) {
            Some(Value::Integer(got)) => EXPOSURE_UNIT * u32::try_from(got).unwrap_or(0),
            _ => exposure,
        })
    }
}

/// The interval of a rate, to a thousandth of it.
fn interval(rate_hz: f64) -> Fraction {
    Fraction::new(1000, (rate_hz * 1000.0).round().max(1.0) as u32)
}

/// The rate of an interval; `None` for one that is none.
fn rate_of(interval: Fraction) -> Option<f64> {
    let Fraction { numerator, denominator } = interval;
    (numerator > 0 && denominator > 0).then(|| f64::from(denominator) / f64::from(numerator))
}

/// An exposure in the control's units, at least one.
fn units(exposure: Duration) -> i64 {
    let units = exposure.as_secs_f64() / EXPOSURE_UNIT.as_secs_f64();
    (units.round() as i64).max(1)
}

impl Camera for V4l2Camera {
    fn identity(&self) -> Identity {
        self.identity.clone()
    }

    fn configure(&mut self, wanted: &CameraSettings, _within: Duration) -> Result<CameraSettings, Fault> {
        let Trigger::Free { rate_hz } = wanted.trigger else {
            return Err(
                self.unsupported("wait for a trigger: V4L2 cameras run by themselves".into(), RUN_FREE)
            );
        };
        if wanted.gain_db.is_some() {
            let mend = "leave gain_db out, and set the device's own gain with v4l2-ctl --set-ctrl";
            return Err(self.unsupported("set a gain in decibels: its units are its maker's".into(), mend));
        }
        let device = self.name();
        let fit = packings(&device, wanted.significant_bits, wanted.pixel_format.as_deref())?;
        let taking = negotiate(&device, wanted.size, &fit, |format| ask(|| self.device.set_format(format)))?;
        let rate_hz = self.set_rate(rate_hz)?;
        let settings = CameraSettings {
            pixel_format: Some(taking.packing.name.into()),
            exposure: self.set_exposure(wanted.exposure)?,
            trigger: Trigger::Free { rate_hz },
            ..wanted.clone()
        };
        let interval = Duration::try_from_secs_f64(rate_hz.recip()).unwrap_or_default();
        self.set_up = Some(SetUp { settings: settings.clone(), taking, interval });
        Ok(settings)
    }

    fn arm(&mut self, _within: Duration) -> Result<(), Fault> {
        let Some(SetUp { settings, interval, .. }) = &self.set_up else {
            return Err(Fault::Order { device: self.name(), doing: "arming", needed: "settings" });
        };
        // The device streams for one at a time.
        self.armed = None;
        let stamps = Stamps::new(&self.timeline, settings.exposure, *interval);
        let intake = Intake::new(self.name(), settings.size, Ids::U32);
        let reader = ask(|| Reader::start(&self.device, self.timeline.clone()))
            .map_err(|e| self.refused("arming", &e))?;
        self.armed = Some(Armed { reader, intake, stamps });
        Ok(())
    }

    fn trigger(&mut self, _within: Duration) -> Result<(), Fault> {
        Err(self.unsupported("be triggered: V4L2 cameras run by themselves".into(), RUN_FREE))
    }

    fn next_frame(&mut self, within: Duration) -> Result<Frame, Fault> {
        let device = self.name();
        let (Some(SetUp { settings, taking, .. }), Some(armed)) = (&self.set_up, &mut self.armed) else {
            return Err(Fault::Order { device, doing: "a frame", needed: "arming" });
        };
        if let Some(next) = armed.intake.take_pending() {
            return next;
        }
        let doing = || "a frame".to_owned();
        let began = self.timeline.deadline(within);
        let filled = match armed.reader.next(within) {
            Ok(Some(filled)) => filled,
            Ok(None) => {
                let waited = self.timeline.waited(began);
                return Err(Fault::Timeout { device, doing: doing(), waited, got: String::new() });
            }
            Err(reason) => return Err(Fault::Disconnected { device, doing: doing(), reason }),
        };
        let id = u64::from(filled.about.sequence);
        if filled.about.flags.contains(Flags::ERROR) {
            return Err(armed.intake.torn(id, "the driver says that its data are damaged"));
        }
        match taking.grey(&filled.bytes) {
            Ok(pixels) => {
                let layout = Layout::packed(settings.size[0], settings.size[1], settings.significant_bits);
                let about = &filled.about;
                let exposure = armed.stamps.exposure(about.flags, about.timestamp, filled.received_ns);
                armed.intake.admit(id, pixels, layout, exposure)
            }
            Err(why) => Err(armed.intake.torn(id, &why)),
        }
    }

    fn disarm(&mut self, _within: Duration) -> Result<(), Fault> {
        self.counts = self.counts();
        self.armed = None;
        Ok(())
    }

    fn counts(&self) -> FrameCounts {
        self.armed.as_ref().map_or(self.counts, |armed| armed.intake.counts())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_camera_is_told_with_what_to_check() {
        let open = |id| V4l2Camera::open(Some(id), Timeline::system()).unwrap_err().to_string();
        for (id, reason) in [
            ("/dev/null", "ioctl"),
            ("/dev/nowhere", "No such file"),
            ("/dev/nul\0", "no file has such a name"),
        ] {
            let said = open(id);
            assert!(said.contains(reason) && said.contains("uwscan devices"), "{said}");
        }
        // Those that are listed can be opened, on a machine that has any.
        for camera in cameras() {
            assert!(V4l2Camera::open(Some(&camera.id), Timeline::system()).is_ok(), "{camera:?}");
        }
    }

    #[test]
    fn an_answer_that_the_bindings_do_not_know_is_an_error() {
        let answer: io::Result<()> = ask(|| panic!("Invalid colorspace"));
        assert_eq!(answer.unwrap_err().to_string(), "the driver's answer is not understood");
        assert_eq!(if_any(ask(|| Ok(5))).unwrap(), Some(5));
        assert_eq!(if_any::<()>(Err(io::Error::from_raw_os_error(22))).unwrap(), None);
        assert!(if_any::<()>(Err(io::Error::from_raw_os_error(5))).is_err());
    }

    #[test]
    fn rates_and_exposures_go_through_the_kernels_units() {
        for rate_hz in [25.0, 29.97, 59.94, 0.5] {
            let back = rate_of(interval(rate_hz)).unwrap();
            assert!((back - rate_hz).abs() <= 0.001 * rate_hz, "{rate_hz}: {back}");
        }
        assert_eq!(rate_of(Fraction::new(0, 25)), None);
        let of_ms = |ms| units(Duration::from_secs_f64(ms * 1e-3));
        assert_eq!([0.0, 0.04, 4.0, 33.3].map(of_ms), [1, 1, 40, 333]);
    }
}
