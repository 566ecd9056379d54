//! Finds a declared chessboard in one image.
//!
//! Candidates come from 8 bits ([`crate::candidates`]), labels from their lattice ([`crate::grid`]),
//! positions from a fit on the image itself with all its bits ([`crate::saddle`]).

use nalgebra::Matrix2;

use crate::board::Chessboard;
use crate::candidates::{ATTEMPTS, candidates};
use crate::complete::{Corners, complete};
use crate::grid::{Place, lattices};
use crate::view::GreyView;

/// A corner of the board in an image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoardCorner {
    /// (column, row) on the board.
    pub index: [usize; 2],
    /// Position [u, v], px; (0, 0) is the centre of the top-left pixel.
    pub pixel: [f64; 2],
    /// Covariance of the position, px², from the residuals of its own fit.
    pub covariance: Matrix2<f64>,
}

/// A chessboard found in one image.
///
/// Labels run so that x (columns) to y (rows) turns clockwise in the image. Of the rotations that are left,
/// the whole board takes one of the two that match its sides, a partial view has its own origin: the pose of
/// the board absorbs both.
#[derive(Debug, Clone, PartialEq)]
pub struct Detection {
    /// The corners, by rows.
    pub corners: Vec<BoardCorner>,
    /// Whether the whole declared board was seen: all four of its outermost lines, each at least half. Single
    /// corners may be missing (glare, or a board whose corner square is left white).
    pub full: bool,
    /// Number of columns and rows between the outermost corners, both included.
    pub seen: [usize; 2],
}

/// Why an image does not show the declared board.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Rejection {
    /// Nothing in the image looks like a chessboard.
    #[error("no chessboard found ({candidates} candidates for corners)")]
    NoBoard {
        /// Points that looked like a corner.
        candidates: usize,
    },
    /// Too few corners for a pose.
    #[error("only {found} corners found, at least {needed} are needed")]
    TooFew {
        /// Corners found.
        found: usize,
        /// Corners needed.
        needed: usize,
    },
    /// The board in the image is larger than the declared one.
    #[error("the board has at least {} x {} inner corners, {} x {} were declared", seen[0], seen[1], declared[0], declared[1])]
    Larger {
        /// Columns and rows seen.
        seen: [usize; 2],
        /// Columns and rows declared.
        declared: [usize; 2],
    },
}

/// Fewer corners of a partial view give a pose too weak to help: three by three.
const MIN_CORNERS: usize = 9;

/// Returns the corners of `board` in the image, or why it is not in it.
///
/// Tried in turn, until the whole board is found: the image as it is, with its brightness evened out, and at
/// half and quarter size (blur). Otherwise the largest part counts.
///
/// # Errors
/// [`Rejection`]: the reason, for the report on this image.
pub fn detect(view: &GreyView<'_>, board: &Chessboard) -> Result<Detection, Rejection> {
    let mut best: Result<Detection, Rejection> = Err(Rejection::NoBoard { candidates: 0 });
    for attempt in ATTEMPTS {
        let candidates = candidates(view, attempt);
        let found = lattices(&candidates)
            .first()
            .ok_or(Rejection::NoBoard { candidates: candidates.len() })
            .and_then(|lattice| label(complete(view, &candidates, lattice), board));
        if found.as_ref().is_ok_and(|detection| detection.full) {
            return found;
        }
        let rank = |result: &Result<Detection, Rejection>| match result {
            Ok(detection) => 3 * detection.corners.len(),
            Err(Rejection::Larger { .. }) => 2,
            Err(Rejection::TooFew { .. }) => 1,
            Err(_) => 0,
        };
        if rank(&found) > rank(&best) || matches!(best, Err(Rejection::NoBoard { candidates: 0 })) {
            best = found;
        }
    }
    best
}

