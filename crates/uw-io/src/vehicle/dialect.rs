//! A controller's dialect as a table, inside a vehicle file or in a file of its own.

use std::path::Path;

use serde::{Deserialize, Serialize};
use uw_hw::galvo::proto::{Command, Dialect, DialectError};

use crate::{error::Error, toml_file::TomlFile};

/// The `format` of a dialect's own file.
pub const FORMAT: &str = "uwscan-dialect";
/// The newest version of it that is read.
pub const VERSION: u32 = 1;

/// Where a controller's dialect differs from SCPI.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DialectTable {
    /// What a line ends with.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub terminator: Option<String>,
    /// The longest reply, bytes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub longest_line: Option<usize>,
    /// Decimals of a value.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub decimals: Option<usize>,
    /// Who it is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub identify: Option<ExchangeTable>,
    /// Back to the state after switching on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reset: Option<ExchangeTable>,
    /// Sends the mirror to a voltage, `{v}`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub set_volts: Option<ExchangeTable>,
    /// Where it is: `{v}` in the reply.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub read_volts: Option<ExchangeTable>,
    /// Answers once all before it is done.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub complete: Option<ExchangeTable>,
    /// The oldest error: `{code}` in the reply, 0 for none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<ExchangeTable>,
    /// Switches the laser on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub laser_on: Option<ExchangeTable>,
    /// Switches it off.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub laser_off: Option<ExchangeTable>,
    /// Whether it is on: `{on}` in the reply.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub laser_state: Option<ExchangeTable>,
    /// Sets its power, `{p}` from 0 to 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub laser_power: Option<ExchangeTable>,
}

/// What is sent, and the pattern of the reply.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExchangeTable {
    /// What is sent; empty where the controller has no such command.
    pub send: String,
    /// The reply that is waited for; absent where the controller says nothing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reply: Option<String>,
}

impl DialectTable {
    /// The dialect of a file of its own.
    ///
    /// # Errors
    /// [`Error`] where it cannot be read or is no dialect.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let file = TomlFile::read(path, FORMAT, VERSION)?;
        let table: Self = file.parse()?;
        table.check(&file, "")?;
        Ok(table)
    }

    /// SCPI with what the table says otherwise.
    ///
    /// # Errors
    /// [`DialectError`] for an exchange that can't be meant.
    pub fn to_dialect(&self) -> Result<Dialect, DialectError> {
        let mut dialect = Dialect::scpi();
        if let Some(terminator) = &self.terminator {
            dialect = dialect.with_terminator(terminator)?;
        }
        if let Some(longest_line) = self.longest_line {
            dialect = dialect.with_longest_line(longest_line)?;
        }
        if let Some(decimals) = self.decimals {
            dialect = dialect.with_decimals(decimals)?;
        }
        for (command, exchange) in self.exchanges() {
            if let Some(ExchangeTable { send, reply }) = exchange {
                dialect = dialect.with(command, send, reply.as_deref())?;
            }
        }
        Ok(dialect)
    }

    fn exchanges(&self) -> [(Command, &Option<ExchangeTable>); 10] {
        [
            (Command::Identify, &self.identify),
            (Command::Reset, &self.reset),
            (Command::SetVolts(0.0), &self.set_volts),
            (Command::ReadVolts, &self.read_volts),
            (Command::Complete, &self.complete),
            (Command::Error, &self.error),
            (Command::LaserOn, &self.laser_on),
            (Command::LaserOff, &self.laser_off),
            (Command::LaserState, &self.laser_state),
            (Command::LaserPower(0.0), &self.laser_power),
        ]
    }

    /// Refuses what is no dialect; its keys are found in `file` after `prefix`.
    pub(super) fn check(&self, file: &TomlFile, prefix: &str) -> Result<(), Error> {
        match self.to_dialect() {
            Ok(_) => Ok(()),
            Err(DialectError { command, what, mend }) => {
                let key = format!("{prefix}{command}");
                Err(file.error(key.trim_end_matches('.'), what, mend))
            }
        }
    }
}
