//! Long calls: without the GIL, on threads of their own, with progress and Ctrl-C.

use crate::errors::input;
use pyo3::prelude::*;
use pyo3::types::PyBool;
use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use uwscan::pipeline;

/// How long Ctrl-C may wait, and how often progress is told.
const LOOK_EVERY: Duration = Duration::from_millis(50);
/// More threads than any machine that this runs on has.
const MOST_THREADS: usize = 1024;

#[derive(Default)]
struct Stage {
    /// Stages since the last look: name, steps done, steps in all.
    stages: Vec<(String, usize, usize)>,
    ended: bool,
}

/// What the working threads tell, and the caller's thread reads.
#[derive(Default)]
struct Watch {
    stage: Mutex<Stage>,
    changed: Condvar,
    cancelled: AtomicBool,
}

impl Watch {
    fn lock(&self) -> MutexGuard<'_, Stage> {
        self.stage.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn end(&self) {
        self.lock().ended = true;
        self.changed.notify_all();
    }
}

impl pipeline::Progress for Watch {
    fn begin(&self, stage: &str, total: usize) {
        self.lock().stages.push((stage.to_owned(), 0, total));
    }

    fn step(&self) {
        if let Some((_, done, _)) = self.lock().stages.last_mut() {
            *done += 1;
        }
    }

    fn more(&self, steps: usize) {
        if let Some((_, _, total)) = self.lock().stages.last_mut() {
            *total += steps;
        }
    }

    fn cancelled(&self) -> bool {
        self.cancelled.load(Ordering::Relaxed)
    }
}

/// Ends the watch when the work ends, however it does.
struct End<'a>(&'a Watch);

impl Drop for End<'_> {
    fn drop(&mut self) {
        self.0.end();
    }
}

/// Does `work` on `threads` threads of its own (`None`: one a processor) while this thread, without the GIL but for a look now and then,
/// tells `progress` and listens for Ctrl-C. What progress or Ctrl-C raises ends the work and comes out.
pub fn run<R: Send>(
    py: Python<'_>,
    threads: Option<usize>,
    progress: Option<&Bound<'_, PyAny>>,
    work: impl FnOnce(&dyn pipeline::Progress) -> R + Send,
) -> PyResult<R> {
    let threads = threads_of(py, threads)?;
    let tell = listener(py, progress)?;
    let watch = Watch::default();
    let (made, raised) = py.detach(|| {
        std::thread::scope(|scope| {
            let worker = scope.spawn(|| {
                let _end = End(&watch);
                // Threads of its own, so that calls from several Python threads do not wait for each other, and a fork finds none.
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
                pool.map(|pool| pool.install(|| work(&watch)))
            });
            let raised = listen(&watch, tell.as_ref());
            (worker.join(), raised)
        })
    });
    raised?;
    match made {
        Ok(Ok(made)) => Ok(made),
        Ok(Err(e)) => Err(input(py, format!("cannot start {threads} threads: {e}"))),
        Err(panic) => std::panic::resume_unwind(panic),
    }
}

fn threads_of(py: Python<'_>, threads: Option<usize>) -> PyResult<usize> {
    match threads {
        None => Ok(std::thread::available_parallelism().map_or(1, NonZeroUsize::get)),
        Some(n @ 1..=MOST_THREADS) => Ok(n),
        Some(n) => Err(input(py, format!("threads must be from 1 to {MOST_THREADS}, got {n}"))),
    }
}

/// What is to be told of progress: the callable that was given; in a notebook a bar of its own; nobody.
fn listener(py: Python<'_>, progress: Option<&Bound<'_, PyAny>>) -> PyResult<Option<Py<PyAny>>> {
    match progress {
        Some(given) if given.is_callable() => Ok(Some(given.clone().unbind())),
        Some(given) if given.cast::<PyBool>().is_ok_and(|b| !b.is_true()) => Ok(None),
        Some(given) => {
            let got = given.repr()?;
            Err(input(
                py,
                format!("progress must be a callable (stage, done, total), False or None, got {got}"),
            ))
        }
        // Only a program that has IPython loaded can be a notebook.
        None if py.import("sys")?.getattr("modules")?.contains("IPython")? => {
            let bar = py.import("uwscan._progress")?.call_method0("notebook_bar")?;
            Ok((!bar.is_none()).then(|| bar.unbind()))
        }
        None => Ok(None),
    }
}

/// Looks after the work until it ends; gives what was raised meanwhile.
fn listen(watch: &Watch, tell: Option<&Py<PyAny>>) -> PyResult<()> {
    let mut raised = Ok(());
    loop {
        let mut stage = watch.lock();
        if !stage.ended {
            (stage, _) =
                watch.changed.wait_timeout(stage, LOOK_EVERY).unwrap_or_else(PoisonError::into_inner);
        }
        let (ended, told) = (stage.ended, stage.stages.clone());
        // Only the last stage goes on.
        let finished = stage.stages.len().saturating_sub(1);
        stage.stages.drain(..finished);
        drop(stage);
        if raised.is_ok() {
            raised = Python::attach(|py| {
                if let Some(tell) = tell {
                    told.into_iter().try_for_each(|said| tell.call1(py, said).map(drop))?;
                }
                // After the end Ctrl-C is Python's own to handle.
                if ended { Ok(()) } else { py.check_signals() }
            });
            if raised.is_err() {
                watch.cancelled.store(true, Ordering::Relaxed);
            }
        }
        if ended {
            return raised;
        }
    }
}
