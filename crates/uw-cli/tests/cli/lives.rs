//! `scan --live` and `serve`, from a client's side.
#![allow(clippy::print_stdout, reason = "what was measured is said")]

use std::{
    fs,
    io::{BufRead, BufReader, Read},
    net::TcpStream,
    path::Path,
    process::{Child, Command, Stdio},
    time::{Duration, Instant},
};

use assert_cmd::cargo::cargo_bin;
use serde_json::{Value, json};
use tokio_tungstenite::tungstenite::{
    Error, HandshakeError, Message, WebSocket, client, client::IntoClientRequest, http::HeaderValue,
};

use crate::{
    job::calibration,
    samples::{edit, fixture},
    scans::{STEPS, config, replayed, simulated},
};

/// Far longer than anything here takes.
const LONG: Duration = Duration::from_secs(120);

/// A run of `uwscan` with a client at its page's socket.
struct Live {
    child: Child,
    socket: WebSocket<TcpStream>,
    /// The latest of each type.
    points: usize,
    epoch: Option<u32>,
    next_id: u64,
}

impl Live {
    fn start(args: &[&str]) -> Self {
        let mut child = Command::new(cargo_bin!("uwscan"))
            .args(args)
            .args(["--foxglove", "off"])
            .env_remove("UWSCAN_VIEW_TOKEN")
            .env_remove("UWSCAN_CONTROL_TOKEN")
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut errors = BufReader::new(child.stderr.take().unwrap());
        let mut said = String::new();
        let address = loop {
            let mut line = String::new();
            assert_ne!(errors.read_line(&mut line).unwrap(), 0, "no address: {said}");
            if let Some(rest) = line.trim().strip_prefix("live: http://") {
                break rest.trim_end_matches('/').to_owned();
            }
            said += &line;
        };
        std::thread::spawn(move || errors.read_to_end(&mut Vec::new()));
        let stream = TcpStream::connect(&address).unwrap();
        stream.set_read_timeout(Some(Duration::from_millis(20))).unwrap();
        let mut request = format!("ws://{address}/ws").into_client_request().unwrap();
        request.headers_mut().insert("sec-websocket-protocol", HeaderValue::from_static("uwscan.live.v1"));
        let mut handshake = client(request, stream);
        let (socket, _) = loop {
            match handshake {
                Ok(done) => break done,
                Err(HandshakeError::Interrupted(middle)) => handshake = middle.handshake(),
                Err(error) => panic!("{error}"),
            }
        };
        let mut live = Self { child, socket, points: 0, epoch: None, next_id: 0 };
        live.say(&json!({"type": "hello", "token": null, "client": "test", "bandwidth_kbps": null}));
        live
    }

    fn say(&mut self, message: &Value) {
        self.socket.send(Message::text(message.to_string())).unwrap();
    }

    /// The next text, if one comes soon; `Err` where the server has gone. Points are counted on the way.
    fn next(&mut self) -> Result<Option<Value>, ()> {
        match self.socket.read() {
            Ok(Message::Text(text)) => Ok(Some(serde_json::from_str(&text).unwrap())),
            Ok(Message::Binary(bytes)) => {
                let number = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
                if bytes[0] == 2 {
                    if self.epoch != Some(number(8)) {
                        (self.epoch, self.points) = (Some(number(8)), 0);
                    }
                    self.points += number(20) as usize;
                }
                let ack = json!({"type": "ack", "sequence": number(4)}).to_string();
                // The server may be gone already.
                let _ = self.socket.send(Message::text(ack));
                Ok(None)
            }
            Ok(Message::Close(_)) => Err(()),
            Ok(_) => Ok(None),
            Err(Error::Io(error)) if error.kind() == std::io::ErrorKind::WouldBlock => Ok(None),
            Err(_) => Err(()),
        }
    }

    /// The next text that is as it should be.
    fn wait(&mut self, what: &str, is: impl Fn(&Value) -> bool) -> Value {
        let began = Instant::now();
        let mut last = Value::Null;
        while began.elapsed() < LONG {
            match self.next() {
                Ok(Some(text)) if is(&text) => return text,
                Ok(Some(text)) if text["type"] == "state" => last = text,
                Ok(_) => {}
                Err(()) => panic!("the server has gone, not {what}: {last}"),
            }
        }
        panic!("not {what}: {last}");
    }

    fn phase(&mut self, phase: &str) -> Value {
        self.wait(phase, |text| text["type"] == "state" && text["phase"] == phase)
    }