/// Numbers the corners as the declared board has them.
fn label(mut corners: Corners, board: &Chessboard) -> Result<Detection, Rejection> {
    let declared = [board.inner_cols(), board.inner_rows()];
    drop_stray_borders(&mut corners, declared);
    if corners.len() < MIN_CORNERS {
        return Err(Rejection::TooFew { found: corners.len(), needed: MIN_CORNERS });
    }
    let (min, seen) = extent(&corners);
    let fits = |seen: [usize; 2]| seen[0] <= declared[0] && seen[1] <= declared[1];
    let turned = [seen[1], seen[0]];
    if !fits(seen) && !fits(turned) {
        let oriented = if (seen[0] > seen[1]) == (declared[0] > declared[1]) { seen } else { turned };
        return Err(Rejection::Larger { seen: oriented, declared });
    }
    let local =
        corners.into_iter().map(|([x, y], saddle)| ([(x - min[0]) as usize, (y - min[1]) as usize], saddle));
    // Four rotations of the labels, none mirrored; of those that fit, the one whose columns run most to the
    // right.
    let mut labelled: Vec<([usize; 2], _)> = local.collect();
    let [cols, rows] = seen;
    let mut choices = Vec::new();
    for quarter in 0..4 {
        let size = if quarter % 2 == 0 { seen } else { turned };
        if fits(size) {
            choices.push((quarter, size));
        }
    }
    let rotate = |quarter: usize, [x, y]: [usize; 2]| match quarter {
        0 => [x, y],
        1 => [y, cols - 1 - x],
        2 => [cols - 1 - x, rows - 1 - y],
        _ => [rows - 1 - y, x],
    };
    let rightward = |quarter: usize| -> f64 {
        let mean =
            labelled.iter().map(|(p, _)| rotate(quarter, *p)[0] as f64).sum::<f64>() / labelled.len() as f64;
        labelled.iter().map(|(p, s)| (rotate(quarter, *p)[0] as f64 - mean) * s.pixel[0]).sum()
    };
    let (quarter, seen) =
        choices.into_iter().max_by(|a, b| rightward(a.0).total_cmp(&rightward(b.0))).unwrap_or((0, seen));
    for (place, _) in &mut labelled {
        *place = rotate(quarter, *place);
    }
    labelled.sort_by_key(|([col, row], _)| (*row, *col));
    let corners: Vec<BoardCorner> = labelled
        .into_iter()
        .map(|(index, s)| BoardCorner { index, pixel: s.pixel, covariance: s.covariance })
        .collect();
    let outermost = |axis: usize, at: usize| corners.iter().filter(|c| c.index[axis] == at).count();
    let half_seen = |axis: usize| {
        let other = declared[1 - axis];
        2 * outermost(axis, 0) >= other && 2 * outermost(axis, declared[axis] - 1) >= other
    };
    let full = seen == declared && half_seen(0) && half_seen(1);
    Ok(Detection { corners, full, seen })
}

/// Least column and row, and how many of each there are.
fn extent(corners: &Corners) -> (Place, [usize; 2]) {
    let span = |axis: usize| {
        let values = || corners.keys().map(|place| place[axis]);
        let (min, max) = (values().min().unwrap_or(0), values().max().unwrap_or(-1));
        (min, (max - min + 1) as usize)
    };
    let ((x, cols), (y, rows)) = (span(0), span(1));
    ([x, y], [cols, rows])
}

/// Where more is seen than was declared, an outermost line that is mostly empty is background that happens to
/// continue the lattice, not a row of the board.
fn drop_stray_borders(corners: &mut Corners, declared: [usize; 2]) {
    let (long, short) = (declared[0].max(declared[1]), declared[0].min(declared[1]));
    loop {
        let (min, seen) = extent(corners);
        if seen[0].max(seen[1]) <= long && seen[0].min(seen[1]) <= short {
            return;
        }
        let lines = [0, 1].into_iter().flat_map(|axis| {
            [min[axis], min[axis] + seen[axis] as i32 - 1].map(|at| {
                let filled = corners.keys().filter(|place| place[axis] == at).count();
                (filled as f64 / seen[1 - axis] as f64, axis, at)
            })
        });
        let Some((filled, axis, at)) = lines.min_by(|a, b| a.0.total_cmp(&b.0)) else { return };
        if filled >= 0.5 {
            return;
        }
        corners.retain(|place, _| place[axis] != at);
    }
}
