//! The GenICam camera against Aravis's fake one, each scene alone in a network namespace with its own camera (`scripts/fake-camera.sh`).
//! Where the machine has no such camera, or may not make namespaces, the tests skip themselves, saying so.
#![cfg(feature = "genicam")]
#![allow(clippy::unwrap_used, clippy::print_stderr)]

use std::{
    process::Command,
    time::{Duration, Instant},
};

use uw_hw::{
    Camera, CameraSettings, Fault, Timeline, Trigger,
    camera::genicam::{GenicamCamera, cameras},
};

const SCRIPT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../scripts/fake-camera.sh");
/// The script's code where there is no fake camera.
const CANNOT: i32 = 77;
const WITHIN: Duration = Duration::from_secs(2);
/// How much later than its deadline a call may come back on a machine that does other things besides.
const GRACE: Duration = Duration::from_millis(700);
const SIZE: [u32; 2] = [320, 240];

/// Runs a scene of this file (an ignored test) beside a fake camera.
fn beside_a_camera(scene: &str, options: &[&str]) {
    let scene_path = format!("scenes::{scene}");
    let ended = Command::new(SCRIPT)
        .args(options)
        .arg("--")
        .arg(std::env::current_exe().unwrap())
        .args([&scene_path, "--exact", "--ignored", "--nocapture"])
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&ended.stdout).into_owned() + &String::from_utf8_lossy(&ended.stderr);
    if ended.status.code() == Some(CANNOT) {
        eprintln!("skipped: {}", said.trim());
        return;
    }
    assert!(ended.status.success(), "{said}");
    assert!(said.contains("1 passed"), "the scene did not run: {said}");
}

#[test]
fn a_triggered_camera_gives_a_frame_a_trigger() {
    beside_a_camera("triggered", &[]);
}

#[test]
fn a_free_running_camera_gives_frame_after_frame() {
    beside_a_camera("free", &[]);
}

#[test]
fn packets_that_are_lost_are_counted_as_frames() {
    beside_a_camera("lossy", &["-r", "20"]);
}

#[test]
fn a_camera_that_is_gone_is_noticed_by_the_frame_that_does_not_come() {
    beside_a_camera("gone", &[]);
}

fn settings(trigger: Trigger) -> CameraSettings {
    CameraSettings {
        size: SIZE,
        pixel_format: None,
        significant_bits: 8,
        exposure: Duration::from_millis(5),
        gain_db: Some(0.0),
        trigger,
    }
}

fn armed(trigger: Trigger, timeline: &Timeline) -> GenicamCamera {
    let mut camera = GenicamCamera::open(None, timeline.clone()).unwrap();
    let in_force = camera.configure(&settings(trigger), WITHIN).unwrap();
    assert_eq!((in_force.size, in_force.exposure), (SIZE, Duration::from_millis(5)));
    camera.arm(WITHIN).unwrap();
    camera
}

mod scenes {
    use super::*;

    #[test]
    #[ignore = "runs beside a fake camera only"]
    fn triggered() {
        let found = cameras();
        assert!(found.iter().any(|info| info.address == "127.0.0.1"), "{found:?}");
        let timeline = Timeline::system();
        let mut camera = armed(Trigger::Software, &timeline);
        assert!(!camera.identity().model.is_empty());
        let quiet = camera.next_frame(Duration::from_millis(200));
        assert!(matches!(quiet, Err(Fault::Timeout { .. })), "nothing was triggered: {quiet:?}");
        for number in 0..20 {
            let asked_ns = timeline.stamp_ns();
            camera.trigger(WITHIN).unwrap();
            let frame = camera.next_frame(WITHIN).unwrap();
            assert_eq!((frame.id(), [frame.width(), frame.height()]), (number, SIZE));
            assert_eq!(frame.significant_bits(), 8);
            let exposure = frame.exposure();
            assert!(
                exposure.stamp_ns >= asked_ns && exposure.stamp_ns <= exposure.received_ns,
                "{exposure:?}"
            );
            assert!(exposure.received_ns <= timeline.stamp_ns());
        }
        assert_eq!(camera.counts().received, 20);
        camera.disarm(WITHIN).unwrap();
    }

