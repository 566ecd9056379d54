//! What is sent for each command.

use super::{Pattern, pattern::Reply};

/// What a controller can be told or asked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Command {
    /// Who it is.
    Identify,
    /// Back to the state after switching on.
    Reset,
    /// Sends the mirror to a voltage, V.
    SetVolts(f64),
    /// Where it is, V.
    ReadVolts,
    /// Answers once all that was sent before is done.
    Complete,
    /// The oldest error that nobody has asked for yet.
    Error,
    /// Switches the laser on.
    LaserOn,
    /// Switches the laser off.
    LaserOff,
    /// Whether the laser is on.
    LaserState,
    /// Sets the laser's power, 0 to 1.
    LaserPower(f64),
}

impl Command {
    /// All commands, by the names that a dialect's table has for them.
    pub const NAMED: [(&'static str, Self); 10] = [
        ("identify", Self::Identify),
        ("reset", Self::Reset),
        ("set_volts", Self::SetVolts(0.0)),
        ("read_volts", Self::ReadVolts),
        ("complete", Self::Complete),
        ("error", Self::Error),
        ("laser_on", Self::LaserOn),
        ("laser_off", Self::LaserOff),
        ("laser_state", Self::LaserState),
        ("laser_power", Self::LaserPower(0.0)),
    ];

    fn index(self) -> usize {
        match self {
            Self::Identify => 0,
            Self::Reset => 1,
            Self::SetVolts(_) => 2,
            Self::ReadVolts => 3,
            Self::Complete => 4,
            Self::Error => 5,
            Self::LaserOn => 6,
            Self::LaserOff => 7,
            Self::LaserState => 8,
            Self::LaserPower(_) => 9,
        }
    }

    /// The name that a dialect's table has for it.
    pub fn name(self) -> &'static str {
        Self::NAMED[self.index()].0
    }

    /// The placeholder of its value, and the field that its reply must have.
    fn needs(self) -> (Option<&'static str>, Option<&'static str>) {
        match self {
            Self::SetVolts(_) => (Some("{v}"), None),
            Self::LaserPower(_) => (Some("{p}"), None),
            Self::ReadVolts => (None, Some("{v}")),
            Self::Error => (None, Some("{code}")),
            Self::LaserState => (None, Some("{on}")),
            Self::Identify => (None, Some("{text}")),
            _ => (None, None),
        }
    }
}

/// What is sent, and the reply that is waited for; none where the controller says nothing.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Exchange {
    send: String,
    reply: Option<Pattern>,
}

/// Why a table is no dialect.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{what}; {mend}")]
pub struct DialectError {
    /// The command that it is about; empty for the whole.
    pub command: String,
    /// What is wrong.
    pub what: String,
    /// What to do.
    pub mend: String,
}

/// How a controller is spoken to.
#[derive(Clone, Debug, PartialEq)]
pub struct Dialect {
    terminator: String,
    longest_line: usize,
    decimals: usize,
    exchanges: [Option<Exchange>; 10],
}

/// What is to be sent.
#[derive(Clone, Debug, PartialEq)]
pub struct Outgoing<'a> {
    /// The bytes, with the line's end.
    pub bytes: Vec<u8>,
    /// The line, for messages.
    pub text: String,
    /// The reply that is waited for.
    pub reply: Option<&'a Pattern>,
}

/// The longest line that a dialect may allow, bytes.
const LONGEST_LINE: usize = 1 << 16;
/// More decimals of a volt than any drive resolves.
const MOST_DECIMALS: usize = 12;

impl Dialect {
    /// IEEE 488.2 and SCPI-99: `*IDN?`, `*RST`, `SOUR:VOLT {v}`, `SOUR:VOLT?`, `*OPC?`, `SYST:ERR?`, `OUTP ON|OFF`, `OUTP?`; lines end with LF,
    /// and a CR before it is accepted. The laser's power has no command of its own.
    pub fn scpi() -> Self {
        let mut dialect =
            Self { terminator: "\n".into(), longest_line: 1024, decimals: 6, exchanges: Default::default() };
        for (command, send, reply) in [
            (Command::Identify, "*IDN?", Some("{text}")),
            (Command::Reset, "*RST", None),
            (Command::SetVolts(0.0), "SOUR:VOLT {v}", None),
            (Command::ReadVolts, "SOUR:VOLT?", Some("{v}")),
            (Command::Complete, "*OPC?", Some("1")),
            (Command::Error, "SYST:ERR?", Some("{code},{text}")),
            (Command::LaserOn, "OUTP ON", None),
            (Command::LaserOff, "OUTP OFF", None),
            (Command::LaserState, "OUTP?", Some("{on}")),
        ] {
            let reply = reply.and_then(|text| Pattern::parse(text).ok());
            dialect.exchanges[command.index()] = Some(Exchange { send: send.into(), reply });
        }
        dialect
    }

