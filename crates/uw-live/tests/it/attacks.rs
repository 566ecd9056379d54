//! What must not get in, and must not hold anything up: the scan goes on through all of it.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::time::{Duration, Instant};

use proptest::prelude::*;
use serde_json::json;
use tokio_tungstenite::tungstenite::Message;

use crate::client::Client;
use crate::scenes::{CONTROL, VIEW, local, serve, serve_with_tokens};

const SOON: Duration = Duration::from_secs(5);

fn say_hello(address: SocketAddr, token: &serde_json::Value) -> u16 {
    let mut client = Client::connect(address, None);
    client.say(&json!({"type": "hello", "token": token}));
    client.closed(SOON)
}

/// The server's answer to bytes, as far as it comes.
pub fn raw(address: SocketAddr, bytes: &[u8]) -> String {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(2))).unwrap();
    let _ = stream.write_all(bytes);
    let mut answer = Vec::new();
    let mut buffer = [0; 4096];
    while let Ok(count @ 1..) = stream.read(&mut buffer) {
        answer.extend(&buffer[..count]);
    }
    String::from_utf8_lossy(&answer).into_owned()
}

fn get(address: SocketAddr, path: &str) -> String {
    raw(address, format!("GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n").as_bytes())
}

/// The server still serves.
fn assert_alive(address: SocketAddr, token: Option<&str>) {
    let began = Instant::now();
    Client::hello(address, token, "honest").text("state", SOON);
    assert!(began.elapsed() < Duration::from_secs(3), "{:?}", began.elapsed());
}

#[test]
fn tokens_that_are_wrong_or_missing_are_refused_slowly() {
    let (server, _feed, _asked) = serve_with_tokens();
    let address = server.listening();
    let began = Instant::now();
    for wrong in [json!(null), json!(""), json!(&CONTROL[1..]), json!(format!("{VIEW} "))] {
        assert_eq!(say_hello(address, &wrong), 4401, "{wrong}");
    }
    assert!(began.elapsed() > Duration::from_secs(2), "four guesses in {:?}", began.elapsed());
    // Commands before the hello are none.
    let mut client = Client::connect(address, None);
    client.say(&json!({"type": "command", "id": 1, "do": "stop"}));
    assert_eq!(client.closed(SOON), 4401);
    assert_alive(address, Some(VIEW));
}

#[test]
fn pages_of_others_are_refused() {
    let (server, _feed, _asked) = serve();
    let address = server.listening();
    for origin in ["http://evil.example", "null", "http://127.0.0.1:1", "https://evil.example:8764"] {
        let mut client = Client::connect(address, Some(origin));
        assert_eq!(client.closed(SOON), 4403, "{origin}");
    }
    let mut own = Client::connect(address, Some(&format!("http://{address}")));
    own.say(&json!({"type": "hello", "token": null}));
    own.text("welcome", SOON);
    // A name that was pointed at this machine.
    let rebound = raw(address, b"GET / HTTP/1.1\r\nHost: evil.example\r\nConnection: close\r\n\r\n");
    assert!(rebound.starts_with("HTTP/1.1 403"), "{rebound}");
    let page = get(address, "/");
    assert!(page.starts_with("HTTP/1.1 200"), "{page}");
    for header in
        ["content-security-policy: default-src 'self'", "nosniff", "no-referrer", "frame-ancestors 'none'"]
    {
        assert!(page.contains(header), "{header}: {page}");
    }
    assert!(!page.to_lowercase().contains("access-control-allow"), "{page}");
}

#[test]
fn others_are_not_served_without_a_token_to_begin_with() {
    use uw_live::{Access, Options, Server};
    let listen = "0.0.0.0:0".parse().unwrap();
    let refused =
        Server::start(Options { listen, access: Access::Local, tls: None, foxglove: None }).unwrap_err();
    assert!(refused.to_string().contains("no token"), "{refused}");
    let refused =
        Server::start(Options { listen: local(), access: Access::Local, tls: None, foxglove: Some(listen) });
    assert!(refused.unwrap_err().to_string().contains("loopback"));
}

