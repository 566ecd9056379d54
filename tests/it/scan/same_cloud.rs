//! One scan, whichever way it comes in, is one cloud.

use super::{
    BALL, CALIBRATION, STEPS, camera_settings, fixture, held, interlock, mock_instrument, plan, record,
};
use std::path::Path;
use uwscan::cloud::PointCloud;
use uwscan::hw::Timeline;
use uwscan::hw::mock::Mock;
use uwscan::io::Capture;
use uwscan::pipeline::Silent;
use uwscan::pipeline::reconstruct::{Settings, reconstruct};
use uwscan::pipeline::record::adaptive::Density;
use uwscan::pipeline::record::{Instrument, Motion, Plan};
use uwscan::pipeline::replay::Replay;

fn cloud_of(path: &Path) -> PointCloud {
    reconstruct(path, &CALIBRATION, &Settings::default(), &Silent).unwrap().cloud
}

fn replay_instrument(capture: &Path, timeline: &Timeline) -> Instrument {
    let replay = Replay::new(Capture::open(capture).unwrap(), None, timeline.clone()).unwrap();
    Instrument {
        interlock: interlock(replay.laser(), replay.galvo(), timeline),
        camera: replay.camera(),
        camera_settings: camera_settings([768, 576]),
    }
}

#[test]
fn mock_replayed_folder_and_replayed_recording_give_the_folders_cloud_bit_for_bit() {
    let folder = tempfile::tempdir().unwrap();
    let timeline = Timeline::system();
    let expected = cloud_of(&fixture("ball"));
    assert!(expected.len() > 2000, "{}", expected.len());

    let by_mock = folder.path().join("mock.mcap");
    let scanned = record(mock_instrument(&Mock::new(timeline.clone()), &timeline), &plan(), &by_mock, true);
    assert!(scanned.whole(), "{scanned:?}");
    let live = scanned.made.unwrap().unwrap();
    assert!(scanned.counts.previewed > 0 && scanned.counts.latency_us.is_some(), "{:?}", scanned.counts);
    assert_eq!(scanned.counts.previewed + scanned.counts.skipped, BALL.volts.len());

    let by_replay = folder.path().join("replay.mcap");
    let scanned = record(replay_instrument(&fixture("ball"), &timeline), &plan(), &by_replay, true);
    assert!(scanned.whole(), "{scanned:?}");
    let again = folder.path().join("again.mcap");
    assert!(record(replay_instrument(&by_replay, &timeline), &plan(), &again, false).whole());

    assert_eq!(live.cloud, expected, "the scan's own cloud");
    for path in [by_mock, by_replay, again] {
        assert_eq!(cloud_of(&path), expected, "{}", path.display());
    }
}

#[test]
fn a_background_image_is_recorded_where_it_was_asked_for_and_repeats_judge_each_sweep_by_itself() {
    let folder = tempfile::tempdir().unwrap();
    let timeline = Timeline::system();
    let path = folder.path().join("twice.mcap");
    let twice = Plan { repeat: 2, background_every: 30, ..plan() };
    let scanned = record(mock_instrument(&Mock::new(timeline.clone()), &timeline), &twice, &path, true);
    assert!(scanned.whole(), "{scanned:?}");
    let dark: Vec<usize> =
        held(&path).into_iter().filter(|(_, volts)| volts.is_none()).map(|(row, _)| row).collect();
    assert_eq!(dark, [0, 31, 45, 76]);
    // Both sweeps show the same images, so both give the same points.
    let cloud = scanned.made.unwrap().unwrap().cloud;
    let rows = cloud.frame_rows().unwrap();
    let (first, second): (Vec<usize>, Vec<usize>) = (0..cloud.len()).partition(|&i| rows[i] < 45);
    let at = |part: &[usize]| part.iter().map(|&i| cloud.positions_mm()[i]).collect::<Vec<_>>();
    assert!(!first.is_empty());
    assert_eq!(at(&first), at(&second));
}

#[test]
fn an_adaptive_sweep_comes_back_to_where_the_ball_is() {
    let folder = tempfile::tempdir().unwrap();
    let timeline = Timeline::system();
    let path = folder.path().join("adaptive.mcap");
    let coarse: Vec<f64> = BALL.volts.iter().copied().step_by(6).collect();
    let motion = Motion::Steps { volts: coarse.clone(), settings: STEPS };
    let plan = Plan { motion, adaptive: Some(Density { finest_v: 0.0225 }), ..plan() };
    let scanned = record(mock_instrument(&Mock::new(timeline.clone()), &timeline), &plan, &path, true);
    assert!(scanned.whole(), "{scanned:?}");
    let further: Vec<f64> = held(&path)[coarse.len()..].iter().filter_map(|(_, volts)| *volts).collect();
    assert_eq!(scanned.counts.planned, coarse.len() + further.len());
    // A ball bends everywhere: its curvature alone asks for 4 parts of each interval in its middle.
    assert!(further.len() >= 2 * coarse.len(), "{} after {}", further.len(), coarse.len());
    assert_eq!(scanned.counts.skipped, 0, "a coarse sweep's points are all waited for");
}
