//! The stream for Foxglove's tools, at its socket. Whether its messages are what their schemas say is scripts/live.py's to see.

use std::collections::BTreeMap;
use std::net::TcpStream;
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::http::HeaderValue;
use tokio_tungstenite::tungstenite::{Error, HandshakeError, Message, WebSocket, client};
use uw_live::{About, Access, Action, Level, Options, Server, Token};

use crate::client::Client;
use crate::scenes::{CONTROL, VIEW, local, picture, scanning, stripe};

fn connect(server: &Server) -> WebSocket<TcpStream> {
    let address = server.foxglove().unwrap();
    let stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(Duration::from_millis(20))).unwrap();
    let mut request = format!("ws://{address}").into_client_request().unwrap();
    request.headers_mut().insert("sec-websocket-protocol", HeaderValue::from_static("foxglove.sdk.v1"));
    let mut handshake = client(request, stream);
    loop {
        match handshake {
            Ok((socket, response)) => {
                assert_eq!(response.headers()["sec-websocket-protocol"], "foxglove.sdk.v1");
                return socket;
            }
            Err(HandshakeError::Interrupted(middle)) => handshake = middle.handshake(),
            Err(error) => panic!("{error}"),
        }
    }
}

/// The next message, if one comes soon.
fn next(socket: &mut WebSocket<TcpStream>) -> Option<Message> {
    match socket.read() {
        Ok(message) => Some(message),
        Err(Error::Io(error)) if error.kind() == std::io::ErrorKind::WouldBlock => None,
        Err(error) => panic!("{error}"),
    }
}

fn send(socket: &mut WebSocket<TcpStream>, value: &Value) {
    socket.send(Message::text(value.to_string())).unwrap();
}

#[test]
fn every_topic_comes_to_who_subscribes_and_nothing_can_be_set() {
    let options = Options { listen: local(), access: Access::Local, tls: None, foxglove: Some(local()) };
    let (server, feed, asked) = Server::start(options).unwrap();
    let parameters = vec![("planned".to_owned(), 101.0)];
    feed.about(About { image_size: [96, 64], parameters, ..About::default() });
    let mut socket = connect(&server);
    let (mut topics, mut counts) = (BTreeMap::new(), BTreeMap::<String, usize>::new());
    let mut planned = Vec::new();
    let until = Instant::now() + Duration::from_secs(10);
    let mut frame = 0;
    // All but the two that a calibration alone gives.
    while counts.len() < 8 || planned.len() < 2 {
        assert!(Instant::now() < until, "{counts:?} of {topics:?}; {planned:?}");
        feed.image(picture(frame, [96, 64]));
        feed.stripe(stripe(frame, 64));
        feed.state(scanning(frame as usize));
        feed.note(Level::Info, "a line");
        frame += 1;
        match next(&mut socket) {
            Some(Message::Text(text)) => {
                let said: Value = serde_json::from_str(&text).unwrap();
                if said["op"] == "advertise" {
                    let channels = said["channels"].as_array().unwrap();
                    for channel in channels {
                        assert_eq!(
                            (&channel["encoding"], &channel["schemaEncoding"]),
                            (&json!("protobuf"), &json!("protobuf"))
                        );
                        let topic = channel["topic"].as_str().unwrap().to_owned();
                        topics.insert(channel["id"].as_u64().unwrap() as u32, topic);
                    }
                    let wanted = |channel: &Value| json!({"id": channel["id"], "channelId": channel["id"]});
                    let subscriptions: Vec<Value> = channels.iter().map(wanted).collect();
                    send(&mut socket, &json!({"op": "subscribe", "subscriptions": subscriptions}));
                    let set = json!({"name": "planned", "value": 7.0});
                    send(&mut socket, &json!({"op": "setParameters", "parameters": [set], "id": "set"}));
                    send(&mut socket, &json!({"op": "getParameters", "parameterNames": [], "id": "get"}));
                } else if said["op"] == "parameterValues" {
                    planned.push(said["parameters"][0]["value"].as_f64().unwrap());
                }
            }
            Some(Message::Binary(bytes)) if bytes[0] == 1 => {
                let id = u32::from_le_bytes(bytes[1..5].try_into().unwrap());
                *counts.entry(topics[&id].clone()).or_default() += 1;
            }
            _ => {}
        }
    }
    assert_eq!(topics.len(), 10);
    assert!(planned.iter().all(|value| (value - 101.0).abs() < 1e-9), "{planned:?}");
    assert!(asked.is_empty());
}

/// A client that sets parameters, and what it is told.
struct Sets(WebSocket<TcpStream>);

impl Sets {
    fn connect(server: &Server) -> Self {
        let mut sets = Self(connect(server));
        // It is listened to once the channels are told.
        sets.until(|said| said["op"] == "advertise");
        sets
    }

