//! Pinhole with Brown–Conrady distortion.

use crate::error::GeomError;
use crate::real::Real;
use nalgebra::{Matrix2, Vector2, Vector3};

/// Brown–Conrady distortion of normalised image points, in OpenCV's order and sense: with r² = x² + y²,
/// x_d = x (1 + k₁r² + k₂r⁴ + k₃r⁶) + 2p₁xy + p₂(r² + 2x²), y_d alike with p₁(r² + 2y²) + 2p₂xy.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Distortion<T = f64> {
    /// Radial, r².
    pub k1: T,
    /// Radial, r⁴.
    pub k2: T,
    /// Decentering, y.
    pub p1: T,
    /// Decentering, x.
    pub p2: T,
    /// Radial, r⁶.
    pub k3: T,
}

impl<T: Real> Distortion<T> {
    /// No distortion.
    pub fn none() -> Self {
        let zero = T::constant(0.0);
        Self { k1: zero, k2: zero, p1: zero, p2: zero, k3: zero }
    }

    /// The distorted normalised image point of an undistorted one.
    pub fn apply(&self, point: &Vector2<T>) -> Vector2<T> {
        let (x, y) = (point.x, point.y);
        let (xx, yy, xy) = (x * x, y * y, (x * y).scale(2.0));
        let r2 = xx + yy;
        let radial = T::constant(1.0) + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3));
        Vector2::new(
            x * radial + self.p1 * xy + self.p2 * (r2 + xx.scale(2.0)),
            y * radial + self.p1 * (r2 + yy.scale(2.0)) + self.p2 * xy,
        )
    }

    fn value(&self) -> Distortion<f64> {
        Distortion {
            k1: self.k1.value(),
            k2: self.k2.value(),
            p1: self.p1.value(),
            p2: self.p2.value(),
            k3: self.k3.value(),
        }
    }
}

impl Distortion<f64> {
    /// ∂(distorted)/∂(undistorted).
    fn jacobian(&self, p: &Vector2<f64>) -> Matrix2<f64> {
        let r2 = p.norm_squared();
        let radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3));
        let slope = 2.0 * (self.k1 + r2 * (2.0 * self.k2 + r2 * 3.0 * self.k3));
        let cross = slope * p.x * p.y + 2.0 * (self.p1 * p.x + self.p2 * p.y);
        Matrix2::new(
            radial + slope * p.x * p.x + 2.0 * self.p1 * p.y + 6.0 * self.p2 * p.x,
            cross,
            cross,
            radial + slope * p.y * p.y + 6.0 * self.p1 * p.y + 2.0 * self.p2 * p.x,
        )
    }
}

/// A pinhole camera in air. Pixel (0, 0) is the centre of the top-left pixel; u right, v down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera<T = f64> {
    /// Focal length in columns, px.
    pub fx: T,
    /// Focal length in rows, px.
    pub fy: T,
    /// Principal point, u, px.
    pub cx: T,
    /// Principal point, v, px.
    pub cy: T,
    /// The lens's distortion.
    pub distortion: Distortion<T>,
}

/// Newton steps after which undistortion is given up.
const MAX_STEPS: u32 = 30;

impl<T: Real> Camera<T> {
    /// The pixel at which light arriving from `direction` (camera frame, any length) is seen.
    ///
    /// # Errors
    /// [`GeomError::BehindCamera`] unless z > 0.
    pub fn project(&self, direction: &Vector3<T>) -> Result<Vector2<T>, GeomError> {
        if direction.z.value().is_nan() || direction.z.value() <= 0.0 {
            return Err(GeomError::BehindCamera { z: direction.z.value() });
        }
        let d = self.distortion.apply(&Vector2::new(direction.x / direction.z, direction.y / direction.z));
        Ok(Vector2::new(self.fx * d.x + self.cx, self.fy * d.y + self.cy))
    }

    /// The direction in air (camera frame, z = 1) from which light at `pixel` arrives.
    ///
    /// # Errors
    /// [`GeomError::Undistortable`] where the distortion can't be undone: beyond the field in which it is monotone.
    pub fn unproject(&self, pixel: &Vector2<T>) -> Result<Vector3<T>, GeomError> {
        let distorted = Vector2::new((pixel.x - self.cx) / self.fx, (pixel.y - self.cy) / self.fy);
        let target = distorted.map(T::value);
        let distortion = self.distortion.value();
        let fail = GeomError::Undistortable { x: target.x, y: target.y };
        let mut p = target;
        let mut inverse = None;
        for _ in 0..MAX_STEPS {
            let jacobian = distortion.jacobian(&p);
            // Past the turning point of the radial curve there is another, false, solution.
            if jacobian.determinant() <= 0.0 || jacobian.trace() <= 0.0 {
                return Err(fail);
            }
            let j = jacobian.try_inverse().ok_or(fail)?;
            let step = j * (distortion.apply(&p) - target);
            p -= step;
            inverse = Some(j);
            if step.norm() <= 1e-15 * (1.0 + p.norm()) {
                break;
            }
        }
        let inverse = inverse.filter(|_| p.norm().is_finite()).ok_or(fail)?;
        if (distortion.apply(&p) - target).norm() > 1e-12 * (1.0 + target.norm()) {
            return Err(fail);
        }
        let at = p.map(T::constant);
        let off = self.distortion.apply(&at) - distorted;
        let undistorted = Vector2::new(
            at.x - off.x.scale(inverse[(0, 0)]) - off.y.scale(inverse[(0, 1)]),
            at.y - off.x.scale(inverse[(1, 0)]) - off.y.scale(inverse[(1, 1)]),
        );
        Ok(Vector3::new(undistorted.x, undistorted.y, T::constant(1.0)))
    }

    /// The camera without derivatives.
    pub fn value(&self) -> Camera<f64> {
        Camera {
            fx: self.fx.value(),
            fy: self.fy.value(),
            cx: self.cx.value(),
            cy: self.cy.value(),
            distortion: self.distortion.value(),
        }
    }
}
