//! Connections: the page's files, and the way to a session.

use std::convert::Infallible;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use http_body_util::Full;
use hyper::body::{Bytes, Incoming};
use hyper::header::{self, HeaderMap, HeaderName, HeaderValue};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::{Method, Request, Response, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::io::{AsyncRead, AsyncWrite, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio_rustls::TlsAcceptor;
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::handshake::derive_accept_key;
use tokio_tungstenite::tungstenite::protocol::{Role, WebSocketConfig};

use crate::access::same_site;
use crate::assets;
use crate::server::Site;
use crate::session;
use crate::wire::{MOST_BYTES, PROTOCOL};

/// How long encryption may take to begin, and the head of a request.
const HEAD_WITHIN: Duration = Duration::from_secs(5);
/// How long a connection that is no session may last.
const CONNECTION_WITHIN: Duration = Duration::from_secs(60);
/// Bytes of a request's head at most.
const HEAD_BYTES: usize = 16 << 10;
/// Bytes that may wait to be written to a session beyond what is under way.
const WRITE_BYTES: usize = 4 << 20;

/// The answer to a request that is not encrypted where it has to be.
const NOT_ENCRYPTED: &[u8] =
    b"HTTP/1.1 400 Bad Request\r\ncontent-type: text/plain; charset=utf-8\r\nconnection: close\r\n\r\n\
    this server speaks https: put https:// before its address\n";

const HEADERS: &[(&str, &str)] = &[
    (
        "content-security-policy",
        "default-src 'self'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' blob: data:; object-src 'none'; \
         base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    ),
    ("x-content-type-options", "nosniff"),
    ("referrer-policy", "no-referrer"),
    ("x-frame-options", "DENY"),
    ("cache-control", "no-cache"),
    ("cross-origin-opener-policy", "same-origin"),
    ("cross-origin-resource-policy", "same-origin"),
];

/// Serves one connection until it ends, or has become a session.
pub(crate) async fn serve<I>(io: I, peer: SocketAddr, site: Arc<Site>)
where
    I: AsyncRead + AsyncWrite + Unpin + Send + 'static,
{
    let service = service_fn(|request| {
        let answer = answer(request, peer, &site);
        async move { Ok::<_, Infallible>(answer) }
    });
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HEAD_WITHIN)
        .max_buf_size(HEAD_BYTES)
        .serve_connection(TokioIo::new(io), service)
        .with_upgrades();
    // What goes wrong with a connection is its client's to see.
    let _ = tokio::time::timeout(CONNECTION_WITHIN, connection).await;
}

/// Serves one connection once it is encrypted.
pub(crate) async fn serve_encrypted(mut io: TcpStream, tls: &TlsAcceptor, peer: SocketAddr, site: Arc<Site>) {
    let begun = async {
        let mut first = [0];
        io.peek(&mut first).await?;
        if !first[0].is_ascii_uppercase() {
            return tls.accept(io).await.map(Some);
        }
        // A browser that was given http:// would show no more than a link that broke.
        io.write_all(NOT_ENCRYPTED).await?;
        io.shutdown().await?;
        // Until it has seen it: a request that nobody read would reset the connection before.
        tokio::io::copy(&mut io, &mut tokio::io::sink()).await?;
        Ok::<_, std::io::Error>(None)
    };
    if let Ok(Ok(Some(io))) = tokio::time::timeout(HEAD_WITHIN, begun).await {
        serve(io, peer, site).await;
    }
}

fn answer(request: Request<Incoming>, peer: SocketAddr, site: &Arc<Site>) -> Response<Full<Bytes>> {
    let headers = request.headers();
    let (host, origin) = (text(headers, &header::HOST), text(headers, &header::ORIGIN));
    let allowed = same_site(host, origin, site.scheme, site.listening, &site.access);
    let mut response = if request.uri().path() == "/ws" {
        upgrade(request, peer, site, allowed)
    } else if !allowed {
        plain(StatusCode::FORBIDDEN, "call this server by its number, or localhost")
    } else if ![Method::GET, Method::HEAD].contains(request.method()) {
        plain(StatusCode::METHOD_NOT_ALLOWED, "there is nothing to write to")
    } else {
        match assets::file(request.uri().path()) {
            Some((kind, content)) => {
                let mut response = Response::new(Full::new(Bytes::from_static(content)));
                response.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static(kind));
                response
            }
            None => plain(StatusCode::NOT_FOUND, "there is no such page"),
        }
    };
    for (name, value) in HEADERS {
        response.headers_mut().insert(HeaderName::from_static(name), HeaderValue::from_static(value));
    }
    response
}

fn plain(status: StatusCode, text: &'static str) -> Response<Full<Bytes>> {
    let mut response = Response::new(Full::new(Bytes::from_static(text.as_bytes())));
    *response.status_mut() = status;
    let kind = HeaderValue::from_static("text/plain; charset=utf-8");
    response.headers_mut().insert(header::CONTENT_TYPE, kind);
    response
}

fn text<'h>(headers: &'h HeaderMap, name: &HeaderName) -> Option<&'h str> {
    // Given twice, it is not known which one counts.
    let mut all = headers.get_all(name).iter();
    let first = all.next()?;
    if all.next().is_some() { Some("") } else { Some(first.to_str().unwrap_or("")) }
}

