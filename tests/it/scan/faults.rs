//! The fault table: what each fault does to a scan, what is kept, and that the laser is off after it.

use super::{BALL, PARK_V, held, mock_instrument, plan, record, record_leaving};
use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;
use std::time::Duration;
use uwscan::hw::Timeline;
use uwscan::hw::interlock::Reason;
use uwscan::hw::mock::{Calls, Device, Mock, MockFault};
use uwscan::hw::{Fault, ManualClock};
use uwscan::pipeline::record::acquire::Ended;
use uwscan::pipeline::record::{Plan, Scanned};

/// The voltage, counted from 0, at which something happens. Before the sweep's first move the ramp from park makes none of its own.
const AT: usize = 10;

/// A scan in which a fault happens at [`AT`]; that the laser is off and the mirror parked, as far as it still listens.
fn with(device: Device, fault: MockFault, calls: fn(u64) -> Calls) -> (Scanned, Vec<(usize, Option<f64>)>) {
    let folder = tempfile::tempdir().unwrap();
    let timeline = Timeline::system();
    let mock = Mock::new(timeline.clone());
    let instrument = mock_instrument(&mock, &timeline);
    // Moves are one command each: the mock's slew is not limited.
    mock.inject(device, fault, calls(mock.calls(device) + AT as u64));
    let path = folder.path().join("scan.mcap");
    let scanned = record(instrument, &plan(), &path, false);
    assert!(!mock.laser_is_on(), "{fault:?} of {device:?}: the laser is on");
    assert!(scanned.report.laser_off.is_ok(), "{:?}", scanned.report);
    (scanned, held(&path))
}

