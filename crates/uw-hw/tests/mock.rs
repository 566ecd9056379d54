//! The mock does right, and does wrong when it is told to: each fault comes typed, within its time, and nothing else is lost.

use std::time::Duration;

use uw_hw::{
    Camera, CameraSettings, Fault, FrameCounts, Laser, ManualClock, Pixels, Timeline, Trigger,
    mock::{Bench, Calls, Device, Mock, MockCamera, MockFault, Shot},
};

const WITHIN: Duration = Duration::from_millis(30);
const SIZE: [u32; 2] = [6, 4];

fn settings(trigger: Trigger) -> CameraSettings {
    CameraSettings {
        size: SIZE,
        pixel_format: None,
        significant_bits: 8,
        exposure: Duration::from_millis(2),
        gain_db: None,
        trigger,
    }
}

/// Images that hold their own number.
fn numbered(shot: &Shot) -> Vec<u8> {
    vec![shot.number as u8; (shot.size[0] * shot.size[1]) as usize]
}

fn armed(mock: &Mock, trigger: Trigger) -> MockCamera {
    let mut camera = mock.camera(numbered);
    camera.configure(&settings(trigger), WITHIN).expect("the mock takes any settings");
    camera.arm(WITHIN).expect("it is set up");
    camera
}

fn bench() -> (Mock, Timeline) {
    let timeline = Timeline::new(ManualClock::starting_at(0));
    let readout = Duration::from_millis(1);
    (Mock::with(timeline.clone(), Bench { readout, buffers: 4, ..Bench::default() }), timeline)
}

/// Ten frames by software trigger: what each call gave, the ids of the frames checked against their pixels.
fn ten(camera: &mut MockCamera) -> Vec<Result<u64, Fault>> {
    let mut came = Vec::new();
    for _ in 0..10 {
        camera.trigger(WITHIN).expect("it is armed");
        loop {
            let next = camera.next_frame(WITHIN);
            let more = matches!(next, Err(Fault::DroppedFrames { .. }));
            came.push(next.map(|frame| {
                let Pixels::U8(pixels) = frame.pixels() else { panic!("8 bits were asked for") };
                assert!(pixels.iter().all(|&value| u64::from(value) == frame.id()));
                frame.id()
            }));
            if !more {
                break;
            }
        }
    }
    came
}

fn ids(came: &[Result<u64, Fault>]) -> Vec<u64> {
    came.iter().filter_map(|next| next.as_ref().ok().copied()).collect()
}

#[test]
fn triggered_frames_come_in_order_with_their_exposure() {
    let (mock, timeline) = bench();
    let mut camera = armed(&mock, Trigger::Software);
    camera.trigger(WITHIN).unwrap();
    let begin = timeline.stamp_ns();
    let frame = camera.next_frame(WITHIN).unwrap();
    assert_eq!((frame.exposure().stamp_ns, frame.exposure().exposure_ns), (begin, 2_000_000));
    assert_eq!(frame.exposure().received_ns, begin + 3_000_000);
    assert_eq!(ids(&ten(&mut camera)), (1..=10).collect::<Vec<_>>());
}

#[test]
fn a_dropped_frame_times_out_and_the_next_one_tells_of_it() {
    let (mock, _) = bench();
    mock.inject(Device::Camera, MockFault::Dropped, Calls::only(3));
    let mut camera = armed(&mock, Trigger::Software);
    let came = ten(&mut camera);
    assert!(matches!(came[3], Err(Fault::Timeout { waited: WITHIN, .. })), "{:?}", came[3]);
    assert!(matches!(came[4], Err(Fault::DroppedFrames { count: 1, next_id: 4, .. })), "{:?}", came[4]);
    assert_eq!(ids(&came), [0, 1, 2, 4, 5, 6, 7, 8, 9]);
    assert_eq!(camera.counts(), FrameCounts { received: 9, dropped: 1, ..FrameCounts::default() });
}

