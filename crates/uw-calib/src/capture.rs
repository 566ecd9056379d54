//! Decides, over all images of a capture, whether the declared board is the one that was seen.

use crate::board::Chessboard;
use crate::corners::{Detection, Rejection};

/// Why a capture does not show the declared board.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum CaptureError {
    /// No image shows a chessboard.
    #[error(
        "a board of {} x {} inner corners was declared, but no chessboard was found in any of {images} images: correct \
         inner_corners if the board is another one, or capture it sharp, evenly lit and large in the image, laser off",
        declared[0], declared[1]
    )]
    NoBoard {
        /// Columns and rows declared.
        declared: [usize; 2],
        /// Images searched.
        images: usize,
    },
    /// Parts of a board were seen, but never all of the declared one.
    #[error(
        "a board of {} x {} inner corners was declared, but no image shows all of it; most often \
         {} x {} were seen (in {images} images): correct inner_corners, or capture the whole board once",
        declared[0], declared[1], seen[0], seen[1]
    )]
    NeverWhole {
        /// Columns and rows declared.
        declared: [usize; 2],
        /// Columns and rows seen most often.
        seen: [usize; 2],
        /// Images that show so many.
        images: usize,
    },
    /// The board has more corners than were declared.
    #[error(
        "a board of {} x {} inner corners was declared, but {images} images show more of them, most often \
         {} x {}: correct inner_corners",
        declared[0], declared[1], seen[0], seen[1]
    )]
    Larger {
        /// Columns and rows declared.
        declared: [usize; 2],
        /// Columns and rows seen most often among those.
        seen: [usize; 2],
        /// Images that show more than was declared.
        images: usize,
    },
}

/// Returns the detections and rejections of a capture unchanged once one image has shown the whole declared
/// board: only then does a partial view count, because a smaller board, or a part of a larger one, would look
/// the same.
///
/// Where more images show a larger board than the declared one, those that show exactly the declared size are
/// parts of it, and the declaration is wrong.
///
/// # Errors
/// [`CaptureError`], naming the size that was seen.
pub fn label_capture(
    images: Vec<Result<Detection, Rejection>>,
    board: &Chessboard,
) -> Result<Vec<Result<Detection, Rejection>>, CaptureError> {
    let declared = [board.inner_cols(), board.inner_rows()];
    let whole = images.iter().flatten().filter(|detection| detection.full).count();
    let larger: Vec<[usize; 2]> = images
        .iter()
        .filter_map(|image| match image {
            Err(Rejection::Larger { seen, .. }) => Some(*seen),
            _ => None,
        })
        .collect();
    if larger.len() > whole
        && let Some((seen, _)) = most_frequent(&larger, declared)
    {
        return Err(CaptureError::Larger { declared, seen, images: larger.len() });
    }
    if whole > 0 {
        return Ok(images);
    }
    let parts: Vec<[usize; 2]> = images.iter().flatten().map(|detection| detection.seen).collect();
    Err(match most_frequent(&parts, declared) {
        Some((seen, images)) => CaptureError::NeverWhole { declared, seen, images },
        None => CaptureError::NoBoard { declared, images: images.len() },
    })
}

/// The size that occurs most often (of equals, the largest) and how often, with its longer side where the
/// declared one is.
fn most_frequent(sizes: &[[usize; 2]], declared: [usize; 2]) -> Option<([usize; 2], usize)> {
    let oriented = |[a, b]: [usize; 2]| {
        if declared[0] >= declared[1] { [a.max(b), a.min(b)] } else { [a.min(b), a.max(b)] }
    };
    let sizes: Vec<[usize; 2]> = sizes.iter().map(|size| oriented(*size)).collect();
    sizes
        .iter()
        .map(|size| (*size, sizes.iter().filter(|other| *other == size).count()))
        .max_by_key(|(size, count)| (*count, size[0] * size[1], *size))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn part(seen: [usize; 2], full: bool) -> Result<Detection, Rejection> {
        Ok(Detection { corners: Vec::new(), full, seen })
    }

    fn larger(seen: [usize; 2]) -> Result<Detection, Rejection> {
        Err(Rejection::Larger { seen, declared: [11, 8] })
    }

    #[test]
    fn one_whole_view_lets_the_parts_count() {
        let board = Chessboard::new(11, 8, 24.0).unwrap();
        let images =
            vec![part([6, 8], false), part([11, 8], true), Err(Rejection::NoBoard { candidates: 3 })];
        assert_eq!(label_capture(images.clone(), &board).unwrap(), images);
    }

    #[test]
    fn a_board_never_seen_whole_is_named_with_what_was_seen() {
        let board = Chessboard::new(17, 13, 24.0).unwrap();
        let images = vec![part([8, 11], false), part([11, 8], false), part([11, 7], false)];
        let error = label_capture(images, &board).unwrap_err();
        assert_eq!(error, CaptureError::NeverWhole { declared: [17, 13], seen: [11, 8], images: 2 });
        assert!(error.to_string().contains("17 x 13") && error.to_string().contains("11 x 8"));
    }

    #[test]
    fn a_larger_board_is_an_error_even_where_a_part_has_the_declared_size() {
        let board = Chessboard::new(11, 8, 24.0).unwrap();
        let images = vec![larger([9, 12]), part([11, 8], true), larger([12, 9])];
        assert_eq!(
            label_capture(images, &board).unwrap_err(),
            CaptureError::Larger { declared: [11, 8], seen: [12, 9], images: 2 }
        );
        // One stray detection does not condemn a capture.
        let images = vec![larger([12, 8]), part([11, 8], true), part([11, 8], true)];
        assert!(label_capture(images, &board).is_ok());
    }

    #[test]
    fn nothing_found_is_its_own_error() {
        let board = Chessboard::new(11, 8, 24.0).unwrap();
        let images = vec![Err(Rejection::NoBoard { candidates: 0 }); 4];
        let error = label_capture(images, &board).unwrap_err();
        assert_eq!(error, CaptureError::NoBoard { declared: [11, 8], images: 4 });
        assert!(error.to_string().contains("11 x 8") && error.to_string().contains("inner_corners"));
        let none = label_capture(Vec::new(), &board);
        assert_eq!(none, Err(CaptureError::NoBoard { declared: [11, 8], images: 0 }));
    }
}