    /// Lines end so; the last byte is also what a reply ends with.
    ///
    /// # Errors
    /// [`DialectError`] for one that is none: `\n`, `\r\n` and `\r` are.
    pub fn with_terminator(mut self, terminator: &str) -> Result<Self, DialectError> {
        if !["\n", "\r\n", "\r"].contains(&terminator) {
            return Err(DialectError {
                command: String::new(),
                what: format!("a line can't end with {terminator:?}"),
                mend: "use \"\\n\", \"\\r\\n\" or \"\\r\"".into(),
            });
        }
        self.terminator = terminator.into();
        Ok(self)
    }

    /// Replies are at most so long, bytes.
    ///
    /// # Errors
    /// [`DialectError`] outside 16 to 65536.
    pub fn with_longest_line(mut self, longest_line: usize) -> Result<Self, DialectError> {
        if !(16..=LONGEST_LINE).contains(&longest_line) {
            return Err(DialectError {
                command: String::new(),
                what: format!("{longest_line} bytes are no line's length"),
                mend: format!("give a number from 16 to {LONGEST_LINE}"),
            });
        }
        self.longest_line = longest_line;
        Ok(self)
    }

    /// Values are sent with so many decimals.
    ///
    /// # Errors
    /// [`DialectError`] above 12.
    pub fn with_decimals(mut self, decimals: usize) -> Result<Self, DialectError> {
        if decimals > MOST_DECIMALS {
            return Err(DialectError {
                command: String::new(),
                what: format!("{decimals} decimals of a volt are more than any drive resolves"),
                mend: format!("give a number from 0 to {MOST_DECIMALS}"),
            });
        }
        self.decimals = decimals;
        Ok(self)
    }

    /// Another exchange for a command; an empty `send` where the controller has none.
    ///
    /// # Errors
    /// [`DialectError`] for a placeholder that is missing or unknown, or a reply that doesn't say what is needed.
    pub fn with(mut self, command: Command, send: &str, reply: Option<&str>) -> Result<Self, DialectError> {
        let error = |what: String, mend: &str| DialectError {
            command: command.name().into(),
            what,
            mend: mend.into(),
        };
        if send.is_empty() {
            if matches!(command, Command::SetVolts(_) | Command::ReadVolts) {
                return Err(error("no galvanometer does without this".into(), "say what is to be sent"));
            }
            self.exchanges[command.index()] = None;
            return Ok(self);
        }
        if send.chars().any(char::is_control) {
            let what = format!("{send:?} holds a line's end or another control character");
            return Err(error(what, "leave it out: the line's end is `terminator`"));
        }
        let (placeholder, field) = command.needs();
        let bare = match placeholder {
            Some(placeholder) if !send.contains(placeholder) => {
                let what = format!("{send:?} says no value");
                return Err(error(what, &format!("put {placeholder} where the value goes")));
            }
            Some(placeholder) => send.replace(placeholder, ""),
            None => send.to_owned(),
        };
        if bare.contains(['{', '}']) {
            let what = format!("{send:?} has a placeholder that is not known");
            return Err(error(what, "{v} is a voltage, {p} the laser's power, and other commands have none"));
        }
        let reply =
            reply.map(Pattern::parse).transpose().map_err(|why| error(why, "mend the reply's pattern"))?;
        if let Some(field) = field
            && !reply.as_ref().is_some_and(|pattern| pattern.text().contains(field))
        {
            let what = format!("the reply doesn't say what {} asks for", command.name());
            return Err(error(what, &format!("give a reply with {field}")));
        }
        self.exchanges[command.index()] = Some(Exchange { send: send.into(), reply });
        Ok(self)
    }

