//! The simulated instrument behind the traits that drive a real one.

use crate::rig::{instrument, matt, scene};
use std::time::Duration;
use uw_hw::Camera as _;
use uw_hw::mock::{Bench, Mock};
use uw_hw::{CameraSettings, GuardedGalvo, Laser, Limits, ManualClock, Pixels, Timeline, Trigger};
use uw_sim::{Renderer, Shape, Shot, camera_sees};

#[test]
fn what_the_driven_camera_delivers_is_what_the_renderer_makes() {
    let within = Duration::from_secs(1);
    let (instrument, scene) =
        (instrument(), scene(vec![matt("floor", Shape::Plane, [0.0, 0.0, 1000.0], [0.1, 0.2, 0.0])]));
    let timeline = Timeline::new(ManualClock::starting_at(1_700_000_000_000_000_000));
    let bench = Bench { time_constant: Duration::from_millis(1), ..Bench::default() };
    let mock = Mock::with(timeline.clone(), bench);
    let began_ns = timeline.stamp_ns();
    let sees = camera_sees(instrument.clone(), scene.clone(), began_ns, 0.005).unwrap();
    let (mut laser, mut camera) = (mock.laser(), mock.camera(sees));
    let limits = Limits::new([-5.0, 5.0], 1000.0, 10.0).unwrap();
    let mut galvo = GuardedGalvo::new(Box::new(mock.galvo()), limits, timeline.clone());
    let settings = CameraSettings {
        size: instrument.size,
        pixel_format: None,
        significant_bits: 8,
        exposure: Duration::from_millis(5),
        gain_db: None,
        trigger: Trigger::Software,
    };
    camera.configure(&settings, within).unwrap();
    camera.arm(within).unwrap();
    laser.on(within).unwrap();
    let renderer = Renderer::new(&instrument, &scene).unwrap();
    let mut take = |volts: f64, wait: Duration| {
        galvo.set(volts, within).unwrap();
        timeline.sleep(wait);
        camera.trigger(within).unwrap();
        let frame = camera.next_frame(within).unwrap();
        let Pixels::U8(seen) = frame.pixels() else { panic!("8 bits") };
        (frame.id(), seen.iter().map(|v| u16::from(*v)).collect::<Vec<u16>>())
    };
    let settled = take(0.4, Duration::from_secs(1));
    let made = renderer.take(&Shot { frame: settled.0, seconds: 0.0, voltage: Some(0.4) }).unwrap();
    assert_eq!(settled.1, made.data);
    // Without waiting the mirror lags: the stripe is elsewhere.
    let lagging = take(0.5, Duration::ZERO);
    let made = renderer.take(&Shot { frame: lagging.0, seconds: 0.0, voltage: Some(0.5) }).unwrap();
    assert_ne!(lagging.1, made.data);
}
