//! TLS of the doors: the server's certificate, read again when its files change, and who a client's certificate says
//! that it is.

use super::Protocol;
use crate::config;
use percept_service::observe;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use rustls::server::WebPkiClientVerifier;
use rustls::{RootCertStore, ServerConfig};
use std::net::SocketAddr;
use std::path::Path;
use std::sync::{Arc, PoisonError, RwLock};
use std::time::{Duration, SystemTime};
use tokio::net::TcpStream;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::server::TlsStream;
use x509_parser::prelude::{ASN1Time, FromDer, GeneralName, X509Certificate};

/// How often the files are looked at.
pub(crate) const LOOK: Duration = Duration::from_secs(5);

/// Who is at the other end of a connection; goes with every request's extensions.
#[derive(Debug, Clone)]
pub(crate) struct PeerIdentity {
    /// Where it connected from.
    pub(crate) address: SocketAddr,
    /// Its certificate, verified by one of the configured authorities; none if it showed none.
    pub(crate) certificate: Option<Arc<ClientCertificate>>,
}

/// Names in a verified certificate.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct ClientCertificate {
    /// Common name of the subject.
    pub(crate) common_name: Option<String>,
    /// Subject alternative names: DNS.
    pub(crate) dns_names: Vec<String>,
    /// Subject alternative names: URIs.
    pub(crate) uris: Vec<String>,
    /// When it ends, seconds since the Unix epoch.
    pub(crate) expires_s: Option<u64>,
}

type Failure = Box<dyn std::error::Error + Send + Sync>;
/// For HTTP/1 and for HTTP/2.
type Configs = [Arc<ServerConfig>; 2];
/// The server's certificate and those between it and its authority.
type Chain = Vec<CertificateDer<'static>>;

/// The server's side of TLS.
pub(crate) struct Tls {
    files: config::Tls,
    current: RwLock<Configs>,
}

impl Tls {
    /// Reads the files.
    ///
    /// # Errors
    /// Naming field, file and what is wrong with it.
    pub(crate) fn open(files: &config::Tls) -> Result<Arc<Self>, Failure> {
        let (configs, chain) = configs(files)?;
        tell(&chain);
        Ok(Arc::new(Self { files: files.clone(), current: RwLock::new(configs) }))
    }

    /// Reads the files again. Files that are wrong leave what was in force.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub(crate) fn reload(&self) -> Result<(), Failure> {
        let (new, chain) = configs(&self.files)?;
        *self.current.write().unwrap_or_else(PoisonError::into_inner) = new;
        tell(&chain);
        Ok(())
    }

    /// Reads the files again whenever they have changed; never ends.
    pub(crate) async fn follow(&self) {
        let mut seen = self.stamps();
        loop {
            tokio::time::sleep(LOOK).await;
            let now = self.stamps();
            if now != seen {
                // Files are replaced one after the other: a pair that does not fit is read again at the next look.
                match self.reload() {
                    Ok(()) => seen = now,
                    Err(error) => tracing::warn!(%error, "changed certificates are not used"),
                }
            }
        }
    }

    fn stamps(&self) -> Stamps {
        stamps(&[&self.files.cert_file, &self.files.key_file, &self.files.client_ca_file])
    }

    /// Agrees on keys with a client.
    pub(super) async fn accept(
        &self,
        socket: TcpStream,
        protocol: Protocol,
    ) -> std::io::Result<(TlsStream<TcpStream>, Option<Arc<ClientCertificate>>)> {
        let config = {
            let [rest, grpc] = &*self.current.read().unwrap_or_else(PoisonError::into_inner);
            Arc::clone(if protocol == Protocol::Rest { rest } else { grpc })
        };
        let stream = TlsAcceptor::from(config).accept(socket).await?;
        let shown = stream.get_ref().1.peer_certificates().and_then(<[_]>::first);
        let certificate = shown.map(names).transpose()?.map(Arc::new);
        Ok((stream, certificate))
    }
}

/// When files were written last; none of those that are not there.
pub(crate) type Stamps = Vec<Option<SystemTime>>;

pub(crate) fn stamps(files: &[&Path]) -> Stamps {
    files.iter().map(|f| std::fs::metadata(f).and_then(|m| m.modified()).ok()).collect()
}

/// Whether the files hold what the doors need.
///
/// # Errors
/// As [`Tls::open`].
pub(crate) fn check(files: &config::Tls) -> Result<(), Failure> {
    configs(files).map(|_| ())
}

/// Says whose certificates are used from now on, and until when. One that does not hold now is used all the same, and warned
/// of: the server's clock may be the one that is wrong.
fn tell(chain: &Chain) {
    let (now, mut first_end) = (ASN1Time::now(), None);
    for certificate in chain {
        let Ok((_, parsed)) = X509Certificate::from_der(certificate) else {
            tracing::warn!("a certificate of tls.cert_file cannot be read: how long it holds is not known");
            continue;
        };
        let (subject, holds) = (parsed.subject().to_string(), parsed.validity());
        let (from, until) = (holds.not_before, holds.not_after);
        if until < now {
            tracing::warn!(subject, %until, "this certificate of tls.cert_file has expired, clients refuse it: renew it");
        } else if now < from {
            let words = "this certificate of tls.cert_file is not valid yet, clients refuse it: look at the clock, or give another";
            tracing::warn!(subject, %from, "{words}");
        } else {
            tracing::info!(subject, %until, "a certificate of tls.cert_file is in force");
        }
        first_end = first_end.into_iter().chain([until.timestamp()]).min();
    }
    first_end.into_iter().for_each(observe::certificate_expiry);
}

