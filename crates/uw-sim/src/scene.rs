//! What stands in front of the instrument.

use crate::error::{SimError, within};
use crate::shape::Shape;
use nalgebra::{UnitQuaternion, Vector3};
use uw_geom::frame::Camera;
use uw_geom::{Medium, Rigid};

/// The frame of an object, in which its shape is described.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Body;

/// Objects in a medium, under light. Whatever moves is where it is at the time of an exposure.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// What is there.
    pub objects: Vec<Object>,
    /// What is outside the windows.
    pub water: Water,
    /// Light beside the laser's.
    pub ambient: Ambient,
    /// The instrument's own velocity, mm/s, camera frame: everything else moves the other way.
    pub instrument_velocity_mm_s: Vector3<f64>,
    /// Seed of all noise: each frame's own follows from this and its number.
    pub seed: u64,
}

/// The medium outside, and what it does to light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Water {
    /// Index at the laser's wavelength.
    pub laser: Medium,
    /// Index at the wavelength of ambient light.
    pub ambient: Medium,
    /// Attenuation, 1/mm, along both ways.
    pub attenuation_per_mm: f64,
    /// Share of the light that a millimetre of water throws back towards the camera, times π (as a white surface would be 1): the haze
    /// along the sheet.
    pub backscatter_per_mm: f64,
}

impl Water {
    /// Air: clear, index 1.
    pub fn air() -> Self {
        let air = Medium::air();
        Self { laser: air, ambient: air, attenuation_per_mm: 0.0, backscatter_per_mm: 0.0 }
    }
}

/// Light that lies evenly on every surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ambient {
    /// Brightness of a white surface in images without the laser, fraction of full scale.
    pub laser_off: f64,
    /// The same while the laser is on, when the exposure is shorter.
    pub laser_on: f64,
}

/// One thing.
#[derive(Clone, Debug, PartialEq)]
pub struct Object {
    /// Its name, for the truth.
    pub name: String,
    /// Its shape, in its own frame.
    pub shape: Shape,
    /// Where it is at time 0.
    pub camera_from_body: Rigid<Camera, Body>,
    /// How it moves.
    pub motion: Motion,
    /// What it looks like.
    pub surface: Surface,
}

/// Steady motion: a translation, and a turn about the object's own origin.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motion {
    /// Velocity, mm/s, camera frame.
    pub velocity_mm_s: Vector3<f64>,
    /// Turn, rad/s, about an axis in the camera frame: the vector's direction.
    pub turn_rad_s: Vector3<f64>,
}

/// How a surface throws light back: Lambert's law, and Phong's lobe with its energy kept (E. Lafortune, Y. Willems, Using the
/// modified Phong reflectance model for physically based rendering, KU Leuven CW197, 1994, Eq 5).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// Share of the light that is thrown back diffusely, 0 to 1.
    pub albedo: f64,
    /// Share that is thrown back about the mirror's direction.
    pub specular: f64,
    /// The lobe's exponent.
    pub shininess: f64,
    /// What is drawn on it.
    pub texture: Texture,
}

/// A pattern on the object's x-y plane, seen along its z axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Texture {
    /// None.
    Plain,
    /// A chessboard: its inner corner (0, 0) at the origin, corner (c, r) at (c, r) squares; squares reach one beyond the outermost
    /// inner corners, and have the surface's albedo or `dark`. Around them: the surface's albedo.
    Chessboard {
        /// Inner corners along x and along y.
        inner_corners: [u32; 2],
        /// Side of a square, mm.
        square_mm: f64,
        /// Albedo of the dark squares; the one below and right of corner (0, 0) is dark.
        dark: f64,
    },
    /// Tiles with joints between them; the first joint's middle runs through the origin.
    Tiles {
        /// From joint to joint, mm.
        pitch_mm: f64,
        /// Width of a joint, mm.
        joint_mm: f64,
        /// Albedo of the joints.
        dark: f64,
    },
}

impl Object {
    /// A thing that does not move.
    pub fn fixed(name: &str, shape: Shape, camera_from_body: Rigid<Camera, Body>, surface: Surface) -> Self {
        Self { name: name.to_owned(), shape, camera_from_body, motion: Motion::default(), surface }
    }

    /// Where it is `seconds` after time 0, as seen from an instrument that moves at `instrument_mm_s`.
    pub fn pose_at(&self, seconds: f64, instrument_mm_s: &Vector3<f64>) -> Rigid<Camera, Body> {
        let start = &self.camera_from_body;
        let turn = UnitQuaternion::from_scaled_axis(self.motion.turn_rad_s * seconds);
        let moved = start.translation_mm() + (self.motion.velocity_mm_s - instrument_mm_s) * seconds;
        Rigid::new(turn * start.rotation(), moved)
    }
}

impl Surface {
    /// A surface without gloss or pattern.
    pub fn matt(albedo: f64) -> Self {
        Self { albedo, specular: 0.0, shininess: 30.0, texture: Texture::Plain }
    }
}

impl Scene {
    /// Whether anything changes its place with time.
    pub fn moves(&self) -> bool {
        let still = |v: &Vector3<f64>| v.norm_squared() <= 0.0;
        !still(&self.instrument_velocity_mm_s)
            || self.objects.iter().any(|o| !still(&o.motion.velocity_mm_s) || !still(&o.motion.turn_rad_s))
    }

    /// Checks every figure.
    ///
    /// # Errors
    /// [`SimError::Invalid`] names the first that no scene has, [`SimError::Object`] with the object that has it.
    pub fn check(&self) -> Result<(), SimError> {
        let least_0 = |what, value| within(what, "0 or more", 0.0..=f64::MAX, value).map(drop);
        for medium in [self.water.laser, self.water.ambient] {
            within("the index outside the windows", "from 1 to 2", 1.0..=2.0, medium.index)?;
        }
        least_0("attenuation", self.water.attenuation_per_mm)?;
        least_0("backscatter", self.water.backscatter_per_mm)?;
        least_0("ambient light", self.ambient.laser_off)?;
        least_0("ambient light", self.ambient.laser_on)?;
        self.objects.iter().try_for_each(|object| {
            object
                .shape
                .check()
                .and_then(|()| object.surface.check())
                .map_err(|source| SimError::Object { object: object.name.clone(), source: Box::new(source) })
        })
    }
}

impl Surface {
    /// Checks every figure.
    fn check(&self) -> Result<(), SimError> {
        let Self { albedo, specular, shininess, texture } = *self;
        let mut fractions = vec![("albedo", albedo), ("the specular share", specular)];
        let positive = |what, value| within(what, "positive", f64::MIN_POSITIVE..=f64::MAX, value);
        match texture {
            Texture::Plain => {}
            Texture::Chessboard { square_mm, dark, .. } => {
                positive("a square's side", square_mm)?;
                fractions.push(("the dark squares' albedo", dark));
            }
            Texture::Tiles { pitch_mm, joint_mm, dark } => {
                positive("the tiles' pitch", pitch_mm)?;
                within("a joint's width", "less than the pitch", 0.0..=pitch_mm, joint_mm)?;
                fractions.push(("the joints' albedo", dark));
            }
        }
        for (what, value) in fractions {
            within(what, "from 0 to 1", 0.0..=1.0, value)?;
        }
        within("shininess", "from 0 to 10000", 0.0..=1e4, shininess).map(drop)
    }
}
