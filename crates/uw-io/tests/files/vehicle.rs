use std::{path::Path, time::Duration};

use tempfile::TempDir;
use uw_hw::{Trigger, galvo::proto::Command};
use uw_io::{Error, Vehicle, vehicle::LaserDriver};

use crate::samples::{edit, says, write};

/// The example that the documentation points to.
const EXAMPLE: &str = include_str!("../../../../docs/vehicle.toml");

fn read(text: impl AsRef<[u8]>) -> Result<(Vehicle, Vec<String>), Error> {
    let dir = TempDir::new().unwrap();
    write(dir.path(), "vehicle.toml", text);
    let (vehicle, warnings) = Vehicle::read(&dir.path().join("vehicle.toml"))?;
    Ok((vehicle, warnings.iter().map(ToString::to_string).collect()))
}

#[test]
fn the_example_is_read_whole_and_becomes_what_the_instrument_takes() {
    let (vehicle, warnings) = read(EXAMPLE).unwrap();
    assert_eq!(warnings, [""; 0]);
    assert_eq!((vehicle.galvo.port.as_deref(), vehicle.galvo.baud), (Some("/dev/ttyUSB0"), Some(115_200)));
    assert_eq!(vehicle.laser.driver, LaserDriver::Galvo);

    let limits = vehicle.limits().unwrap();
    assert_eq!((limits.range_v(), limits.slew_v_per_s(), limits.follow_v()), ([-4.0, 4.0], 400.0, 0.01));
    let camera = vehicle.camera_settings();
    assert_eq!((camera.size, camera.significant_bits, camera.trigger), ([1920, 1200], 8, Trigger::Software));
    assert_eq!((camera.exposure, camera.gain_db), (Duration::from_millis(4), Some(0.0)));
    let policy = vehicle.policy();
    assert_eq!((policy.within, policy.watchdog), (Duration::from_millis(250), Some(Duration::from_secs(2))));
    let schedule = vehicle.schedule().unwrap();
    assert_eq!((schedule.volts().len(), schedule.volts()[0]), (351, -3.5));
    assert_eq!(vehicle.step_and_settle().settle, Duration::from_millis(3));
    assert_eq!(vehicle.continuous(), None);
    let dialect = vehicle.galvo_dialect().unwrap();
    assert_eq!(dialect.outgoing(Command::ReadVolts).unwrap().text, "MEAS:VOLT?");
    assert_eq!(dialect.outgoing(Command::SetVolts(0.5)).unwrap().text, "SOUR:VOLT 0.500000");
}

#[test]
fn paths_count_from_the_files_folder_and_a_dialect_may_have_its_own_file() {
    let dir = TempDir::new().unwrap();
    let table = "[galvo.dialect]\nread_volts = { send = \"MEAS:VOLT?\", reply = \"{v}\" }\n";
    let text = edit(&edit(EXAMPLE, table, ""), "park_v = 0.0", "park_v = 0.0\ndialect_file = \"other.toml\"");
    write(dir.path(), "vehicle.toml", text);
    let path = dir.path().join("vehicle.toml");
    let (vehicle, _) = Vehicle::read(&path).unwrap();
    assert_eq!(vehicle.resolve(&vehicle.rig), dir.path().join("rig.toml"));
    assert_eq!(vehicle.resolve(Path::new("/etc/rig.toml")), Path::new("/etc/rig.toml"));
    says(&vehicle.galvo_dialect().unwrap_err().to_string(), &["other.toml", "cannot open"]);

    let head = "format = \"uwscan-dialect\"\nversion = 1\n";
    write(dir.path(), "other.toml", format!("{head}set_volts = {{ send = \"V={{v}}\", reply = \"OK\" }}\n"));
    let dialect = vehicle.galvo_dialect().unwrap();
    assert_eq!(dialect.outgoing(Command::SetVolts(1.0)).unwrap().text, "V=1.000000");
    write(dir.path(), "other.toml", format!("{head}set_volts = {{ send = \"V=\" }}\n"));
    says(
        &vehicle.galvo_dialect().unwrap_err().to_string(),
        &["other.toml:3:1: set_volts", "no value", "{v}"],
    );
}

#[test]
fn what_is_written_is_read_back() {
    let (vehicle, _) = read(EXAMPLE).unwrap();
    let (again, _) = read(vehicle.to_toml().unwrap()).unwrap();
    assert_eq!(again.to_toml().unwrap(), vehicle.to_toml().unwrap());
    assert_eq!(again.galvo, vehicle.galvo);
}

