//! The chessboard target: its size and its corners in the board frame.

/// Largest number of inner corners along one side; a typing error is likelier than such a board.
const MAX_SIDE: usize = 500;

/// A planar chessboard, described by its inner corners (where four squares meet).
///
/// Board frame: origin at corner (0, 0), x along a row of corners, y along a column, z = x × y away from a
/// camera that sees the printed side (labels run clockwise from x to y in the image), millimetres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Chessboard {
    inner_cols: usize,
    inner_rows: usize,
    square_mm: f64,
}

/// Why a board's description is refused.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum BoardError {
    /// Fewer than 3 corners a side give no usable pose, more than 500 are a mistake.
    #[error("a chessboard needs 3 to {MAX_SIDE} inner corners a side, got {inner_cols} x {inner_rows}")]
    Corners {
        /// Corners along a row, as given.
        inner_cols: usize,
        /// Corners along a column, as given.
        inner_rows: usize,
    },
    /// The side of a square is not a positive, finite length.
    #[error("the side of a square must be a positive length in mm, got {square_mm}")]
    Square {
        /// Side of a square, as given.
        square_mm: f64,
    },
}

impl Chessboard {
    /// Returns a board with `inner_cols` corners along a row and `inner_rows` along a column.
    ///
    /// # Errors
    /// [`BoardError`] when a count or the length of a side makes no board.
    ///
    /// # Examples
    /// ```
    /// let board = uw_calib::Chessboard::new(11, 8, 24.0)?;
    /// assert_eq!(board.corner_mm([2, 1]), [48.0, 24.0, 0.0]);
    /// # Ok::<(), uw_calib::BoardError>(())
    /// ```
    pub fn new(inner_cols: usize, inner_rows: usize, square_mm: f64) -> Result<Self, BoardError> {
        let valid = 3..=MAX_SIDE;
        if !valid.contains(&inner_cols) || !valid.contains(&inner_rows) {
            return Err(BoardError::Corners { inner_cols, inner_rows });
        }
        if !(square_mm.is_finite() && square_mm > 0.0) {
            return Err(BoardError::Square { square_mm });
        }
        Ok(Self { inner_cols, inner_rows, square_mm })
    }

    /// Returns the number of inner corners along a row.
    #[must_use]
    pub fn inner_cols(&self) -> usize {
        self.inner_cols
    }

    /// Returns the number of inner corners along a column.
    #[must_use]
    pub fn inner_rows(&self) -> usize {
        self.inner_rows
    }

    /// Returns the side of a square, mm.
    #[must_use]
    pub fn square_mm(&self) -> f64 {
        self.square_mm
    }

    /// Returns the number of inner corners.
    #[must_use]
    pub fn corners(&self) -> usize {
        self.inner_cols * self.inner_rows
    }

    /// Returns the corner at (column, row) in the board frame, mm; indices may lie beyond the board.
    #[must_use]
    pub fn corner_mm(&self, [col, row]: [usize; 2]) -> [f64; 3] {
        [col as f64 * self.square_mm, row as f64 * self.square_mm, 0.0]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nonsense_is_refused() {
        for (cols, rows) in [(0, 8), (11, 2), (usize::MAX, usize::MAX)] {
            assert_eq!(
                Chessboard::new(cols, rows, 10.0),
                Err(BoardError::Corners { inner_cols: cols, inner_rows: rows })
            );
        }
        for square in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(matches!(Chessboard::new(11, 8, square), Err(BoardError::Square { .. })));
        }
    }
}
