//! A client as simple as can be: tungstenite on a TCP socket, encrypted or not.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::http::HeaderValue;
use tokio_tungstenite::tungstenite::{Error, Message, WebSocket, client};
use uw_live::wire::PROTOCOL;

/// What a client got.
#[derive(Debug)]
pub enum Got {
    Text(Value),
    Binary(Vec<u8>),
    Closed(u16),
}

pub struct Client<S = TcpStream> {
    pub socket: WebSocket<S>,
    /// Whether binary messages are acknowledged.
    pub acks: bool,
}

impl Client {
    /// Connects, from a page of `origin` if one is given.
    pub fn connect(address: SocketAddr, origin: Option<&str>) -> Self {
        Self::over(tcp(address), &format!("ws://{address}"), origin)
    }

    /// Connects and says hello.
    pub fn hello(address: SocketAddr, token: Option<&str>, name: &str) -> Self {
        let mut client = Self::connect(address, None);
        client.say(&json!({"type": "hello", "token": token, "client": name, "bandwidth_kbps": null}));
        client
    }
}

/// A socket whose reads do not wait for long.
pub fn tcp(address: SocketAddr) -> TcpStream {
    let stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(Duration::from_millis(20))).unwrap();
    stream.set_nodelay(true).unwrap();
    stream
}

impl<S: Read + Write> Client<S> {
    /// Shakes hands over a stream.
    pub fn over(stream: S, server: &str, origin: Option<&str>) -> Self {
        let mut request = format!("{server}/ws").into_client_request().unwrap();
        request.headers_mut().insert("sec-websocket-protocol", HeaderValue::from_static(PROTOCOL));
        if let Some(origin) = origin {
            request.headers_mut().insert("origin", HeaderValue::from_str(origin).unwrap());
        }
        let mut handshake = client(request, stream);
        let (socket, _) = loop {
            match handshake {
                Ok(done) => break done,
                Err(tokio_tungstenite::tungstenite::HandshakeError::Interrupted(middle)) => {
                    handshake = middle.handshake();
                }
                Err(error) => panic!("{error}"),
            }
        };
        Self { socket, acks: true }
    }

    pub fn say(&mut self, value: &Value) {
        self.socket.send(Message::text(value.to_string())).unwrap();
    }

    /// What comes next, if something comes in time; binary messages are acknowledged.
    pub fn next(&mut self, within: Duration) -> Option<Got> {
        let deadline = Instant::now() + within;
        loop {
            match self.socket.read() {
                Ok(Message::Text(text)) => return Some(Got::Text(serde_json::from_str(&text).unwrap())),
                Ok(Message::Binary(bytes)) => {
                    if self.acks {
                        let sequence = u32::from_le_bytes(bytes[4..8].try_into().unwrap());
                        // The server may be gone already.
                        let ack = json!({"type": "ack", "sequence": sequence}).to_string();
                        let _ = self.socket.send(Message::text(ack));
                    }
                    return Some(Got::Binary(bytes.to_vec()));
                }
                Ok(Message::Close(frame)) => return Some(Got::Closed(frame.map_or(1005, |f| f.code.into()))),
                Ok(_) => {}
                Err(Error::Io(error)) if error.kind() == std::io::ErrorKind::WouldBlock => {}
                Err(_) => return Some(Got::Closed(1006)),
            }
            if Instant::now() >= deadline {
                return None;
            }
        }
    }

    /// The next text of a type; whatever else comes is passed over.
    pub fn text(&mut self, kind: &str, within: Duration) -> Value {
        let deadline = Instant::now() + within;
        while Instant::now() < deadline {
            match self.next(Duration::from_millis(50)) {
                Some(Got::Text(value)) if value["type"] == kind => return value,
                Some(Got::Closed(code)) => panic!("closed with {code} instead of {kind}"),
                _ => {}
            }
        }
        panic!("no {kind} within {within:?}");
    }

    /// With which code the server closes.
    pub fn closed(&mut self, within: Duration) -> u16 {
        let deadline = Instant::now() + within;
        while Instant::now() < deadline {
            if let Some(Got::Closed(code)) = self.next(Duration::from_millis(50)) {
                return code;
            }
        }
        panic!("still open after {within:?}");
    }

    /// Asks, and waits for the answer: `None` where it is done, else why not.
    pub fn command(&mut self, id: u64, word: &str) -> Option<String> {
        self.say(&json!({"type": "command", "id": id, "do": word}));
        loop {
            let answer = self.text("answer", Duration::from_secs(5));
            if answer["id"] == id {
                return answer["error"].as_str().map(str::to_owned);
            }
        }
    }
}

/// A cloud as a page puts it together.
#[derive(Debug, Default)]
pub struct Cloud {
    pub epoch: Option<u32>,
    pub points: Vec<[f64; 3]>,
    pub brightness: Vec<u8>,
    /// The largest half step of any message, mm.
    pub half_step: f64,
}

impl Cloud {
    pub fn take(&mut self, bytes: &[u8]) {
        if bytes[0] != 2 {
            return;
        }
        let f32_at = |at: usize| f64::from(f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()));
        let u32_at = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        let epoch = u32_at(8);
        let first = u64::from_le_bytes(bytes[12..20].try_into().unwrap()) as usize;
        if self.epoch != Some(epoch) {
            *self = Self { epoch: Some(epoch), ..Self::default() };
        }
        assert_eq!(first, self.points.len(), "points follow each other");
        let corner = [24, 28, 32].map(f32_at);
        let step = f32_at(36);
        self.half_step = self.half_step.max(step / 2.0);
        let count = u32_at(20) as usize;
        assert_eq!(bytes.len(), 40 + 7 * count);
        for point in bytes[40..].chunks_exact(7) {
            let steps = |i: usize| f64::from(u16::from_le_bytes([point[2 * i], point[2 * i + 1]]));
            self.points.push([0, 1, 2].map(|i| corner[i] + step * steps(i)));
            self.brightness.push(point[6]);
        }
    }
}