    #[test]
    #[ignore = "runs beside a fake camera only"]
    fn free() {
        let timeline = Timeline::system();
        let mut camera = armed(Trigger::Free { rate_hz: 40.0 }, &timeline);
        let mut stamps = Vec::new();
        while stamps.len() < 40 {
            match camera.next_frame(WITHIN) {
                Ok(frame) => stamps.push((frame.id(), frame.exposure().stamp_ns)),
                Err(fault) if fault.is_passing() => {}
                Err(fault) => panic!("{fault}"),
            }
        }
        assert!(stamps.windows(2).all(|two| two[0].0 < two[1].0 && two[0].1 < two[1].1), "{stamps:?}");
        let counts = camera.counts();
        let last = stamps.last().unwrap().0;
        assert_eq!(counts.received + counts.dropped + counts.unusable, last + 1, "{counts:?}");
        // 25 ms from frame to frame, the median of them: the fake camera sleeps, so never faster.
        let mut gaps: Vec<i64> =
            stamps.windows(2).map(|two| (two[1].1 - two[0].1) / (two[1].0 - two[0].0) as i64).collect();
        gaps.sort_unstable();
        let median = gaps[gaps.len() / 2];
        assert!((20_000_000..50_000_000).contains(&median), "{median} ns");
        camera.disarm(WITHIN).unwrap();
    }

    #[test]
    #[ignore = "runs beside a fake camera only"]
    fn lossy() {
        let mut camera = armed(Trigger::Free { rate_hz: 40.0 }, &Timeline::system());
        let began = Instant::now();
        let (mut good, mut told) = (0, 0);
        while (good < 3 || told < 3) && began.elapsed() < Duration::from_secs(30) {
            match camera.next_frame(WITHIN) {
                Ok(_) => good += 1,
                Err(Fault::DroppedFrames { count, .. }) => told += count,
                Err(Fault::FrameContent { .. }) => told += 1,
                Err(Fault::Timeout { .. }) => {}
                Err(fault) => panic!("{fault}"),
            }
        }
        let counts = camera.counts();
        assert!(told >= 3, "a fifth of all packets is lost: {counts:?}");
        assert_eq!((counts.received, counts.dropped + counts.unusable), (good, told));
    }

    #[test]
    #[ignore = "runs beside a fake camera only"]
    fn gone() {
        let mut camera = armed(Trigger::Software, &Timeline::system());
        camera.trigger(WITHIN).unwrap();
        camera.next_frame(WITHIN).unwrap();
        let pid = std::env::var("UWSCAN_FAKE_CAMERA").unwrap();
        assert!(Command::new("kill").args(["-9", &pid]).status().unwrap().success());
        std::thread::sleep(Duration::from_millis(100));
        let within = Duration::from_millis(500);
        let began = Instant::now();
        // The trigger's own acknowledgement may already be missed.
        let fault = camera.trigger(within).and_then(|()| camera.next_frame(within)).unwrap_err();
        assert!(matches!(fault, Fault::Timeout { .. } | Fault::Disconnected { .. }), "{fault}");
        eprintln!("noticed after {:?}: {fault}", began.elapsed());
        assert!(began.elapsed() < 2 * within + GRACE, "{:?}", began.elapsed());
        let began = Instant::now();
        assert!(matches!(camera.next_frame(within), Err(Fault::Timeout { .. })));
        assert!(began.elapsed() < within + GRACE);
        // Nobody waits for it at the end either.
        let began = Instant::now();
        assert!(camera.disarm(WITHIN).is_err());
        drop(camera);
        assert!(began.elapsed() < GRACE, "{:?}", began.elapsed());
    }
}