    fn until(&mut self, is: impl Fn(&Value) -> bool) -> (Value, Vec<String>) {
        let until = Instant::now() + Duration::from_secs(10);
        let mut warnings = Vec::new();
        while Instant::now() < until {
            if let Some(Message::Text(text)) = next(&mut self.0) {
                assert!(!text.contains(CONTROL) && !text.contains(VIEW), "a token is told: {text}");
                let said: Value = serde_json::from_str(&text).unwrap();
                if is(&said) {
                    return (said, warnings);
                }
                if said["op"] == "status" {
                    warnings.push(said["message"].as_str().unwrap().to_owned());
                }
            }
        }
        panic!("not told within 10 s; {warnings:?}");
    }

    /// The value that a parameter has after it was to be set, and the warnings on the way.
    fn set(&mut self, name: &str, value: &Value) -> (Value, Vec<String>) {
        let parameter = json!({"name": name, "value": value});
        send(&mut self.0, &json!({"op": "setParameters", "parameters": [parameter], "id": "this"}));
        let (said, warnings) = self.until(|said| said["op"] == "parameterValues" && said["id"] == "this");
        (said["parameters"][0]["value"].clone(), warnings)
    }

    #[track_caller]
    fn is_refused(&mut self, name: &str, value: &Value, still: &Value, words: &str) {
        let (now, warnings) = self.set(name, value);
        assert_eq!(&now, still, "{name}");
        assert!(warnings.len() == 1 && warnings[0].contains(words), "{words}: {warnings:?}");
    }
}

#[test]
fn a_setting_is_set_by_who_has_shown_the_token_to_steer_alone() {
    let token = |text| Token::new(text).unwrap();
    let access = Access::Tokens { view: token(VIEW), control: token(CONTROL) };
    let options = Options { listen: local(), access, tls: None, foxglove: Some(local()) };
    let (server, feed, asked) = Server::start(options).unwrap();
    feed.about(About { parameters: vec![("planned".to_owned(), 101.0)], ..About::default() });
    feed.settings(vec![("rate".to_owned(), 1.0)]);
    let scans = feed.clone();
    let (heard, hears) = std::sync::mpsc::channel();
    std::thread::spawn(move || {
        for asked in asked {
            let Action::Set { name, value } = asked.action.clone() else { panic!("{asked:?}") };
            heard.send((name.clone(), value, asked.who.clone())).unwrap();
            if value > 0.0 {
                scans.settings(vec![(name, value)]);
                asked.done();
            } else {
                asked.refuse("a rate is above zero");
            }
        }
    });
    let mut client = Sets::connect(&server);
    let (two, one) = (json!(2.0), json!(1.0));
    client.is_refused("rate", &two, &one, "control_token");
    let began = Instant::now();
    for wrong in [json!(VIEW), json!(&CONTROL[1..])] {
        client.is_refused("control_token", &wrong, &json!(""), "not the token to steer");
    }
    assert!(began.elapsed() >= Duration::from_secs(1), "two guesses in {:?}", began.elapsed());
    client.is_refused("control_token", &json!(7.0), &json!(""), "a text");
    client.is_refused("rate", &two, &one, "control_token");
    assert!(hears.try_recv().is_err(), "something was asked for without a right to");

    assert_eq!(client.set("control_token", &json!(CONTROL)), (json!(""), Vec::new()));
    assert_eq!(client.set("rate", &two), (two.clone(), Vec::new()));
    let (name, value, who) = hears.recv().unwrap();
    assert_eq!((name.as_str(), value.to_bits()), ("rate", 2.0_f64.to_bits()));
    assert!(who.starts_with("Foxglove client"), "{who}");
    client.is_refused("rate", &json!(-1.0), &two, "above zero");
    assert_eq!(hears.recv().unwrap().1.to_bits(), (-1.0_f64).to_bits());
    client.is_refused("rate", &json!("fast"), &two, "a number");
    client.is_refused("planned", &two, &json!(101.0), "no such parameter to set");
    // The right is the client's that showed it.
    Sets::connect(&server).is_refused("rate", &one, &two, "control_token");
    // One steers at a time.
    let mut page = Client::hello(server.listening(), Some(CONTROL), "bow");
    page.text("welcome", Duration::from_secs(5));
    assert_eq!(page.command(1, "take-control"), None);
    client.is_refused("rate", &one, &two, "bow steers");
    assert_eq!(page.command(2, "release-control"), None);
    assert_eq!(client.set("rate", &json!(3)), (json!(3.0), Vec::new()));
    // Given back.
    assert_eq!(client.set("control_token", &json!("")), (json!(""), Vec::new()));
    client.is_refused("rate", &one, &json!(3.0), "control_token");
}

#[test]
fn where_no_token_is_asked_for_nothing_is_set() {
    let options = Options { listen: local(), access: Access::Local, tls: None, foxglove: Some(local()) };
    let (server, feed, asked) = Server::start(options).unwrap();
    feed.settings(vec![("rate".to_owned(), 1.0)]);
    let mut client = Sets::connect(&server);
    client.is_refused("rate", &json!(2.0), &json!(1.0), "--control-token-file");
    client.set("control_token", &json!(CONTROL));
    client.is_refused("rate", &json!(2.0), &json!(1.0), "--control-token-file");
    assert!(asked.is_empty());
}
