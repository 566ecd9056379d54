//! How a command ends.

use std::process::ExitCode;

use crate::console::Console;

/// A command's end, if it did not fail.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// All that was asked for.
    Done,
    /// An input was missing or unreadable, and the rest was used.
    WithLoss,
}

const FAILED: u8 = 1;
const WITH_LOSS: u8 = 3;

/// The process's exit code, once the error, if any, is told.
pub fn code(result: anyhow::Result<Outcome>, console: &Console) -> ExitCode {
    match result {
        Ok(Outcome::Done) => ExitCode::SUCCESS,
        Ok(Outcome::WithLoss) => ExitCode::from(WITH_LOSS),
        Err(error) => match error.downcast::<clap::Error>() {
            Ok(usage) => usage.exit(),
            Err(error) => {
                console.error(&chain(&error));
                ExitCode::from(FAILED)
            }
        },
    }
}

/// The error and its causes on one line, each said once: many a message quotes its cause already.
pub fn chain(error: &anyhow::Error) -> String {
    error.chain().fold(String::new(), |said, cause| {
        let cause = cause.to_string();
        match said.is_empty() {
            true => cause,
            false if said.contains(&cause) => said,
            false => format!("{said}: {cause}"),
        }
    })
}

#[cfg(test)]
mod tests {
    use super::chain;

    #[test]
    fn a_cause_that_the_message_quotes_is_not_repeated() {
        let error = anyhow::anyhow!("disk full").context("cannot write: disk full").context("cloud.ply");
        assert_eq!(chain(&error), "cloud.ply: cannot write: disk full");
    }
}
