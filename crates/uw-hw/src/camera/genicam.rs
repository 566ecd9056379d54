//! GigE Vision and USB3 Vision cameras, by the Aravis library (feature `genicam`).
//!
//! Stamps: a frame carries the camera's own time of its exposure's start. How far that clock is off the [`Timeline`] is taken as the smallest
//! difference between a frame's receipt and its exposure's end by that clock, so that stamps are late by the shortest transmission
//! at most; a frame that was triggered by software does not begin before its trigger. A camera that is gone is noticed by the trigger that
//! it doesn't acknowledge, or the frame that does not come: the library tells of lost control four to five seconds later, and a call to
//! such a camera takes it three. So the camera has a thread of its own, on which its stream ends, too; nobody waits for it longer than he may.

use std::{
    sync::{Mutex, PoisonError},
    time::Duration,
};

use aravis::{AcquisitionMode, Aravis, Auto, Buffer, BufferStatus, CameraExt, CameraExtManual, StreamExt};

use super::{CameraInfo, Ids, Intake, aside::Aside};
use crate::{
    Camera, CameraSettings, Exposure, Fault, Frame, FrameCounts, Identity, Pixels, Timeline, Trigger,
    clock::nanoseconds, frame::Layout,
};

/// Buffers that the library fills while nobody takes them.
const BUFFERS: usize = 16;
/// By how much a camera's clock may run off within a scan, ns: what a frame's stamp may be before its trigger and still belong to it.
const CLOCK_NS: i64 = 2_000_000;

static LIBRARY: Mutex<Option<Aravis>> = Mutex::new(None);

/// The cameras that answer within the second or two that looking takes.
pub fn cameras() -> Vec<CameraInfo> {
    let mut library = LIBRARY.lock().unwrap_or_else(PoisonError::into_inner);
    if library.is_none() {
        *library = Aravis::initialize().ok();
    }
    let found = library.as_ref().map(Aravis::get_device_list).unwrap_or_default();
    let text = |value: &std::ffi::CString| value.to_string_lossy().into_owned();
    found
        .iter()
        .map(|info| CameraInfo {
            id: text(&info.id),
            about: format!("{} {}, {}", text(&info.vendor), text(&info.model), text(&info.protocol)),
            address: text(&info.address),
        })
        .collect()
}

/// A GenICam camera.
pub struct GenicamCamera {
    camera: Aside<aravis::Camera>,
    identity: Identity,
    timeline: Timeline,
    settings: Option<CameraSettings>,
    armed: Option<Armed>,
    counts: FrameCounts,
}

struct Armed {
    stream: aravis::Stream,
    intake: Intake,
    /// Timeline less the camera's clock, at most, ns.
    offset_ns: Option<i64>,
    triggered_ns: Option<i64>,
}

impl GenicamCamera {
    /// The camera with this id or address; the first that answers where `id` is `None`.
    ///
    /// # Errors
    /// [`Fault::Open`].
    pub fn open(id: Option<&str>, timeline: Timeline) -> Result<Self, Fault> {
        let camera = aravis::Camera::new(id).map_err(|e| Fault::Open {
            device: id.map_or_else(|| "camera".into(), |id| format!("camera {id}")),
            reason: e.message().to_owned(),
            mend: "check power, cable and address, and that no other program has it; `uwscan devices` lists cameras"
                .into(),
        })?;
        let identity = Identity {
            driver: "genicam".into(),
            place: id.unwrap_or_default().into(),
            vendor: camera.vendor_name().map(|text| text.to_string()).unwrap_or_default(),
            model: camera.model_name().map(|text| text.to_string()).unwrap_or_default(),
            serial: camera.device_id().map(|text| text.to_string()).unwrap_or_default(),
            firmware: camera.string("DeviceVersion").map(|text| text.to_string()).unwrap_or_default(),
        };
        let camera = Aside::new("uwscan-genicam", camera).map_err(|e| Fault::Open {
            device: crate::limits::name(&identity),
            reason: e.to_string(),
            mend: "end other programs: the system has no thread left".into(),
        })?;
        Ok(Self { camera, identity, timeline, settings: None, armed: None, counts: FrameCounts::default() })
    }

    fn name(&self) -> String {
        crate::limits::name(&self.identity)
    }

    /// What the camera answers in time.
    fn ask<T: Send + 'static>(
        &mut self,
        within: Duration,
        doing: &str,
        what: impl FnOnce(&aravis::Camera) -> Result<T, Fault> + Send + 'static,
    ) -> Result<T, Fault> {
        let began = self.timeline.deadline(within);
        self.camera.ask(within, what).unwrap_or_else(|| {
            let waited = self.timeline.waited(began);
            Err(Fault::Timeout { device: self.name(), doing: doing.into(), waited, got: String::new() })
        })
    }
}

impl Drop for GenicamCamera {
    fn drop(&mut self) {
        // A stream tells the camera of its end, and waits for the answer.
        if let Some(Armed { stream, .. }) = self.armed.take() {
            self.camera.leave(move |_| drop(stream));
        }
    }
}