fn has_word(headers: &HeaderMap, name: &HeaderName, word: &str) -> bool {
    let values = headers.get_all(name).iter().filter_map(|value| value.to_str().ok());
    values.flat_map(|value| value.split(',')).any(|one| one.trim().eq_ignore_ascii_case(word))
}

/// Makes a session of a connection.
fn upgrade(
    mut request: Request<Incoming>,
    peer: SocketAddr,
    site: &Arc<Site>,
    allowed: bool,
) -> Response<Full<Bytes>> {
    let headers = request.headers();
    let key = text(headers, &header::SEC_WEBSOCKET_KEY).map(|key| derive_accept_key(key.as_bytes()));
    let asked = has_word(headers, &header::UPGRADE, "websocket")
        && has_word(headers, &header::CONNECTION, "upgrade")
        && text(headers, &header::SEC_WEBSOCKET_VERSION) == Some("13")
        && has_word(headers, &header::SEC_WEBSOCKET_PROTOCOL, PROTOCOL);
    let (Some(key), true, &Method::GET) = (key, asked, request.method()) else {
        return plain(StatusCode::BAD_REQUEST, "this is for WebSockets with the subprotocol uwscan.live.v1");
    };
    let Ok(key) = HeaderValue::from_str(&key) else {
        return plain(StatusCode::BAD_REQUEST, "this is no key");
    };
    let site = site.clone();
    let upgraded = hyper::upgrade::on(&mut request);
    tokio::spawn(async move {
        let Ok(upgraded) = upgraded.await else { return };
        let config = WebSocketConfig::default()
            .max_message_size(Some(MOST_BYTES))
            .max_frame_size(Some(MOST_BYTES))
            .max_write_buffer_size(WRITE_BYTES);
        let io = TokioIo::new(upgraded);
        let socket = WebSocketStream::from_raw_socket(io, Role::Server, Some(config)).await;
        session::run(socket, site, peer, allowed).await;
    });
    let mut response = Response::new(Full::default());
    *response.status_mut() = StatusCode::SWITCHING_PROTOCOLS;
    let headers = response.headers_mut();
    headers.insert(header::UPGRADE, HeaderValue::from_static("websocket"));
    headers.insert(header::CONNECTION, HeaderValue::from_static("upgrade"));
    headers.insert(header::SEC_WEBSOCKET_ACCEPT, key);
    headers.insert(header::SEC_WEBSOCKET_PROTOCOL, HeaderValue::from_static(PROTOCOL));
    response
}
