//! Captures for a calibration, guided: each placement of the board is judged at once, and what the set still lacks is told.
//!
//! A placement is one image without the laser, which must show the board, and one at each of a few voltages, whose stripes must lie on it.
//! The folder grows by whole placements, and `uwscan calibrate` takes it after each.

mod checks;
mod coverage;
mod files;

use crate::pipeline::instrument::Opened;
use crate::pipeline::record::session::{Room, unsigned};
use crate::pipeline::record::{Instrument, SETUP};
use crate::pipeline::simulate::Placement;
use crate::{Error, pipeline::record::plan};
use checks::STRIPE_LINES;
pub use coverage::Stance;
use files::Files;
use std::ops::ControlFlow;
use std::path::Path;
use uw_calib::Chessboard;
use uw_hw::interlock::{Handle, Reason, Report};
use uw_hw::sweep::{Aim, Event, Exposed, Spacing, StepAndSettle, step_and_settle};
use uw_hw::{Fault, Frame, Trigger};
use uw_io::{Medium, Rig, Target, Vehicle};

/// What is to be captured.
#[derive(Clone, Debug)]
pub struct Wanted {
    /// The board.
    pub target: Target,
    /// What is outside the windows.
    pub medium: Medium,
    /// Voltages of the stripes at each placement, from one end of the vehicle's sweep to the other; at least 2.
    pub voltages: usize,
}

/// An image, and the voltage that was read back for it; `None` with the laser off.
type Image = (Option<f64>, Frame);

/// A placement that was kept.
#[derive(Clone, Debug)]
pub struct Kept {
    /// Its number, from 0.
    pub pose: u32,
    /// Corners that were seen, and how many the board has.
    pub corners: [usize; 2],
    /// Median standard deviation of a corner's coordinate, px.
    pub sharp_px: f64,
    /// How the board stands, roughly; `None` where its corners don't tell.
    pub stance: Option<Stance>,
    /// Voltages at which the stripe lies on the board.
    pub stripes: usize,
    /// What would have been better.
    pub notes: Vec<String>,
}

/// What became of a placement.
#[derive(Clone, Debug)]
pub enum Taken {
    /// It is in the folder.
    Kept(Kept),
    /// It is not, and why: said to whoever holds the board.
    Again(String),
}

/// A capture in the making.
pub struct Guide {
    instrument: Instrument,
    placement: Option<Placement>,
    rig: Rig,
    wanted: Wanted,
    board: Chessboard,
    volts: Vec<f64>,
    steps: StepAndSettle,
    min_free_bytes: u64,
    files: Files,
    set: Vec<Stance>,
    /// Placements that were looked at, kept or not.
    tried: usize,
    whole_seen: bool,
}

impl Guide {
    /// Begins a capture in a folder that is not there yet, or is empty. The camera is armed, the laser stays off between placements.
    ///
    /// # Errors
    /// [`Error`] where the board is none, the camera can't be triggered by software, the voltages are none, or the folder can't be made.
    pub fn begin(
        opened: Opened,
        vehicle: &Vehicle,
        rig: &Rig,
        wanted: Wanted,
        folder: &Path,
    ) -> Result<Self, Error> {
        let Opened { mut instrument, placement, .. } = opened;
        let [columns, rows] = wanted.target.inner_corners.map(|n| n as usize);
        let board = Chessboard::new(columns, rows, wanted.target.square_mm)
            .map_err(|source| Error::Board { path: folder.to_owned(), source })?;
        let s = &vehicle.sweep;
        let volts = plan::voltages(s.from_v, s.to_v, Spacing::Count(wanted.voltages.max(2)), &[])?;
        let settings = &instrument.camera_settings;
        if settings.trigger != Trigger::Software {
            return Err(Fault::Unsupported {
                device: "camera".into(),
                what: "capture a calibration as it is triggered".into(),
                mend:
                    "write camera.trigger = \"software\" and sweep.mode = \"step\" in a vehicle file for this"
                        .into(),
            }
            .into());
        }
        let min_free_bytes = (vehicle.disk.min_free_mb * 1e6) as u64;
        room(folder, min_free_bytes)?;
        let handle = instrument.interlock.handle();
        let camera = instrument.camera.as_mut();
        handle.patiently(|| camera.configure(settings, SETUP).and_then(|_| camera.arm(SETUP)))?;
        let files = Files::begin(folder, rig, &wanted)?;
        Ok(Self {
            instrument,
            placement,
            rig: rig.clone(),
            wanted,
            board,
            volts,
            steps: vehicle.step_and_settle(),
            min_free_bytes,
            files,
            set: Vec::new(),
            tried: 0,
            whole_seen: false,
        })
    }

    /// Drives the instrument: for signals, and to feed the watchdog while a board is placed.
    pub fn handle(&self) -> Handle {
        self.instrument.interlock.handle()
    }

    /// Placements in the folder.
    pub fn kept(&self) -> usize {
        self.files.poses()
    }

