//! Results on standard output: text, or one JSON object.

use std::io::{self, Write};

use serde::Serialize;
use uwscan::io::{Problem, Severity};

pub use uwscan::report::{decimals, plus_minus};

/// Writes a result. A reader that has gone away (`uwscan … | head`) has what it wanted: that is no failure.
///
/// # Errors
/// Standard output can't be written.
pub fn print(bytes: impl AsRef<[u8]>) -> anyhow::Result<()> {
    let mut out = io::stdout().lock();
    match out.write_all(bytes.as_ref()).and_then(|()| out.flush()) {
        Err(e) if e.kind() != io::ErrorKind::BrokenPipe => {
            Err(anyhow::Error::new(e).context("cannot write to standard output"))
        }
        _ => Ok(()),
    }
}

/// Writes a record as the one JSON object of `--json`; what is no finite number is `null` there.
///
/// # Errors
/// As [`print`].
pub fn json(record: &impl Serialize) -> anyhow::Result<()> {
    let mut text = serde_json::to_string(record)?;
    text.push('\n');
    print(text)
}

/// An input that was missing or unreadable.
#[derive(Debug, Serialize)]
pub struct Lost {
    file: String,
    reason: String,
}

/// What was lost, for JSON.
pub fn lost(problems: &[Problem]) -> Vec<Lost> {
    let lost = problems.iter().filter(|p| p.severity == Severity::Loss);
    lost.map(|p| Lost { file: p.error.path().display().to_string(), reason: p.to_string() }).collect()
}

/// A result's own warnings and those about its inputs, for JSON.
pub fn warnings(own: &[String], problems: &[Problem]) -> Vec<String> {
    let inputs = problems.iter().filter(|p| p.severity == Severity::Warning).map(ToString::to_string);
    own.iter().cloned().chain(inputs).collect()
}
