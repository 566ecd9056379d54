//! What is seen at one place of an image: surface, laser light on it, where that came from.

use crate::error::SimError;
use crate::instrument::{Instrument, Light};
use crate::scene::Water;
use crate::world::{Hit, World};
use nalgebra::{Vector2, Vector3};
use uw_geom::{Dual, GeomError, Medium, Ray, Real, Sheet, lift, norm, values};

/// Beyond this many standard deviations from its middle the sheet has no light worth a ray (3e-7 of the middle's).
pub(crate) const EDGE_SIGMAS: f64 = 5.5;
/// Up to here it is found out whether light reaches a surface, so that interpolation between samples knows.
const TRIED_SIGMAS: f64 = 8.0;

/// A scene at one moment as the instrument sees it with the mirror at one voltage.
pub(crate) struct Sight<'a> {
    pub(crate) instrument: &'a Instrument,
    pub(crate) world: &'a World<'a>,
    pub(crate) water: Water,
    pub(crate) light: Light,
    dual: Sheet<Dual<3>>,
}

/// What is seen at one place.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Glimpse {
    /// Which smooth surface.
    pub(crate) object: usize,
    pub(crate) facet: u32,
    /// Whether laser light reaches it.
    pub(crate) lit: bool,
    /// Signed distance from the middle of the sheet, mm.
    pub(crate) off_mm: f64,
    /// The sheet's standard deviation there, mm.
    pub(crate) sigma_mm: f64,
    /// Brightness in the sheet's middle of a surface of albedo 1, fraction of full scale.
    pub(crate) diffuse: f64,
    /// What gloss adds.
    pub(crate) gloss: f64,
    /// Where on the object's drawing, mm.
    pub(crate) drawn: [f64; 2],
    /// The surface point, camera frame, mm.
    pub(crate) point: Vector3<f64>,
}

impl Glimpse {
    /// Whether another glimpse is of the same smooth surface in the same light.
    pub(crate) fn joins(&self, other: &Self) -> bool {
        self.same_surface(other) && self.lit == other.lit
    }

    /// Whether another glimpse is of the same smooth surface.
    pub(crate) fn same_surface(&self, other: &Self) -> bool {
        self.object == other.object && self.facet == other.facet
    }
}

/// Light at a point: how it comes there.
pub(crate) struct Arrival {
    /// Signed distance of the point from the middle of the sheet, mm.
    pub(crate) off_mm: f64,
    /// Millimetres that the point moves for a radian at the apex, across the sheet.
    lever_mm: f64,
    /// Direction in air, of any length.
    air: Vector3<f64>,
}

impl<'a> Sight<'a> {
    pub(crate) fn new(
        instrument: &'a Instrument,
        world: &'a World<'a>,
        water: Water,
        voltage: f64,
    ) -> Result<Self, SimError> {
        let light = instrument.light(voltage, water.laser);
        let s = &light.sheet;
        // Where the fan's middle doesn't leave through the window, the mirror stands elsewhere than it is meant to.
        s.port.ray_out(&s.apex_mm, &light.middle, s.outside)?;
        s.ray(0.0)?;
        let dual = Sheet {
            apex_mm: lift(&s.apex_mm),
            normal: lift(&s.normal),
            port: s.port.lift(),
            outside: Medium::of_index(Dual::constant(s.outside.index)),
        };
        Ok(Self { instrument, world, water, light, dual })
    }

    /// The ray that the camera sees at a pixel.
    pub(crate) fn ray(&self, pixel: &Vector2<f64>) -> Option<Ray> {
        self.instrument.scanner.pixel_ray(pixel, self.water.laser).ok()
    }

    /// What is seen at a pixel; `None` where nothing is, or where the laser's window doesn't face what is.
    pub(crate) fn look(&self, pixel: &Vector2<f64>) -> Option<Glimpse> {
        let ray = self.ray(pixel)?;
        let hit = self.world.hit(&ray)?;
        self.glimpse(&hit, &ray).ok()
    }

