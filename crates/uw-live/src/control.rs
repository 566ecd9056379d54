//! What clients may ask for, and who may ask for it.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use serde::Deserialize;
use tokio::sync::{Notify, oneshot};

/// What a scan can be asked for.
#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    /// Scan now: a station that is idle.
    Start,
    /// Hold between two exposures, the laser off.
    Pause,
    /// Go on where it was held.
    Resume,
    /// End the scan and keep what there is.
    Stop,
    /// Laser off at once, whatever else happens; the scan ends by that.
    LaserOff,
    /// Something of a replay.
    Replay(Replay),
    /// Another value of a setting ([`crate::Feed::settings`]).
    Set {
        /// Its name.
        name: String,
        /// Finite.
        value: f64,
    },
}

impl Action {
    /// Whether anybody may ask for it who has the right to control, without the controller's place.
    pub fn at_any_time(&self) -> bool {
        matches!(self, Self::Stop | Self::LaserOff | Self::Replay(_))
    }

    /// In words, for logs.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Start => "start",
            Self::Pause => "pause",
            Self::Resume => "resume",
            Self::Stop => "stop",
            Self::LaserOff => "laser off",
            Self::Replay(_) => "replay",
            Self::Set { .. } => "another setting",
        }
    }
}

/// What a replay can be asked for.
#[derive(Clone, Debug, PartialEq)]
pub enum Replay {
    /// Show another capture, by its name.
    Open(String),
    /// Go on.
    Play,
    /// Hold.
    Pause,
    /// Show this frame next: its place among the images, from 0.
    Seek(u32),
    /// So many times as fast as it was recorded.
    Rate(f64),
}

impl Replay {
    /// [`Replay::Rate`]; `None` where that is out of range.
    pub fn rate(rate: f64) -> Option<Self> {
        (0.01..=100.0).contains(&rate).then_some(Self::Rate(rate))
    }
}

/// A request and who made it. Dropped without an answer, it is refused.
#[derive(Debug)]
pub struct Asked {
    /// What for.
    pub action: Action,
    /// The client's name and address.
    pub who: String,
    answer: Answer,
}

impl Asked {
    pub(crate) fn new(action: Action, who: String, outbox: Arc<Outbox>, id: u64) -> Self {
        Self { action, who, answer: Answer { to: Some(To::Client(outbox, id)) } }
    }

    /// With an answer that somebody waits for: why it is not done.
    pub(crate) fn awaited(action: Action, who: String) -> (Self, oneshot::Receiver<Option<String>>) {
        let (to, answer) = oneshot::channel();
        (Self { action, who, answer: Answer { to: Some(To::Waiting(to)) } }, answer)
    }

    /// It is done.
    pub fn done(mut self) {
        self.answer.give(None);
    }

    /// It is not done, and why.
    pub fn refuse(mut self, why: &str) {
        self.answer.give(Some(why));
    }
}

#[derive(Debug)]
struct Answer {
    to: Option<To>,
}

/// To whom an answer goes.
#[derive(Debug)]
enum To {
    Client(Arc<Outbox>, u64),
    Waiting(oneshot::Sender<Option<String>>),
}

impl Answer {
    fn give(&mut self, error: Option<&str>) {
        match self.to.take() {
            Some(To::Client(outbox, id)) => outbox.answer(id, error),
            // Who waited may be gone.
            Some(To::Waiting(to)) => drop(to.send(error.map(str::to_owned))),
            None => {}
        }
    }
}

impl Drop for Answer {
    fn drop(&mut self) {
        self.give(Some("nobody took it: the scan has ended, or never began"));
    }
}

/// Most answers that wait for a client.
const MOST_ANSWERS: usize = 256;

/// Answers on their way to a client.
#[derive(Debug, Default)]
pub(crate) struct Outbox {
    waiting: Mutex<VecDeque<String>>,
    pub(crate) wake: Notify,
}

impl Outbox {
    pub(crate) fn answer(&self, id: u64, error: Option<&str>) {
        self.put(&serde_json::json!({"type": "answer", "id": id, "ok": error.is_none(), "error": error}));
    }

    pub(crate) fn put(&self, message: &serde_json::Value) {
        let mut waiting = self.waiting();
        if waiting.len() >= MOST_ANSWERS {
            waiting.pop_front();
        }
        waiting.push_back(message.to_string());
        drop(waiting);
        self.wake.notify_one();
    }

    pub(crate) fn take(&self) -> Option<String> {
        self.waiting().pop_front()
    }

    fn waiting(&self) -> MutexGuard<'_, VecDeque<String>> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The one place from which a scan is steered.
#[derive(Debug, Default)]
pub(crate) struct Seat(Mutex<Option<(u64, String)>>);

impl Seat {
    fn held(&self) -> MutexGuard<'_, Option<(u64, String)>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes it where it is free.
    ///
    /// # Errors
    /// The name of who has it.
    pub fn take(&self, client: u64, name: &str) -> Result<(), String> {
        let mut held = self.held();
        match &*held {
            Some((holder, other)) if *holder != client => Err(other.clone()),
            _ => {
                *held = Some((client, name.to_owned()));
                Ok(())
            }
        }
    }

    /// Gives it back; whether the client had it.
    pub fn release(&self, client: u64) -> bool {
        let mut held = self.held();
        let had = held.as_ref().is_some_and(|(holder, _)| *holder == client);
        if had {
            *held = None;
        }
        had
    }

    /// Who has it: name, and whether it is this client.
    pub fn holder(&self, client: u64) -> (Option<String>, bool) {
        let held = self.held();
        (held.as_ref().map(|(_, name)| name.clone()), held.as_ref().is_some_and(|(id, _)| *id == client))
    }
}

/// The words of a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Word {
    /// Take the controller's place.
    TakeControl,
    /// Give it back.
    ReleaseControl,
    /// [`Action::Start`].
    Start,
    /// [`Action::Pause`].
    Pause,
    /// [`Action::Resume`].
    Resume,
    /// [`Action::Stop`].
    Stop,
    /// [`Action::LaserOff`].
    LaserOff,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_client_at_a_time_steers() {
        let seat = Seat::default();
        seat.take(1, "bow").unwrap();
        seat.take(1, "bow").unwrap();
        assert_eq!(seat.take(2, "stern").unwrap_err(), "bow");
        assert!(!seat.release(2) && seat.release(1));
        seat.take(2, "stern").unwrap();
        assert_eq!(seat.holder(1), (Some("stern".to_owned()), false));
    }

    #[test]
    fn what_nobody_answers_is_refused() {
        let outbox = Arc::new(Outbox::default());
        drop(Asked::new(Action::Stop, "x".to_owned(), outbox.clone(), 3));
        Asked::new(Action::Stop, "x".to_owned(), outbox.clone(), 4).done();
        let texts: Vec<String> = std::iter::from_fn(|| outbox.take()).collect();
        assert!(texts[0].contains("\"ok\":false") && texts[0].contains("\"id\":3"), "{texts:?}");
        assert!(texts[1].contains("\"ok\":true") && texts.len() == 2, "{texts:?}");
        (0..1000).for_each(|id| outbox.answer(id, None));
        assert_eq!(std::iter::from_fn(|| outbox.take()).count(), MOST_ANSWERS);
    }
}
