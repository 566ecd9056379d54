//! Images and their truth: the crate's front.

use crate::curve::{self, Along, CurvePoint};
use crate::error::SimError;
use crate::instrument::Instrument;
use crate::noise::{Picture, frame_seed, sense};
use crate::scene::Scene;
use crate::sight::Sight;
use crate::speckle::{Speckle, mix};
use crate::spread::{Canvas, Kernel};
use crate::stripe::SAMPLES;
use crate::world::World;
use crate::{ambient, haze, stripe};
use nalgebra::Vector2;

/// An instrument in front of a scene.
#[derive(Clone, Copy, Debug)]
pub struct Renderer<'a> {
    instrument: &'a Instrument,
    scene: &'a Scene,
}

/// One image to take.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shot {
    /// Number of the frame: with the scene's seed it fixes the noise.
    pub frame: u64,
    /// Seconds since time 0, at which things are where they are shown.
    pub seconds: f64,
    /// The galvanometer's voltage; `None`: the laser is off.
    pub voltage: Option<f64>,
}

/// Light on the sensor without noise: one value a pixel, fractions of full scale, before vignetting.
#[derive(Clone, Debug)]
pub struct Exposed(Canvas);

impl<'a> Renderer<'a> {
    /// The renderer of a scene.
    ///
    /// # Errors
    /// [`SimError`] for a figure that no instrument or scene has.
    pub fn new(instrument: &'a Instrument, scene: &'a Scene) -> Result<Self, SimError> {
        instrument.check()?;
        scene.check()?;
        Ok(Self { instrument, scene })
    }

    /// The image of a shot, noise and all.
    ///
    /// # Errors
    /// [`SimError::Geometry`] for a voltage at which no light leaves the laser's window.
    pub fn take(&self, shot: &Shot) -> Result<Picture, SimError> {
        self.develop(shot, self.ambient(shot.seconds).as_ref())
    }

    /// What ambient light shows of the scene at a time, for any number of shots at which nothing has moved; `None` where there is no
    /// such light.
    pub fn ambient(&self, seconds: f64) -> Option<Exposed> {
        let light = self.scene.ambient;
        (light.laser_off > 0.0 || light.laser_on > 0.0).then(|| {
            let world = World::new(self.scene, seconds);
            Exposed(ambient::render(self.instrument, &world, &self.scene.water))
        })
    }

    /// [`Renderer::take`] with the ambient light's part at hand.
    ///
    /// # Errors
    /// As [`Renderer::take`].
    pub fn develop(&self, shot: &Shot, ambient: Option<&Exposed>) -> Result<Picture, SimError> {
        let expected = self.expected_dn(shot, ambient)?;
        let seed = frame_seed(self.scene.seed, shot.frame);
        Ok(sense(&expected, self.instrument.size, &self.instrument.sensor, seed))
    }

    /// Expected grey values of a shot above darkness, row by row: without shot noise, read noise, steps and limits.
    ///
    /// # Errors
    /// As [`Renderer::take`].
    pub fn expected_dn(&self, shot: &Shot, ambient: Option<&Exposed>) -> Result<Vec<f32>, SimError> {
        let instrument = self.instrument;
        let [width, height] = instrument.size.map(|n| n as usize);
        let mut light = match shot.voltage {
            Some(voltage) => self.laser(shot, voltage)?,
            None => Canvas::new(width, height),
        };
        let level =
            if shot.voltage.is_some() { self.scene.ambient.laser_on } else { self.scene.ambient.laser_off };
        if let Some(Exposed(ambient)) = ambient.filter(|_| level > 0.0) {
            light.data.iter_mut().zip(&ambient.data).for_each(|(o, x)| *o += level as f32 * x);
        }
        self.scatter(&mut light);
        let full = instrument.sensor.full_scale();
        let flat = instrument.lens.vignetting <= 0.0;
        for (v, line) in light.data.chunks_exact_mut(width).enumerate() {
            for (u, value) in line.iter_mut().enumerate().filter(|(_, value)| **value > 0.0) {
                let left = if flat { 1.0 } else { instrument.vignette(&Vector2::new(u as f64, v as f64)) };
                *value *= (full * left) as f32;
            }
        }
        Ok(light.data)
    }

    /// The exact stripe of a shot: every point that the laser lights and the camera sees, one or more a row (column).
    ///
    /// # Errors
    /// As [`Renderer::take`].
    pub fn curve(&self, seconds: f64, voltage: f64, along: Along) -> Result<Vec<CurvePoint>, SimError> {
        let world = World::new(self.scene, seconds);
        let sight = Sight::new(self.instrument, &world, self.scene.water, voltage)?;
        Ok(curve::points(&sight, along))
    }

    fn laser(&self, shot: &Shot, voltage: f64) -> Result<Canvas, SimError> {
        let world = World::new(self.scene, shot.seconds);
        let sight = Sight::new(self.instrument, &world, self.scene.water, voltage)?;
        let lens = &self.instrument.lens;
        let sensor = &self.instrument.sensor;
        let seed = mix(frame_seed(self.scene.seed, shot.frame));
        let speckle = Speckle::new(seed, sensor.speckle, sensor.speckle_px);
        let mut light = stripe::render(&sight, &Kernel::new(lens.blur_px, SAMPLES), speckle.as_ref());
        if self.scene.water.backscatter_per_mm > 0.0 {
            let kernel = Kernel::new(lens.blur_px, 1);
            let veil = kernel.crop(&haze::render(&sight, voltage, kernel.reach)?, kernel.reach);
            light.data.iter_mut().zip(&veil.data).for_each(|(o, x)| *o += x);
        }
        Ok(light)
    }

    /// Forward scatter: a share of the light spread wider.
    fn scatter(&self, light: &mut Canvas) {
        let lens = &self.instrument.lens;
        let wider = (lens.halo_px.powi(2) - lens.blur_px.powi(2)).max(0.0).sqrt();
        if lens.halo <= 0.0 || wider <= 0.0 {
            return;
        }
        let kernel = Kernel::new(wider, 1);
        let margin = kernel.reach;
        let mut padded = Canvas::new(light.width + 2 * margin, light.height + 2 * margin);
        for (row, line) in light.data.chunks_exact(light.width).enumerate() {
            let start = (row + margin) * padded.width + margin;
            padded.data[start..start + light.width].copy_from_slice(line);
        }
        let spread = kernel.crop(&padded, margin);
        let share = lens.halo as f32;
        light.data.iter_mut().zip(&spread.data).for_each(|(o, x)| *o += share * (x - *o));
    }
}
