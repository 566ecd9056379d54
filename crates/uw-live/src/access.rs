//! Who may watch and who may steer: tokens, the origin of a page, the name by which the server is called.

use std::net::{IpAddr, SocketAddr};

use rand::RngExt;
use subtle::ConstantTimeEq;

use crate::Error;

/// What a client may do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Rights {
    /// Watch.
    View,
    /// Watch and steer.
    Control,
}

impl Rights {
    /// As messages have it.
    pub fn name(self) -> &'static str {
        match self {
            Self::View => "view",
            Self::Control => "control",
        }
    }
}

/// A secret. It is not shown by `Debug`.
#[derive(Clone, PartialEq, Eq)]
pub struct Token(String);

/// Fewest characters of a token: 96 bits where they are random hexadecimal digits.
const LEAST: usize = 24;

impl Token {
    /// Of some text, without the white space around it.
    ///
    /// # Errors
    /// [`Error::WeakToken`] where it is short, or has what is no printable ASCII.
    pub fn new(text: &str) -> Result<Self, Error> {
        let text = text.trim();
        let got = text.bytes().filter(u8::is_ascii_graphic).count();
        if got < LEAST || got != text.len() {
            return Err(Error::WeakToken { least: LEAST, got });
        }
        Ok(Self(text.to_owned()))
    }

    /// 128 random bits.
    pub fn random() -> Self {
        Self(format!("{:032x}", rand::rng().random::<u128>()))
    }

    /// For whoever is to have it.
    pub fn reveal(&self) -> &str {
        &self.0
    }

    /// Whether that is it, in a time that depends on the length alone.
    fn is(&self, offered: &str) -> bool {
        self.0.as_bytes().ct_eq(offered.as_bytes()).into()
    }
}

impl std::fmt::Debug for Token {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Token(…)")
    }
}

/// What is asked of clients.
#[derive(Clone, Debug)]
pub enum Access {
    /// Nothing: whoever is on this machine may steer. Only on a loopback address.
    Local,
    /// One of two tokens.
    Tokens {
        /// To watch.
        view: Token,
        /// To steer.
        control: Token,
    },
}

impl Access {
    /// The rights that a token gives; `None`: none.
    pub fn rights(&self, offered: Option<&str>) -> Option<Rights> {
        match self {
            Self::Local => Some(Rights::Control),
            Self::Tokens { view, control } => {
                let offered = offered.unwrap_or_default();
                // Both are compared, whichever it is.
                match (control.is(offered), view.is(offered)) {
                    (true, _) => Some(Rights::Control),
                    (false, true) => Some(Rights::View),
                    (false, false) => None,
                }
            }
        }
    }
}

/// How a browser's address of the server begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scheme {
    /// Not encrypted.
    Http,
    /// Encrypted.
    Https,
}

impl Scheme {
    /// As addresses have it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Http => "http",
            Self::Https => "https",
        }
    }
}

/// Whether a request may come from the page that it says it comes from, by the name that it called the server.
///
/// A browser sends `Origin` with every WebSocket: it has to be the page of this very server, encrypted where that is: whoever sits on the way could make
/// another one up. And a server without tokens answers only to
/// its numbers and to `localhost`: to any other name a foreign page may have pointed the browser (DNS rebinding).
pub fn same_site(
    host: Option<&str>,
    origin: Option<&str>,
    scheme: Scheme,
    listening: SocketAddr,
    access: &Access,
) -> bool {
    let Some(host) = host else { return false };
    if matches!(access, Access::Local) && !is_local_name(host, listening.ip()) {
        return false;
    }
    let Some(origin) = origin else { return true };
    let called = origin.split_once("://").filter(|(by, _)| by.eq_ignore_ascii_case(scheme.name()));
    called.is_some_and(|(_, name)| name.eq_ignore_ascii_case(host))
}

fn is_local_name(host: &str, listening: IpAddr) -> bool {
    let name = match host.rsplit_once(':') {
        Some((name, port)) if port.bytes().all(|digit| digit.is_ascii_digit()) => name,
        _ => host,
    };
    let number = name.trim_start_matches('[').trim_end_matches(']').parse::<IpAddr>();
    name.eq_ignore_ascii_case("localhost")
        || number.is_ok_and(|number| number.is_loopback() || number == listening)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tokens_give_the_rights_that_they_are_for() {
        let access = Access::Tokens { view: Token::random(), control: Token::random() };
        let Access::Tokens { view, control } = &access else { unreachable!() };
        assert_eq!(access.rights(Some(view.reveal())), Some(Rights::View));
        assert_eq!(access.rights(Some(control.reveal())), Some(Rights::Control));
        let short = &control.reveal()[1..];
        for wrong in [None, Some(""), Some("x"), Some(short), Some(&format!("{}0", control.reveal())[..])] {
            assert_eq!(access.rights(wrong), None, "{wrong:?}");
        }
        assert!(!format!("{access:?}").contains(view.reveal()));
    }

    #[test]
    fn tokens_that_can_be_guessed_are_refused() {
        for weak in ["", "secret", "0123456789012345678901 x", "ÿÿÿÿÿÿÿÿÿÿÿÿÿÿÿÿÿÿÿÿÿÿÿÿÿÿ"]
        {
            assert!(matches!(Token::new(weak), Err(Error::WeakToken { .. })), "{weak}");
        }
        assert_eq!(Token::new(" 0123456789abcdef01234567\n").unwrap().reveal(), "0123456789abcdef01234567");
    }

    #[test]
    fn a_foreign_page_is_not_let_in() {
        let at = "127.0.0.1:8080".parse().unwrap();
        let local = |host, origin| same_site(host, origin, Scheme::Http, at, &Access::Local);
        assert!(local(Some("127.0.0.1:8080"), None));
        assert!(local(Some("localhost:8080"), Some("http://localhost:8080")));
        assert!(local(Some("[::1]:8080"), Some("http://[::1]:8080")));
        assert!(!local(Some("127.0.0.1:8080"), Some("http://evil.example")));
        assert!(!local(Some("127.0.0.1:8080"), Some("http://127.0.0.1:9090")));
        assert!(!local(Some("127.0.0.1:8080"), Some("null")));
        assert!(!local(None, None));
        // A name that somebody's name server resolved to this machine.
        assert!(!local(Some("evil.example:8080"), Some("http://evil.example:8080")));
        assert!(!local(Some("localhost.evil.example"), None));
        let access = Access::Tokens { view: Token::random(), control: Token::random() };
        let far = |host, origin| {
            same_site(Some(host), Some(origin), Scheme::Http, "10.0.0.2:80".parse().unwrap(), &access)
        };
        assert!(far("auv.local:80", "http://auv.local:80"));
        assert!(!far("auv.local:80", "http://evil.example"));
        // A page that came unencrypted is not this server's, whatever it says.
        let at = "10.0.0.2:443".parse().unwrap();
        let encrypted = |origin| same_site(Some("auv.local"), Some(origin), Scheme::Https, at, &access);
        assert!(encrypted("https://auv.local"));
        assert!(
            !encrypted("http://auv.local") && !encrypted("https://evil.example") && !encrypted("auv.local")
        );
        assert!(!far("auv.local:80", "https://auv.local:80"));
    }
}
