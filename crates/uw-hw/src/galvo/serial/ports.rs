//! Which serial ports there are, and opening one.

use std::{io, path::Path, time::Duration};

use serialport::{ClearBuffer, ErrorKind, SerialPort, SerialPortType};

use crate::Fault;

/// Which port, at which speed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Port {
    /// Its name, such as `/dev/ttyUSB0`.
    pub name: String,
    /// Its speed.
    pub baud: u32,
}

/// A serial port that is there.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PortInfo {
    /// Its name, such as `/dev/ttyUSB0`.
    pub name: String,
    /// What is known of it, such as a USB adapter's maker and product; may be empty.
    pub about: String,
}

/// The serial ports of this machine.
///
/// # Errors
/// What the system said.
pub fn ports() -> Result<Vec<PortInfo>, String> {
    let found = serialport::available_ports().map_err(|e| e.to_string())?;
    let mut ports: Vec<PortInfo> = found
        .into_iter()
        .map(|port| {
            let about = match port.port_type {
                SerialPortType::UsbPort(usb) => {
                    let said = [usb.manufacturer, usb.product, usb.serial_number];
                    let said: Vec<String> = said.into_iter().flatten().collect();
                    format!("USB {:04x}:{:04x} {}", usb.vid, usb.pid, said.join(", ")).trim_end().to_owned()
                }
                SerialPortType::BluetoothPort => "Bluetooth".into(),
                SerialPortType::PciPort => "PCI".into(),
                SerialPortType::Unknown => String::new(),
            };
            PortInfo { name: port.port_name, about }
        })
        .collect();
    ports.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(ports)
}

/// A port that is ours alone, with nothing in its buffers.
pub(super) fn open(port: &Port) -> Result<Box<dyn SerialPort>, Fault> {
    let fault =
        |reason: String, mend: &str| Fault::Open { device: port.name.clone(), reason, mend: mend.into() };
    let builder = serialport::new(&port.name, port.baud).timeout(Duration::ZERO);
    let mut opened = builder.open().map_err(|e| {
        let mend = match e.kind() {
            ErrorKind::Io(io::ErrorKind::PermissionDenied) => {
                "add yourself to the port's group (often `dialout`), then log in again"
            }
            _ if !Path::new(&port.name).exists() => "check cable and power; `uwscan devices` lists the ports",
            ErrorKind::NoDevice => "close the program that has it open",
            ErrorKind::InvalidInput => "check that it is a serial port, and its speed",
            _ => "check that it is a serial port",
        };
        fault(e.to_string(), mend)
    })?;
    // A pseudo-terminal takes any speed, a real port the nearest that it has: what is in force is asked for.
    match opened.baud_rate() {
        Ok(baud) if baud.abs_diff(port.baud) > port.baud / 50 => {
            let reason = format!("it works at {baud} baud, {} were asked for", port.baud);
            return Err(fault(reason, "give a speed that the port has"));
        }
        _ => {}
    }
    // Many controllers listen only while DTR is up; a pseudo-terminal has no such line (ENOTTY) and needs none.
    let _ = opened.write_data_terminal_ready(true);
    let _ = opened.clear(ClearBuffer::All);
    Ok(opened)
}