    /// Asks; why it is not done, and how long the answer took.
    fn ask(&mut self, mut message: Value) -> (Option<String>, Duration) {
        self.next_id += 1;
        let id = self.next_id;
        message["id"] = id.into();
        let asked = Instant::now();
        self.say(&message);
        let answer = self.wait("an answer", |text| text["type"] == "answer" && text["id"] == id);
        (answer["error"].as_str().map(str::to_owned), asked.elapsed())
    }

    #[track_caller]
    fn command(&mut self, word: &str) -> Duration {
        let (error, took) = self.ask(json!({"type": "command", "do": word}));
        assert_eq!(error, None, "{word}");
        took
    }

    /// What is printed at the end, and the exit code.
    fn end(mut self) -> (String, Option<i32>) {
        while self.next().is_ok() {}
        let mut out = String::new();
        self.child.stdout.take().unwrap().read_to_string(&mut out).unwrap();
        (out, self.child.wait().unwrap().code())
    }
}

impl Drop for Live {
    fn drop(&mut self) {
        // A test that failed leaves it running.
        let _ = self.child.kill();
    }
}

fn has(recording: &Path, text: &str) -> bool {
    let bytes = fs::read(recording).unwrap();
    bytes.windows(text.len()).any(|window| window == text.as_bytes())
}

#[test]
fn a_scan_is_watched_held_and_resumed_and_its_points_are_those_on_the_fly() {
    let calibration = calibration();
    let dir = replayed(None, Some(&calibration));
    let config = config(dir.path());
    let mut live = Live::start(&["scan", "--config", &config, "--live", "0", "--repeat", "5", "--json"]);
    let welcome = live.wait("a welcome", |text| text["type"] == "welcome");
    assert_eq!((&welcome["mode"], &welcome["rights"]), (&json!("scan"), &json!("control")));
    live.wait("frames", |text| text["frames"].as_u64() > Some(3));
    let (refused, _) = live.ask(json!({"type": "command", "do": "pause"}));
    assert!(refused.unwrap().contains("take control"));
    live.command("take-control");
    live.command("pause");
    let held = live.phase("paused");
    assert_eq!(held["laser"], "off");
    // What was under way is recorded; then nothing comes any more.
    std::thread::sleep(Duration::from_millis(300));
    let count = |live: &mut Live| live.wait("a state", |text| text["type"] == "state")["frames"].as_u64();
    let until = Instant::now() + Duration::from_secs(2);
    let mut counts = Vec::new();
    while Instant::now() < until {
        counts.push(count(&mut live));
    }
    let last = counts.len() - 1;
    assert_eq!(counts[last], counts[last / 2], "{counts:?}");
    assert!(counts[last] < Some(5 * 43));
    live.command("resume");
    let ended = live.phase("finished");
    assert_eq!((&ended["frames"], &ended["laser"]), (&json!(5 * 43), &json!("off")));
    // The last points may come after the last state.
    let until = Instant::now() + Duration::from_secs(1);
    while Instant::now() < until && live.next().is_ok() {}
    let points = live.points;
    let (out, code) = live.end();
    assert_eq!(code, Some(0));
    let report: Value = serde_json::from_str(&out).unwrap();
    assert_eq!(report["frames"], 5 * 43);
    assert_eq!(report["on_the_fly"]["points"], points, "{report}");
    let recording = dir.path().join("scan-0001.mcap");
    assert!(has(&recording, "held, as test (127.0.0.1:") && has(&recording, "resumed, as test (127.0.0.1:"));
}

#[test]
fn a_client_puts_the_laser_off_at_once_and_the_scan_ends_with_what_it_has() {
    let dir = simulated(STEPS);
    edit(dir.path(), "vehicle.toml", "count = 5", "count = 5000");
    let config = config(dir.path());
    let mut live = Live::start(&["scan", "--config", &config, "--live", "0", "--json"]);
    live.wait("frames", |text| text["frames"].as_u64() > Some(2));
    let took = live.command("laser-off");
    println!("laser off, asked for over the network: done and answered after {took:?}");
    // The bar is 100 ms where nothing else takes the processor; here other tests do.
    assert!(took < Duration::from_secs(1), "{took:?}");
    let ended = live.phase("finished");
    let why = ended["ended"].as_str().unwrap().to_owned();
    assert!(why.contains("laser switched off, as test (127.0.0.1:"), "{why}");
    let (out, code) = live.end();
    let report: Value = serde_json::from_str(&out).unwrap();
    assert_eq!((code, &report["laser_off"]), (Some(3), &json!(true)), "{report}");
    assert!(
        report["frames"].as_u64() > Some(2) && report["lost"]["not_reached"].as_u64() > Some(0),
        "{report}"
    );
    assert!(has(&dir.path().join("scan-0001.mcap"), &why));
}

