//! Scalars that the model is written in: `f64`, or [`Dual`] numbers that carry exact first derivatives along.

use nalgebra::{Matrix3, Scalar, Vector2, Vector3};
use num_traits::{One, Zero};
use std::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Sub, SubAssign};

/// A real number, with or without derivatives: everything the scanner's model needs of a scalar.
///
/// Functions that have to iterate (undistortion, forward projection, triangulation) iterate in `f64` and then take ONE
/// Newton step in the scalar itself: by the implicit function theorem that step carries the exact derivatives.
pub trait Real:
    Scalar
    + Copy
    + Send
    + Sync
    + Zero
    + One
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + SubAssign
    + MulAssign
    + DivAssign
{
    /// The number with all derivatives zero.
    fn constant(value: f64) -> Self;
    /// The number without its derivatives.
    fn value(self) -> f64;
    /// Square root.
    fn sqrt(self) -> Self;
    /// Sine and cosine of an angle in radians.
    fn sin_cos(self) -> (Self, Self);
    /// Arc tangent of `self / x` in the right quadrant, radians.
    fn atan2(self, x: Self) -> Self;
    /// The number times a constant (cheaper than a product of two).
    fn scale(self, factor: f64) -> Self;
}

impl Real for f64 {
    fn constant(value: f64) -> Self {
        value
    }
    fn value(self) -> f64 {
        self
    }
    fn sqrt(self) -> Self {
        f64::sqrt(self)
    }
    fn sin_cos(self) -> (Self, Self) {
        f64::sin_cos(self)
    }
    fn atan2(self, x: Self) -> Self {
        f64::atan2(self, x)
    }
    fn scale(self, factor: f64) -> Self {
        self * factor
    }
}

/// A value and its `N` partial derivatives, propagated exactly (forward-mode differentiation).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dual<const N: usize> {
    /// The value.
    pub re: f64,
    /// The partial derivatives, one per variable.
    pub eps: [f64; N],
}

impl<const N: usize> Dual<N> {
    /// The `index`-th variable at `value`: its derivative with respect to itself is 1.
    ///
    /// # Panics
    /// If `index` is not below `N`.
    pub fn variable(value: f64, index: usize) -> Self {
        let mut eps = [0.0; N];
        eps[index] = 1.0;
        Self { re: value, eps }
    }

    /// `f(self)` for a function with the given value and derivative at `self.re`.
    #[inline]
    fn chain(self, value: f64, slope: f64) -> Self {
        Self { re: value, eps: self.eps.map(|e| e * slope) }
    }

    #[inline]
    fn zip(self, other: Self, re: f64, a: f64, b: f64) -> Self {
        let mut eps = [0.0; N];
        for (e, (x, y)) in eps.iter_mut().zip(self.eps.iter().zip(&other.eps)) {
            *e = a * x + b * y;
        }
        Self { re, eps }
    }
}

impl<const N: usize> Add for Dual<N> {
    type Output = Self;
    #[inline]
    fn add(self, o: Self) -> Self {
        self.zip(o, self.re + o.re, 1.0, 1.0)
    }
}

impl<const N: usize> Sub for Dual<N> {
    type Output = Self;
    #[inline]
    fn sub(self, o: Self) -> Self {
        self.zip(o, self.re - o.re, 1.0, -1.0)
    }
}

impl<const N: usize> Mul for Dual<N> {
    type Output = Self;
    #[inline]
    fn mul(self, o: Self) -> Self {
        self.zip(o, self.re * o.re, o.re, self.re)
    }
}

impl<const N: usize> Div for Dual<N> {
    type Output = Self;
    #[inline]
    fn div(self, o: Self) -> Self {
        let q = self.re / o.re;
        self.zip(o, q, 1.0 / o.re, -q / o.re)
    }
}

impl<const N: usize> Neg for Dual<N> {
    type Output = Self;
    #[inline]
    fn neg(self) -> Self {
        self.chain(-self.re, -1.0)
    }
}

impl<const N: usize> AddAssign for Dual<N> {
    #[inline]
    fn add_assign(&mut self, o: Self) {
        *self = *self + o;
    }
}

impl<const N: usize> SubAssign for Dual<N> {
    #[inline]
    fn sub_assign(&mut self, o: Self) {
        *self = *self - o;
    }
}

impl<const N: usize> MulAssign for Dual<N> {
    #[inline]
    fn mul_assign(&mut self, o: Self) {
        *self = *self * o;
    }
}

impl<const N: usize> DivAssign for Dual<N> {
    #[inline]
    fn div_assign(&mut self, o: Self) {
        *self = *self / o;
    }
}

impl<const N: usize> Zero for Dual<N> {
    fn zero() -> Self {
        Self::constant(0.0)
    }
    fn is_zero(&self) -> bool {
        self.re.abs() <= 0.0 && self.eps.iter().all(|e| e.abs() <= 0.0)
    }
}

impl<const N: usize> One for Dual<N> {
    fn one() -> Self {
        Self::constant(1.0)
    }
}

impl<const N: usize> Real for Dual<N> {
    #[inline]
    fn constant(value: f64) -> Self {
        Self { re: value, eps: [0.0; N] }
    }
    fn value(self) -> f64 {
        self.re
    }
    #[inline]
    fn sqrt(self) -> Self {
        let s = self.re.sqrt();
        self.chain(s, 0.5 / s)
    }
    fn sin_cos(self) -> (Self, Self) {
        let (s, c) = self.re.sin_cos();
        (self.chain(s, c), self.chain(c, -s))
    }
    fn atan2(self, x: Self) -> Self {
        let n = self.re * self.re + x.re * x.re;
        self.zip(x, self.re.atan2(x.re), x.re / n, -self.re / n)
    }
    #[inline]
    fn scale(self, factor: f64) -> Self {
        self.chain(self.re * factor, factor)
    }
}

/// A constant vector in the scalar `T`.
pub fn lift<T: Real>(v: &Vector3<f64>) -> Vector3<T> {
    v.map(T::constant)
}

/// A constant pixel in the scalar `T`.
pub fn lift2<T: Real>(v: &Vector2<f64>) -> Vector2<T> {
    v.map(T::constant)
}

/// A vector without its derivatives.
pub fn values<T: Real>(v: &Vector3<T>) -> Vector3<f64> {
    v.map(T::value)
}

/// Euclidean length.
#[inline]
pub fn norm<T: Real>(v: &Vector3<T>) -> T {
    v.dot(v).sqrt()
}

/// The vector scaled to length 1; `None` where its length is zero or not finite.
pub fn unit<T: Real>(v: &Vector3<T>) -> Option<Vector3<T>> {
    let n = norm(v);
    (n.value() > 0.0 && n.value().is_finite()).then(|| v * (T::constant(1.0) / n))
}

/// Rotation by `angle` radians about the frame's x axis (right-hand rule).
pub fn rotation_about_x<T: Real>(angle: T) -> Matrix3<T> {
    let (s, c) = angle.sin_cos();
    let (o, i) = (T::constant(0.0), T::constant(1.0));
    Matrix3::new(i, o, o, o, c, -s, o, s, c)
}
