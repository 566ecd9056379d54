//! A pose as it moves many points.

use nalgebra::{Isometry3, Matrix3, Point3, Vector3};

/// A rigid motion, its turn as a matrix, and where it brings the middle of what it moves.
pub(super) struct Pose {
    turn: Matrix3<f64>,
    shift: Vector3<f64>,
    pub(super) middle: Vector3<f64>,
}

impl Pose {
    /// Returns a motion of what has this middle.
    pub(super) fn of(motion: &Isometry3<f64>, middle: &Vector3<f64>) -> Self {
        Self {
            turn: motion.rotation.to_rotation_matrix().into_inner(),
            shift: motion.translation.vector,
            middle: (motion * Point3::from(*middle)).coords,
        }
    }

    /// Returns a place, moved.
    pub(super) fn place(&self, place: &Vector3<f64>) -> Vector3<f64> {
        self.turn * place + self.shift
    }

    /// Returns a direction, turned.
    pub(super) fn direction(&self, direction: &Vector3<f64>) -> Vector3<f64> {
        self.turn * direction
    }

    /// Returns the direction that is turned to this one.
    pub(super) fn back(&self, direction: &Vector3<f64>) -> Vector3<f64> {
        self.turn.tr_mul(direction)
    }
}
