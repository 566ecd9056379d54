//! What a vehicle file can't say, and what it hardly means.

use super::{CameraDriver, CameraTrigger, GalvoDriver, LaserDriver, SweepMode, Vehicle};
use crate::{
    error::{Error, Problem},
    toml_file::TomlFile,
};

/// Speeds that serial ports have. A pseudo-terminal takes any, so that nobody else would notice a wrong one.
const BAUDS: [u32; 18] = [
    1200, 2400, 4800, 9600, 19_200, 38_400, 57_600, 115_200, 230_400, 460_800, 500_000, 576_000, 921_600,
    1_000_000, 1_500_000, 2_000_000, 3_000_000, 4_000_000,
];
/// A day: longer waits are wrong units.
const LONGEST_MS: f64 = 86_400_000.0;

struct Check<'a> {
    file: &'a TomlFile,
    warnings: Vec<Problem>,
}

pub(super) fn check(vehicle: &Vehicle, file: &TomlFile) -> Result<Vec<Problem>, Error> {
    let mut check = Check { file, warnings: Vec::new() };
    check.galvo(vehicle)?;
    check.laser(vehicle)?;
    check.camera(vehicle)?;
    check.sweep(vehicle)?;
    check.positive("disk.min_free_mb", vehicle.disk.min_free_mb, "megabytes")?;
    check.time("interlock.watchdog_ms", vehicle.interlock.watchdog_ms)?;
    if vehicle.interlock.watchdog_ms <= vehicle.camera.timeout_ms {
        let what = format!(
            "the watchdog's {} ms are not longer than the {} ms that a frame may take: it would stop scans that go well",
            vehicle.interlock.watchdog_ms, vehicle.camera.timeout_ms
        );
        return Err(file.error("interlock.watchdog_ms", what, "make it longer than camera.timeout_ms"));
    }
    let simulated = [
        vehicle.galvo.driver == GalvoDriver::Simulated,
        vehicle.camera.driver == CameraDriver::Simulated,
        vehicle.laser.driver == LaserDriver::Simulated,
    ];
    if vehicle.scene.is_none() && simulated.contains(&true) {
        let what = "simulated devices need a scene to see";
        return Err(file.error("scene", what, "add a line: scene = \"scene.toml\""));
    }
    let replayed = [
        ("galvo.driver", vehicle.galvo.driver == GalvoDriver::Replay),
        ("laser.driver", vehicle.laser.driver == LaserDriver::Replay),
    ];
    let alone = replayed.into_iter().find(|(_, so)| *so && vehicle.camera.driver != CameraDriver::Replay);
    if let Some((key, _)) = alone {
        let what = "only a replayed camera has a recording to take this from";
        return Err(file.error(key, what, "write camera.driver = \"replay\", or choose another driver here"));
    }
    Ok(check.warnings)
}