impl std::fmt::Debug for GenicamCamera {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("GenicamCamera")
            .field("identity", &self.identity)
            .field("settings", &self.settings)
            .field("armed", &self.armed.is_some())
            .finish_non_exhaustive()
    }
}

/// A fault of a camera that said no.
fn refused(device: &str, doing: &str, said: &glib::Error) -> Fault {
    Fault::Refused { device: device.into(), doing: doing.into(), reason: said.message().into() }
}

/// The pixel format that holds so many bits, right-justified and unpacked.
fn format_of(bits: u8) -> Option<&'static str> {
    Some(match bits {
        8 => "Mono8",
        10 => "Mono10",
        12 => "Mono12",
        14 => "Mono14",
        16 => "Mono16",
        _ => return None,
    })
}

/// Sets a camera up; gives the settings in force.
fn set_up(camera: &aravis::Camera, device: String, wanted: &CameraSettings) -> Result<CameraSettings, Fault> {
    let done = |doing: &str, result: Result<(), glib::Error>| result.map_err(|e| refused(&device, doing, &e));
    let Some(by_bits) = format_of(wanted.significant_bits) else {
        return Err(Fault::Unsupported {
            device,
            what: format!("deliver values of {} bits", wanted.significant_bits),
            mend: "GenICam has 8, 10, 12, 14 and 16".into(),
        });
    };
    let format = wanted.pixel_format.as_deref().unwrap_or(by_bits);
    if format != by_bits {
        return Err(Fault::Unsupported {
            device,
            what: format!("read {format} as values of {} bits", wanted.significant_bits),
            mend: format!("write pixel_format = \"{by_bits}\", or leave it out"),
        });
    }
    done("its pixel format", camera.set_pixel_format_from_string(format))?;
    let [width, height] = wanted.size.map(|side| i32::try_from(side).unwrap_or(i32::MAX));
    done("its region", camera.set_region(0, 0, width, height))?;
    let region = camera.region();
    let size = region.as_ref().map(|(_, _, w, h)| [w.unsigned_abs(), h.unsigned_abs()]);
    match size {
        Ok(size) if size == wanted.size => {}
        Ok(got) => return Err(Fault::FrameSize { device, needed: wanted.size, got }),
        Err(e) => return Err(refused(&device, "its region", e)),
    }
    if camera.is_exposure_auto_available().unwrap_or(false) {
        done("its automatic exposure", camera.set_exposure_time_auto(Auto::Off))?;
    }
    done("its exposure", camera.set_exposure_time(wanted.exposure.as_secs_f64() * 1e6))?;
    if let Some(gain) = wanted.gain_db {
        if camera.is_gain_auto_available().unwrap_or(false) {
            done("its automatic gain", camera.set_gain_auto(Auto::Off))?;
        }
        done("its gain", camera.set_gain(gain))?;
    }
    done("its acquisition mode", camera.set_acquisition_mode(AcquisitionMode::Continuous))?;
    match wanted.trigger {
        Trigger::Software => done("its software trigger", camera.set_trigger("Software"))?,
        Trigger::Hardware => done("its trigger", camera.set_trigger("Line0"))?,
        Trigger::Free { rate_hz } => {
            done("its trigger", camera.clear_triggers())?;
            done("its frame rate", camera.set_frame_rate(rate_hz))?;
        }
    }
    let exposure = camera.exposure_time().map(|us| Duration::from_secs_f64(us.max(0.0) * 1e-6));
    Ok(CameraSettings {
        pixel_format: Some(format.into()),
        exposure: exposure.unwrap_or(wanted.exposure),
        gain_db: camera.gain().ok().filter(|_| wanted.gain_db.is_some()),
        ..wanted.clone()
    })
}

/// Has a camera send frames: its stream, and how it numbers them.
fn start(camera: &aravis::Camera, device: &str) -> Result<(aravis::Stream, Ids), Fault> {
    let payload = camera.payload().map_err(|e| refused(device, "its payload", &e))?;
    let stream = camera.create_stream().map_err(|e| refused(device, "a stream", &e))?;
    (0..BUFFERS).for_each(|_| stream.push_buffer(Buffer::new_allocate(payload as usize)));
    let extended = || camera.string("GevGVSPExtendedIDMode").is_ok_and(|mode| mode == "On");
    let ids = if camera.is_gv_device() && !extended() { Ids::GIGE_16 } else { Ids::WIDE };
    camera.start_acquisition().map_err(|e| refused(device, "arming", &e))?;
    Ok((stream, ids))
}

impl Camera for GenicamCamera {
    fn identity(&self) -> Identity {
        self.identity.clone()
    }

    fn configure(&mut self, wanted: &CameraSettings, within: Duration) -> Result<CameraSettings, Fault> {
        let (device, wanted) = (self.name(), wanted.clone());
        let in_force = self.ask(within, "its settings", move |camera| set_up(camera, device, &wanted))?;
        self.settings = Some(in_force.clone());
        Ok(in_force)
    }