    /// Images in the folder.
    pub fn images(&self) -> usize {
        self.files.images()
    }

    /// What the set still lacks, each as what to do next.
    pub fn missing(&self) -> Vec<String> {
        coverage::missing(&self.set, &self.volts, self.wanted.medium)
    }

    /// Captures the placement that the board is in now. The laser is off when this returns.
    ///
    /// # Errors
    /// [`Error`] where nothing more can be captured: a drive failed, the interlock has stopped, the disk is full. What is in the folder
    /// is whole.
    pub fn take(&mut self) -> Result<Taken, Error> {
        room(self.files.folder(), self.min_free_bytes)?;
        if let Some(placement) = &self.placement {
            placement.put(self.tried);
        }
        self.tried += 1;
        let middle = self.volts[self.volts.len() / 2];
        let dark = match self.expose(&[Aim::dark(middle)])? {
            Ok(mut frames) if frames.len() == 1 => frames.remove(0),
            Ok(_) => return Ok(Taken::Again("the camera gave no image".to_owned())),
            Err(fault) => return Ok(Taken::Again(fault.to_string())),
        };
        let handle = self.handle();
        let mut board = match handle.patiently(|| checks::board(&dark.1, &self.board)) {
            Ok(board) => board,
            Err(why) => return Ok(Taken::Again(why)),
        };
        if !board.full && !self.whole_seen {
            let why = format!(
                "only {} of its corners are seen: show all of it at least once, first",
                board.corners.len()
            );
            return Ok(Taken::Again(why));
        }
        let aims: Vec<Aim> = self.volts.iter().copied().map(Aim::lit).collect();
        let lit = match self.expose(&aims)? {
            Ok(lit) => lit,
            Err(fault) => return Ok(Taken::Again(fault.to_string())),
        };
        let lines = handle.patiently(|| {
            lit.iter().map(|(_, frame)| board.stripe_lines(frame)).collect::<Result<Vec<_>, _>>()
        })?;
        let stripes: Vec<bool> = lines.iter().map(|lines| *lines >= STRIPE_LINES).collect();
        let on_board = stripes.iter().filter(|on| **on).count();
        if on_board == 0 {
            let why = format!(
                "the stripe lies on it at none of {} voltages, {:.3} to {:.3} V: move it to where the stripe goes",
                self.volts.len(),
                self.volts[0],
                self.volts[self.volts.len() - 1]
            );
            return Ok(Taken::Again(why));
        }
        if on_board < 2 {
            board.notes.push(format!("the stripe lies on it at one of {} voltages only", self.volts.len()));
        }
        let pose = self.files.add(&dark, &lit)?;
        self.whole_seen |= board.full;
        let stance = Stance::of(&board.corners, &self.rig, self.wanted.medium, stripes);
        self.set.extend(stance.clone());
        Ok(Taken::Kept(Kept {
            pose,
            corners: [board.corners.len(), self.board.inner_cols() * self.board.inner_rows()],
            sharp_px: board.sharp_px,
            stance,
            stripes: on_board,
            notes: board.notes,
        }))
    }

    /// Images at some positions, with the voltages that were read back; the inner error is one after which another try may succeed.
    fn expose(&mut self, aims: &[Aim]) -> Result<Result<Vec<Image>, Fault>, Error> {
        let handle = self.handle();
        let mut frames = Vec::with_capacity(aims.len());
        let each = |event| {
            if let Event::Exposed(Exposed { volts, laser_on, frame, .. }) = event {
                frames.push((laser_on.then_some(volts), frame));
            }
            ControlFlow::Continue(())
        };
        let swept = step_and_settle(
            &handle,
            self.instrument.camera.as_mut(),
            aims.iter().copied(),
            &self.steps,
            each,
        );
        let off = handle.laser_off();
        match swept {
            Ok(()) => off.map(|()| Ok(frames)).map_err(Error::from),
            // A fault of a drive, or a signal, has stopped the interlock: nothing more goes.
            Err(fault) if handle.reason().is_some() => Err(fault.into()),
            Err(fault) => Ok(Err(fault)),
        }
    }

    /// Ends in order: laser off, mirror parked.
    pub fn finish(self) -> Report {
        let Instrument { interlock, mut camera, .. } = self.instrument;
        // It is done with: what it says to that changes nothing.
        let _ = camera.disarm(SETUP);
        interlock.handle().stop(Reason::Done)
    }
}

fn room(path: &Path, min_free_bytes: u64) -> Result<(), Error> {
    match (Room { path, min_free_bytes }).shortage() {
        Some(free_bytes) => {
            Err(Error::NoRoom { path: path.to_owned(), free_bytes, needed_bytes: min_free_bytes })
        }
        None => Ok(()),
    }
}

/// The stamp of an image in frames.csv.
fn stamp_ns(frame: &Frame) -> u64 {
    unsigned(frame.exposure().stamp_ns)
}
