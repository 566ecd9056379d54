//! Photographs of a chessboard → the camera alone: on land, without a window, without a laser.

use crate::pipeline::Progress;
use crate::pipeline::boards::{self, Boards, Seen, name};
use crate::pipeline::load::Reading;
use crate::{Error, Failure, Notes};
use std::path::Path;
use uw_calib::{BoardView, CalibError, Outside, Pinhole, PinholeOptions, calibrate_pinhole, closed_form};
use uw_geom::{Camera, Distortion};
use uw_io::{Capture, Medium, Reduce};

/// A camera, and what it was made from.
#[derive(Debug)]
pub struct Photographed {
    /// The camera; its views are those of `files`.
    pub pinhole: Pinhole,
    /// Width and height of the images, px.
    pub image_size: [u32; 2],
    /// The images that show the board, as messages name them.
    pub files: Vec<String>,
    /// Corners, seen and predicted, (u, v) each, px, of each of `files`.
    pub corners: Vec<Vec<[[f64; 2]; 2]>>,
    /// Losses, and images that were left out.
    pub notes: Notes,
}

/// The camera from the laser-off images of a calibration's capture in air, as a pinhole with Brown–Conrady's distortion: for a camera that has no window, or
/// to be compared with other programs, which know of none. It says nothing of an instrument under water: that is [`calibrate`](super::calibrate::calibrate)'s.
///
/// # Errors
/// [`Failure`] where a file is wrong, no image shows the declared board, or the images determine no camera.
pub fn calibrate_camera(
    capture: &Path,
    options: PinholeOptions,
    progress: &dyn Progress,
) -> Result<Photographed, Failure> {
    let mut notes = Notes::default();
    match solve(capture, options, &mut notes, progress) {
        Ok(made) => Ok(Photographed { notes, ..made }),
        Err(error) => Err(Failure { error: Box::new(error), notes }),
    }
}

fn solve(
    path: &Path,
    options: PinholeOptions,
    notes: &mut Notes,
    progress: &dyn Progress,
) -> Result<Photographed, Error> {
    let mut capture = Capture::open(path)?;
    notes.problems.append(&mut capture.take_problems());
    let kind = |needed, got| Error::Kind { path: capture.path.clone(), needed, got };
    let target = capture.target.as_ref().ok_or_else(|| kind("calibration", "scan"))?;
    if capture.medium != Medium::Air {
        return Err(kind("calibration in air", "calibration in water"));
    }
    let first = capture.present().find(|frame| !frame.laser_on);
    let first = first.ok_or(CalibError::TooFewPoses { needed: 3, got: 0 })?;
    let first = capture.image(first, Reduce::Luma, None)?;
    let image_size = [first.width, first.height];
    let reading = Reading::like(&first);
    let Boards { seen, square_mm } = boards::find(&capture, target, reading, notes, progress)?;
    progress.begin("adjustment", 1);
    let files: Vec<String> = seen.values().map(|seen| name(&capture, seen.frame)).collect();
    let view = |(seen, file): (Seen<'_>, &String)| BoardView {
        file: file.clone(),
        outside: Outside::Air,
        square_mm,
        corners: seen.corners,
        stripes: Vec::new(),
    };
    let views: Vec<BoardView> = seen.into_values().zip(&files).map(view).collect();
    // Where the closed form has none, the adjustment says what is missing; it begins with a lens of ordinary length.
    let start = closed_form(&views, image_size).unwrap_or_else(|| {
        let [width, height] = image_size.map(f64::from);
        let (cx, cy) = (0.5 * (width - 1.0), 0.5 * (height - 1.0));
        Camera { fx: width, fy: width, cx, cy, distortion: Distortion::none() }
    });
    let pinhole = calibrate_pinhole(&views, &start, options)?;
    progress.step();
    let corners = std::iter::zip(&views, &pinhole.poses).map(|(view, pose)| {
        let predicted = |corner: &uw_calib::CornerPoint| {
            let [x, y] = corner.board_mm.into();
            let point = pose.transform_point(&nalgebra::Vector3::new(x, y, 0.0));
            [corner.pixel.into(), pinhole.camera.project(&point).map_or([f64::NAN; 2], Into::into)]
        };
        view.corners.iter().map(predicted).collect()
    });
    let corners = corners.collect();
    Ok(Photographed { pinhole, image_size, files, corners, notes: Notes::default() })
}