/// That all until the fault is in the recording, and the rest is said to be lost.
fn kept_until_the_fault(scanned: &Scanned, held: &[(usize, Option<f64>)], why: &[(&'static str, usize)]) {
    let expected: Vec<_> = BALL.volts.iter().take(AT).copied().map(Some).enumerate().collect();
    assert_eq!(held, expected);
    assert_eq!((scanned.counts.recorded, scanned.counts.acquired), (AT, AT));
    let lost: BTreeMap<&str, usize> = why.iter().copied().collect();
    assert_eq!(scanned.counts.lost, lost, "{:?}", scanned.ended);
    assert_eq!(scanned.counts.lost_frames() + AT, BALL.volts.len());
    assert!(scanned.recorded.is_some() && scanned.recording_error.is_none(), "the recording is finished");
    assert!(!scanned.whole());
}

const REST: usize = 43 - AT;

#[test]
fn a_galvanometer_that_is_silent_wrong_refusing_stuck_or_unplugged_ends_the_scan_with_what_there_was() {
    use MockFault::{Refuses, Silent, Stuck, Unplugged, WrongReply};
    for fault in [Silent, WrongReply, Refuses, Stuck, Unplugged] {
        // But for a stuck mirror, which still answers, a fault is in the read-back before the move that it begins with.
        let calls = if fault == Stuck { Calls::from } else { |call| Calls::from(call + 1) };
        let (scanned, held) = with(Device::Galvo, fault, calls);
        kept_until_the_fault(&scanned, &held, &[("not_reached", REST)]);
        let Some(Ended::Fault(ended)) = &scanned.ended else { panic!("{:?}", scanned.ended) };
        let named = match fault {
            Silent => matches!(ended, Fault::Timeout { .. }),
            WrongReply => matches!(ended, Fault::Protocol { .. }),
            Refuses => matches!(ended, Fault::Refused { .. }),
            Stuck => matches!(ended, Fault::NotFollowing { .. }),
            _ => matches!(ended, Fault::Disconnected { .. }),
        };
        assert!(named, "{fault:?} gave {ended}");
    }
}

#[test]
fn a_camera_that_falls_silent_sends_wrong_sizes_or_is_unplugged_ends_the_scan_with_what_there_was() {
    for (fault, why) in [
        (MockFault::Silent, "camera_silent"),
        (MockFault::WrongSize, "unusable"),
        (MockFault::Torn, "unusable"),
        (MockFault::Unplugged, "not_reached"),
    ] {
        let (scanned, held) = with(Device::Camera, fault, Calls::from);
        let losses =
            if why == "not_reached" { vec![(why, REST)] } else { vec![(why, 1), ("not_reached", REST - 1)] };
        kept_until_the_fault(&scanned, &held, &losses);
        let parked = scanned.report.parked.clone().unwrap();
        assert!((parked - PARK_V).abs() < 1e-9, "{fault:?}: the mirror is at {parked} V");
    }
}

#[test]
fn a_frame_that_is_dropped_torn_or_late_is_exposed_again_and_one_that_comes_twice_counts_once() {
    let all: Vec<_> = BALL.volts.iter().copied().map(Some).enumerate().collect();
    for fault in
        [MockFault::Dropped, MockFault::Torn, MockFault::Slow(super::WITHIN * 2), MockFault::Duplicated]
    {
        let (scanned, held) = with(Device::Camera, fault, Calls::only);
        assert!(scanned.whole(), "{fault:?}: {scanned:?}");
        assert_eq!(held, all, "{fault:?}");
        let once = (scanned.counts.duplicated, scanned.counts.repeated);
        // A frame that is late may make that of its repetition late, too.
        let right = match fault {
            MockFault::Duplicated => once == (1, 0),
            MockFault::Slow(_) => once.0 == 0 && once.1 > 0,
            _ => once == (0, 1),
        };
        assert!(right, "{fault:?}: {once:?}");
    }
}

#[test]
fn a_laser_that_will_not_go_off_is_never_silent() {
    let folder = tempfile::tempdir().unwrap();
    let timeline = Timeline::system();
    let mock = Mock::new(timeline.clone());
    let instrument = mock_instrument(&mock, &timeline);
    mock.inject(Device::Laser, MockFault::StaysAsItIs, Calls::from(mock.calls(Device::Laser) + 1));
    let scanned = record(instrument, &plan(), &folder.path().join("scan.mcap"), false);
    let alarms = scanned.report.alarms();
    assert!(alarms[0].contains("THE LASER MAY STILL BE ON"), "{alarms:?}");
    assert_eq!(scanned.counts.recorded, BALL.volts.len());
}

#[test]
fn somebody_who_asks_for_the_end_gets_it_and_keeps_what_there_is() {
    let folder = tempfile::tempdir().unwrap();
    let timeline = Timeline::system();
    let mock = Mock::new(timeline.clone());
    let instrument = mock_instrument(&mock, &timeline);
    mock.inject(Device::Camera, MockFault::Slow(Duration::from_millis(10)), Calls::from(0));
    let handle = instrument.interlock.handle();
    let path = folder.path().join("scan.mcap");
    let scanned = std::thread::scope(|scope| {
        scope.spawn(|| {
            while mock.calls(Device::Camera) < AT as u64 {
                std::thread::sleep(Duration::from_millis(1));
            }
            handle.stop(Reason::Signal(2));
        });
        record(instrument, &plan(), &path, false)
    });
    assert!(!mock.laser_is_on());
    assert_eq!(scanned.report.reason, Reason::Signal(2));
    let got = scanned.counts.recorded;
    assert!((1..BALL.volts.len()).contains(&got), "{got}");
    assert_eq!(held(&path).len(), got);
    assert_eq!(scanned.counts.lost, BTreeMap::from([("not_reached", BALL.volts.len() - got)]));
}

#[test]
fn a_clock_that_steps_back_changes_nothing_but_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let clock = ManualClock::starting_at(1_760_000_000_000_000_000);
    let timeline = Timeline::new(clock.clone());
    let mock = Mock::new(timeline.clone());
    let mut instrument = mock_instrument(&mock, &timeline);
    let (ball, stepped) = (BALL.clone(), clock.clone());
    instrument.camera = Box::new(mock.camera(move |shot: &uwscan::hw::mock::Shot| {
        if shot.number == AT as u64 {
            stepped.step_wall(-3_600_000_000_000);
        }
        uwscan::hw::Pixels::U8(ball.image(shot.volts))
    }));
    let path = folder.path().join("scan.mcap");
    let scanned = record(instrument, &plan(), &path, false);
    assert!(scanned.whole(), "{scanned:?}");
    let capture = uwscan::io::Capture::open(&path).unwrap();
    let stamps: Vec<u64> = capture.frames.iter().map(|frame| frame.stamp_ns).collect();
    assert_eq!(stamps.len(), BALL.volts.len());
    assert!(stamps.is_sorted(), "stamps go on as if the clock had not been set");
    let bytes = std::fs::read(&path).unwrap();
    let told = b"clock stepped by -3600.000 s";
    assert!(bytes.windows(told.len()).any(|window| window == told), "the log in the recording says so");
}

/// A folder on a small file system of its own, which goes with it; `None`, saying so, where that can't be had.
struct SmallDisk(tempfile::TempDir);

impl SmallDisk {
    fn of_megabytes(size: u32) -> Option<Self> {
        let folder = tempfile::tempdir().unwrap();
        let mounted = Command::new("mount")
            .args(["-t", "tmpfs", "-o", &format!("size={size}m"), "tmpfs"])
            .arg(folder.path())
            .output();
        match mounted {
            Ok(output) if output.status.success() => Some(Self(folder)),
            _ => {
                eprintln!("skipped: a small file system can't be mounted here (needs root)");
                None
            }
        }
    }

    fn path(&self) -> &Path {
        self.0.path()
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg(self.0.path()).status();
    }
}

#[test]
fn a_disk_that_is_left_less_room_than_it_is_to_have_ends_the_scan_in_order() {
    let Some(disk) = SmallDisk::of_megabytes(60) else { return };
    let timeline = Timeline::system();
    let mock = Mock::new(timeline.clone());
    let path = disk.path().join("scan.mcap");
    let min_free_bytes = 30_000_000;
    let plan = Plan { repeat: 6, ..plan() };
    let scanned = record_leaving(mock_instrument(&mock, &timeline), &plan, &path, min_free_bytes).unwrap();
    assert!(!mock.laser_is_on());
    let Some(Ended::NoRoom { free_bytes, needed_bytes }) = scanned.ended else {
        panic!("{:?}", scanned.ended)
    };
    assert!(free_bytes < needed_bytes && needed_bytes == min_free_bytes);
    // Whatever was acquired is in the recording, which is finished; the rest was not reached.
    assert!(scanned.recorded.is_some() && scanned.recording_error.is_none(), "{:?}", scanned.recording_error);
    let held = held(&path).len();
    assert!(held > 10 && held == scanned.counts.acquired, "{held} of {:?}", scanned.counts);
    assert_eq!(scanned.counts.lost, BTreeMap::from([("not_reached", 6 * BALL.volts.len() - held)]));
    // A scan is not begun where there is less from the start: what the first one left.
    let again = disk.path().join("again.mcap");
    let failure =
        record_leaving(mock_instrument(&mock, &timeline), &plan, &again, 2 * min_free_bytes).unwrap_err();
    assert!(failure.to_string().contains("disk.min_free_mb"), "{failure}");
    assert!(!again.exists() && !mock.laser_is_on());
}

#[test]
fn a_full_disk_ends_the_scan_and_what_is_on_it_can_be_read() {
    let Some(disk) = SmallDisk::of_megabytes(10) else { return };
    let timeline = Timeline::system();
    let mock = Mock::new(timeline.clone());
    let path = disk.path().join("scan.mcap");
    // More than may wait to be written, so that the scan is not over before it is noticed.
    let repeat = 9;
    let scanned = record(mock_instrument(&mock, &timeline), &Plan { repeat, ..plan() }, &path, false);
    assert!(!mock.laser_is_on());
    let error = scanned.recording_error.as_ref().expect("the disk holds a tenth of it").to_string();
    assert!(error.contains("free some space"), "{error}");
    assert_eq!(scanned.ended, Some(Ended::Recording));
    let held = held(&path).len();
    let counts = &scanned.counts;
    assert!(held > 5 && held == counts.recorded, "{held} of {}", counts.recorded);
    assert_eq!(counts.recorded + counts.lost_frames(), repeat as usize * BALL.volts.len(), "{counts:?}");
}