    /// What to send; `None` where the controller has no such command. A value that is not finite is sent as zero: none comes here,
    /// [limits](crate::limits) refuse it before.
    pub fn outgoing(&self, command: Command) -> Option<Outgoing<'_>> {
        let exchange = self.exchanges[command.index()].as_ref()?;
        let value = match command {
            Command::SetVolts(value) | Command::LaserPower(value) if value.is_finite() => value,
            _ => 0.0,
        };
        let number = format!("{value:.*}", self.decimals);
        // No controller needs to know of a negative zero.
        let number = if number.bytes().all(|b| b"-0.".contains(&b)) {
            number.trim_start_matches('-')
        } else {
            &number
        };
        let text = exchange.send.replace("{v}", number).replace("{p}", number);
        Some(Outgoing {
            bytes: format!("{text}{}", self.terminator).into_bytes(),
            text,
            reply: exchange.reply.as_ref(),
        })
    }

    /// Whether the controller has such a command.
    pub fn has(&self, command: Command) -> bool {
        self.exchanges[command.index()].is_some()
    }

    /// The byte that a reply ends with.
    pub fn end(&self) -> u8 {
        self.terminator.bytes().last().unwrap_or(b'\n')
    }

    /// The longest reply, bytes.
    pub fn longest_line(&self) -> usize {
        self.longest_line
    }

    /// Whether a reply to [`Command::Error`] says that there is none.
    pub fn is_no_error(reply: &Reply) -> bool {
        reply.code == Some(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sent(dialect: &Dialect, command: Command) -> Option<String> {
        dialect.outgoing(command).map(|outgoing| String::from_utf8(outgoing.bytes).unwrap())
    }

    #[test]
    fn scpi_is_spoken_as_the_standard_has_it() {
        let scpi = Dialect::scpi();
        let all = Command::NAMED.map(|(_, command)| sent(&scpi, command));
        let expected = [
            "*IDN?\n",
            "*RST\n",
            "SOUR:VOLT 0.000000\n",
            "SOUR:VOLT?\n",
            "*OPC?\n",
            "SYST:ERR?\n",
            "OUTP ON\n",
            "OUTP OFF\n",
            "OUTP?\n",
        ];
        assert_eq!(all.iter().flatten().map(String::as_str).collect::<Vec<_>>(), expected);
        assert_eq!(all[9], None, "there is no command for the power");
        assert_eq!(sent(&scpi, Command::SetVolts(-1.234_567_8)).as_deref(), Some("SOUR:VOLT -1.234568\n"));
        assert_eq!(sent(&scpi, Command::SetVolts(-1e-9)).as_deref(), Some("SOUR:VOLT 0.000000\n"));
        assert!(Command::NAMED.iter().all(|(name, command)| command.name() == *name));
    }

    #[test]
    fn every_exchange_of_scpi_passes_the_check_of_tables() {
        let scpi = Dialect::scpi();
        for (_, command) in Command::NAMED {
            let Some(Exchange { send, reply }) = &scpi.exchanges[command.index()] else { continue };
            let again = scpi.clone().with(command, send, reply.as_ref().map(Pattern::text));
            assert_eq!(again.as_ref(), Ok(&scpi));
        }
    }

    #[test]
    fn another_controller_needs_a_table_only() {
        let other = Dialect::scpi()
            .with_terminator("\r")
            .and_then(|d| d.with_decimals(3))
            .and_then(|d| d.with(Command::SetVolts(0.0), "V1={v}", Some("OK")))
            .and_then(|d| d.with(Command::ReadVolts, "V1?", Some("V1={v}")))
            .and_then(|d| d.with(Command::Complete, "", None))
            .and_then(|d| d.with(Command::LaserPower(0.0), "PWR {p}", None))
            .unwrap();
        assert_eq!(sent(&other, Command::SetVolts(0.5)).as_deref(), Some("V1=0.500\r"));
        assert_eq!(sent(&other, Command::Complete), None);
        assert_eq!(sent(&other, Command::LaserPower(0.25)).as_deref(), Some("PWR 0.250\r"));
        let reply = other.outgoing(Command::ReadVolts).unwrap().reply.unwrap().matches("v1=-2.5");
        assert_eq!(reply.unwrap().number, Some(-2.5));
    }

    #[test]
    fn tables_that_can_not_be_meant_are_refused_with_a_mend() {
        let scpi = Dialect::scpi();
        for (command, send, reply) in [
            (Command::SetVolts(0.0), "SOUR:VOLT", None),
            (Command::SetVolts(0.0), "", None),
            (Command::SetVolts(0.0), "SOUR:VOLT {x}{v}", None),
            (Command::ReadVolts, "SOUR:VOLT?", None),
            (Command::ReadVolts, "SOUR:VOLT?", Some("{text}")),
            (Command::LaserOn, "OUTP ON\n", None),
            (Command::LaserState, "OUTP?", Some("{bogus}")),
            (Command::Identify, "*IDN? {v}", Some("{text}")),
        ] {
            let error = scpi.clone().with(command, send, reply).unwrap_err();
            assert_eq!(error.command, command.name());
            assert!(!error.mend.is_empty(), "{error}");
        }
        assert!(scpi.clone().with_terminator(";").is_err());
        assert!(scpi.clone().with_longest_line(4).is_err());
        assert!(scpi.with_decimals(13).is_err());
    }
}