    fn arm(&mut self, within: Duration) -> Result<(), Fault> {
        let device = self.name();
        let Some(settings) = &self.settings else {
            return Err(Fault::Order { device, doing: "arming", needed: "settings" });
        };
        let size = settings.size;
        let name = device.clone();
        let (stream, ids) = self.ask(within, "arming", move |camera| start(camera, &name))?;
        let intake = Intake::new(device, size, ids);
        self.armed = Some(Armed { stream, intake, offset_ns: None, triggered_ns: None });
        Ok(())
    }

    fn trigger(&mut self, within: Duration) -> Result<(), Fault> {
        let device = self.name();
        let (Some(settings), Some(armed)) = (&self.settings, &mut self.armed) else {
            return Err(Fault::Order { device, doing: "triggering", needed: "arming" });
        };
        if settings.trigger != Trigger::Software {
            let (what, mend) = ("be triggered by software as it is set up", "configure that trigger");
            return Err(Fault::Unsupported { device, what: what.into(), mend: mend.into() });
        }
        armed.triggered_ns = Some(self.timeline.stamp_ns());
        self.ask(within, "a trigger", move |camera| {
            camera.software_trigger().map_err(|e| Fault::Disconnected {
                device,
                doing: "a trigger".into(),
                reason: e.message().to_owned(),
            })
        })
    }

    fn next_frame(&mut self, within: Duration) -> Result<Frame, Fault> {
        let device = self.name();
        let (Some(settings), Some(armed)) = (&self.settings, &mut self.armed) else {
            return Err(Fault::Order { device, doing: "a frame", needed: "arming" });
        };
        if let Some(next) = armed.intake.take_pending() {
            return next;
        }
        let began = self.timeline.deadline(within);
        let microseconds = u64::try_from(within.as_micros()).unwrap_or(u64::MAX);
        let Some(buffer) = armed.stream.timeout_pop_buffer(microseconds) else {
            let waited = self.timeline.waited(began);
            return Err(Fault::Timeout { device, doing: "a frame".into(), waited, got: String::new() });
        };
        let received_ns = self.timeline.stamp_ns();
        let (id, status) = (buffer.frame_id(), buffer.status());
        let admitted = if status == BufferStatus::Success {
            let exposure = exposure(&buffer, armed, settings, received_ns);
            let size = [buffer.image_width(), buffer.image_height()].map(i32::unsigned_abs);
            let layout = Layout::packed(size[0], size[1], settings.significant_bits);
            let pixels = pixels(buffer.image_data(), settings.significant_bits);
            armed.intake.admit(id, pixels, layout, exposure)
        } else {
            Err(armed.intake.torn(id, &format!("the library says {status:?}")))
        };
        armed.stream.push_buffer(buffer);
        admitted
    }

    fn disarm(&mut self, within: Duration) -> Result<(), Fault> {
        self.counts = self.counts();
        let device = self.name();
        let stream = self.armed.take().map(|armed| armed.stream);
        if self.camera.is_late() {
            self.camera.leave(move |_| drop(stream));
            let (doing, reason) = ("disarming".into(), "it did not answer the last time".into());
            return Err(Fault::Disconnected { device, doing, reason });
        }
        self.ask(within, "disarming", move |camera| {
            let stopped = camera.stop_acquisition();
            drop(stream);
            stopped.map_err(|e| refused(&device, "disarming", &e))
        })
    }

    fn counts(&self) -> FrameCounts {
        self.armed.as_ref().map_or(self.counts, |armed| armed.intake.counts())
    }
}

fn exposure(buffer: &Buffer, armed: &mut Armed, settings: &CameraSettings, received_ns: i64) -> Exposure {
    let long_ns = nanoseconds(settings.exposure);
    let camera_ns = i64::try_from(buffer.timestamp()).unwrap_or(0);
    let offset_ns = received_ns.saturating_sub(long_ns).saturating_sub(camera_ns);
    let offset_ns = armed.offset_ns.map_or(offset_ns, |smallest| smallest.min(offset_ns));
    armed.offset_ns = Some(offset_ns);
    let mut stamp_ns = camera_ns.saturating_add(offset_ns);
    if let Some(trigger_ns) = armed.triggered_ns
        && stamp_ns < trigger_ns
        && trigger_ns.saturating_sub(stamp_ns) <= long_ns.saturating_add(CLOCK_NS)
    {
        stamp_ns = trigger_ns;
    }
    Exposure { stamp_ns, exposure_ns: long_ns.unsigned_abs(), received_ns }
}

/// Values in the machine's order: GigE Vision and USB3 Vision send the lower byte first.
fn pixels(bytes: Vec<u8>, bits: u8) -> Pixels {
    if bits <= 8 {
        return bytes.into();
    }
    bytes.chunks_exact(2).map(|two| u16::from_le_bytes([two[0], two[1]])).collect::<Vec<u16>>().into()
}
