//! The page and its socket over TLS.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use crossbeam_channel::Receiver;
use rcgen::{CertifiedKey, KeyPair, generate_simple_self_signed};
use serde_json::json;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::ServerName;
use tokio_rustls::rustls::{ClientConfig, ClientConnection, RootCertStore, StreamOwned};
use uw_live::{Access, Asked, Error, Feed, Level, Options, Server, Tls};

use crate::attacks::raw;
use crate::client::{Client, tcp};
use crate::scenes::{local, picture, scanning, stripe};

const SOON: Duration = Duration::from_secs(5);

/// A certificate for this machine and its key, made now, in a folder.
struct Made {
    folder: tempfile::TempDir,
    trusted: Arc<ClientConfig>,
}

impl Made {
    fn new() -> Self {
        let names = vec!["localhost".to_owned(), "127.0.0.1".to_owned()];
        let CertifiedKey { cert, signing_key } = generate_simple_self_signed(names).unwrap();
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("cert.pem"), cert.pem()).unwrap();
        std::fs::write(folder.path().join("key.pem"), signing_key.serialize_pem()).unwrap();
        let mut roots = RootCertStore::empty();
        roots.add(cert.der().clone()).unwrap();
        let config = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
            .with_safe_default_protocol_versions()
            .unwrap();
        let trusted = Arc::new(config.with_root_certificates(roots).with_no_client_auth());
        Self { folder, trusted }
    }

    fn file(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn holding(&self, name: &str, text: &str) -> PathBuf {
        let path = self.file(name);
        std::fs::write(&path, text).unwrap();
        path
    }

    fn serve(&self) -> (Server, Feed, Receiver<Asked>) {
        let tls = Some(Tls::read(&self.file("cert.pem"), &self.file("key.pem")).unwrap());
        Server::start(Options { listen: local(), access: Access::Local, tls, foxglove: None }).unwrap()
    }

    fn stream(&self, address: SocketAddr) -> StreamOwned<ClientConnection, TcpStream> {
        let name = ServerName::from(address.ip());
        StreamOwned::new(ClientConnection::new(self.trusted.clone(), name).unwrap(), tcp(address))
    }

    fn connect(
        &self,
        address: SocketAddr,
        origin: Option<&str>,
    ) -> Client<StreamOwned<ClientConnection, TcpStream>> {
        // By its blocking socket, so that the handshake is done in one go.
        let mut stream = self.stream(address);
        stream.sock.set_read_timeout(Some(SOON)).unwrap();
        stream.conn.complete_io(&mut stream.sock).unwrap();
        stream.sock.set_read_timeout(Some(Duration::from_millis(20))).unwrap();
        Client::over(stream, &format!("ws://{address}"), origin)
    }
}

fn hello(client: &mut Client<StreamOwned<ClientConnection, TcpStream>>) {
    client.say(&json!({"type": "hello", "token": null, "client": "x", "bandwidth_kbps": null}));
    client.text("welcome", SOON);
}

#[test]
fn a_scan_is_watched_and_steered_over_an_encrypted_socket() {
    let made = Made::new();
    let (server, feed, asked) = made.serve();
    std::thread::spawn(move || asked.into_iter().for_each(Asked::done));
    let address = server.listening();
    let mut client = made.connect(address, Some(&format!("https://{address}")));
    hello(&mut client);
    feed.image(picture(0, [384, 288]));
    feed.stripe(stripe(0, 288));
    feed.state(scanning(1));
    let (mut images, mut points) = (0, 0);
    let until = Instant::now() + SOON;
    while images == 0 || points < 288 {
        assert!(Instant::now() < until, "{images} images, {points} points");
        if let Some(crate::client::Got::Binary(bytes)) = client.next(Duration::from_millis(50)) {
            images += usize::from(bytes[0] == 1);
            let number = || u32::from_le_bytes(bytes[20..24].try_into().unwrap()) as usize;
            points += if bytes[0] == 2 { number() } else { 0 };
        }
    }
    assert_eq!(client.command(1, "laser-off"), None);
}

