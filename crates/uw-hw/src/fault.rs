//! What hardware does instead of what was asked.

use std::time::Duration;

/// What a device did instead of what was asked. `device` names it with its place, `doing` is what was being asked of it.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Fault {
    /// It can't be opened.
    #[error("{device}: cannot be opened: {reason}; {mend}")]
    Open {
        /// Which device.
        device: String,
        /// Why.
        reason: String,
        /// What to do.
        mend: String,
    },
    /// No answer came in time.
    #[error("{device}: no answer to {doing} within {:.0} ms{}", waited.as_secs_f64() * 1e3, heard(got))]
    Timeout {
        /// Which device.
        device: String,
        /// What was asked.
        doing: String,
        /// How long was waited.
        waited: Duration,
        /// What had come by then, as text; empty for silence.
        got: String,
    },
    /// The link is gone: unplugged, switched off, or taken by somebody else.
    #[error("{device}: the link was lost at {doing}: {reason}; check cable and power")]
    Disconnected {
        /// Which device.
        device: String,
        /// What was asked.
        doing: String,
        /// What the system said.
        reason: String,
    },
    /// The answer is not one that the protocol knows.
    #[error("{device}: the answer to {doing} is {got:?}, where {needed} is needed")]
    Protocol {
        /// Which device.
        device: String,
        /// What was asked.
        doing: String,
        /// What is needed.
        needed: String,
        /// What came.
        got: String,
    },
    /// The device understood, and said no.
    #[error("{device}: {doing} was refused: {reason}")]
    Refused {
        /// Which device.
        device: String,
        /// What was asked.
        doing: String,
        /// The device's own words.
        reason: String,
    },
    /// A value outside what the instrument may be driven with; it was not sent.
    #[error("{device}: {quantity} {value} {unit} is outside [{}, {}] {unit}: it was not sent", allowed[0], allowed[1])]
    OutOfRange {
        /// Which device.
        device: String,
        /// What the value is.
        quantity: &'static str,
        /// Its unit.
        unit: &'static str,
        /// The value.
        value: f64,
        /// Lowest and highest value that are allowed.
        allowed: [f64; 2],
    },
    /// The read-back is not where the drive was sent: a stuck mirror, a wrong scale, a drive without power.
    #[error(
        "{device}: sent to {commanded_v} V, but it reads {read_back_v} V (at most {tolerance_v} V between them): \
         check that the mirror is free and the drive has power"
    )]
    NotFollowing {
        /// Which device.
        device: String,
        /// Where it was sent, V.
        commanded_v: f64,
        /// Where it is, V.
        read_back_v: f64,
        /// By how much they may differ, V.
        tolerance_v: f64,
    },
    /// An image of another size than was configured.
    #[error("{device}: a frame of {} x {} pixels came, {} x {} were configured", got[0], got[1], needed[0], needed[1])]
    FrameSize {
        /// Which device.
        device: String,
        /// Width and height as configured, pixels.
        needed: [u32; 2],
        /// Width and height that came, pixels.
        got: [u32; 2],
    },
    /// A frame whose data don't make an image.
    #[error("{device}: frame {id} is unusable: {reason}")]
    FrameContent {
        /// Which device.
        device: String,
        /// The frame's id.
        id: u64,
        /// What is wrong with it.
        reason: String,
    },
    /// Frames were lost before one that came; the next call gives that one.
    #[error("{device}: {count} frames were dropped before frame {next_id}")]
    DroppedFrames {
        /// Which device.
        device: String,
        /// How many.
        count: u64,
        /// The frame that came after them.
        next_id: u64,
    },
    /// A frame came a second time; nothing is lost.
    #[error("{device}: frame {id} came again")]
    DuplicateFrame {
        /// Which device.
        device: String,
        /// Its id.
        id: u64,
    },
    /// The wall clock was set while the instrument was working. Stamps go on as if it had not been.
    #[error("the system's clock stepped by {:+.3} s; stamps keep to the time at the start", *by_ns as f64 * 1e-9)]
    ClockStepped {
        /// By how much; negative where it went back.
        by_ns: i64,
    },
    /// The device can't do this at all.
    #[error("{device}: cannot {what}; {mend}")]
    Unsupported {
        /// Which device.
        device: String,
        /// What it can't do, as an infinitive.
        what: String,
        /// What to do.
        mend: String,
    },
    /// Calls in an order that makes no sense, such as a frame of a camera that is not armed.
    #[error("{device}: {doing} needs {needed} first")]
    Order {
        /// Which device.
        device: String,
        /// What was asked.
        doing: &'static str,
        /// What must come before it.
        needed: &'static str,
    },
    /// The interlock has put the laser off, and it stays off.
    #[error("the laser is off and stays off: {reason}")]
    Stopped {
        /// Why.
        reason: String,
    },
}

impl Fault {
    /// Whether the device goes on by itself: one frame is lost or came twice, and the next call may well succeed.
    pub fn is_passing(&self) -> bool {
        matches!(
            self,
            Self::DroppedFrames { .. }
                | Self::DuplicateFrame { .. }
                | Self::FrameContent { .. }
                | Self::ClockStepped { .. }
        )
    }
}

fn heard(got: &str) -> String {
    if got.is_empty() { String::new() } else { format!(": only {got:?} came") }
}
