//! Servers, and scans that are made up.

use std::net::{Ipv4Addr, SocketAddr};

use crossbeam_channel::Receiver;
use uw_calib::Across;
use uw_cloud::{CloudPoint, Frame as CloudFrame, PointCloud};
use uw_hw::frame::Layout;
use uw_hw::{Exposure, Frame, Pixels};
use uw_live::feed::Picture;
use uw_live::{Access, Asked, Feed, Options, Server, State, Stripe, Token};

pub const VIEW: &str = "view-0123456789abcdef0123456789";
pub const CONTROL: &str = "control-0123456789abcdef0123456";

pub fn local() -> SocketAddr {
    (Ipv4Addr::LOCALHOST, 0).into()
}

pub fn serve() -> (Server, Feed, Receiver<Asked>) {
    Server::start(Options { listen: local(), access: Access::Local, tls: None, foxglove: None }).unwrap()
}

pub fn serve_with_tokens() -> (Server, Feed, Receiver<Asked>) {
    let token = |text| Token::new(text).unwrap();
    let access = Access::Tokens { view: token(VIEW), control: token(CONTROL) };
    Server::start(Options { listen: local(), access, tls: None, foxglove: None }).unwrap()
}

pub fn now_ns() -> u64 {
    let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap();
    since.as_nanos() as u64
}

/// An image with a stripe and noise, so that it compresses like a real one.
pub fn picture(frame: u32, size: [u32; 2]) -> Picture {
    let [width, height] = size;
    let mut seed = frame.wrapping_mul(2_654_435_761) | 1;
    let mut values = Vec::with_capacity((width * height) as usize);
    for v in 0..height {
        for u in 0..width {
            seed ^= seed << 13;
            seed ^= seed >> 17;
            seed ^= seed << 5;
            let off = f64::from(u) - (f64::from(width) * 0.4 + f64::from(v) * 0.1);
            let stripe = 150.0 * (-off * off / 8.0).exp();
            values.push((stripe + f64::from(10 + (seed >> 24) % 8)) as u8);
        }
    }
    let stamp_ns = now_ns() as i64;
    let exposure = Exposure { stamp_ns, exposure_ns: 0, received_ns: stamp_ns };
    let image = Frame::new(Pixels::from(values), Layout::packed(width, height, 8), 0, exposure).unwrap();
    Picture {
        frame,
        stamp_ns: stamp_ns as u64,
        laser_on: true,
        voltage_v: Some(f64::from(frame) * 0.01),
        image,
    }
}

/// A stripe of `lines` points on a wavy surface.
pub fn stripe(frame: u32, lines: u32) -> Stripe {
    let point = |line: u32| {
        let (x, y) = (f64::from(frame) * 0.37 - 50.0, f64::from(line) * 0.21 - 30.0);
        CloudPoint {
            position_mm: [x, y, 800.0 + 20.0 * (x * 0.05).sin() * (y * 0.07).cos()],
            intensity: (line % 256) as f32,
            frame_row: frame,
            pixel: [300.0, line as f32],
            sigma_mm: 0.05,
            covariance_mm2: [0.0; 6],
            shared_mm: Some([1e-3, 2e-3, -3e-3]),
        }
    };
    let points: Vec<CloudPoint> = (0..lines).map(point).collect();
    Stripe {
        frame,
        stamp_ns: now_ns(),
        voltage_v: f64::from(frame) * 0.01,
        across: Across::U,
        all_lines: lines,
        lines: (0..lines).collect(),
        position_px: (0..lines).map(|line| 307.2 + f64::from(line) * 0.1).collect(),
        sigma_px: vec![0.05; lines as usize],
        width_px: vec![2.0; lines as usize],
        amplitude: vec![150.0; lines as usize],
        full_scale: 255.0,
        cloud: PointCloud::from_points(CloudFrame::Camera, &points),
    }
}

/// All positions of some stripes, mm.
pub fn positions(frames: std::ops::Range<u32>, lines: u32) -> Vec<[f64; 3]> {
    frames.flat_map(|frame| stripe(frame, lines).cloud.positions_mm().to_vec()).collect()
}

pub fn scanning(frames: usize) -> State {
    State { phase: uw_live::Phase::Scanning, frames, stamp_ns: now_ns(), ..State::default() }
}