#[test]
fn wrong_sizes_torn_and_repeated_frames_are_told_and_cost_themselves_only() {
    let (mock, _) = bench();
    mock.inject(Device::Camera, MockFault::WrongSize, Calls::only(1));
    mock.inject(Device::Camera, MockFault::Torn, Calls::only(2));
    let mut camera = armed(&mock, Trigger::Software);
    let came = ten(&mut camera);
    assert!(matches!(came[1], Err(Fault::FrameSize { needed: SIZE, got: [7, 4], .. })), "{:?}", came[1]);
    assert!(matches!(came[2], Err(Fault::FrameContent { id: 2, .. })), "{:?}", came[2]);
    assert_eq!(ids(&came), [0, 3, 4, 5, 6, 7, 8, 9]);

    mock.inject(Device::Camera, MockFault::Duplicated, Calls::only(10));
    camera.trigger(WITHIN).unwrap();
    assert_eq!(camera.next_frame(WITHIN).map(|frame| frame.id()), Ok(10));
    assert!(matches!(camera.next_frame(WITHIN), Err(Fault::DuplicateFrame { id: 10, .. })));
    let counts = FrameCounts { received: 9, dropped: 0, duplicated: 1, unusable: 2 };
    assert_eq!(camera.counts(), counts);
}

#[test]
fn a_silent_camera_is_noticed_at_the_deadline_and_an_unplugged_one_at_once() {
    let (mock, timeline) = bench();
    mock.inject(Device::Camera, MockFault::Silent, Calls::from(0));
    let mut camera = armed(&mock, Trigger::Free { rate_hz: 100.0 });
    let began = timeline.since_start();
    assert!(matches!(camera.next_frame(WITHIN), Err(Fault::Timeout { .. })));
    assert_eq!(timeline.since_start() - began, WITHIN);
    mock.mend();
    mock.inject(Device::Camera, MockFault::Unplugged, Calls::from(0));
    assert!(matches!(camera.next_frame(WITHIN), Err(Fault::Disconnected { .. })));
    assert!(matches!(camera.arm(WITHIN), Err(Fault::Disconnected { .. })));
}

#[test]
fn a_free_running_camera_drops_what_nobody_takes_and_counts_it() {
    let (mock, timeline) = bench();
    let mut camera = armed(&mock, Trigger::Free { rate_hz: 100.0 });
    for number in 0..5 {
        let frame = camera.next_frame(WITHIN).unwrap();
        assert_eq!((frame.id(), frame.exposure().stamp_ns), (number, number as i64 * 10_000_000));
    }
    timeline.sleep(Duration::from_millis(200));
    let Err(Fault::DroppedFrames { count, next_id, .. }) = camera.next_frame(WITHIN) else {
        panic!("20 frames don't fit into 4 buffers");
    };
    assert_eq!(next_id, 5 + count);
    assert_eq!(camera.next_frame(WITHIN).map(|frame| frame.id()), Ok(next_id));
    assert_eq!(camera.counts().dropped, count);
    assert!((15..=17).contains(&count), "{count}");
}

#[test]
fn a_frame_shows_the_bench_in_the_middle_of_its_exposure() {
    let (mock, _) = bench();
    let mut laser = mock.laser();
    laser.on(WITHIN).unwrap();
    let mut camera = mock.camera(|shot| vec![u8::from(shot.laser_on); 24]);
    camera.configure(&settings(Trigger::Software), WITHIN).unwrap();
    camera.arm(WITHIN).unwrap();
    for on in [true, false] {
        if !on {
            laser.off(WITHIN).unwrap();
        }
        camera.trigger(WITHIN).unwrap();
        let frame = camera.next_frame(WITHIN).unwrap();
        assert_eq!(frame.pixels(), &Pixels::from(vec![u8::from(on); 24]));
    }
}

#[test]
fn a_laser_that_does_not_obey_is_told_by_its_answer_or_by_asking() {
    let (mock, _) = bench();
    let mut laser = mock.laser();
    laser.on(WITHIN).unwrap();
    mock.inject(Device::Laser, MockFault::Refuses, Calls::only(1));
    mock.inject(Device::Laser, MockFault::StaysAsItIs, Calls::only(2));
    assert!(matches!(laser.off(WITHIN), Err(Fault::Refused { .. })));
    assert_eq!(laser.off(WITHIN), Ok(()));
    assert_eq!(laser.is_on(WITHIN), Ok(true));
    assert_eq!((laser.off(WITHIN), laser.is_on(WITHIN)), (Ok(()), Ok(false)));
    assert!(matches!(laser.set_power(1.5, WITHIN), Err(Fault::OutOfRange { .. })));
    assert_eq!((laser.set_power(0.25, WITHIN), mock.power()), (Ok(()), 0.25));
}
