//! Diagnostics on standard error: errors, warnings, losses.

use std::{
    fmt::Display,
    io::{IsTerminal, Write},
};

use clap::builder::styling::{AnsiColor, Style};
use uwscan::{
    Failure, Notes,
    io::{Problem, Severity},
};

use crate::{
    args::{Color, Global},
    exit::Outcome,
};

/// Losses told one by one; the others are counted, and listed by --verbose.
const LOSSES_TOLD: usize = 10;

/// Images named that tests of quality rejected, where there is no result that lists them.
const REJECTS_TOLD: usize = 3;

/// Standard error, as the user wants it.
#[derive(Clone, Debug)]
pub struct Console {
    color: bool,
    terminal: bool,
    verbosity: i16,
}

impl Console {
    /// What the arguments and the terminal ask for.
    pub fn new(global: &Global) -> Self {
        let terminal = std::io::stderr().is_terminal();
        let no_color = std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty());
        let color = match global.color {
            Color::Auto => terminal && !no_color,
            Color::Always => true,
            Color::Never => false,
        };
        Self { color, terminal, verbosity: i16::from(global.verbose) - i16::from(global.quiet) }
    }

    /// Whether everything is to be told.
    pub fn verbose(&self) -> bool {
        self.verbosity > 0
    }

    /// Whether progress is to be shown.
    pub fn shows_progress(&self) -> bool {
        self.verbosity >= 0
    }

    /// Whether a bar can be drawn.
    pub fn is_terminal(&self) -> bool {
        self.terminal
    }

    /// Tells why there is no result.
    pub fn error(&self, message: &str) {
        self.tell(AnsiColor::Red, "error", message);
    }

    /// Tells what to know before trusting a result.
    pub fn warn(&self, message: impl Display) {
        if self.verbosity >= -1 {
            self.tell(AnsiColor::Yellow, "warning", message);
        }
    }

    /// Tells what was wrong with inputs and gone on without; what that makes of the command's end.
    pub fn problems(&self, problems: &[Problem]) -> Outcome {
        let (lost, warnings): (Vec<&Problem>, Vec<&Problem>) =
            problems.iter().partition(|p| p.severity == Severity::Loss);
        warnings.iter().for_each(|problem| self.warn(problem));
        let told = if self.verbose() { lost.len() } else { LOSSES_TOLD };
        lost.iter().take(told).for_each(|problem| self.warn(format_args!("lost: {problem}")));
        if let Some(more @ 1..) = lost.len().checked_sub(told) {
            self.warn(format_args!("lost: {more} more images; --verbose names them"));
        }
        if lost.is_empty() { Outcome::Done } else { Outcome::WithLoss }
    }

    /// Tells what a job had noticed when it failed: it may be the cause. The error itself is left to tell.
    pub fn failure(&self, failure: Failure) -> anyhow::Error {
        let Notes { problems, warnings, rejected } = failure.notes;
        self.problems(&problems);
        warnings.iter().for_each(|warning| self.warn(warning));
        let told = if self.verbose() { rejected.len() } else { rejected.len().min(REJECTS_TOLD) };
        for image in &rejected[..told] {
            self.warn(format_args!("rejected: {}: {}", image.file, image.reason));
        }
        if let Some(more @ 1..) = rejected.len().checked_sub(told) {
            self.warn(format_args!("rejected: {more} more images; --verbose names them"));
        }
        anyhow::Error::new(*failure.error)
    }

    /// Writes a line of diagnostics. Nobody can be told that standard error is closed.
    pub fn line(&self, line: impl Display) {
        let _ = writeln!(std::io::stderr().lock(), "{line}");
    }

    fn tell(&self, color: AnsiColor, label: &str, message: impl Display) {
        let style = if self.color { color.on_default().bold() } else { Style::new() };
        self.line(format_args!("{style}{label}:{style:#} {message}"));
    }
}