    /// How light comes to a point near the sheet: off_sheet's sine g over its slope |∇g| is the distance from the sheet, and 1/|∇g| the
    /// lever.
    pub(crate) fn arrival(&self, point: &Vector3<f64>) -> Result<Arrival, GeomError> {
        let p: Vector3<Dual<3>> = Vector3::from_fn(|i, _| Dual::variable(point[i], i));
        let air = self.dual.port.air_direction(&self.dual.apex_mm, &p, self.dual.outside)?;
        let sine = self.dual.normal.dot(&air) / norm(&air);
        let lever_mm = 1.0 / Vector3::from(sine.eps).norm();
        Ok(Arrival { off_mm: sine.re * lever_mm, lever_mm, air: values(&air) })
    }

    /// The path of light from the apex to a point, through the window's outer face at the given point, mm.
    fn path_mm(&self, exit: &Vector3<f64>, point: &Vector3<f64>) -> f64 {
        (exit - self.light.sheet.apex_mm).norm() + (point - exit).norm()
    }

    fn glimpse(&self, hit: &Hit, ray: &Ray) -> Result<Glimpse, GeomError> {
        let sheet = &self.light.sheet;
        let arrival = self.arrival(&hit.point)?;
        let beam = sheet.port.ray_out(&sheet.apex_mm, &arrival.air, self.water.laser)?;
        let path_mm = self.path_mm(&beam.origin, &hit.point);
        let sigma_mm = self.light.sigma_mm(path_mm);
        let cosine = -hit.normal.dot(&beam.direction);
        let mut lit = cosine > 0.0 && self.light.within_fan(&arrival.air);
        if lit && arrival.off_mm.abs() < TRIED_SIGMAS * sigma_mm {
            lit = self.world.clear(&hit.point, &beam.origin);
        }
        let way = (hit.point - beam.origin).norm() + hit.distance_mm;
        let arriving = self.light.irradiance(path_mm, arrival.lever_mm)
            * (-self.water.attenuation_per_mm * way).exp()
            * cosine.max(0.0);
        let surface = self.world.surface(hit.object);
        let gloss = if surface.specular > 0.0 {
            let mirrored = beam.direction + hit.normal * (2.0 * cosine);
            let towards = (-mirrored.dot(&ray.direction)).max(0.0);
            surface.specular * 0.5 * (surface.shininess + 2.0) * towards.powf(surface.shininess)
        } else {
            0.0
        };
        Ok(Glimpse {
            object: hit.object,
            facet: hit.facet,
            lit,
            off_mm: arrival.off_mm,
            sigma_mm,
            diffuse: arriving,
            gloss: arriving * gloss,
            drawn: hit.drawn,
            point: hit.point,
        })
    }

    /// Brightness of the water in the sheet as the camera's ray crosses it at a point, had the surface behind it been infinitely far: a
    /// layer of water of standard deviation σ, crossed at a slant, throws back √(2π) σ / |slant| millimetres' worth.
    pub(crate) fn haze(&self, point: &Vector3<f64>, ray: &Ray, distance_mm: f64) -> Option<f64> {
        let sheet = &self.light.sheet;
        let arrival = self.arrival(point).ok()?;
        if !self.light.within_fan(&arrival.air) {
            return None;
        }
        let beam = sheet.port.ray_out(&sheet.apex_mm, &arrival.air, self.water.laser).ok()?;
        if !self.world.clear(point, &beam.origin) {
            return None;
        }
        let path_mm = self.path_mm(&beam.origin, point);
        let sigma = self.light.sigma_mm(path_mm);
        // The sheet's normal there: square to the beam and to the fan's trace.
        let across = self.light.sheet.normal.cross(&beam.direction).cross(&beam.direction);
        let slant = across.try_normalize(0.0)?.dot(&ray.direction).abs().max(LEAST_SLANT);
        let way = (point - beam.origin).norm() + distance_mm;
        let thickness = (2.0 * std::f64::consts::PI).sqrt() * sigma / slant;
        Some(
            self.water.backscatter_per_mm
                * thickness
                * self.light.irradiance(path_mm, arrival.lever_mm)
                * (-self.water.attenuation_per_mm * way).exp(),
        )
    }
}

/// A ray that runs along the sheet leaves it by the sheet's own curvature: the slant counts as no less than this.
const LEAST_SLANT: f64 = 1e-2;
