//! Where a scan puts what it has, and from where sessions take it.
//!
//! Nothing here waits for the network: each thing has one place, in which the latest wins, and every lock is held for as long as it
//! takes to swap it. Points go to a [`Cloud`] of their own, bounded; of images and stripes a few are kept.

mod told;

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::watch;

use crate::cloud::{Cloud, Point};

pub use told::{About, Laser, Level, Mode, Phase, Picture, State, Stripe, Timeline};
pub(crate) use told::{Note, Shown};

/// Images that wait for their stripe.
const IMAGES: usize = 8;
/// Stripes that are kept for the stream.
const STRIPES: usize = 64;
/// Lines for people that a client gets again when it comes back.
const NOTES: usize = 200;

/// A value and how often it was set.
#[derive(Clone, Debug, Default)]
pub(crate) struct Versioned<T> {
    pub value: T,
    pub version: u64,
}

impl<T> Versioned<T> {
    fn set(&mut self, value: T) {
        self.value = value;
        self.version += 1;
    }
}

/// All that is shown but the cloud; cheap to clone.
#[derive(Clone, Debug, Default)]
pub(crate) struct Board {
    pub about: Versioned<Arc<About>>,
    pub settings: Versioned<Arc<Vec<(String, f64)>>>,
    pub state: Versioned<Arc<State>>,
    /// Changes where the state is to be told at once.
    pub urgent: u64,
    pub shown: Versioned<Option<Shown>>,
    pub stripe: Versioned<Option<Arc<Stripe>>>,
    pub timeline: Versioned<Option<Timeline>>,
    /// How many notes there ever were.
    pub noted: u64,
}

#[derive(Default)]
struct Held {
    board: Board,
    images: VecDeque<Arc<Picture>>,
    notes: VecDeque<Arc<Note>>,
    stripes: VecDeque<Arc<Stripe>>,
    stripes_came: u64,
}

pub(crate) struct Shared {
    held: Mutex<Held>,
    cloud: Mutex<Cloud>,
    pub wake: watch::Sender<u64>,
}

impl Shared {
    pub fn new() -> Arc<Self> {
        // Runs differ in their clouds' names: a client that comes back to another run begins anew.
        let generation = (now_ns() / 1_000_000) as u32;
        Arc::new(Self {
            held: Mutex::default(),
            cloud: Mutex::new(Cloud::new(generation)),
            wake: watch::Sender::new(0),
        })
    }

    fn held(&self) -> MutexGuard<'_, Held> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn cloud(&self) -> MutexGuard<'_, Cloud> {
        self.cloud.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn board(&self) -> Board {
        self.held().board.clone()
    }

    /// Notes from the `first`th on that are still kept.
    pub fn notes(&self, first: u64) -> Vec<Arc<Note>> {
        let held = self.held();
        let oldest = held.board.noted - held.notes.len() as u64;
        held.notes.iter().skip(first.saturating_sub(oldest) as usize).cloned().collect()
    }

    /// Stripes from the `first`th on that are still kept, and the number of the next one.
    pub fn stripes(&self, first: u64) -> (Vec<Arc<Stripe>>, u64) {
        let held = self.held();
        let oldest = held.stripes_came - held.stripes.len() as u64;
        let skip = first.saturating_sub(oldest) as usize;
        (held.stripes.iter().skip(skip).cloned().collect(), held.stripes_came)
    }

    /// Tells sessions that the state is to be told at once.
    pub fn urge(&self) {
        self.held().board.urgent += 1;
        self.wake();
    }

    pub fn wake(&self) {
        self.wake.send_modify(|count| *count = count.wrapping_add(1));
    }

    pub fn note(&self, level: Level, text: impl Into<String>) {
        let mut held = self.held();
        if held.notes.len() == NOTES {
            held.notes.pop_front();
        }
        held.notes.push_back(Arc::new(Note { level, text: text.into(), stamp_ns: now_ns() }));
        held.board.noted += 1;
        drop(held);
        self.wake();
    }
}

/// Now, nanoseconds since the Unix epoch.
pub fn now_ns() -> u64 {
    let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    since.map_or(0, |since| u64::try_from(since.as_nanos()).unwrap_or(u64::MAX))
}

/// Takes what a scan has, from any of its threads, and never waits for the network.
#[derive(Clone)]
pub struct Feed {
    pub(crate) shared: Arc<Shared>,
}

impl std::fmt::Debug for Feed {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Feed").finish_non_exhaustive()
    }
}

impl Feed {
    /// What stays as it is from now on.
    pub fn about(&self, about: About) {
        self.shared.held().board.about.set(Arc::new(about));
        self.shared.wake();
    }

    /// What Foxglove's tools may ask to be set ([`crate::Action::Set`]), and read: names and values as they are from now on.
    pub fn settings(&self, settings: Vec<(String, f64)>) {
        self.shared.held().board.settings.set(Arc::new(settings));
        self.shared.wake();
    }

    /// How the scan is. A change of phase or laser, or an end, is told at once.
    pub fn state(&self, state: State) {
        let mut held = self.shared.held();
        let was = &held.board.state.value;
        let urgent = was.phase != state.phase || was.laser != state.laser || was.ended != state.ended;
        held.board.state.set(Arc::new(state));
        held.board.urgent += u64::from(urgent);
        drop(held);
        self.shared.wake();
    }

