//! An identity provider's public keys, fetched by HTTP: the one thing that percept asks of somebody else.

use axum::http::{Request, StatusCode, Uri, header};
use bytes::BytesMut;
use http_body_util::{BodyExt, Empty};
use hyper::client::conn::http1;
use hyper_util::rt::TokioIo;
use percept_identity::{FetchKeys, JwtSettings, discovered_jwks_url, discovery_url};
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, ServerName};
use rustls::{ClientConfig, RootCertStore};
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;

/// A provider that answers later is taken for absent.
const TIMEOUT: Duration = Duration::from_secs(5);
/// More than any provider's keys take.
const MAX_BYTES: usize = 1 << 20;

/// Fetches the keys from where the settings say, or where the issuer says that they are.
pub(crate) fn keys(settings: &JwtSettings) -> FetchKeys {
    let settings = Arc::new(settings.clone());
    Arc::new(move || {
        let settings = Arc::clone(&settings);
        Box::pin(async move { fetched(&settings).await })
    })
}

async fn fetched(settings: &JwtSettings) -> Result<String, String> {
    if !settings.jwks_url.is_empty() {
        return get(&settings.jwks_url, &settings.ca_file).await;
    }
    let description = get(&discovery_url(&settings.issuer), &settings.ca_file).await?;
    let url = discovered_jwks_url(&settings.issuer, &description)?;
    if settings.issuer.starts_with("https://") && !url.starts_with("https://") {
        return Err(format!("the issuer's jwks_uri is {url:?}, which is not protected"));
    }
    get(&url, &settings.ca_file).await
}

/// What is at a URL. Redirections are not followed: they could lead anywhere.
async fn get(url: &str, ca_file: &str) -> Result<String, String> {
    let fetched = tokio::time::timeout(TIMEOUT, connected(url, ca_file)).await;
    let fetched = fetched.map_err(|_| format!("no answer within {} s", TIMEOUT.as_secs()));
    fetched.flatten().map_err(|e| format!("{url}: {e}"))
}

async fn connected(url: &str, ca_file: &str) -> Result<String, String> {
    let url: Uri = url.parse().map_err(|e| format!("it is no URL: {e}"))?;
    let host = url.host().ok_or("it names no host")?;
    let bare = host.trim_start_matches('[').trim_end_matches(']').to_owned();
    let encrypted = url.scheme_str() == Some("https");
    let port = url.port_u16().unwrap_or(if encrypted { 443 } else { 80 });
    let socket = TcpStream::connect((bare.as_str(), port)).await.map_err(|e| e.to_string())?;
    if !encrypted {
        return asked(&url, socket).await;
    }
    let config = client_config(ca_file)?;
    let name = ServerName::try_from(bare).map_err(|e| e.to_string())?;
    let socket = TlsConnector::from(Arc::new(config)).connect(name, socket).await.map_err(|e| e.to_string())?;
    asked(&url, socket).await
}

fn client_config(ca_file: &str) -> Result<ClientConfig, String> {
    let mut roots = RootCertStore::empty();
    if ca_file.is_empty() {
        let found = rustls_native_certs::load_native_certs();
        roots.add_parsable_certificates(found.certs);
    } else {
        let wrong = |e: String| format!("auth.jwt.ca_file {ca_file:?}: {e}");
        for certificate in CertificateDer::pem_file_iter(ca_file).map_err(|e| wrong(e.to_string()))? {
            let certificate = certificate.map_err(|e| wrong(e.to_string()))?;
            roots.add(certificate).map_err(|e| wrong(e.to_string()))?;
        }
    }
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let builder = ClientConfig::builder_with_provider(provider).with_safe_default_protocol_versions();
    Ok(builder.map_err(|e| e.to_string())?.with_root_certificates(roots).with_no_client_auth())
}

async fn asked<S: AsyncRead + AsyncWrite + Unpin + Send + 'static>(url: &Uri, socket: S) -> Result<String, String> {
    let (mut sender, connection) = http1::handshake(TokioIo::new(socket)).await.map_err(|e| e.to_string())?;
    // It ends with the socket, which ends with the sender.
    tokio::spawn(connection);
    let path = url.path_and_query().map_or("/", |p| p.as_str());
    let authority = url.authority().map(|a| a.as_str()).unwrap_or_default();
    let request = Request::get(path).header(header::HOST, authority).header(header::ACCEPT, "application/json");
    let request = request.body(Empty::<bytes::Bytes>::new()).map_err(|e| e.to_string())?;
    let answer = sender.send_request(request).await.map_err(|e| e.to_string())?;
    if answer.status() != StatusCode::OK {
        return Err(format!("the answer is {}", answer.status()));
    }
    let (mut body, mut all) = (answer.into_body(), BytesMut::new());
    while let Some(frame) = body.frame().await {
        let frame = frame.map_err(|e| e.to_string())?;
        let data = frame.into_data().unwrap_or_default();
        if all.len() + data.len() > MAX_BYTES {
            return Err(format!("the answer has more than {MAX_BYTES} bytes"));
        }
        all.extend_from_slice(&data);
    }
    String::from_utf8(all.to_vec()).map_err(|e| e.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::Router;
    use axum::response::Redirect;
    use axum::routing::get;
    use serde_json::json;

    /// A provider on this machine; its address.
    async fn provider() -> String {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let issuer = format!("http://{}", listener.local_addr().unwrap());
        let description = json!({"issuer": issuer, "jwks_uri": format!("{issuer}/keys")}).to_string();
        let app = Router::new()
            .route("/.well-known/openid-configuration", get(move || async move { description }))
            .route("/keys", get(|| async { "{\"keys\": []}" }))
            .route("/elsewhere", get(|| async { Redirect::temporary("/keys") }))
            .route("/much", get(|| async { "x".repeat(MAX_BYTES + 1) }));
        tokio::spawn(async move { axum::serve(listener, app).await });
        issuer
    }

    #[tokio::test]
    async fn keys_are_found_by_discovery_or_at_their_url() {
        let issuer = provider().await;
        let discovered = JwtSettings { issuer: issuer.clone(), ..JwtSettings::default() };
        assert_eq!(keys(&discovered)().await.unwrap(), "{\"keys\": []}");
        let told = JwtSettings { jwks_url: format!("{issuer}/keys"), ..discovered.clone() };
        assert_eq!(keys(&told)().await.unwrap(), "{\"keys\": []}");
        // It describes itself by another name than the one that was configured.
        let other = JwtSettings { issuer: format!("{issuer}/"), ..discovered };
        assert!(keys(&other)().await.unwrap_err().contains("of the issuer"));
    }

    #[tokio::test]
    async fn redirections_floods_and_absences_are_told() {
        let issuer = provider().await;
        let fails = async |path: &str| get_from(&format!("{issuer}{path}")).await.unwrap_err();
        assert!(fails("/elsewhere").await.contains("307"));
        assert!(fails("/absent").await.contains("404"));
        assert!(fails("/much").await.contains("more than"));
        assert!(get_from("http://127.0.0.1:1/").await.is_err());
    }

    async fn get_from(url: &str) -> Result<String, String> {
        super::get(url, "").await
    }
}
