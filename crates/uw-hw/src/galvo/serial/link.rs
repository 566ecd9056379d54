//! Question and answer over a port, each line within its time.

use std::{
    io::{self, ErrorKind},
    sync::{Arc, Mutex, PoisonError},
    time::Duration,
};

use serialport::SerialPort;

use super::ports::{self, Port};
use crate::{
    Deadline, Fault, Identity, Timeline,
    galvo::proto::{Command, Dialect, Line, Lines, Outgoing, Pattern, Reply},
};

/// The longest wait for bytes: deadlines are looked at this often at least.
const LOOK: Duration = Duration::from_millis(20);
/// A controller that has been quiet for so long has said what it had to say.
const QUIET: Duration = Duration::from_millis(30);
/// Bytes thrown away at most when the line is cleared: a controller that never stops talking is another fault.
const MOST_STALE: usize = 1 << 16;
/// Errors that a controller's queue may hold: one that never ends is no queue.
const MOST_ERRORS: usize = 64;

/// A link that galvanometer and laser share where one controller drives both.
pub type SharedLink = Arc<Mutex<Link>>;

/// A controller that was asked who it is.
pub struct Link {
    port: Port,
    open: Option<Box<dyn SerialPort>>,
    dialect: Dialect,
    lines: Lines,
    timeline: Timeline,
    identity: Identity,
    /// The line by which the controller is known again; `None` where its dialect has no such command.
    known_by: Option<String>,
    /// An answer may still be under way that nobody waits for.
    stale: bool,
    /// What its queue of errors held when it was opened.
    left_errors: Vec<String>,
}

impl std::fmt::Debug for Link {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Link")
            .field("port", &self.port)
            .field("identity", &self.identity)
            .finish_non_exhaustive()
    }
}

impl Link {
    /// Opens the port, asks the controller who it is, and empties its queue of errors: one that an earlier program left would be taken for the answer
    /// to the first command ([`Self::left_errors`] has them). `timeline` must be on the machine's clocks: a port knows no other time.
    ///
    /// # Errors
    /// [`Fault::Open`]; [`Fault::Timeout`] for a controller that doesn't answer, as one does at another speed.
    pub fn open(port: Port, dialect: Dialect, timeline: Timeline, within: Duration) -> Result<Self, Fault> {
        let opened = ports::open(&port)?;
        let lines = Lines::new(dialect.end(), dialect.longest_line());
        let identity = Identity { driver: "scpi".into(), place: port.name.clone(), ..Identity::default() };
        let mut link = Self {
            port,
            open: Some(opened),
            dialect,
            lines,
            timeline,
            identity,
            known_by: None,
            stale: false,
            left_errors: Vec::new(),
        };
        link.introduce(within)?;
        // A controller that can't say will be told of when it is asked in earnest.
        if let Ok(errors) = link.errors(within) {
            link.left_errors = errors;
        }
        Ok(link)
    }

    /// The link, shared.
    pub fn shared(self) -> SharedLink {
        Arc::new(Mutex::new(self))
    }

    /// Who the controller says it is.
    pub fn identity(&self) -> Identity {
        self.identity.clone()
    }

    /// The errors that the controller's queue held when it was opened: code and text.
    pub fn left_errors(&self) -> &[String] {
        &self.left_errors
    }

    /// Empties the controller's queue of errors: code and text of each; none where its dialect has no such question.
    ///
    /// # Errors
    /// As [`Self::ask`].
    pub fn errors(&mut self, within: Duration) -> Result<Vec<String>, Fault> {
        let mut said = Vec::new();
        while said.len() < MOST_ERRORS {
            match self.ask(Command::Error, within)? {
                Some(reply) if !Dialect::is_no_error(&reply) => {
                    let Reply { code, text, .. } = reply;
                    said.push(format!("{} {}", code.unwrap_or_default(), text.unwrap_or_default()));
                }
                _ => break,
            }
        }
        Ok(said)
    }

    /// The controller's dialect.
    pub fn dialect(&self) -> &Dialect {
        &self.dialect
    }

    pub(super) fn timeline(&self) -> &Timeline {
        &self.timeline
    }

    pub(super) fn name(&self) -> String {
        crate::limits::name(&self.identity)
    }

