//! Where scans go: that it is there, has room, and takes images as fast as they come.

use super::Findings;
use std::io::Write;
use std::path::Path;
use std::time::{Duration, Instant};
use uw_io::vehicle::{CameraTrigger, SweepMode, Vehicle};

/// Most that is written to see how fast that goes, and the time after which enough is known.
const MOST_BYTES: usize = 128 << 20;
const LONGEST: Duration = Duration::from_secs(1);
/// Pieces that are written, as large as the recorder's.
const PIECE: usize = 4 << 20;
/// A disk that is no faster than this many times what a scan needs will fall behind when it does something else besides.
const SPARE: f64 = 1.25;
/// What driving and asking take of a stepped image's time, at least, seconds.
const STEP_S: f64 = 0.001;

pub(super) fn examine(vehicle: &Vehicle, findings: &mut Findings<'_>) {
    findings.about("disk");
    let folder = vehicle.resolve(&vehicle.disk.folder);
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { &folder };
    if !folder.is_dir() {
        let what = format!("disk.folder: there is no folder {}", folder.display());
        findings.fault(what, "make it, or name another one");
        return;
    }
    let c = &vehicle.camera;
    let frame_bytes = f64::from(c.width) * f64::from(c.height) * if c.bits > 8 { 2.0 } else { 1.0 };
    room(vehicle, folder, frame_bytes, findings);
    let rate_hz = rate_hz(vehicle);
    let needed = frame_bytes * rate_hz;
    match write_rate(folder) {
        Err(error) => {
            let what = format!("disk.folder: {} cannot be written: {error}", folder.display());
            findings.fault(what, "check its permissions, or name another one");
        }
        Ok(rate) => {
            let what = format!(
                "{} takes {:.0} MB/s; {rate_hz:.0} images a second are {:.0} MB/s",
                folder.display(),
                rate * 1e-6,
                needed * 1e-6
            );
            let mend = "use a faster disk, fewer bits, or fewer images a second";
            match (rate < needed * SPARE, c.trigger) {
                (true, CameraTrigger::Free) => findings.fault(format!("{what}: images would be lost"), mend),
                (true, _) => findings.warning(format!("{what}: exposures would wait for it"), mend),
                (false, _) => findings.good(what),
            }
        }
    }
}

fn room(vehicle: &Vehicle, folder: &Path, frame_bytes: f64, findings: &mut Findings<'_>) {
    let free = match uw_io::disk::free_bytes(folder) {
        Ok(Some(free)) => free as f64 * 1e-6,
        Ok(None) => return findings.skipped("free space: this system is not asked", ""),
        Err(error) => return findings.file(&error),
    };
    let least = vehicle.disk.min_free_mb;
    let sweep = frame_bytes * images(vehicle) * 1e-6;
    let there = format!("{}: {free:.0} MB are free", folder.display());
    if free < least {
        findings.fault(
            format!("{there}, and disk.min_free_mb leaves {least:.0} MB there"),
            "free some space, or lower it",
        );
    } else if free - least < sweep {
        let what =
            format!("{there}; a sweep takes {sweep:.0} MB, and disk.min_free_mb leaves {least:.0} MB there");
        findings.fault(what, "free some space, or sweep with fewer images");
    } else {
        findings.good(format!(
            "{there}: room for {:.0} sweeps",
            ((free - least) / sweep.max(1e-6)).floor().min(1e6)
        ));
    }
}

/// Images of one sweep.
fn images(vehicle: &Vehicle) -> f64 {
    match vehicle.sweep.mode {
        SweepMode::Step => vehicle.schedule().map_or(0.0, |schedule| schedule.volts().len() as f64),
        SweepMode::Continuous => {
            let s = &vehicle.sweep;
            (s.to_v - s.from_v).abs() / s.rate_v_per_s.unwrap_or(f64::INFINITY) * rate_hz(vehicle)
        }
    }
}

/// Images a second, at most.
fn rate_hz(vehicle: &Vehicle) -> f64 {
    let c = &vehicle.camera;
    let step_s = (vehicle.settle() + vehicle.camera_settings().exposure).as_secs_f64() + STEP_S;
    c.rate_hz.filter(|_| c.trigger == CameraTrigger::Free).unwrap_or(1.0 / step_s)
}

/// Bytes a second that a folder's disk takes and makes durable.
fn write_rate(folder: &Path) -> std::io::Result<f64> {
    let piece = vec![0x5a_u8; PIECE];
    let mut file = uw_io::disk::scratch_file(folder)?;
    let (began, mut written) = (Instant::now(), 0);
    while written < MOST_BYTES && began.elapsed() < LONGEST {
        file.write_all(&piece)?;
        written += piece.len();
    }
    file.sync_data()?;
    Ok(written as f64 / began.elapsed().as_secs_f64())
}
