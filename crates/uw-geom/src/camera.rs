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
        let radial = self.radial(r2);
        Vector2::new(
            x * radial + self.p1 * xy + self.p2 * (r2 + xx.scale(2.0)),
            y * radial + self.p1 * (r2 + yy.scale(2.0)) + self.p2 * xy,
        )
    }

    /// 1 + k₁r² + k₂r⁴ + k₃r⁶.
    fn radial(&self, r2: T) -> T {
        T::constant(1.0) + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
    }

    /// The distortion without derivatives.
    pub fn value(&self) -> Distortion<f64> {
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
    /// Whether an undistorted normalised point lies in the field around the optical axis in which distortion is one-to-one:
    /// r(1 + k₁r² + k₂r⁴ + k₃r⁶) grows all the way from the axis to it, and the decentering does not fold it over. Farther
    /// out a polynomial turns back, and [`Camera::project`] gives a pixel at which the point isn't seen.
    pub fn is_one_to_one_at(&self, point: &Vector2<f64>) -> bool {
        let jacobian = self.jacobian(point);
        self.grows_to(point.norm_squared()) && jacobian.determinant() > 0.0 && jacobian.trace() > 0.0
    }

    /// Whether d(radial curve)/dr = 1 + 3k₁q + 5k₂q² + 7k₃q³, q = r², is positive on all of 0 … q.
    #[inline]
    fn grows_to(&self, q: f64) -> bool {
        let (a, b, c) = (3.0 * self.k1, 5.0 * self.k2, 7.0 * self.k3);
        if q * (a.abs() + q * (b.abs() + q * c.abs())) < 1.0 {
            return true;
        }
        let grows = |q: f64| 1.0 + q * (a + q * (b + q * c)) > 0.0;
        // Its smallest value is at an end or where a + 2bq + 3cq² = 0; the second form of the roots stands c = 0.
        let root = (b * b - 3.0 * a * c).max(0.0).sqrt();
        let inside = |x: f64| x > 0.0 && x < q;
        let turns = [-a / (b + root), -a / (b - root)];
        grows(q) && turns.into_iter().filter(|x| inside(*x)).all(grows)
    }

    /// ∂(distorted)/∂(undistorted).
    #[inline]
    fn jacobian(&self, p: &Vector2<f64>) -> Matrix2<f64> {
        let r2 = p.norm_squared();
        let radial = self.radial(r2);
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
/// A step of undistortion (normalised image) behind which the last one ends below rounding: Newton doubles the digits.
const NEARLY_SETTLED: f64 = 1e-4;

impl<T: Real> Camera<T> {
    /// The pixel at which light arriving from `direction` (camera frame, any length) is seen. Far outside the field of view
    /// a distortion polynomial may fold back into the image: [`Distortion::is_one_to_one_at`] tells.
    ///
    /// # Errors
    /// [`GeomError::BehindCamera`] unless z > 0; [`GeomError::Invalid`] for figures that are not finite.
    pub fn project(&self, direction: &Vector3<T>) -> Result<Vector2<T>, GeomError> {
        if direction.z.value().is_nan() || direction.z.value() <= 0.0 {
            return Err(GeomError::BehindCamera { z: direction.z.value() });
        }
        let d = self.distortion.apply(&Vector2::new(direction.x / direction.z, direction.y / direction.z));
        let pixel = Vector2::new(self.fx * d.x + self.cx, self.fy * d.y + self.cy);
        let size = pixel.x.value().abs() + pixel.y.value().abs();
        if !size.is_finite() {
            return Err(GeomError::Invalid { what: "a projected pixel", needed: "finite", got: size });
        }
        Ok(pixel)
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
        // Past the turning point of the radial curve there is another, false, solution: the Jacobian tells.
        let inverse_at = |p: &Vector2<f64>| {
            let j = distortion.jacobian(p);
            let determinant = j.determinant();
            (determinant > 0.0 && j.trace() > 0.0)
                .then(|| Matrix2::new(j.m22, -j.m12, -j.m21, j.m11) * (1.0 / determinant))
                .ok_or(fail)
        };
        let radial = distortion.radial(target.norm_squared());
        let decentering = distortion.apply(&target) - target * radial;
        let mut p = if radial > 0.5 { (target - decentering) / radial } else { target };
        let mut settled = false;
        for _ in 0..MAX_STEPS {
            let step = inverse_at(&p)? * (distortion.apply(&p) - target);
            p -= step;
            settled = step.norm_squared() <= NEARLY_SETTLED * NEARLY_SETTLED;
            if settled {
                break;
            }
        }
        if !settled || !distortion.grows_to(p.norm_squared()) {
            return Err(fail);
        }
        // The last step in the scalar itself: exact derivatives by the implicit function theorem.
        let inverse = inverse_at(&p)?;
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