impl Check<'_> {
    fn error(&self, key: &str, what: impl Into<String>, mend: impl Into<String>) -> Error {
        self.file.error(key, what, mend)
    }

    fn warn(&mut self, key: &str, what: impl Into<String>, mend: impl Into<String>) {
        self.warnings.push(self.file.warning(key, what, mend));
    }

    fn galvo(&mut self, vehicle: &Vehicle) -> Result<(), Error> {
        let g = &vehicle.galvo;
        let [low, high] = g.range_v;
        if !(low.is_finite() && high.is_finite() && low < high) {
            let what = format!("[{low}, {high}] is no range");
            return Err(self.error(
                "galvo.range_v",
                what,
                "give the lower voltage first, then the higher one",
            ));
        }
        self.positive("galvo.slew_v_per_s", g.slew_v_per_s, "V/s")?;
        self.positive("galvo.follow_v", g.follow_v, "volts")?;
        if g.follow_v > (high - low) / 10.0 {
            let what = format!(
                "{} V are more than a tenth of range_v: a stuck mirror would not be found",
                g.follow_v
            );
            self.warn("galvo.follow_v", what, "give what the read-back is really off by, such as 0.01");
        }
        for (key, value) in [("galvo.settle_ms", g.settle_ms), ("galvo.lag_ms", g.lag_ms)] {
            if !(0.0..=LONGEST_MS).contains(&value) {
                let what = format!("{value} is no time");
                return Err(self.error(key, what, "give milliseconds, from 0; `uwscan doctor` measures it"));
            }
        }
        self.time("galvo.timeout_ms", g.timeout_ms)?;
        self.within("galvo.park_v", g.park_v, g.range_v)?;
        let serial = g.driver == GalvoDriver::Scpi;
        self.serial("galvo", serial, g.port.as_deref(), g.baud)?;
        self.dialect("galvo", g.dialect_file.is_some(), g.dialect.as_ref())
    }

    fn laser(&mut self, vehicle: &Vehicle) -> Result<(), Error> {
        let l = &vehicle.laser;
        self.serial("laser", l.driver == LaserDriver::Scpi, l.port.as_deref(), l.baud)?;
        self.dialect("laser", l.dialect_file.is_some(), l.dialect.as_ref())?;
        if l.driver == LaserDriver::Scpi && l.port.is_some() && l.port == vehicle.galvo.port {
            let what = "the galvanometer's controller is on this port, and a port is opened once";
            return Err(self.error(
                "laser.port",
                what,
                "where one controller drives both, write driver = \"galvo\"",
            ));
        }
        match l.power {
            Some(power) if !(power > 0.0 && power <= 1.0) => {
                let what = format!("{power} is no fraction of the laser's power");
                Err(self.error("laser.power", what, "give a number above 0, up to 1"))
            }
            _ => Ok(()),
        }
    }

    fn camera(&mut self, vehicle: &Vehicle) -> Result<(), Error> {
        let c = &vehicle.camera;
        for (key, side) in [("camera.width", c.width), ("camera.height", c.height)] {
            if !(1..=1 << 16).contains(&side) {
                let what = format!("{side} pixels are no image's size");
                return Err(self.error(key, what, "give the size of the images in pixels"));
            }
        }
        if !(1..=16).contains(&c.bits) {
            let what = format!("{} significant bits can't be read", c.bits);
            return Err(self.error("camera.bits", what, "give 8 for 8-bit images, 9 to 16 for 16-bit ones"));
        }
        if c.driver == CameraDriver::Replay && c.id.as_deref().is_none_or(str::is_empty) {
            let what = "a replayed camera needs the capture that it shows";
            return Err(self.error(
                "camera.id",
                what,
                "add a line: id = \"capture\", a capture folder or a recording",
            ));
        }
        self.time("camera.exposure_ms", c.exposure_ms)?;
        self.time("camera.timeout_ms", c.timeout_ms)?;
        if c.timeout_ms <= c.exposure_ms {
            let what = format!("no frame of {} ms exposure comes within {} ms", c.exposure_ms, c.timeout_ms);
            return Err(self.error(
                "camera.timeout_ms",
                what,
                "give the exposure, the read-out and some more",
            ));
        }
        if let Some(gain) = c.gain_db
            && !gain.is_finite()
        {
            return Err(self.error(
                "camera.gain_db",
                format!("{gain} is no gain"),
                "give decibels, such as 0.0",
            ));
        }
        match (c.trigger, c.rate_hz) {
            (CameraTrigger::Free, Some(rate_hz)) => {
                self.positive("camera.rate_hz", rate_hz, "frames a second")?;
                if c.exposure_ms * 1e-3 * rate_hz > 1.0 {
                    let what = format!(
                        "an exposure of {} ms is longer than the {:.3} ms from frame to frame",
                        c.exposure_ms,
                        1e3 / rate_hz
                    );
                    return Err(self.error("camera.exposure_ms", what, "expose shorter, or lower rate_hz"));
                }
                Ok(())
            }
            (CameraTrigger::Free, None) => {
                let what = "a camera that runs by itself needs a rate";
                Err(self.error("camera.rate_hz", what, "add a line: rate_hz = 100.0"))
            }
            (_, Some(_)) => {
                let what = "rate_hz says nothing where the camera doesn't run by itself";
                Err(self.error("camera.rate_hz", what, "remove it, or write trigger = \"free\""))
            }
            (_, None) => Ok(()),
        }
    }

    fn sweep(&mut self, vehicle: &Vehicle) -> Result<(), Error> {
        let (s, g) = (&vehicle.sweep, &vehicle.galvo);
        self.within("sweep.from_v", s.from_v, g.range_v)?;
        self.within("sweep.to_v", s.to_v, g.range_v)?;
        let trigger = vehicle.camera.trigger;
        match s.mode {
            SweepMode::Step => {
                let key = match (s.step_v, s.count) {
                    (Some(_), None) => "sweep.step_v",
                    (None, Some(_)) => "sweep.count",
                    _ => {
                        let what = "a sweep by steps needs either step_v or count";
                        return Err(self.error("sweep.step_v", what, "give one of the two"));
                    }
                };
                if s.rate_v_per_s.is_some() {
                    let what = "rate_v_per_s says nothing in a sweep by steps";
                    return Err(self.error(
                        "sweep.rate_v_per_s",
                        what,
                        "remove it, or write mode = \"continuous\"",
                    ));
                }
                if trigger == CameraTrigger::Free {
                    let what =
                        "a camera that runs by itself exposes while the mirror moves from step to step";
                    let mend = "write trigger = \"software\" or \"hardware\", or sweep.mode = \"continuous\"";
                    return Err(self.error("camera.trigger", what, mend));
                }
                vehicle.schedule().map_err(|e| self.error(key, e.to_string(), "mend it")).map(|_| ())
            }
            SweepMode::Continuous => {
                let Some(rate) = s.rate_v_per_s else {
                    let what = "a continuous sweep needs a rate";
                    return Err(self.error("sweep.rate_v_per_s", what, "add a line: rate_v_per_s = 1.0"));
                };
                if !(rate > 0.0 && rate <= g.slew_v_per_s) {
                    let what =
                        format!("{rate} V/s is not above 0 and up to galvo.slew_v_per_s, {}", g.slew_v_per_s);
                    return Err(self.error("sweep.rate_v_per_s", what, "sweep slower"));
                }
                if s.step_v.is_some() || s.count.is_some() {
                    let what = "step_v and count say nothing in a continuous sweep";
                    return Err(self.error("sweep.mode", what, "remove them, or write mode = \"step\""));
                }
                if trigger == CameraTrigger::Software {
                    let what = "a continuous sweep doesn't trigger each frame";
                    return Err(self.error("camera.trigger", what, "write trigger = \"free\" and a rate_hz"));
                }
                Ok(())
            }
        }
    }

    fn serial(
        &mut self,
        table: &str,
        serial: bool,
        port: Option<&str>,
        baud: Option<u32>,
    ) -> Result<(), Error> {
        let key = |key: &str| format!("{table}.{key}");
        match (serial, port, baud) {
            (false, None, None) => Ok(()),
            (false, ..) => {
                let what = "a port and a baud are of no use with this driver";
                Err(self.error(&key("driver"), what, "remove port and baud, or write driver = \"scpi\""))
            }
            (true, None | Some(""), _) => {
                let what = "a controller on a serial port needs the port";
                Err(self.error(&key("port"), what, "add it; `uwscan devices` lists the ports"))
            }
            (true, Some(_), None) => {
                let what = "a controller on a serial port needs its speed";
                Err(self.error(&key("baud"), what, "add it, as the controller's manual says"))
            }
            (true, Some(_), Some(baud)) if !BAUDS.contains(&baud) => {
                let what = format!("{baud} baud is no speed of a serial port");
                let near = BAUDS.iter().min_by_key(|known| known.abs_diff(baud)).copied().unwrap_or_default();
                Err(self.error(&key("baud"), what, format!("did you mean {near}?")))
            }
            (true, Some(_), Some(_)) => Ok(()),
        }
    }

    fn dialect(&self, table: &str, file: bool, dialect: Option<&super::DialectTable>) -> Result<(), Error> {
        match dialect {
            Some(_) if file => {
                let what = "dialect_file and a dialect's table are both given";
                Err(self.error(&format!("{table}.dialect_file"), what, "keep one of the two"))
            }
            Some(dialect) => dialect.check(self.file, &format!("{table}.dialect.")),
            None => Ok(()),
        }
    }

    fn within(&self, key: &str, volts: f64, [low, high]: [f64; 2]) -> Result<(), Error> {
        if (low..=high).contains(&volts) {
            return Ok(());
        }
        let what = format!("{volts} V is outside galvo.range_v [{low}, {high}]");
        Err(self.error(key, what, "give a voltage inside, or mend the range"))
    }

    fn positive(&self, key: &str, value: f64, unit: &str) -> Result<(), Error> {
        if value > 0.0 && value.is_finite() {
            return Ok(());
        }
        Err(self.error(key, format!("{value} must be positive and finite"), format!("give it in {unit}")))
    }

    fn time(&self, key: &str, value: f64) -> Result<(), Error> {
        if value > 0.0 && value <= LONGEST_MS {
            return Ok(());
        }
        Err(self.error(key, format!("{value} is no time to wait"), "give milliseconds, above 0"))
    }
}