#[test]
fn no_path_leads_out_of_the_page() {
    let (server, _feed, _asked) = serve();
    let address = server.listening();
    for path in [
        "/../Cargo.toml",
        "/%2e%2e/Cargo.toml",
        "/..%2fCargo.toml",
        "//etc/passwd",
        "/assets/../index.html",
        "/index.html/..",
        "/.",
        "/index.html%00",
    ] {
        let answer = get(address, path);
        assert!(answer.starts_with("HTTP/1.1 40"), "{path}: {answer}");
        assert!(!answer.contains("[package]") && !answer.contains("root:"), "{path}");
    }
    let post = raw(
        address,
        format!("POST / HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\nContent-Length: 0\r\n\r\n")
            .as_bytes(),
    );
    assert!(post.starts_with("HTTP/1.1 405"), "{post}");
    let plain = get(address, "/ws");
    assert!(plain.starts_with("HTTP/1.1 400"), "{plain}");
}

#[test]
fn large_many_and_malformed_messages_end_a_session() {
    let (server, _feed, _asked) = serve();
    let address = server.listening();
    let after_hello = |message: Message| {
        let mut client = Client::hello(address, None, "x");
        client.text("welcome", SOON);
        client.socket.send(message).unwrap();
        client.closed(SOON)
    };
    assert_eq!(after_hello(Message::text("x".repeat(70_000))), 4413);
    assert_eq!(after_hello(Message::text("{}")), 4400);
    assert_eq!(after_hello(Message::binary(vec![1, 2, 3])), 4400);
    assert_eq!(after_hello(Message::text(r#"{"type":"hello","token":null}"#)), 4400);
    let mut client = Client::hello(address, None, "x");
    client.text("welcome", SOON);
    for _ in 0..100 {
        let _ = client.socket.send(Message::text(r#"{"type":"ack","sequence":4000000000}"#));
    }
    assert_eq!(client.closed(SOON), 4429);
    assert_alive(address, None);
}

#[test]
fn slow_heads_and_silent_sockets_are_dropped() {
    let (server, _feed, _asked) = serve();
    let address = server.listening();
    let began = Instant::now();
    let mut slow: Vec<TcpStream> = (0..50).map(|_| TcpStream::connect(address).unwrap()).collect();
    let mut silent = Client::connect(address, None);
    slow.iter_mut().for_each(|stream| stream.write_all(b"GET / HTTP/1.1\r\nHost: ").unwrap());
    assert_alive(address, None);
    assert_eq!(silent.closed(Duration::from_secs(8)), 4408);
    for mut stream in slow {
        stream.set_read_timeout(Some(Duration::from_secs(4))).unwrap();
        let mut rest = Vec::new();
        // Closed, or reset: not waited for.
        match stream.read_to_end(&mut rest) {
            Ok(_) => {}
            Err(error) => assert_ne!(error.kind(), std::io::ErrorKind::WouldBlock, "still open"),
        }
    }
    assert!(began.elapsed() < Duration::from_secs(15), "{:?}", began.elapsed());
}

#[test]
fn more_clients_than_there_is_room_for_are_told_so() {
    let (server, _feed, _asked) = serve();
    let address = server.listening();
    let mut clients: Vec<Client> = (0..64).map(|i| Client::hello(address, None, &i.to_string())).collect();
    clients.iter_mut().for_each(|client| {
        client.text("welcome", SOON);
    });
    assert_eq!(say_hello(address, &json!(null)), 4429);
    clients.pop();
    let deadline = Instant::now() + SOON;
    while say_hello_is_refused(address) {
        assert!(Instant::now() < deadline);
    }
}

fn say_hello_is_refused(address: SocketAddr) -> bool {
    let mut client = Client::hello(address, None, "x");
    matches!(client.next(SOON), Some(crate::client::Got::Closed(4429)))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 8, ..ProptestConfig::default() })]

    /// Bytes of all kinds, as requests, as frames after a handshake, and as messages.
    #[test]
    fn no_bytes_end_the_server(noise in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..300), 10), text in ".{0,100}") {
        let (server, feed, asked) = serve();
        let address = server.listening();
        for bytes in &noise {
            let mut stream = TcpStream::connect(address).unwrap();
            let _ = stream.write_all(bytes);
            let mut upgraded = Client::hello(address, None, "x");
            let _ = upgraded.socket.get_mut().write_all(bytes);
            let mut client = Client::hello(address, None, &text);
            let word = format!("{{\"type\":\"command\",\"id\":1,\"do\":{text:?}}}");
            let _ = client.socket.send(Message::text(word));
        }
        feed.note(uw_live::Level::Info, "still here");
        assert_alive(address, None);
        // Noise asks for nothing.
        prop_assert!(asked.is_empty());
    }
}