    fn introduce(&mut self, within: Duration) -> Result<(), Fault> {
        if !self.dialect.has(Command::Identify) {
            return Ok(());
        }
        let deadline = self.timeline.deadline(within);
        // What an earlier owner of the port left half said is ended here, and what the controller still says about that is thrown away.
        self.write(&[self.dialect.end()], "who it is", deadline)?;
        self.drain(deadline, "who it is")?;
        let mut said = self.identify(deadline)?;
        // An old line could have been taken for the answer: it is who it is when it says so twice.
        loop {
            let again = self.identify(deadline)?;
            if again == said {
                break;
            }
            said = again;
        }
        let mut parts = said.splitn(4, ',').map(|part| part.trim().to_owned());
        let mut next = || parts.next().unwrap_or_default();
        let Identity { driver, place, .. } = self.identity.clone();
        let (vendor, model, serial, firmware) = (next(), next(), next(), next());
        self.identity = Identity { driver, place, vendor, model, serial, firmware };
        self.known_by = Some(said);
        self.stale = false;
        Ok(())
    }

    fn identify(&mut self, deadline: Deadline) -> Result<String, Fault> {
        let reply = self.exchange(Command::Identify, deadline)?;
        Ok(reply.and_then(|reply| reply.text).unwrap_or_default())
    }

    /// Sends a command and gives its reply; `None` where the dialect has no such command.
    ///
    /// # Errors
    /// [`Fault::Timeout`], [`Fault::Protocol`], [`Fault::Disconnected`].
    pub fn ask(&mut self, command: Command, within: Duration) -> Result<Option<Reply>, Fault> {
        let deadline = self.timeline.deadline(within);
        self.ask_by(command, deadline)
    }

    pub(super) fn ask_by(&mut self, command: Command, deadline: Deadline) -> Result<Option<Reply>, Fault> {
        if self.stale {
            self.resynchronise(deadline)?;
        }
        self.exchange(command, deadline)
    }

    /// Sends a command that does something: waits until it is done, and asks whether the controller minded.
    pub(super) fn tell(&mut self, command: Command, deadline: Deadline) -> Result<(), Fault> {
        if self.ask_by(command, deadline)?.is_none() {
            return Err(Fault::Unsupported {
                device: self.name(),
                what: format!("do {}", command.name()),
                mend: "its dialect has no such command: add it there, if the controller has one".into(),
            });
        }
        self.ask_by(Command::Complete, deadline)?;
        match self.ask_by(Command::Error, deadline)? {
            Some(reply) if !Dialect::is_no_error(&reply) => {
                let doing = self.dialect.outgoing(command).map(|outgoing| outgoing.text).unwrap_or_default();
                let (code, text) = (reply.code.unwrap_or_default(), reply.text.unwrap_or_default());
                Err(Fault::Refused { device: self.name(), doing, reason: format!("{code} {text}") })
            }
            _ => Ok(()),
        }
    }

    /// Sends a command without waiting for anything, whatever state the line is in; opens the port again if it was lost.
    pub(super) fn shout(&mut self, command: Command, deadline: Deadline) -> Result<(), Fault> {
        if self.open.is_none() {
            self.open = Some(ports::open(&self.port)?);
        }
        let Some(Outgoing { bytes, text, .. }) = self.dialect.outgoing(command) else { return Ok(()) };
        self.stale = true;
        self.write(&bytes, &text, deadline)
    }

    /// Whether an answer may still be under way, or the port is gone.
    pub(super) fn is_disturbed(&self) -> bool {
        self.stale || self.open.is_none()
    }

    /// Throws away what belongs to earlier questions: the controller is asked who it is, and all before that answer is old.
    fn resynchronise(&mut self, deadline: Deadline) -> Result<(), Fault> {
        let doing = "resynchronising";
        self.drain(deadline, doing)?;
        if let (Some(known_by), Some(outgoing)) =
            (self.known_by.clone(), self.dialect.outgoing(Command::Identify))
        {
            let bytes = outgoing.bytes;
            self.write(&bytes, doing, deadline)?;
            while self.line(deadline, doing)? != Line::Text(known_by.clone()) {}
        }
        self.stale = false;
        Ok(())
    }

