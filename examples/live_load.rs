//! What viewers cost a scan: its rate, the time from exposure to points, and the process's memory, at 200 images a second on the mock instrument; without a
//! live server, with one that nobody watches, and with 20 viewers and one that is stuck, one after the other, again and again in one run.
//!
//! `cargo run --release --features live --example live_load -- CALIBRATION [FOLDER] [ROUNDS] [SECONDS]`: recordings go to the folder (`/dev/shm`). The viewers are a
//! process of their own, as they are other machines in use; where processors are few they take the scan's all the same, so the machine should be idle.

#![allow(clippy::print_stdout, reason = "the table of figures is what is asked for")]
#![allow(clippy::unwrap_used, reason = "a bench that can't run says so by stopping")]

mod memory;

use memory::resident_mib;
use std::io::Read;
use std::net::{SocketAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::http::HeaderValue;
use tokio_tungstenite::tungstenite::{Message, WebSocket, client};
use uwscan::cloud::PointCloud;
use uwscan::hw::interlock::{Interlock, Policy};
use uwscan::hw::mock::Mock;
use uwscan::hw::sweep::Continuous;
use uwscan::hw::{CameraSettings, GuardedGalvo, Limits, Pixels, Timeline, Trigger};
use uwscan::io::calibration_toml::{self, CalibrationFile};
use uwscan::io::recording::{Head, Options, Stripe};
use uwscan::io::{Capture, Expect, Kind, Medium, Overwrite, Reduce, SaidBy};
use uwscan::live::{Access, Mode, Server};
use uwscan::pipeline::live::{Watch, Watched};
use uwscan::pipeline::record::session::{Observer, Shot};
use uwscan::pipeline::record::{Instrument, Motion, Phase, Plan, Scanned, Settings, Steering, Tally, scan};
use uwscan::pipeline::{Silent, reconstruct};
use uwscan::stripe::Method;

const RATE_HZ: f64 = 200.0;
const VIEWERS: usize = 20;
const SIZE: [u32; 2] = [768, 576];

/// Who looks on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Audience {
    NoServer,
    Nobody,
    Many,
}

/// The sweep over a ball: voltages and images.
struct Sweep {
    volts: Vec<f64>,
    images: Vec<Arc<Vec<u8>>>,
}

impl Sweep {
    fn read() -> Self {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/ball");
        let capture = Capture::open(&folder).unwrap();
        let expect = Some(Expect::of(&capture.rig.as_ref().unwrap().camera, SaidBy::Rig));
        let image = |file: &str| {
            let image = uwscan::io::images::read(&folder.join(file), Reduce::Luma, expect).unwrap();
            let uwscan::io::Pixels::U8(values) = image.data else { panic!("8 bits") };
            Arc::new(values)
        };
        let (volts, images) =
            capture.present().map(|frame| (frame.voltage_v.unwrap(), image(&frame.file))).unzip();
        Self { volts, images }
    }

    fn at(&self, volts: f64) -> Arc<Vec<u8>> {
        let off = |i: &usize| (self.volts[*i] - volts).abs();
        let nearest = (0..self.volts.len()).min_by(|a, b| off(a).total_cmp(&off(b))).unwrap();
        self.images[nearest].clone()
    }

    fn range_v(&self) -> [f64; 2] {
        let low = self.volts.iter().copied().fold(f64::INFINITY, f64::min);
        [low, self.volts.iter().copied().fold(f64::NEG_INFINITY, f64::max)]
    }
}

fn instrument(sweep: &Arc<Sweep>) -> Instrument {
    let timeline = Timeline::system();
    let mock = Mock::new(timeline.clone());
    mock.keep_no_events();
    let limits = Limits::new([-10.0, 10.0], 1e9, 1e-6).unwrap();
    let galvo = GuardedGalvo::new(Box::new(mock.galvo()), limits, timeline);
    let policy = Policy { watchdog: None, ..Policy::default() };
    let interlock = Interlock::engage(Box::new(mock.laser()), galvo, policy, |_| {}).unwrap();
    let shown = sweep.clone();
    let camera_settings = CameraSettings {
        size: SIZE,
        pixel_format: None,
        significant_bits: 8,
        exposure: Duration::from_micros(100),
        gain_db: None,
        trigger: Trigger::Free { rate_hz: RATE_HZ },
    };
    let camera = Box::new(mock.camera(move |shot| Pixels::U8(shown.at(shot.volts))));
    Instrument { interlock, camera, camera_settings }
}

