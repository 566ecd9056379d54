//! What the instrument sees of a board: corners, and where on it the laser's stripe lies.

use crate::data::{Across, Outside};
use crate::parameters::Instrument;
use nalgebra::{Matrix3, UnitQuaternion, Vector2, Vector3, Vector6};
use uw_geom::frame::{Board, Camera};
use uw_geom::{Dual, GeomError, Medium, Real, Rigid, Sheet, lift};

/// `camera_from_board`, in the scalar `T`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pose<T: nalgebra::Scalar> {
    rotation: Matrix3<T>,
    translation_mm: Vector3<T>,
}

impl<T: Real> Pose<T> {
    pub(crate) fn constant(pose: &Rigid<Camera, Board>) -> Self {
        Self {
            rotation: pose.rotation_matrix().map(T::constant),
            translation_mm: lift(&pose.translation_mm()),
        }
    }

    /// A point of the board in the camera frame, mm.
    pub(crate) fn point(&self, board_mm: &Vector2<f64>) -> Vector3<T> {
        let column = |i: usize| self.rotation.column(i).into_owned();
        self.translation_mm + column(0).map(|x| x.scale(board_mm.x)) + column(1).map(|x| x.scale(board_mm.y))
    }

    fn normal(&self) -> Vector3<T> {
        self.rotation.column(2).into_owned()
    }
}

impl<const N: usize> Pose<Dual<N>> {
    /// The pose with its six local coordinates (turn in the board's frame, then move in the camera's) as the last six
    /// variables.
    pub(crate) fn variables(pose: &Rigid<Camera, Board>) -> Self {
        let v = |i: usize| Dual::variable(0.0, N - 6 + i);
        let i = Dual::constant(1.0);
        let turn = Matrix3::new(i, -v(2), v(1), v(2), i, -v(0), -v(1), v(0), i);
        let still = Self::constant(pose);
        let moved = still.translation_mm + Vector3::new(v(3), v(4), v(5));
        Self { rotation: still.rotation * turn, translation_mm: moved }
    }
}

/// The pose moved by its six local coordinates, as [`Pose::variables`] names them.
pub(crate) fn moved_pose(pose: &Rigid<Camera, Board>, step: &Vector6<f64>) -> Rigid<Camera, Board> {
    let turn = UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(0).into_owned());
    Rigid::new(pose.rotation() * turn, pose.translation_mm() + step.fixed_rows::<3>(3))
}

impl<T: Real> Instrument<T> {
    /// What is outside, as laser light meets it.
    pub(crate) fn laser_medium(&self, outside: Outside) -> Medium<T> {
        match outside {
            Outside::Air => Medium::air(),
            Outside::Water { laser_index, .. } => {
                Medium::of_index(T::constant(laser_index) + self.water_offset)
            }
        }
    }

    /// What is outside, as the light on the board meets it.
    pub(crate) fn board_medium(&self, outside: Outside) -> Medium<T> {
        match outside {
            Outside::Air => Medium::air(),
            Outside::Water { board_index, .. } => {
                Medium::of_index(T::constant(board_index) + self.water_offset + self.dispersion_offset)
            }
        }
    }

    /// The point of the board's plane seen at `pixel`, camera frame, mm.
    pub(crate) fn on_board(
        &self,
        pixel: &Vector2<T>,
        pose: &Pose<T>,
        medium: Medium<T>,
    ) -> Result<Vector3<T>, GeomError> {
        let ray = self.scanner.pixel_ray(pixel, medium)?;
        let normal = pose.normal();
        let t = normal.dot(&(pose.translation_mm - ray.origin)) / normal.dot(&ray.direction);
        if !(t.value() > 0.0 && t.value().is_finite()) {
            return Err(GeomError::NoIntersection);
        }
        Ok(ray.at(t))
    }
}

/// The stripe of one sheet on one board, as the camera sees it.
pub(crate) struct StripeOnBoard<T: nalgebra::Scalar> {
    pub(crate) instrument: Instrument<T>,
    pub(crate) pose: Pose<T>,
    pub(crate) sheet: Sheet<T>,
    pub(crate) medium: Medium<T>,
    pub(crate) across: Across,
}

/// Newton steps in the measured coordinate; two or three suffice.
const MAX_STEPS: u32 = 15;
/// A step below which the position is settled, px: far below any noise, and Newton doubles its digits.
const SETTLED_PX: f64 = 1e-5;

impl<T: Real> StripeOnBoard<T> {
    pub(crate) fn new(
        instrument: Instrument<T>,
        pose: Pose<T>,
        outside: Outside,
        voltage_v: f64,
        across: Across,
    ) -> Self {
        let medium = instrument.laser_medium(outside);
        let sheet = instrument.scanner.sheet(T::constant(voltage_v), medium);
        Self { instrument, pose, sheet, medium, across }
    }

    /// Sine of the angle in air between the fan's plane and the light to the board's point seen at `pixel`.
    pub(crate) fn off_sheet(&self, pixel: &Vector2<T>) -> Result<T, GeomError> {
        self.sheet.off_sheet(&self.instrument.on_board(pixel, &self.pose, self.medium)?)
    }
}

/// Where the stripe is seen in the row (or column) of a measurement.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Crossing {
    /// The pixel: the measured coordinate moved onto the stripe.
    pub(crate) pixel: Vector2<f64>,
    /// ∂(off sheet)/∂(measured coordinate) there, 1/px.
    pub(crate) slope: f64,
}

impl StripeOnBoard<Dual<1>> {
    /// The stripe's position in the row (column) of `pixel`, searched from the measured one.
    pub(crate) fn crossing(&self, pixel: &Vector2<f64>) -> Result<Crossing, GeomError> {
        let measured = self.across.index();
        let mut at = *pixel;
        for _ in 0..MAX_STEPS {
            let mut variable = at.map(Dual::constant);
            variable[measured] = Dual::variable(at[measured], 0);
            let off = self.off_sheet(&variable)?;
            let [slope] = off.eps;
            let step = off.re / slope;
            if !step.is_finite() {
                return Err(GeomError::NoIntersection);
            }
            at[measured] -= step;
            if step.abs() < SETTLED_PX {
                return Ok(Crossing { pixel: at, slope });
            }
        }
        Err(GeomError::NotConverged { what: "the stripe's place on the board", iterations: MAX_STEPS })
    }
}
