//! Where a live server listens, and to whom, as arguments.

use std::{
    net::{IpAddr, Ipv4Addr, SocketAddr},
    path::{Path, PathBuf},
};

use anyhow::Context;
use uwscan::{
    live::{Access, Feed, Options, Server, Tls, Token},
    pipeline::live::Requests,
};

use crate::console::Console;

/// The live server's options.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Live options")]
pub struct Listening {
    /// Stream for Foxglove, Lichtblick and foxglove-sdk at this address of this machine, or none ("off") [default: the next port]
    #[arg(long, value_name = "ADDR", value_parser = stream)]
    foxglove: Option<Stream>,
    /// File with the token that lets a client watch [default: UWSCAN_VIEW_TOKEN, else one made at random, which is printed]
    #[arg(long, value_name = "FILE")]
    view_token_file: Option<PathBuf>,
    /// File with the token that lets a client steer, too [default: UWSCAN_CONTROL_TOKEN, else one made at random, which is printed]
    #[arg(long, value_name = "FILE")]
    control_token_file: Option<PathBuf>,
    /// Encrypt the page and its socket (https) with this certificate, a PEM file
    #[arg(long, value_name = "FILE", requires = "tls_key")]
    tls_cert: Option<PathBuf>,
    /// The certificate's private key, a PEM file
    #[arg(long, value_name = "FILE", requires = "tls_cert")]
    tls_key: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stream {
    Off,
    At(SocketAddr),
}

/// A server that runs.
pub struct Live {
    pub server: Server,
    pub feed: Feed,
    pub asked: Requests,
}

/// An address to listen on: with a port, or the port alone for this machine only.
pub fn address(text: &str) -> Result<SocketAddr, String> {
    let text = text.trim();
    if let Ok(port) = text.strip_prefix(':').unwrap_or(text).parse() {
        return Ok(SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), port));
    }
    let text = text.strip_prefix("localhost:").map_or(text.to_owned(), |port| format!("127.0.0.1:{port}"));
    text.parse().map_err(|_| "give an address and a port, such as 127.0.0.1:8764 or 0.0.0.0:8764".to_owned())
}

fn stream(text: &str) -> Result<Stream, String> {
    if text.eq_ignore_ascii_case("off") { Ok(Stream::Off) } else { address(text).map(Stream::At) }
}

impl Listening {
    /// Whether any of them is given.
    pub fn is_given(&self) -> bool {
        let files = [&self.view_token_file, &self.control_token_file, &self.tls_cert, &self.tls_key];
        self.foxglove.is_some() || files.into_iter().any(Option::is_some)
    }

    /// Listens at an address.
    ///
    /// # Errors
    /// It can't be had, a token can't be read or is too weak, or a certificate can't be used.
    pub fn start(&self, listen: SocketAddr, console: &Console) -> anyhow::Result<Live> {
        let tls = match (&self.tls_cert, &self.tls_key) {
            (Some(certificate), Some(key)) => Some(Tls::read(certificate, key)?),
            _ => None,
        };
        let access = self.access(listen, console)?;
        let next = SocketAddr::new(
            IpAddr::V4(Ipv4Addr::LOCALHOST),
            if listen.port() == 0 { 0 } else { listen.port().saturating_add(1) },
        );
        let start =
            |foxglove| Server::start(Options { listen, access: access.clone(), tls: tls.clone(), foxglove });
        let started = match self.foxglove {
            Some(Stream::Off) => start(None),
            Some(Stream::At(at)) => start(Some(at)),
            None => {
                match start(Some(next)) {
                    // Nobody asked for it at that port.
                    Err(error @ uwscan::live::Error::Foxglove { .. }) => {
                        console.warn(format_args!("no stream for Foxglove: {error} (--foxglove ADDR)"));
                        start(None)
                    }
                    started => started,
                }
            }
        };
        let (server, feed, asked) = started?;
        console.line(format_args!("live: {}://{}/", server.scheme().name(), server.listening()));
        if let Some(at) = server.foxglove() {
            console.line(format_args!("live: ws://{at} for Foxglove, on this machine alone"));
        }
        Ok(Live { server, feed, asked })
    }

    /// What is asked of clients: nothing on this machine, unless tokens are given.
    fn access(&self, listen: SocketAddr, console: &Console) -> anyhow::Result<Access> {
        let view = token(self.view_token_file.as_deref(), "UWSCAN_VIEW_TOKEN")?;
        let control = token(self.control_token_file.as_deref(), "UWSCAN_CONTROL_TOKEN")?;
        if listen.ip().is_loopback() && view.is_none() && control.is_none() {
            return Ok(Access::Local);
        }
        let made = |given: Option<Token>, what: &str| {
            given.unwrap_or_else(|| {
                let token = Token::random();
                console.line(format_args!("live: token to {what}: {}", token.reveal()));
                token
            })
        };
        Ok(Access::Tokens { view: made(view, "watch"), control: made(control, "steer") })
    }
}

/// The token of a file, or of the environment.
fn token(file: Option<&Path>, variable: &str) -> anyhow::Result<Option<Token>> {
    if let Some(path) = file {
        let text = std::fs::read_to_string(path).map_err(uwscan::io::Error::file(path, "read"))?;
        return Ok(Some(Token::new(&text).with_context(|| path.display().to_string())?));
    }
    match std::env::var(variable) {
        Ok(text) => Ok(Some(Token::new(&text).with_context(|| variable.to_owned())?)),
        Err(std::env::VarError::NotPresent) => Ok(None),
        Err(error) => Err(error).with_context(|| variable.to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_may_be_a_port_alone() {
        let of = |text: &str| address(text).map(|address| address.to_string());
        for text in ["8764", ":8764", "127.0.0.1:8764", "localhost:8764"] {
            assert_eq!(of(text).as_deref(), Ok("127.0.0.1:8764"), "{text}");
        }
        assert_eq!(of("0.0.0.0:1").as_deref(), Ok("0.0.0.0:1"));
        assert_eq!(of("[::1]:1").as_deref(), Ok("[::1]:1"));
        for bad in ["", "x", "70000", "1.2.3.4", "auv.local:80"] {
            assert!(of(bad).is_err(), "{bad}");
        }
        assert_eq!(stream("off"), Ok(Stream::Off));
    }
}
