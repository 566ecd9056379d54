//! The way through: images and voltages → stripes → rays and sheets → points.
//!
//! | stage | module | in | out | decides | how it fails |
//! |---|---|---|---|---|---|
//! | load | `load` | capture, row | grey image | colour → channel, background frame of each scan frame | a lost image is a [`uw_io::Problem`] |
//! | boards | `boards` | laser-off images | corners | whether the declared board was seen | rejected image with a reason; [`crate::Error::BoardNotSeen`] |
//! | stripes | `stripes` | laser-on images | centre, sigma | rows or columns, rejects by reason | a rejected measurement is counted |
//! | calibrate | `calibrate` | captures, rig | [`uw_calib::Calibration`] | which measurements take part | [`uw_calib::CalibError`] says what to capture |
//! | camera | [`camera`] | photographs of a board | a pinhole camera | – | [`uw_calib::CalibError`] says what is missing |
//! | sweep | `sweep` | centres of all images | centres | what the sheet's thickness moves, what it spoils | a rejected measurement is counted |
//! | points | `points` | centres, calibration | points with covariance | refraction model | points without an intersection are counted |
//! | record | `record` | instrument, plan | recording, points on the fly | what is waited for and what is lost, where more voltages are wanted | counted losses; [`record::Scanned`] says why it ended early |
//! | reconstruct | `reconstruct` | scan, calibration | [`uw_cloud::PointCloud`] | water's index, order of the stages | [`crate::Failure`] |
//! | capture | `capture` | instrument, board | capture folder of a calibration | whether a placement is kept, what the set lacks | [`capture::Taken`] says why it is not; [`crate::Error`] |
//! | doctor | `doctor` | vehicle file | findings: what is wrong, where, and how to mend it | what a scan needs of files, drives, camera, disk, clock | a finding |
//! | report | [`report`] | scans, clouds, nominal values, a reference | one page, JSON, CSV | which ball is which, what is shown | [`crate::Failure`] |
//! | simulate | `simulate` | scene file | capture, truth | true instrument, scene at each exposure | [`crate::Error::SceneFile`] |
//! | demo | `demo` | scenes compiled in | figures beside their truth | what has to come out how well | [`crate::Failure`] |
//! | reproduce | [`reproduce`] | seed | the paper's experiments, its method and ours | – | [`crate::Failure`] |
//! | batch | [`batch`] | folder of recordings, calibration | a cloud and a result each, one table | what is there already, what is no scan | a recording that fails is a row of the table |
//! | uncertainty | [`uncertainty`] | cloud, calibration, fit | the calibration's part of its covariance | whether the cloud came of that calibration | [`crate::Error::OtherCalibration`] |
//! | live | `live` (feature `live`) | a scan while it runs, or recordings | what `uw-live` shows, and what is asked for there | nothing: it hands on | a request that can't be met is refused in words |

pub mod batch;
mod boards;
pub mod calibrate;
pub mod camera;
pub mod capture;
pub mod demo;
pub mod doctor;
pub mod instrument;
#[cfg(feature = "live")]
pub mod live;
mod load;
mod points;
pub mod reconstruct;
pub mod record;
pub mod replay;
pub mod report;
pub mod reproduce;
pub mod simulate;
mod stripes;
mod sweep;
pub mod uncertainty;

/// Told how far a long piece of work has come; called from several threads.
pub trait Progress: Sync {
    /// A stage of `total` steps begins.
    fn begin(&self, stage: &str, total: usize);
    /// One more step is done.
    fn step(&self);
    /// The stage has so many steps more than it began with.
    fn more(&self, _steps: usize) {}
    /// What there is to say besides, in a few words; the last is the one that counts.
    fn note(&self, _text: &str) {}
    /// Whether the work is to be given up: asked before every step, from any thread, and then [`crate::Error::Cancelled`] comes of it.
    fn cancelled(&self) -> bool {
        false
    }
}

/// Tells nobody.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Progress for Silent {
    fn begin(&self, _: &str, _: usize) {}
    fn step(&self) {}
}
