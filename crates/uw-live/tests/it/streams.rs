//! The stream for Foxglove's tools, at its socket. Whether its messages are what their schemas say is scripts/live.py's to see.

use std::collections::BTreeMap;
use std::net::TcpStream;
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::http::HeaderValue;
use tokio_tungstenite::tungstenite::{Error, HandshakeError, Message, WebSocket, client};
use uw_live::{About, Access, Level, Options, Server};

use crate::scenes::{local, picture, scanning, stripe};

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
