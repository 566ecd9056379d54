//! `uwscan devices`: what is attached, as far as this build can see.

use std::fmt::Write;

use serde::Serialize;
use uwscan::hw::{camera::CameraInfo, galvo::serial};

use crate::{console::Console, exit::Outcome, output};

/// Arguments of `devices`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Print one JSON object instead of text
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Record {
    serial_ports: Vec<Port>,
    cameras: Vec<Camera>,
    not_compiled: Vec<&'static str>,
    warnings: Vec<String>,
}

#[derive(Serialize)]
struct Port {
    port: String,
    about: String,
}

#[derive(Serialize)]
struct Camera {
    driver: &'static str,
    id: String,
    about: String,
    address: String,
}

#[cfg(feature = "genicam")]
fn genicam() -> Vec<CameraInfo> {
    uwscan::hw::camera::genicam::cameras()
}

#[cfg(not(feature = "genicam"))]
fn genicam() -> Vec<CameraInfo> {
    Vec::new()
}

#[cfg(all(feature = "v4l2", target_os = "linux"))]
fn v4l2() -> Vec<CameraInfo> {
    uwscan::hw::camera::v4l2::cameras()
}

#[cfg(not(all(feature = "v4l2", target_os = "linux")))]
fn v4l2() -> Vec<CameraInfo> {
    Vec::new()
}

/// Drivers of cameras, whether this build has them, and what they are for.
const DRIVERS: [(&str, bool, &str); 2] = [
    ("genicam", cfg!(feature = "genicam"), "GigE Vision and USB3 Vision cameras"),
    ("v4l2", cfg!(all(feature = "v4l2", target_os = "linux")), "Video4Linux cameras and grabbers"),
];

/// Looks, and prints what is there. That nothing is there is no failure.
///
/// # Errors
/// Standard output can't be written.
pub fn run(args: &Args, console: &Console) -> anyhow::Result<Outcome> {
    let (ports, warnings) = match serial::ports() {
        Ok(ports) => (ports, Vec::new()),
        Err(reason) => {
            (Vec::new(), vec![format!("serial ports cannot be listed: {reason}; check permissions")])
        }
    };
    let not_compiled = DRIVERS.into_iter().filter(|(_, has, _)| !has).map(|(name, ..)| name).collect();
    let serial_ports = ports.into_iter().map(|port| Port { port: port.name, about: port.about }).collect();
    let by =
        |driver| move |CameraInfo { id, about, address }: CameraInfo| Camera { driver, id, about, address };
    let cameras =
        genicam().into_iter().map(by("genicam")).chain(v4l2().into_iter().map(by("v4l2"))).collect();
    let record = Record { serial_ports, cameras, not_compiled, warnings };
    record.warnings.iter().for_each(|warning| console.warn(warning));
    if args.json {
        output::json(&record)?;
    } else {
        output::print(text(&record))?;
    }
    Ok(Outcome::Done)
}

fn text(record: &Record) -> String {
    let mut text = String::from("serial ports\n");
    for Port { port, about } in &record.serial_ports {
        // Writing to a text can't fail.
        _ = writeln!(text, "  {port}  {about}");
    }
    if record.serial_ports.is_empty() {
        text += "  none\n";
    }
    text += "cameras\n";
    for Camera { driver, id, about, address } in &record.cameras {
        _ = writeln!(text, "  {id}  {driver}, {about}, {address}");
    }
    if record.cameras.is_empty() {
        text += "  none\n";
    }
    for what in &record.not_compiled {
        _ = writeln!(text, "not compiled in: {what}");
    }
    for (driver, _, cameras) in DRIVERS.iter().filter(|(name, ..)| record.not_compiled.contains(name)) {
        _ = writeln!(text, "build with --features {driver} to see {cameras}");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_there_is_listed_and_what_this_build_cannot_see_is_said() {
        let port = Port { port: "/dev/ttyUSB0".into(), about: "USB 0403:6001 FTDI".into() };
        let mut record = Record {
            serial_ports: vec![port],
            cameras: vec![],
            not_compiled: vec!["genicam"],
            warnings: vec![],
        };
        let said = text(&record);
        for part in
            ["  /dev/ttyUSB0  USB 0403:6001 FTDI\n", "cameras\n  none\n", "not compiled in: genicam\n"]
        {
            assert!(said.contains(part), "{said}");
        }
        record.serial_ports.clear();
        record.not_compiled.clear();
        assert_eq!(text(&record), "serial ports\n  none\ncameras\n  none\n");
    }
}