/// One scan, and the most memory that the process held meanwhile, MiB.
fn run(
    sweep: &Arc<Sweep>,
    calibration: &CalibrationFile,
    path: &Path,
    seconds: f64,
    audience: Audience,
) -> (Scanned, f64) {
    let [from_v, to_v] = sweep.range_v();
    let ride = Continuous {
        from_v,
        to_v,
        rate_v_per_s: (to_v - from_v) / seconds,
        command_every: Duration::from_millis(2),
        settle: Duration::ZERO,
        lag: Duration::ZERO,
        frame_within: Duration::from_secs(1),
    };
    let motion = Motion::Continuous { stretches: vec![ride], rate_hz: RATE_HZ };
    let plan = Plan { motion, repeat: 1, adaptive: None, background_every: 0 };
    let instrument = instrument(sweep);
    let mut server = None;
    let mut viewers = None;
    let watch = (audience != Audience::NoServer).then(|| {
        let listen = SocketAddr::from(([127, 0, 0, 1], 0));
        let options = uwscan::live::Options { listen, access: Access::Local, tls: None, foxglove: None };
        let (started, feed, _) = Server::start(options).unwrap();
        if audience == Audience::Many {
            viewers = Some(Viewers::start(started.listening()));
        }
        server = Some(started);
        let camera = &instrument.camera_settings;
        let watched = Watched {
            mode: Mode::Scan,
            recording: path,
            plan: &plan,
            camera,
            calibration: Some(calibration),
        };
        Watch::new(feed, Steering::default(), &watched)
    });
    let head = Head::new(Kind::Scan, Medium::Water, None);
    let settings = Settings {
        path,
        overwrite: Overwrite::Replace,
        recording: Options::default(),
        min_free_bytes: 0,
        head: &head,
        rig: None,
        calibration: Some(calibration),
        reconstruct: reconstruct::Settings::default(),
        preview: Method::Robust,
    };
    let looking = Looking { watch, most_mib: Mutex::new(0.0) };
    let scanned = scan(instrument, &plan, &settings, &Silent, &looking).unwrap();
    drop(viewers);
    (scanned, looking.most_mib.into_inner().unwrap())
}

/// Looks at the memory while it is scanned, and hands on what happens to who watches.
struct Looking {
    watch: Option<Watch>,
    most_mib: Mutex<f64>,
}

impl Observer for Looking {
    fn recorded(&self, tally: &Tally) {
        if tally.counts().recorded.is_multiple_of(100) {
            let mut most_mib = self.most_mib.lock().unwrap();
            *most_mib = most_mib.max(resident_mib());
        }
        self.watch.iter().for_each(|watch| watch.recorded(tally));
    }

    fn exposed(&self, shot: &Shot) {
        self.watch.iter().for_each(|watch| watch.exposed(shot));
    }

    fn traced(&self, stripe: &Stripe<'_>, voltage_v: f64, cloud: &PointCloud) {
        self.watch.iter().for_each(|watch| watch.traced(stripe, voltage_v, cloud));
    }

    fn phase(&self, phase: Phase, tally: &Tally) {
        self.watch.iter().for_each(|watch| watch.phase(phase, tally));
    }

    fn steering(&self) -> Option<&Steering> {
        self.watch.as_ref().and_then(Observer::steering)
    }
}

/// A process of viewers, ended when this is dropped.
struct Viewers(Child);

impl Viewers {
    fn start(server: SocketAddr) -> Self {
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args(["--viewers", &server.to_string()])
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        // It says one byte once all are let in.
        child.stdout.as_mut().unwrap().read_exact(&mut [0]).unwrap();
        Self(child)
    }
}