#[test]
fn what_was_not_encrypted_is_not_let_in_where_it_has_to_be() {
    let made = Made::new();
    let (server, feed, _asked) = made.serve();
    let address = server.listening();
    // Whoever sits on the way can make up a page of this very name that is not encrypted.
    for origin in [format!("http://{address}"), "https://evil.example".to_owned(), "null".to_owned()] {
        assert_eq!(made.connect(address, Some(&origin)).closed(SOON), 4403, "{origin}");
    }
    let get = |host: &str| {
        let mut stream = made.stream(address);
        stream.sock.set_read_timeout(Some(SOON)).unwrap();
        write!(stream, "GET / HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n").unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        String::from_utf8_lossy(&answer).into_owned()
    };
    let page = get(&address.to_string());
    assert!(page.starts_with("HTTP/1.1 200") && page.to_lowercase().contains("<!doctype html>"), "{page}");
    assert!(get("evil.example").starts_with("HTTP/1.1 403"));
    // Who forgot the s is told so, and gets nothing else.
    let request = format!("GET / HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n");
    let plain = raw(address, request.as_bytes());
    assert!(plain.starts_with("HTTP/1.1 400") && plain.contains("https://"), "{plain}");
    // Noise in place of a handshake ends no more than its own connection.
    for noise in [&b"\x16\x03\x01\xff\xff"[..], b"\0\0\0\0", &[0xff; 3000]] {
        raw(address, noise);
    }
    feed.note(Level::Info, "still here");
    hello(&mut made.connect(address, None));
}

#[test]
fn slow_handshakes_are_dropped() {
    let made = Made::new();
    let (server, _feed, _asked) = made.serve();
    let address = server.listening();
    let began = Instant::now();
    // Some say nothing, some begin a handshake, some a request.
    let starts: [&[u8]; 3] = [b"", b"\x16\x03\x01\x02", b"GET / HTTP/1.1\r\n"];
    let slow: Vec<TcpStream> = (0..60)
        .map(|i| {
            let mut stream = TcpStream::connect(address).unwrap();
            stream.write_all(starts[i % 3]).unwrap();
            stream
        })
        .collect();
    hello(&mut made.connect(address, None));
    assert!(began.elapsed() < Duration::from_secs(3), "{:?}", began.elapsed());
    for mut stream in slow {
        stream.set_read_timeout(Some(Duration::from_secs(8))).unwrap();
        match stream.read_to_end(&mut Vec::new()) {
            Ok(_) => {}
            Err(error) => assert_ne!(error.kind(), std::io::ErrorKind::WouldBlock, "still open"),
        }
    }
    assert!(began.elapsed() < Duration::from_secs(10), "{:?}", began.elapsed());
}

#[test]
fn files_that_cannot_be_served_with_are_told_by_name() {
    let made = Made::new();
    let (cert, key) = (made.file("cert.pem"), made.file("key.pem"));
    let text = std::fs::read_to_string(&cert).unwrap();
    let mut torn = text.clone();
    torn.truncate(text.len() / 2);
    let torn = made.holding("torn.pem", &torn);
    let other = made.holding("other.pem", &KeyPair::generate().unwrap().serialize_pem());
    let nothing = made.holding("nothing.pem", "");
    let begun = "-----BEGIN ENCRYPTED PRIVATE KEY-----\nAAAA\n-----END ENCRYPTED PRIVATE KEY-----\n";
    let locked = made.holding("locked.pem", begun);
    let hollow = made.holding("hollow.pem", "-----BEGIN PRIVATE KEY-----\nAAAA\n-----END PRIVATE KEY-----\n");
    let garbled =
        made.holding("garbled.pem", "-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n");
    let missing = made.file("missing.pem");
    let cases: [(&Path, &Path, &str, &str); 10] = [
        (&missing, &key, "missing.pem", "cannot be read"),
        (&cert, &missing, "missing.pem", "cannot be read"),
        // The two swapped.
        (&key, &cert, "key.pem", "has no certificate"),
        (&nothing, &key, "nothing.pem", "has no certificate"),
        (&cert, &nothing, "nothing.pem", "has no private key"),
        (&cert, &locked, "locked.pem", "passphrase"),
        (&torn, &key, "torn.pem", "damaged"),
        (&cert, &hollow, "hollow.pem", "make the two anew"),
        (&garbled, &key, "garbled.pem", "make the two anew"),
        (&cert, &other, "other.pem", "cert.pem: give the two that were made together"),
    ];
    for (certificate, key, file, words) in cases {
        let error = Tls::read(certificate, key).unwrap_err();
        let Error::Tls { file: at, .. } = &error else { panic!("{error}") };
        let said = error.to_string();
        assert!(at.ends_with(file) && said.contains(file) && said.contains(words), "{file}, {words}: {said}");
    }
}
