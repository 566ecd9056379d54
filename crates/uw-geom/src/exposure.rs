//! One image's worth of triangulation: what the voltage fixes is worked out once.

use crate::error::GeomError;
use crate::ray::Ray;
use crate::real::{Dual, Real, values};
use crate::scanner::{Scanner, Triangulated};
use crate::snell::Medium;
use crate::trace::{Solver, Tracer};
use nalgebra::{Vector2, Vector3};

/// The scanner at one voltage in one medium, for triangulating the many pixels of an image: the same answers as
/// [`Scanner::triangulate`] and [`Scanner::triangulate_with_derivatives`], several times faster.
#[derive(Clone, Debug)]
pub struct Exposure {
    scanner: Scanner,
    outside: Medium,
    solver: Solver,
    dual: DualExposure,
}

/// The same in numbers that carry ∂/∂u, ∂/∂v and ∂/∂voltage.
#[derive(Clone, Debug)]
struct DualExposure {
    scanner: Scanner<Dual<3>>,
    outside: Medium<Dual<3>>,
    tracer: Tracer<Dual<3>>,
}

impl Scanner {
    /// The scanner at `voltage`, ready for the pixels of one image.
    ///
    /// # Errors
    /// [`GeomError`] for a voltage at which the fan does not leave through its window.
    pub fn exposure(&self, voltage: f64, outside: Medium) -> Result<Exposure, GeomError> {
        let scanner = self.lift::<Dual<3>>();
        let dual_outside = Medium::of_index(Dual::constant(outside.index));
        let tracer = Tracer::new(&scanner.sheet(Dual::variable(voltage, 2), dual_outside))?;
        Ok(Exposure {
            scanner: *self,
            outside,
            solver: Solver::new(&tracer.value()),
            dual: DualExposure { scanner, outside: dual_outside, tracer },
        })
    }
}

impl Exposure {
    /// The point of the sheet seen at `pixel`, camera frame, mm.
    ///
    /// # Errors
    /// As [`Scanner::triangulate`].
    pub fn triangulate(&self, pixel: &Vector2<f64>) -> Result<Vector3<f64>, GeomError> {
        let ray = self.scanner.pixel_ray(pixel, self.outside)?;
        Ok(ray.at(self.solver.solve(&ray)?.distance_mm))
    }

    /// The point of the sheet seen at `pixel` (camera frame, mm) with its derivatives to pixel and voltage.
    ///
    /// # Errors
    /// As [`Scanner::triangulate`].
    pub fn triangulate_with_derivatives(&self, pixel: &Vector2<f64>) -> Result<Triangulated, GeomError> {
        let uv = Vector2::new(Dual::variable(pixel.x, 0), Dual::variable(pixel.y, 1));
        let ray = self.dual.scanner.pixel_ray(&uv, self.dual.outside)?;
        let fixed = Ray { origin: values(&ray.origin), direction: values(&ray.direction) };
        let p = self.dual.tracer.meet(&ray, &self.solver.solve(&fixed)?);
        Ok(Triangulated {
            point_mm: p.map(Real::value),
            per_u: p.map(|x| x.eps[0]),
            per_v: p.map(|x| x.eps[1]),
            per_volt: p.map(|x| x.eps[2]),
        })
    }
}
