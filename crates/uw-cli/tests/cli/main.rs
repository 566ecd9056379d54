//! What the `uwscan` process promises: streams, exit codes, JSON, messages, and outputs that are whole or not there.
#![allow(clippy::unwrap_used)]

mod bad_captures;
mod batches;
mod boards;
mod cameras;
mod clouds;
#[cfg(unix)]
mod controller;
#[cfg(unix)]
mod doctor;
#[cfg(unix)]
mod faults;
mod fits;
#[cfg(all(unix, feature = "genicam"))]
mod gige;
mod infos;
mod job;
mod lives;
mod meshes;
mod recordings;
mod reports;
mod samples;
mod scans;
mod simulations;
mod usage;