#[test]
fn each_slip_is_named_with_its_key_and_its_mend() {
    let with = |from: &str, to: &str| edit(EXAMPLE, from, to);
    let continuous = "mode = \"continuous\"";
    let cases: &[(String, &[&str])] = &[
        (with("uwscan-vehicle", "uwscan-rig"), &["format", "uwscan-vehicle"]),
        (with("version = 1", "version = 2"), &["newer"]),
        (with("baud = 115200", "baud = 115201"), &[":10:1: galvo.baud", "did you mean 115200?"]),
        (with("baud = 115200\n", ""), &["galvo.baud", "speed"]),
        (with("port = \"/dev/ttyUSB0\"\n", ""), &["galvo.port", "uwscan devices"]),
        (with("driver = \"scpi\"", "driver = \"spci\""), &["did you mean \"scpi\"?"]),
        (with("driver = \"scpi\"", "driver = \"simulated\""), &["galvo.driver", "of no use"]),
        (with("range_v = [-4.0, 4.0]", "range_v = [4.0, -4.0]"), &["galvo.range_v", "lower voltage first"]),
        (with("range_v = [-4.0, 4.0]", "range_v = [nan, 4.0]"), &["galvo.range_v"]),
        (with("slew_v_per_s = 400.0", "slew_v_per_s = 0"), &["galvo.slew_v_per_s", "positive"]),
        (with("settle_ms = 3.0", "settle_ms = -3.0"), &["galvo.settle_ms", "doctor"]),
        (with("follow_v = 0.01", "follow_v = 0.0"), &["galvo.follow_v"]),
        (with("park_v = 0.0", "park_v = 4.5"), &["galvo.park_v", "outside galvo.range_v"]),
        (with("\"{v}\"", "\"{text}\""), &["galvo.dialect.read_volts", "{v}"]),
        (with("read_volts", "read_vots"), &["did you mean `read_volts`?"]),
        (with("driver = \"galvo\"", "driver = \"galvo\"\npower = 1.5"), &["laser.power", "1.5"]),
        (
            with("driver = \"galvo\"", "driver = \"scpi\"\nport = \"/dev/ttyUSB0\"\nbaud = 9600"),
            &["laser.port", "driver = \"galvo\""],
        ),
        (with("width = 1920", "width = 0"), &["camera.width"]),
        (
            with("driver = \"genicam\"\nid = \"192.168.1.20\"\n", "driver = \"replay\"\n"),
            &["camera.id", "a capture folder or a recording"],
        ),
        (with("bits = 8", "bits = 17"), &["camera.bits"]),
        (with("timeout_ms = 500.0", "timeout_ms = 4.0"), &["camera.timeout_ms", "exposure"]),
        (with("timeout_ms = 500.0", "timeout_ms = 2000.0"), &["watchdog", "camera.timeout_ms"]),
        (with("timeout_ms = 500.0", "timeout_ms = 500.0\ntrigger = \"free\""), &["camera.rate_hz", "rate"]),
        (with("timeout_ms = 500.0", "timeout_ms = 500.0\nrate_hz = 5.0"), &["camera.rate_hz", "free"]),
        (
            with("timeout_ms = 500.0", "timeout_ms = 500.0\ntrigger = \"free\"\nrate_hz = 300.0"),
            &["camera.exposure_ms", "from frame to frame"],
        ),
        (
            with("timeout_ms = 500.0", "timeout_ms = 500.0\ntrigger = \"free\"\nrate_hz = 30.0"),
            &["camera.trigger", "from step to step"],
        ),
        (with("to_v = 3.5", "to_v = 4.5"), &["sweep.to_v", "outside galvo.range_v"]),
        (with("step_v = 0.02", "step_v = -0.02"), &["sweep.step_v", "positive"]),
        (with("step_v = 0.02", "step_v = 0.02\ncount = 5"), &["sweep.step_v", "either"]),
        (with("step_v = 0.02", "count = 0"), &["sweep.count", "0 positions"]),
        (with("mode = \"step\"", continuous), &["sweep.rate_v_per_s", "needs a rate"]),
        (
            with("mode = \"step\"", &format!("{continuous}\nrate_v_per_s = 500.0")),
            &["sweep.rate_v_per_s", "galvo.slew_v_per_s"],
        ),
        (with("min_free_mb = 2000.0", "min_free_mb = -1"), &["disk.min_free_mb"]),
        (with("[disk]\nfolder = \"scans\"\nmin_free_mb = 2000.0\n", ""), &["the table [disk]"]),
        (with("driver = \"genicam\"", "driver = \"simulated\""), &["scene", "scene.toml"]),
        (with("rig = \"rig.toml\"\n", ""), &["missing field `rig`"]),
    ];
    for (text, parts) in cases {
        let message = read(text).unwrap_err().to_string();
        says(&message, parts);
        says(&message, &["vehicle.toml"]);
    }
}

#[test]
fn a_tolerance_that_finds_no_stuck_mirror_is_warned_of() {
    let (_, warnings) = read(edit(EXAMPLE, "follow_v = 0.01", "follow_v = 2.0")).unwrap();
    says(&warnings.join("\n"), &["galvo.follow_v", "stuck mirror"]);
}