    /// One question and its answer.
    fn exchange(&mut self, command: Command, deadline: Deadline) -> Result<Option<Reply>, Fault> {
        let Some(Outgoing { bytes, text, reply }) = self.dialect.outgoing(command) else { return Ok(None) };
        let pattern: Option<Pattern> = reply.cloned();
        // From here on an answer may come; only one that was taken is out of the way.
        self.stale = true;
        self.write(&bytes, &text, deadline)?;
        let Some(pattern) = pattern else {
            self.stale = false;
            return Ok(Some(Reply::default()));
        };
        let line = self.line(deadline, &text)?;
        let got = match &line {
            Line::Text(got) => got.clone(),
            Line::TooLong => format!("a line of more than {} bytes", self.dialect.longest_line()),
        };
        match pattern.matches(&got).filter(|_| line != Line::TooLong) {
            Some(reply) => {
                self.stale = false;
                Ok(Some(reply))
            }
            None => {
                let needed = pattern.text().to_owned();
                Err(Fault::Protocol { device: self.name(), doing: text, needed, got })
            }
        }
    }

    /// The next line.
    fn line(&mut self, deadline: Deadline, doing: &str) -> Result<Line, Fault> {
        loop {
            if let Some(line) = self.lines.next_line() {
                return Ok(line);
            }
            let Some(left) = self.timeline.left(deadline) else {
                let waited = self.timeline.waited(deadline);
                let got = self.lines.part();
                return Err(Fault::Timeout { device: self.name(), doing: doing.into(), waited, got });
            };
            self.read(left.min(LOOK), doing)?;
        }
    }

    /// Throws away what comes until the controller is quiet.
    fn drain(&mut self, deadline: Deadline, doing: &str) -> Result<(), Fault> {
        let mut stale = 0;
        while let Some(left) = self.timeline.left(deadline) {
            let came = self.read(left.min(QUIET), doing)?;
            self.lines.clear();
            stale += came;
            if came == 0 || stale > MOST_STALE {
                break;
            }
        }
        Ok(())
    }

    /// Takes what comes within the time; how many bytes.
    fn read(&mut self, within: Duration, doing: &str) -> Result<usize, Fault> {
        let mut bytes = [0; 512];
        let read = match &mut self.open {
            Some(port) => {
                port.set_timeout(within).map_err(io::Error::from).and_then(|()| port.read(&mut bytes))
            }
            None => Err(io::Error::new(ErrorKind::NotConnected, "it was lost before")),
        };
        match read {
            Ok(0) => Err(self.lost(doing, "the port was closed at the other end")),
            Ok(count) => {
                self.lines.push(&bytes[..count]);
                Ok(count)
            }
            Err(e)
                if matches!(
                    e.kind(),
                    ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted
                ) =>
            {
                Ok(0)
            }
            Err(e) => Err(self.lost(doing, &e.to_string())),
        }
    }

    fn write(&mut self, bytes: &[u8], doing: &str, deadline: Deadline) -> Result<(), Fault> {
        let mut rest = bytes;
        while !rest.is_empty() {
            let Some(left) = self.timeline.left(deadline) else {
                let waited = self.timeline.waited(deadline);
                return Err(Fault::Timeout {
                    device: self.name(),
                    doing: doing.into(),
                    waited,
                    got: String::new(),
                });
            };
            let wrote = match &mut self.open {
                Some(port) => {
                    port.set_timeout(left.min(LOOK)).map_err(io::Error::from).and_then(|()| port.write(rest))
                }
                None => Err(io::Error::new(ErrorKind::NotConnected, "it was lost before")),
            };
            match wrote {
                Ok(0) => return Err(self.lost(doing, "nothing can be written any more")),
                Ok(count) => rest = &rest[count..],
                Err(e)
                    if matches!(
                        e.kind(),
                        ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted
                    ) => {}
                Err(e) => return Err(self.lost(doing, &e.to_string())),
            }
        }
        Ok(())
    }

    fn lost(&mut self, doing: &str, reason: &str) -> Fault {
        self.open = None;
        self.stale = true;
        self.lines.clear();
        Fault::Disconnected { device: self.name(), doing: doing.into(), reason: reason.into() }
    }
}

pub(super) fn lock(link: &SharedLink) -> std::sync::MutexGuard<'_, Link> {
    link.lock().unwrap_or_else(PoisonError::into_inner)
}
