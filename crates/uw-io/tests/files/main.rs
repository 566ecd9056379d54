//! What the readers and writers of files promise, on files made in temporary folders.
#![allow(clippy::unwrap_used)]

mod atomic;
mod calibration;
mod capture;
mod clouds;
mod formats;
mod images;
mod meshes;
mod recorder;
mod recordings;
mod rig;
mod rig_domain;
mod samples;
mod scene;
mod vehicle;
