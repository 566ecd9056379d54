//! Frames as marker types, and rigid transforms between them.

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use std::marker::PhantomData;
use std::ops::Mul;

/// x right, y down, z forward; origin in the optical centre.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Camera;
/// x along the mirror's axis, z out to the scene in the laser plane at the reference voltage (FORMATS §3).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Galvo;
/// x along a row of corners, y along a column, z = 0 on the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Board;
/// Whatever the vehicle navigates in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct World;

/// `A_from_B`: takes points and directions in frame `B` to frame `A`; millimetres.
#[derive(Debug, PartialEq)]
pub struct Rigid<A, B> {
    isometry: Isometry3<f64>,
    frames: PhantomData<(A, B)>,
}

impl<A, B> Clone for Rigid<A, B> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<A, B> Copy for Rigid<A, B> {}

impl<A, B> Rigid<A, B> {
    /// The transform with this rotation and translation (the origin of `B` in `A`, mm).
    pub fn new(rotation: UnitQuaternion<f64>, translation_mm: Vector3<f64>) -> Self {
        Self {
            isometry: Isometry3::from_parts(Translation3::from(translation_mm), rotation),
            frames: PhantomData,
        }
    }

    /// The transform whose rotation is closest to `rotation` (columns: the axes of `B` in `A`): the orthogonal factor of its
    /// polar decomposition. Figures that are not numbers are handed on.
    pub fn from_matrix(rotation: &Matrix3<f64>, translation_mm: Vector3<f64>) -> Self {
        Self::new(UnitQuaternion::from_rotation_matrix(&closest_rotation(rotation)), translation_mm)
    }

    /// The transform that changes nothing.
    pub fn identity() -> Self {
        Self::new(UnitQuaternion::identity(), Vector3::zeros())
    }

    /// A point of `B`, in `A` (mm).
    pub fn transform_point(&self, point_mm: &Vector3<f64>) -> Vector3<f64> {
        self.isometry.transform_point(&Point3::from(*point_mm)).coords
    }

    /// A direction of `B`, in `A`: rotated, not moved.
    pub fn transform_direction(&self, direction: &Vector3<f64>) -> Vector3<f64> {
        self.isometry.rotation * direction
    }

    /// `B_from_A`.
    pub fn inverse(&self) -> Rigid<B, A> {
        Rigid { isometry: self.isometry.inverse(), frames: PhantomData }
    }

    /// The same transform without its frames, for code that knows none.
    pub fn isometry(&self) -> Isometry3<f64> {
        self.isometry
    }

    /// The rotation's part.
    pub fn rotation(&self) -> UnitQuaternion<f64> {
        self.isometry.rotation
    }

    /// The rotation as a matrix; its columns are the axes of `B` in `A`.
    pub fn rotation_matrix(&self) -> Matrix3<f64> {
        self.isometry.rotation.to_rotation_matrix().into_inner()
    }

    /// The origin of `B` in `A`, mm.
    pub fn translation_mm(&self) -> Vector3<f64> {
        self.isometry.translation.vector
    }
}

impl<A, B, C> Mul<Rigid<B, C>> for Rigid<A, B> {
    type Output = Rigid<A, C>;
    fn mul(self, other: Rigid<B, C>) -> Rigid<A, C> {
        Rigid { isometry: self.isometry * other.isometry, frames: PhantomData }
    }
}

/// nalgebra's own search for the closest rotation never ends on a matrix of zeros or of NaN.
fn closest_rotation(matrix: &Matrix3<f64>) -> Rotation3<f64> {
    let factors = matrix.iter().all(|x| x.is_finite()).then(|| matrix.svd(true, true));
    let Some((Some(u), Some(v_t))) = factors.map(|f| (f.u, f.v_t)) else {
        return Rotation3::from_matrix_unchecked(Matrix3::repeat(f64::NAN));
    };
    // Of the two orthogonal factors the one that doesn't mirror, at the cost of the least singular value.
    let sign = (u * v_t).determinant().signum();
    Rotation3::from_matrix_unchecked(u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v_t)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A matrix near a rotation gives the rotation that it is nearest to, and none makes it search for ever.
    #[test]
    fn the_closest_rotation_is_found() {
        let exact = UnitQuaternion::from_scaled_axis(Vector3::new(0.3, -1.2, 2.0)).to_rotation_matrix();
        let stretch = Matrix3::new(1.1, 0.02, 0.0, 0.02, 0.9, 0.01, 0.0, 0.01, 1.05);
        // Exactly: R S with S symmetric and positive has R as its orthogonal factor.
        let found: Rigid<Camera, Galvo> = Rigid::from_matrix(&(exact.matrix() * stretch), Vector3::zeros());
        assert!((found.rotation_matrix() - exact.matrix()).norm() < 1e-12);
        let half_turn: Rigid<Camera, Galvo> =
            Rigid::from_matrix(&Matrix3::from_diagonal(&Vector3::new(-1.0, -1.0, 1.0)), Vector3::zeros());
        assert!((half_turn.rotation_matrix()[(0, 0)] + 1.0).abs() < 1e-12);
        let nothing: Rigid<Camera, Galvo> = Rigid::from_matrix(&Matrix3::zeros(), Vector3::zeros());
        assert!((nothing.rotation_matrix().determinant() - 1.0).abs() < 1e-12);
        let nan: Rigid<Camera, Galvo> = Rigid::from_matrix(&Matrix3::repeat(f64::NAN), Vector3::zeros());
        assert!(nan.rotation_matrix()[(0, 0)].is_nan());
    }

    /// Rounding of a few products of numbers near 1000 mm.
    const ROUNDING_MM: f64 = 1e-9;

    proptest! {
        #[test]
        fn a_transform_and_its_inverse_cancel(
            axis in prop::array::uniform3(-3.0..3.0f64), t in prop::array::uniform3(-1e3..1e3f64),
            p in prop::array::uniform3(-1e3..1e3f64),
        ) {
            let camera_from_galvo: Rigid<Camera, Galvo> =
                Rigid::new(UnitQuaternion::from_scaled_axis(Vector3::from(axis)), Vector3::from(t));
            let p = Vector3::from(p);
            let back = (camera_from_galvo.inverse() * camera_from_galvo).transform_point(&p);
            prop_assert!((back - p).norm() < ROUNDING_MM);
            let d = camera_from_galvo.transform_direction(&p);
            prop_assert!((d.norm() - p.norm()).abs() < ROUNDING_MM);
        }
    }
}