    /// Empties the cloud, and forgets images and stripes.
    pub fn restart(&self) {
        self.shared.cloud().restart();
        let mut held = self.shared.held();
        (held.images, held.stripes) = Default::default();
        (held.board.shown, held.board.stripe) = {
            let (shown, stripe) = (held.board.shown.version, held.board.stripe.version);
            (Versioned { value: None, version: shown + 1 }, Versioned { value: None, version: stripe + 1 })
        };
        drop(held);
        self.shared.wake();
    }

    /// An image. It is shown with its stripe where that follows soon, else without.
    pub fn image(&self, picture: Picture) {
        let picture = Arc::new(picture);
        let mut held = self.shared.held();
        if held.images.len() == IMAGES {
            let late = held.images.pop_front();
            let shown = held.board.shown.value.as_ref().map(|shown| shown.picture.frame);
            if let Some(late) = late.filter(|late| shown.is_none_or(|shown| shown < late.frame)) {
                // Nobody finds stripes, or not fast enough.
                held.board.shown.set(Some(Shown { picture: late, stripe: None }));
            }
        }
        held.images.push_back(picture);
        drop(held);
        self.shared.wake();
    }

    /// An image that gets no stripe, shown at once.
    pub fn bare_image(&self, picture: Picture) {
        let shown = Shown { picture: Arc::new(picture), stripe: None };
        self.shared.held().board.shown.set(Some(shown));
        self.shared.wake();
    }

    /// The stripe and the points of an image.
    pub fn stripe(&self, stripe: impl Into<Arc<Stripe>>) {
        let stripe = stripe.into();
        self.shared.cloud().extend(points(&stripe));
        let mut held = self.shared.held();
        let at = held.images.iter().position(|picture| picture.frame == stripe.frame);
        if let Some(at) = at {
            let picture = held.images.drain(..=at).next_back();
            if let Some(picture) = picture {
                held.board.shown.set(Some(Shown { picture, stripe: Some(stripe.clone()) }));
            }
        }
        if held.stripes.len() == STRIPES {
            held.stripes.pop_front();
        }
        held.stripes.push_back(stripe.clone());
        held.stripes_came += 1;
        held.board.stripe.set(Some(stripe));
        drop(held);
        self.shared.wake();
    }

    /// Points of an image that is not shown now.
    pub fn points(&self, stripe: &Stripe) {
        self.shared.cloud().extend(points(stripe));
        self.shared.wake();
    }

    /// A line for people: what went wrong, in plain words.
    pub fn note(&self, level: Level, text: impl Into<String>) {
        self.shared.note(level, text);
    }

    /// Where a replay is.
    pub fn timeline(&self, timeline: Timeline) {
        self.shared.held().board.timeline.set(Some(timeline));
        self.shared.wake();
    }
}

/// The points of a stripe as clients get them.
fn points(stripe: &Stripe) -> impl Iterator<Item = Point> + '_ {
    let intensities = stripe.cloud.intensities();
    stripe.cloud.positions_mm().iter().enumerate().map(move |(i, position)| {
        let share = intensities.map_or(1.0, |values| values[i] / stripe.full_scale.max(1.0));
        Point { position_mm: position.map(|x| x as f32), brightness: (share.clamp(0.0, 1.0) * 255.0) as u8 }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use uw_calib::Across;
    use uw_cloud::PointCloud;
    use uw_hw::frame::Layout;
    use uw_hw::{Exposure, Frame, Pixels};

    fn picture(frame: u32) -> Picture {
        let exposure = Exposure { stamp_ns: 0, exposure_ns: 0, received_ns: 0 };
        let image = Frame::new(Pixels::from(vec![0_u8; 4]), Layout::packed(2, 2, 8), 0, exposure).unwrap();
        Picture { frame, stamp_ns: 0, laser_on: true, voltage_v: Some(0.0), image }
    }

    fn stripe(frame: u32) -> Stripe {
        Stripe {
            frame,
            stamp_ns: 0,
            voltage_v: 0.0,
            across: Across::U,
            all_lines: 2,
            lines: vec![],
            position_px: vec![],
            sigma_px: vec![],
            width_px: vec![],
            amplitude: vec![],
            full_scale: 255.0,
            cloud: PointCloud::default(),
        }
    }

    fn shown(feed: &Feed) -> Option<(u32, bool)> {
        feed.shared.board().shown.value.map(|shown| (shown.picture.frame, shown.stripe.is_some()))
    }

    #[test]
    fn an_image_is_shown_with_its_own_stripe_or_late_without() {
        let feed = Feed { shared: Shared::new() };
        (0..3).for_each(|frame| feed.image(picture(frame)));
        assert_eq!(shown(&feed), None);
        feed.stripe(stripe(1));
        assert_eq!(shown(&feed), Some((1, true)));
        feed.stripe(stripe(0));
        assert_eq!(shown(&feed), Some((1, true)), "an image that was left behind");
        (3..30).for_each(|frame| feed.image(picture(frame)));
        assert_eq!(shown(&feed), Some((21, false)));
        feed.restart();
        assert_eq!(shown(&feed), None);
    }

    #[test]
    fn the_last_notes_and_stripes_are_kept() {
        let feed = Feed { shared: Shared::new() };
        (0..500).for_each(|i| feed.note(Level::Info, i.to_string()));
        let texts = |first| feed.shared.notes(first).iter().map(|n| n.text.clone()).collect::<Vec<_>>();
        assert_eq!(texts(0).len(), 200);
        assert_eq!(texts(498), ["498", "499"]);
        assert!(texts(500).is_empty());
        (0..100).for_each(|frame| feed.stripe(stripe(frame)));
        let (stripes, next) = feed.shared.stripes(98);
        assert_eq!((stripes.len(), stripes[0].frame, next), (2, 98, 100));
    }
}