/// For HTTP/1 and for HTTP/2, with the certificates in them.
fn configs(files: &config::Tls) -> Result<(Configs, Chain), Failure> {
    let chain = certificates("tls.cert_file", &files.cert_file)?;
    let key = PrivateKeyDer::from_pem_file(&files.key_file).map_err(|e| wrong("tls.key_file", &files.key_file, e))?;
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let builder = ServerConfig::builder_with_provider(Arc::clone(&provider)).with_safe_default_protocol_versions()?;
    let builder = if files.client_ca_file.as_os_str().is_empty() {
        builder.with_no_client_auth()
    } else {
        let mut roots = RootCertStore::empty();
        for authority in certificates("tls.client_ca_file", &files.client_ca_file)? {
            roots.add(authority).map_err(|e| wrong("tls.client_ca_file", &files.client_ca_file, e))?;
        }
        let verifier = WebPkiClientVerifier::builder_with_provider(Arc::new(roots), provider);
        let verifier = if files.client_cert_required { verifier } else { verifier.allow_unauthenticated() };
        builder.with_client_cert_verifier(verifier.build()?)
    };
    let rest = builder.with_single_cert(chain.clone(), key).map_err(|e| wrong("tls.key_file", &files.key_file, e))?;
    let speaking = |protocol: &[u8]| {
        let mut config = rest.clone();
        config.alpn_protocols = vec![protocol.to_vec()];
        Arc::new(config)
    };
    Ok(([speaking(b"http/1.1"), speaking(b"h2")], chain))
}

fn certificates(field: &str, path: &Path) -> Result<Chain, Failure> {
    let read: Result<Vec<_>, _> = CertificateDer::pem_file_iter(path).and_then(Iterator::collect);
    let certificates = read.map_err(|e| wrong(field, path, e))?;
    if certificates.is_empty() {
        return Err(wrong(field, path, "it holds no certificate"));
    }
    Ok(certificates)
}

fn wrong(field: &str, path: &Path, problem: impl std::fmt::Display) -> Failure {
    format!("{field} is {}, which cannot be used: {problem}; give a PEM file", path.display()).into()
}

/// The names of a certificate; that it is valid was checked before.
fn names(certificate: &CertificateDer<'_>) -> std::io::Result<ClientCertificate> {
    let invalid = |e: String| std::io::Error::new(std::io::ErrorKind::InvalidData, e);
    let (_, parsed) = X509Certificate::from_der(certificate).map_err(|e| invalid(e.to_string()))?;
    let common_name = parsed.subject().iter_common_name().next().and_then(|n| n.as_str().ok()).map(str::to_owned);
    // One from before 1970 has ended, too.
    let expires_s = Some(u64::try_from(parsed.validity().not_after.timestamp()).unwrap_or_default());
    let mut out = ClientCertificate { common_name, dns_names: vec![], uris: vec![], expires_s };
    let alternative = parsed.subject_alternative_name().map_err(|e| invalid(e.to_string()))?;
    for name in alternative.iter().flat_map(|n| &n.value.general_names) {
        match name {
            GeneralName::DNSName(name) => out.dns_names.push((*name).to_owned()),
            GeneralName::URI(uri) => out.uris.push((*uri).to_owned()),
            _ => {}
        }
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rcgen::{CertificateParams, DnType, KeyPair, SanType};

    #[test]
    fn names_are_read_from_the_certificate() {
        let mut params = CertificateParams::new(vec!["robot-7.site.example".to_owned()]).unwrap();
        params.distinguished_name.push(DnType::CommonName, "robot-7");
        params.subject_alt_names.push(SanType::URI("spiffe://site/robot/7".try_into().unwrap()));
        let certificate = params.self_signed(&KeyPair::generate().unwrap()).unwrap();
        let expected = ClientCertificate {
            common_name: Some("robot-7".to_owned()),
            dns_names: vec!["robot-7.site.example".to_owned()],
            uris: vec!["spiffe://site/robot/7".to_owned()],
            // rcgen's own: the first second of the year 4096.
            expires_s: Some(67_090_118_400),
        };
        assert_eq!(names(certificate.der()).unwrap(), expected);
        assert!(names(&CertificateDer::from(vec![1, 2, 3])).is_err());
    }

    #[test]
    fn files_that_are_wrong_leave_what_was_in_force() {
        let dir = tempfile::tempdir().unwrap();
        let (cert_file, key_file) = (dir.path().join("cert.pem"), dir.path().join("key.pem"));
        let write = || {
            let key = KeyPair::generate().unwrap();
            let cert = CertificateParams::new(vec!["localhost".to_owned()]).unwrap().self_signed(&key).unwrap();
            std::fs::write(&cert_file, cert.pem()).unwrap();
            std::fs::write(&key_file, key.serialize_pem()).unwrap();
        };
        write();
        let tls = Tls::open(&config::Tls {
            cert_file: cert_file.clone(),
            key_file: key_file.clone(),
            ..config::Tls::default()
        })
        .unwrap();
        let in_force = || Arc::as_ptr(&tls.current.read().unwrap()[0]);
        let first = in_force();
        std::fs::write(&cert_file, "no certificate").unwrap();
        let complaint = tls.reload().unwrap_err().to_string();
        assert!(complaint.contains("tls.cert_file") && complaint.contains("cert.pem"), "{complaint}");
        assert_eq!(in_force(), first);
        write();
        tls.reload().unwrap();
        assert_ne!(in_force(), first);
    }
}
