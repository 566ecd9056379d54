//! Certificates: what a server shows so that the link to it is encrypted, and its clients know which one it is.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::{Error as PemError, PemObject};
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::rustls::version::TLS13;
use tokio_rustls::rustls::{Error as RustlsError, ServerConfig};

use crate::Error;

/// A certificate and its key. The key is not shown by `Debug`.
#[derive(Clone)]
pub struct Tls(Arc<ServerConfig>);

/// What is wrong with a certificate's or a key's file, and how to mend it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TlsFault {
    /// The file can't be read.
    #[error("cannot be read: {0}; give a PEM file")]
    Unread(std::io::Error),
    /// It has lines of PEM that are none.
    #[error("is no PEM file, or a damaged one: {0}; make it anew")]
    Malformed(String),
    /// There is no certificate in it.
    #[error(
        "has no certificate: give the PEM file with BEGIN CERTIFICATE, the server's own first, then those that vouch for it"
    )]
    NoCertificate,
    /// There is no key in it that can be used.
    #[error(
        "has no private key: give the PEM file with BEGIN PRIVATE KEY; one under a passphrase has to be written without it"
    )]
    NoKey,
    /// It can't be understood, or is of a kind that is not served with.
    #[error("cannot be served with: {0}; make the two anew, with an ECDSA P-256, Ed25519 or RSA key")]
    Unusable(String),
    /// The key is another certificate's.
    #[error("is not the key of the certificate in {certificate}: give the two that were made together")]
    Mismatch {
        /// The certificate's file.
        certificate: PathBuf,
    },
}

impl std::fmt::Debug for Tls {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Tls(…)")
    }
}

impl Tls {
    /// Of two PEM files: a certificate, with those that vouch for it if there are any, and its key. Whether it has run out is for clients to see.
    ///
    /// # Errors
    /// [`Error::Tls`] with the file that is at fault.
    pub fn read(certificate: &Path, key: &Path) -> Result<Self, Error> {
        let at = |file: &Path| {
            let file = file.to_owned();
            move |fault| Error::Tls { file, fault }
        };
        let text = std::fs::read(certificate).map_err(TlsFault::Unread).map_err(at(certificate))?;
        let chain: Result<Vec<CertificateDer<'static>>, PemError> =
            CertificateDer::pem_slice_iter(&text).collect();
        let chain = chain.map_err(|error| TlsFault::Malformed(error.to_string())).map_err(at(certificate))?;
        if chain.is_empty() {
            return Err(at(certificate)(TlsFault::NoCertificate));
        }
        let text = std::fs::read(key).map_err(TlsFault::Unread).map_err(at(key))?;
        let secret = match PrivateKeyDer::from_pem_slice(&text) {
            Ok(secret) => secret,
            Err(PemError::NoItemsFound) => return Err(at(key)(TlsFault::NoKey)),
            Err(error) => return Err(at(key)(TlsFault::Malformed(error.to_string()))),
        };
        let provider = Arc::new(ring::default_provider());
        // A key that ring can't use is the key's fault; what is said after that is the certificate's.
        if let Err(error) = provider.key_provider.load_private_key(secret.clone_key()) {
            return Err(at(key)(TlsFault::Unusable(error.to_string())));
        }
        let config = ServerConfig::builder_with_provider(provider)
            .with_protocol_versions(&[&TLS13])
            .and_then(|builder| builder.with_no_client_auth().with_single_cert(chain, secret));
        let mut config = config.map_err(|error| match error {
            RustlsError::InconsistentKeys(_) => {
                at(key)(TlsFault::Mismatch { certificate: certificate.to_owned() })
            }
            error => at(certificate)(TlsFault::Unusable(error.to_string())),
        })?;
        config.alpn_protocols = vec![b"http/1.1".to_vec()];
        Ok(Self(Arc::new(config)))
    }

    pub(crate) fn acceptor(&self) -> TlsAcceptor {
        self.0.clone().into()
    }
}
