//! How far the work has come: a bar with rate and time left on a terminal, plain lines elsewhere.

use std::{
    fmt::Write,
    sync::{Mutex, PoisonError},
    time::{Duration, Instant},
};

use indicatif::{ProgressBar, ProgressState, ProgressStyle};

use crate::console::Console;

const BAR: &str = "{prefix:>11} [{bar:30}] {pos}/{len} {rate}, {eta} left  {msg}";
/// A stage without steps to count.
const SPINNER: &str = "{prefix:>11} {spinner} {elapsed}";
/// How often a plain line is written, and a spinner turned.
const LINE_EVERY: Duration = Duration::from_secs(10);
const TURN_EVERY: Duration = Duration::from_millis(100);

/// Shows progress on standard error until it is dropped.
pub struct Progress<'c> {
    console: &'c Console,
    stage: Mutex<Option<Stage>>,
}

enum Stage {
    Bar(ProgressBar),
    Lines { name: String, total: usize, done: usize, began: Instant, told: Instant, note: String },
}

impl<'c> Progress<'c> {
    /// Shows what the console is to show.
    pub fn new(console: &'c Console) -> Self {
        Self { console, stage: Mutex::new(None) }
    }

    fn replace(&self, next: Option<Stage>) {
        let mut stage = self.stage.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(Stage::Bar(bar)) = stage.take() {
            bar.finish_and_clear();
        }
        *stage = next;
    }

    /// A stage drawn on the terminal.
    fn bar(name: &str, total: usize) -> Stage {
        let bar = ProgressBar::new(total as u64).with_prefix(name.to_owned());
        let template = if total > 1 { BAR } else { SPINNER };
        // A template that can't be read would be a bar in the default style, not a reason to stop.
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style.progress_chars("=> ").with_key("rate", rate));
        }
        bar.enable_steady_tick(TURN_EVERY);
        Stage::Bar(bar)
    }
}

fn rate(state: &ProgressState, to: &mut dyn Write) {
    // The bar's own text can always be written.
    _ = write!(to, "{:.1}/s", state.per_sec());
}

impl uwscan::pipeline::Progress for Progress<'_> {
    fn begin(&self, name: &str, total: usize) {
        if !self.console.shows_progress() {
            return;
        }
        let stage = if self.console.is_terminal() {
            Self::bar(name, total)
        } else {
            self.console.line(if total > 1 { format!("{name}: {total}") } else { name.to_owned() });
            let now = Instant::now();
            Stage::Lines { name: name.to_owned(), total, done: 0, began: now, told: now, note: String::new() }
        };
        self.replace(Some(stage));
    }

    fn step(&self) {
        let mut stage = self.stage.lock().unwrap_or_else(PoisonError::into_inner);
        match stage.as_mut() {
            Some(Stage::Bar(bar)) => bar.inc(1),
            Some(Stage::Lines { name, total, done, began, told, note }) => {
                *done += 1;
                if told.elapsed() >= LINE_EVERY && *done < *total {
                    *told = Instant::now();
                    let rate = *done as f64 / began.elapsed().as_secs_f64();
                    let left = (*total - *done) as f64 / rate;
                    self.console
                        .line(format_args!("{name}: {done} of {total}, {rate:.1}/s, {left:.0} s left{note}"));
                }
            }
            None => {}
        }
    }

    fn more(&self, steps: usize) {
        match self.stage.lock().unwrap_or_else(PoisonError::into_inner).as_mut() {
            Some(Stage::Bar(bar)) => bar.inc_length(steps as u64),
            Some(Stage::Lines { total, .. }) => *total += steps,
            None => {}
        }
    }

    fn note(&self, text: &str) {
        match self.stage.lock().unwrap_or_else(PoisonError::into_inner).as_mut() {
            Some(Stage::Bar(bar)) => bar.set_message(text.to_owned()),
            Some(Stage::Lines { note, .. }) => *note = format!(", {text}"),
            None => {}
        }
    }
}

impl Drop for Progress<'_> {
    fn drop(&mut self) {
        self.replace(None);
    }
}
