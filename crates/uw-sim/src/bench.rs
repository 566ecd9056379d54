//! A simulated instrument behind `uw-hw`'s traits: the mock's bench, whose camera sees a scene.

use crate::instrument::Instrument;
use crate::render::{Exposed, Renderer, Shot};
use crate::scene::Scene;
use crate::{Picture, SimError};
use uw_hw::Pixels;
use uw_hw::mock;

/// What the camera of a mock's bench sees: give the closure to [`mock::Mock::camera`]. The bench says where its mirror was in the middle of
/// the exposure (lag, settling), whether the laser was on, and when; the instrument adds the galvanometer's non-linearity and all that
/// light does. A shot gives the same image whenever it is asked for, and time 0 of things that move is `began_ns`. `exposure_s`: how
/// long exposures are.
///
/// An exposure at which no light leaves the laser's window is dark.
///
/// # Errors
/// [`SimError`] for a figure that no instrument or scene has.
pub fn camera_sees(
    instrument: Instrument,
    scene: Scene,
    began_ns: i64,
    exposure_s: f64,
) -> Result<impl FnMut(&mock::Shot) -> Pixels + Send + 'static, SimError> {
    Renderer::new(&instrument, &scene)?;
    let moves = scene.moves();
    let mut ambient: Option<Option<Exposed>> = None;
    Ok(move |shot: &mock::Shot| {
        let seconds = (shot.stamp_ns - began_ns) as f64 * 1e-9 + 0.5 * exposure_s;
        let [width, height] = shot.size;
        let dark = || {
            pixels(Picture {
                width,
                height,
                bits: instrument.sensor.bits,
                data: vec![instrument.sensor.offset_dn as u16; width as usize * height as usize],
            })
        };
        // A camera that is set up for another size than the instrument's sees a window of it, which is not simulated.
        if shot.size != instrument.size {
            return dark();
        }
        let Ok(renderer) = Renderer::new(&instrument, &scene) else { return dark() };
        if ambient.is_none() || moves {
            ambient = Some(renderer.ambient(seconds));
        }
        let lit = Shot { frame: shot.number, seconds, voltage: shot.laser_on.then_some(shot.volts) };
        let unlit = Shot { voltage: None, ..lit };
        let seen = ambient.as_ref().and_then(Option::as_ref);
        let picture = renderer.develop(&lit, seen).or_else(|_| renderer.develop(&unlit, seen));
        picture.map_or_else(|_| dark(), pixels)
    })
}

fn pixels(picture: Picture) -> Pixels {
    if picture.bits <= 8 {
        picture.data.iter().map(|v| *v as u8).collect::<Vec<u8>>().into()
    } else {
        picture.data.into()
    }
}
