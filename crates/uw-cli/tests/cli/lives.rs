//! `scan --live` and `serve`, from a client's side.
#![allow(clippy::print_stdout, reason = "what was measured is said")]

use std::{
    fs,
    io::{BufRead, BufReader, Read, Write},
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
    samples::{edit, fixture, part_of},
    scans::{STEPS, config, replayed, simulated},
};

/// Far longer than anything here takes.
const LONG: Duration = Duration::from_secs(120);

/// A run of `uwscan` with a client at its page's socket.
struct Live {
    child: Child,
    /// Where Foxglove's stream is, if there is one.
    foxglove: Option<String>,
    socket: WebSocket<TcpStream>,
    /// The latest of each type.
    points: usize,
    epoch: Option<u32>,
    next_id: u64,
}

impl Live {
    fn start(args: &[&str]) -> Self {
        Self::begin(args, None)
    }

    /// With a token to steer, there is a stream for Foxglove, too.
    fn begin(args: &[&str], token: Option<&str>) -> Self {
        let mut child = Command::new(cargo_bin!("uwscan"))
            .args(args)
            .args(["--foxglove", if token.is_some() { "0" } else { "off" }])
            .env_remove("UWSCAN_VIEW_TOKEN")
            .env_remove("UWSCAN_CONTROL_TOKEN")
            .envs(token.map(|token| ("UWSCAN_CONTROL_TOKEN", token)))
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
        // The stream's address comes right after.
        let foxglove = token.map(|_| {
            let mut line = String::new();
            errors.read_line(&mut line).unwrap();
            let rest = line.trim().strip_prefix("live: ws://").unwrap();
            rest.split(' ').next().unwrap().to_owned()
        });
        std::thread::spawn(move || errors.read_to_end(&mut Vec::new()));
        let socket = connect(&address, "/ws", "uwscan.live.v1");
        let mut live = Self { child, foxglove, socket, points: 0, epoch: None, next_id: 0 };
        live.say(&json!({"type": "hello", "token": token, "client": "test", "bandwidth_kbps": null}));
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

fn connect(address: &str, path: &str, protocol: &'static str) -> WebSocket<TcpStream> {
    let stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(Duration::from_millis(20))).unwrap();
    let mut request = format!("ws://{address}{path}").into_client_request().unwrap();
    request.headers_mut().insert("sec-websocket-protocol", HeaderValue::from_static(protocol));
    let mut handshake = client(request, stream);
    loop {
        match handshake {
            Ok((socket, _)) => return socket,
            Err(HandshakeError::Interrupted(middle)) => handshake = middle.handshake(),
            Err(error) => panic!("{error}"),
        }
    }
}

/// Has a parameter set over Foxglove's stream: the value that it has then, and what was warned of.
fn set(socket: &mut WebSocket<TcpStream>, name: &str, value: &Value) -> (Value, Option<String>) {
    let parameter = json!({"name": name, "value": value});
    let asked = json!({"op": "setParameters", "parameters": [parameter], "id": name});
    socket.send(Message::text(asked.to_string())).unwrap();
    let began = Instant::now();
    let mut warned = None;
    while began.elapsed() < LONG {
        let Ok(Message::Text(text)) = socket.read() else { continue };
        let said: Value = serde_json::from_str(&text).unwrap();
        if said["op"] == "parameterValues" && said["id"] == name {
            return (said["parameters"][0]["value"].clone(), warned);
        }
        if said["op"] == "status" {
            warned = said["message"].as_str().map(str::to_owned);
        }
    }
    panic!("{name} is not answered");
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

#[test]
fn viewers_are_told_of_files_and_not_of_the_folders_that_they_are_in() {
    let dir = part_of("ball", |row, _| row < 5);
    let table = fs::read_to_string(dir.path().join("frames.csv")).unwrap();
    let missing = table.lines().nth(2).unwrap().split(',').next().unwrap();
    fs::remove_file(dir.path().join(missing)).unwrap();
    let mut live = Live::start(&["serve", dir.path().to_str().unwrap(), "--listen", "0"]);
    let note = live
        .wait("a note", |text| text["type"] == "note" && text["text"].as_str().unwrap().contains(missing));
    let name = dir.path().file_name().unwrap().to_str().unwrap();
    let text = note["text"].as_str().unwrap();
    assert!(text.starts_with(&format!("{name}/{missing}: ")), "{text}");
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

/// A token as one might be given.
const TOKEN: &str = "0123456789abcdef01234567";

#[test]
fn a_station_scans_the_part_that_foxglove_was_told_of() {
    let dir = simulated(STEPS);
    let config = config(dir.path());
    let folder = dir.path().join("new/scans");
    let output = folder.to_str().unwrap();
    let mut live = Live::begin(&["serve", "--config", &config, "--listen", "0", "-o", output], Some(TOKEN));
    let mut foxglove = connect(live.foxglove.as_ref().unwrap(), "", "foxglove.sdk.v1");
    assert_eq!(set(&mut foxglove, "next.from_v", &json!(0.9)).0, json!(0.8), "without a right to");
    assert_eq!(set(&mut foxglove, "control_token", &json!(TOKEN)), (json!(""), None));
    for (name, value, still) in [
        ("next.to_v", json!(1.2), json!(1.1)),
        ("next.from_v", json!(-1.0), json!(0.8)),
        ("next.from_v", json!(1.1), json!(0.8)),
        ("next.repeat", json!(1.5), json!(1.0)),
        ("next.repeat", json!(0), json!(1.0)),
    ] {
        let (now, why) = set(&mut foxglove, name, &value);
        assert!(now == still && why.is_some(), "{name}: {now}, {why:?}");
    }
    assert_eq!(set(&mut foxglove, "next.from_v", &json!(0.9)), (json!(0.9), None));
    assert_eq!(set(&mut foxglove, "next.repeat", &json!(2)), (json!(2.0), None));
    live.command("take-control");
    live.command("start");
    live.phase("scanning");
    let ended = live.phase("finished");
    // Three of the five voltages, twice.
    assert_eq!(ended["frames"], 6, "{ended}");
    let recording = folder.join("scan-0001.mcap");
    assert!(has(&recording, "next.from_v = 0.9, as Foxglove client "));
    assert!(has(&recording, "next.repeat = 2, as Foxglove client ") && !has(&recording, TOKEN));
}

#[test]
fn the_pace_of_a_replay_is_set_from_foxglove() {
    let ball = fixture("ball");
    let mut live = Live::begin(&["serve", ball.to_str().unwrap(), "--listen", "0"], Some(TOKEN));
    live.wait("a time line", |text| text["type"] == "timeline" && text["rate"] == 1.0);
    let mut foxglove = connect(live.foxglove.as_ref().unwrap(), "", "foxglove.sdk.v1");
    assert_eq!(set(&mut foxglove, "replay.rate", &json!(4.0)).0, json!(1.0), "without a right to");
    assert_eq!(set(&mut foxglove, "control_token", &json!(TOKEN)), (json!(""), None));
    let (now, why) = set(&mut foxglove, "replay.rate", &json!(0.0));
    assert!(now == 1.0 && why.unwrap().contains("0.01 to 100"), "{now}");
    assert_eq!(set(&mut foxglove, "replay.rate", &json!(4.0)), (json!(4.0), None));
    live.wait("another pace", |text| text["type"] == "timeline" && text["rate"] == 4.0);
    // What the page sets is told there, too.
    assert_eq!(live.ask(json!({"type": "replay", "do": "rate", "rate": 0.5})).0, None);
    let (now, why) = set(&mut foxglove, "replay.rate", &json!("slow"));
    assert!(now == 0.5 && why.is_some(), "{now}");
}

#[test]
fn others_need_a_token_and_a_weak_one_is_refused() {
    let dir = simulated(STEPS);
    let file = dir.path().join("token");
    fs::write(&file, "secret\n").unwrap();
    let config = config(dir.path());
    let weak = ["serve", "--config", &config, "--listen", "0", "--view-token-file", file.to_str().unwrap()];
    crate::samples::uwscan(weak).fails(&["token", "at least 24"]);
    fs::remove_file(&file).unwrap();
    crate::samples::uwscan(weak).fails(&["token: cannot read", "check the path"]);
    let far = ["serve", "--config", &config, "--listen", "0", "--foxglove", "0.0.0.0:0"];
    crate::samples::uwscan(far).fails(&["Foxglove", "loopback"]);
    crate::samples::uwscan(["scan", "--config", &config, "--foxglove", "off"]).is_misused(&["--live"]);
    crate::samples::uwscan(["serve"]).is_misused(&["CAPTURE"]);
}

#[test]
fn a_certificate_is_served_with_and_a_wrong_one_is_told_of() {
    let dir = simulated(STEPS);
    let config = config(dir.path());
    let made = rcgen::generate_simple_self_signed(vec!["localhost".to_owned()]).unwrap();
    let (cert, key) = (dir.path().join("cert.pem"), dir.path().join("key.pem"));
    fs::write(&cert, made.cert.pem()).unwrap();
    fs::write(&key, made.signing_key.serialize_pem()).unwrap();
    let [cert, key] = [&cert, &key].map(|path| path.to_str().unwrap());
    let serve = ["serve", "--config", &config, "--listen", "0", "--foxglove", "off"];
    let with = |more: &[&str]| crate::samples::uwscan(serve.iter().chain(more).copied());
    with(&["--tls-cert", cert]).is_misused(&["--tls-key"]);
    with(&["--tls-cert", key, "--tls-key", key]).fails(&["key.pem", "has no certificate"]);
    crate::samples::uwscan(["scan", "--config", &config, "--tls-cert", cert, "--tls-key", key])
        .is_misused(&["--live"]);
    let mut child = Command::new(cargo_bin!("uwscan"))
        .args(serve)
        .args(["--tls-cert", cert, "--tls-key", key])
        .stdin(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let errors = BufReader::new(child.stderr.take().unwrap());
    let address = errors.lines().find_map(|line| {
        line.unwrap().strip_prefix("live: https://").map(|rest| rest.trim_end_matches('/').to_owned())
    });
    // Over TLS it is spoken to in uw-live's own tests; here, that nothing else is answered.
    let mut stream = TcpStream::connect(address.unwrap()).unwrap();
    stream.write_all(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n").unwrap();
    stream.shutdown(std::net::Shutdown::Write).unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(answer.starts_with("HTTP/1.1 400") && answer.contains("https://"), "{answer}");
}