impl Drop for Viewers {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn connect(server: SocketAddr, name: &str) -> WebSocket<TcpStream> {
    let mut request = format!("ws://{server}/ws").into_client_request().unwrap();
    request.headers_mut().insert("sec-websocket-protocol", HeaderValue::from_static("uwscan.live.v1"));
    let (mut socket, _) = client(request, TcpStream::connect(server).unwrap()).unwrap();
    let hello = format!(r#"{{"type":"hello","token":null,"client":"{name}","bandwidth_kbps":null}}"#);
    socket.send(Message::text(hello)).unwrap();
    socket
}

/// Twenty that read and acknowledge all that comes, and one that reads nothing, until they are ended.
fn view(server: SocketAddr) {
    let _stuck = connect(server, "stuck");
    let mut viewers: Vec<_> = (0..VIEWERS)
        .map(|i| {
            let mut socket = connect(server, &i.to_string());
            socket.read().unwrap();
            socket.get_mut().set_nonblocking(true).unwrap();
            socket
        })
        .collect();
    println!();
    while !viewers.is_empty() {
        viewers.retain_mut(|socket| {
            loop {
                match socket.read() {
                    Ok(Message::Binary(bytes)) => {
                        let sequence = u32::from_le_bytes(bytes[4..8].try_into().unwrap());
                        let ack = Message::text(format!(r#"{{"type":"ack","sequence":{sequence}}}"#));
                        if socket.send(ack).is_err() {
                            return false;
                        }
                    }
                    Ok(_) => {}
                    Err(tokio_tungstenite::tungstenite::Error::Io(error))
                        if error.kind() == std::io::ErrorKind::WouldBlock =>
                    {
                        return true;
                    }
                    Err(_) => return false,
                }
            }
        });
        std::thread::sleep(Duration::from_millis(2));
    }
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn main() {
    let args: Vec<String> = std::env::args().skip(1).collect();
    if let [flag, server] = &args[..]
        && flag == "--viewers"
    {
        return view(server.parse().unwrap());
    }
    let (calibration, _) = calibration_toml::read(Path::new(&args[0])).unwrap();
    let folder = PathBuf::from(args.get(1).map_or("/dev/shm", String::as_str));
    let rounds: usize = args.get(2).map_or(5, |n| n.parse().unwrap());
    let seconds: f64 = args.get(3).map_or(10.0, |n| n.parse().unwrap());
    let path = folder.join("live-load.mcap");
    let sweep = Arc::new(Sweep::read());
    let audiences = [Audience::NoServer, Audience::Nobody, Audience::Many];
    let mut figures: [Vec<[f64; 4]>; 3] = Default::default();
    println!("{SIZE:?} px at {RATE_HZ} Hz for {seconds} s, exposure to points in ms, most memory in MiB");
    for round in 0..rounds {
        for (audience, figures) in audiences.iter().zip(&mut figures) {
            let began = Instant::now();
            let (scanned, memory_mib) = run(&sweep, &calibration, &path, seconds, *audience);
            let counts = &scanned.counts;
            let [middle, late] = counts.latency_us.unwrap().map(|us| us as f64 * 1e-3);
            let rate_hz = scanned.frames_per_second();
            println!(
                "{round} {audience:?}: {rate_hz:.2} Hz, {} lost, {} without points on the fly, median {middle:.2}, 99 % {late:.2}, {memory_mib:.0} MiB, {:.0} s in all",
                counts.lost_frames(),
                counts.skipped,
                began.elapsed().as_secs_f64()
            );
            figures.push([rate_hz, middle, late, memory_mib]);
        }
    }
    std::fs::remove_file(&path).unwrap();
    let at = |which: usize, i: usize| median(figures[which].iter().map(|one| one[i]).collect());
    println!("medians of {rounds} rounds, and by those without a server");
    for (which, audience) in audiences.iter().enumerate() {
        let [rate, middle, late, memory] = [0, 1, 2, 3].map(|i| at(which, i));
        let change = |i: usize| 100.0 * (at(which, i) / at(0, i) - 1.0);
        println!(
            "{audience:?}: {rate:.2} Hz ({:+.1} %), median {middle:.2} ms ({:+.1} %), 99 % {late:.2} ms ({:+.1} %), {memory:.0} MiB",
            change(0),
            change(1),
            change(2)
        );
    }
}
