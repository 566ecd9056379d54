//! The target in a capture's laser-off images.

use crate::pipeline::Progress;
use crate::pipeline::load::{Reading, grey_view};
use crate::{Error, Notes};
use nalgebra::Vector2;
use rayon::prelude::*;
use std::collections::BTreeMap;
use uw_calib::{BoardError, Chessboard, CornerPoint, Detection, Rejected, Rejection, detect, label_capture};
use uw_io::{Capture, FrameRecord, Problem, Target};

/// The board of one pose.
pub(crate) struct Seen<'c> {
    pub(crate) frame: &'c FrameRecord,
    pub(crate) corners: Vec<CornerPoint>,
}

/// What the laser-off images of a capture show.
pub(crate) struct Boards<'c> {
    /// By pose.
    pub(crate) seen: BTreeMap<u32, Seen<'c>>,
    pub(crate) square_mm: f64,
}

impl Boards<'_> {
    /// Whether some image of the frame's pose shows the board.
    pub(crate) fn shows(&self, frame: &FrameRecord) -> bool {
        frame.pose.is_some_and(|pose| self.seen.contains_key(&pose))
    }
}

/// The board that a capture declares.
fn chessboard(target: &Target) -> Result<Chessboard, BoardError> {
    let [columns, rows] = target.inner_corners.map(|n| n as usize);
    Chessboard::new(columns, rows, target.square_mm)
}

/// Corners of the declared board, for each pose that shows it; lost and rejected images are noted.
///
/// # Errors
/// [`Error::BoardNotSeen`] where no image shows the whole declared board.
pub(crate) fn find<'c>(
    capture: &'c Capture,
    target: &Target,
    reading: Reading,
    notes: &mut Notes,
    progress: &dyn Progress,
) -> Result<Boards<'c>, Error> {
    let board = chessboard(target).map_err(|source| Error::Board { path: capture.path.clone(), source })?;
    let frames: Vec<&FrameRecord> = capture.present().filter(|f| !f.laser_on).collect();
    progress.begin("boards", frames.len());
    let found: Vec<Result<Result<Detection, Rejection>, uw_io::Error>> = frames
        .par_iter()
        .map(|frame| {
            if progress.cancelled() {
                // Nobody sees it: all of it ends below.
                return Ok(Err(Rejection::NoBoard { candidates: 0 }));
            }
            let image = reading.board(capture, frame);
            let detection = image.map(|image| match grey_view(&image) {
                Ok(view) => detect(&view, &board),
                Err(_) => Err(Rejection::NoBoard { candidates: 0 }),
            });
            progress.step();
            detection
        })
        .collect();

    if progress.cancelled() {
        return Err(Error::Cancelled);
    }
    let mut boards = Boards { seen: BTreeMap::new(), square_mm: board.square_mm() };
    let (mut read, mut detections, mut losses) = (Vec::new(), Vec::new(), Vec::new());
    for (frame, found) in std::iter::zip(frames, found) {
        match found {
            Ok(detection) => {
                if let Err(reason) = &detection {
                    notes.rejected.push(Rejected { file: name(capture, frame), reason: reason.to_string() });
                }
                read.push(frame);
                detections.push(detection);
            }
            Err(error) => losses.push(Problem::loss(frame.row, error)),
        }
    }
    if read.is_empty() && !losses.is_empty() {
        let first = Box::new(losses.swap_remove(0).error);
        return Err(Error::NothingLeft { path: capture.path.clone(), first });
    }
    notes.problems.append(&mut losses);
    let labelled = label_capture(detections, &board)
        .map_err(|e| Error::BoardNotSeen { path: capture.path.clone(), reason: e.to_string() })?;
    for (frame, detection) in std::iter::zip(read, labelled) {
        let (Ok(detection), Some(pose)) = (detection, frame.pose) else { continue };
        let corners: Vec<CornerPoint> = detection.corners.iter().map(|c| corner(&board, c)).collect();
        // A pose photographed twice counts once, by the image that shows more of the board.
        let better = boards.seen.get(&pose).is_none_or(|s| s.corners.len() < corners.len());
        if better {
            boards.seen.insert(pose, Seen { frame, corners });
        }
    }
    Ok(boards)
}

fn corner(board: &Chessboard, found: &uw_calib::BoardCorner) -> CornerPoint {
    let [x, y, _] = board.corner_mm(found.index);
    CornerPoint {
        board_mm: Vector2::new(x, y),
        pixel: Vector2::from(found.pixel),
        covariance: found.covariance,
    }
}

/// An image as messages name it: folder and file.
pub(crate) fn name(capture: &Capture, frame: &FrameRecord) -> String {
    capture.image_path(frame).display().to_string()
}