#[test]
fn a_recording_is_served_with_a_time_line() {
    let (ball, calibration) = (fixture("ball"), calibration());
    let args = ["serve", ball.to_str().unwrap(), "--listen", "0", "-c", &calibration];
    let mut live = Live::start(&args);
    live.wait("a time line", |text| text["type"] == "timeline" && text["frames"] == 43);
    live.say(&json!({"type": "captures"}));
    let captures = live.wait("captures", |text| text["type"] == "captures");
    assert_eq!(captures["names"], json!(["ball"]));
    let replay = |live: &mut Live, more: Value| {
        let mut message = json!({"type": "replay"});
        message.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        live.ask(message).0
    };
    assert_eq!(replay(&mut live, json!({"do": "pause"})), None);
    assert_eq!(replay(&mut live, json!({"do": "seek", "frame": 42})), None);
    live.wait("the last frame", |text| text["type"] == "timeline" && text["at_frame"] == 42);
    // What was jumped over is made meanwhile: most of the ball, at least.
    const MANY: usize = 1000;
    let until = Instant::now() + LONG;
    while live.points < MANY {
        assert!(Instant::now() < until, "{} points", live.points);
        live.next().unwrap();
    }
    assert!(replay(&mut live, json!({"do": "seek", "frame": 43})).unwrap().contains("43 images"));
    assert!(
        replay(&mut live, json!({"do": "open", "capture": "../../etc"})).unwrap().contains("no recording")
    );
    assert_eq!(replay(&mut live, json!({"do": "seek", "frame": 0})), None);
    live.wait("the first frame", |text| text["type"] == "timeline" && text["at_frame"] == 0);
    let until = Instant::now() + Duration::from_millis(500);
    while Instant::now() < until {
        live.next().unwrap();
    }
    assert!(live.points < MANY / 4, "{} points at the first frame", live.points);
    let (refused, _) = live.ask(json!({"type": "command", "do": "stop"}));
    assert!(refused.unwrap().contains("recording"));
}

#[cfg(unix)]
#[test]
fn a_station_scans_when_it_is_asked_to_and_stays() {
    let dir = simulated(STEPS);
    let config = config(dir.path());
    let mut live = Live::start(&["serve", "--config", &config, "--listen", "0"]);
    live.phase("idle");
    let (nothing, _) = live.ask(json!({"type": "command", "do": "stop"}));
    assert_eq!(nothing.as_deref(), Some("nothing is being scanned"));
    live.command("take-control");
    for name in ["scan-0001.mcap", "scan-0002.mcap"] {
        live.command("start");
        live.phase("scanning");
        let ended = live.phase("finished");
        assert_eq!((&ended["recording"], &ended["frames"]), (&json!(name), &json!(5)));
        assert!(uwscan::io::Capture::open(&dir.path().join(name)).unwrap().present().count() == 5);
        // The next may start once the last one's file is done with.
        std::thread::sleep(Duration::from_millis(500));
    }
    let kill = format!("kill -TERM {}", live.child.id());
    assert!(Command::new("sh").args(["-c", &kill]).status().unwrap().success());
    assert_eq!(live.end().1, Some(0));
}

#[test]
fn others_need_a_token_and_a_weak_one_is_refused() {
    let dir = simulated(STEPS);
    let file = dir.path().join("token");
    fs::write(&file, "secret\n").unwrap();
    let config = config(dir.path());
    let weak = ["serve", "--config", &config, "--listen", "0", "--view-token-file", file.to_str().unwrap()];
    crate::samples::uwscan(weak).fails(&["token", "at least 24"]);
    let far = ["serve", "--config", &config, "--listen", "0", "--foxglove", "0.0.0.0:0"];
    crate::samples::uwscan(far).fails(&["Foxglove", "loopback"]);
    crate::samples::uwscan(["scan", "--config", &config, "--foxglove", "off"]).is_misused(&["--live"]);
    crate::samples::uwscan(["serve"]).is_misused(&["CAPTURE"]);
}
