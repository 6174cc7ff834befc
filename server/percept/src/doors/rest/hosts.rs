//! Which names the door answers to, so that a page of elsewhere cannot reach it through a browser: neither by making its
//! own name point here (DNS rebinding), nor by asking across origins.

use super::refused::Refused;
use axum::http::request::Parts;
use axum::http::uri::Authority;
use axum::http::{Method, StatusCode, header};
use percept_service::reason;
use std::net::{IpAddr, SocketAddr};

/// Paths that machines ask by whatever name; they tell nothing.
const ANY_NAME: [&str; 3] = ["/livez", "/readyz", "/healthz"];

/// Ends of paths by which somebody goes on watching. To a WebSocket a browser lets any page connect.
const WATCHES: [&str; 2] = ["/events", "/foxglove"];

/// The names.
#[derive(Debug, Clone)]
pub(super) struct Hosts {
    bound: IpAddr,
    allowed: Vec<String>,
}

impl Hosts {
    /// The address bound, localhost where that is loopback, and what was configured.
    pub(super) fn new(bound: SocketAddr, allowed: &[String]) -> Self {
        let allowed = allowed.iter().map(|name| name.to_ascii_lowercase()).collect();
        Self { bound: bound.ip().to_canonical(), allowed }
    }

    /// Lets a request pass whose host is one of ours and whose origin, if it changes or watches something, is that host.
    ///
    /// # Errors
    /// `HOST_UNKNOWN` (421), `ORIGIN_FORBIDDEN` (403).
    pub(super) fn check(&self, parts: &Parts) -> Result<(), Refused> {
        let path = parts.uri.path();
        if ANY_NAME.contains(&path) {
            return Ok(());
        }
        let text = |name| parts.headers.get(name).map(|v: &header::HeaderValue| v.to_str().unwrap_or_default());
        let host = parts.uri.authority().map(Authority::as_str).or_else(|| text(header::HOST)).unwrap_or_default();
        if !self.is_ours(host) {
            let shown: String = host.chars().take(200).collect();
            let message = format!("host is {shown:?}; use the server's address, or add it to listen.allowed_hosts");
            return Err(Refused::http(StatusCode::MISDIRECTED_REQUEST, reason::HOST_UNKNOWN, message));
        }
        let acts = !matches!(parts.method, Method::GET | Method::HEAD | Method::OPTIONS)
            || WATCHES.iter().any(|end| path.ends_with(end));
        match text(header::ORIGIN) {
            Some(origin) if acts && !self.is_origin(origin, host) => {
                let shown: String = origin.chars().take(200).collect();
                let message = format!(
                    "origin is {shown:?} but the host is {host:?}; add the origin's host to listen.allowed_hosts"
                );
                Err(Refused::http(StatusCode::FORBIDDEN, reason::ORIGIN_FORBIDDEN, message))
            }
            _ => Ok(()),
        }
    }

    fn is_ours(&self, host: &str) -> bool {
        if self.is_listed(host) {
            return true;
        }
        let Ok(authority) = host.parse::<Authority>() else { return false };
        let name = authority.host().trim_start_matches('[').trim_end_matches(']');
        match name.parse::<IpAddr>().map(|ip| ip.to_canonical()) {
            // An address is nobody's to point elsewhere.
            Ok(ip) => self.bound.is_unspecified() || ip == self.bound || (ip.is_loopback() && self.bound.is_loopback()),
            Err(_) => {
                name.eq_ignore_ascii_case("localhost") && (self.bound.is_loopback() || self.bound.is_unspecified())
            }
        }
    }

    fn is_listed(&self, host: &str) -> bool {
        let host = host.to_ascii_lowercase();
        let name = host.rsplit_once(':').filter(|(_, port)| port.bytes().all(|b| b.is_ascii_digit())).map(|(n, _)| n);
        self.allowed.iter().any(|entry| entry == "*" || *entry == host || Some(entry.as_str()) == name)
    }

    fn is_origin(&self, origin: &str, host: &str) -> bool {
        let Some((_, authority)) = origin.split_once("://") else { return false };
        authority.eq_ignore_ascii_case(host) || self.is_listed(authority)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::extract::Request;
    use axum::response::IntoResponse;

    fn status(bound: &str, allowed: &[&str], request: &[(&str, &str)], method: &str, path: &str) -> u16 {
        let allowed: Vec<String> = allowed.iter().map(|&a| a.to_owned()).collect();
        let hosts = Hosts::new(bound.parse().unwrap(), &allowed);
        let mut builder = Request::builder().method(method).uri(path);
        for (name, value) in request {
            builder = builder.header(*name, *value);
        }
        let (parts, ()) = builder.body(()).unwrap().into_parts();
        hosts.check(&parts).map_or_else(|refused| refused.into_response().status().as_u16(), |()| 200)
    }

    fn asked(bound: &str, allowed: &[&str], host: &str) -> u16 {
        status(bound, allowed, &[("host", host)], "GET", "/v1/sessions")
    }

    #[test]
    fn names_of_others_are_misdirected() {
        let local = "127.0.0.1:8080";
        for host in ["127.0.0.1:8080", "localhost:8080", "LOCALHOST", "[::1]:9", "127.0.0.1:1"] {
            assert_eq!(asked(local, &[], host), 200, "{host}");
        }
        for host in
            ["evil.example", "evil.example:8080", "localhost.evil.example", "10.0.0.1", "", "a b", "127.0.0.1.nip.io"]
        {
            assert_eq!(asked(local, &[], host), 421, "{host}");
        }
        assert_eq!(asked("10.0.0.5:8080", &[], "10.0.0.5:8080"), 200);
        assert_eq!(asked("10.0.0.5:8080", &[], "localhost:8080"), 421);
        assert_eq!(asked("0.0.0.0:8080", &[], "192.168.1.7:8080"), 200, "an address cannot be rebound");
        assert_eq!(asked("0.0.0.0:8080", &[], "percept:8080"), 421);
    }

    #[test]
    fn names_are_allowed_with_a_port_or_for_any() {
        let any = "0.0.0.0:8080";
        assert_eq!(asked(any, &["percept.example"], "Percept.Example:8080"), 200);
        assert_eq!(asked(any, &["percept.example:8080"], "percept.example:8080"), 200);
        assert_eq!(asked(any, &["percept.example:8080"], "percept.example:81"), 421);
        assert_eq!(asked(any, &["percept.example"], "percept.example.evil"), 421);
        assert_eq!(asked(any, &["*"], "whatever:1"), 200);
    }

    #[test]
    fn pages_of_other_origins_neither_change_nor_watch() {
        let from = |origin, method, path| {
            let headers = [("host", "localhost:8080"), ("origin", origin)];
            status("127.0.0.1:8080", &["map.example"], &headers, method, path)
        };
        assert_eq!(from("http://localhost:8080", "POST", "/v1/sessions"), 200);
        assert_eq!(from("https://map.example", "POST", "/v1/sessions"), 200);
        for origin in ["http://evil.example", "null", "http://localhost:3000", ""] {
            assert_eq!(from(origin, "POST", "/v1/sessions"), 403, "{origin}");
            assert_eq!(from(origin, "DELETE", "/v1/sessions/a"), 403, "{origin}");
            assert_eq!(from(origin, "GET", "/v1/sessions/a/events"), 403, "{origin}");
            assert_eq!(from(origin, "GET", "/v1/sessions/a/foxglove"), 403, "{origin}");
            assert_eq!(from(origin, "GET", "/v1/sessions"), 200, "without a word from us the page cannot read it");
        }
    }

    #[test]
    fn probes_ask_by_any_name() {
        assert_eq!(status("127.0.0.1:8080", &[], &[("host", "pod-7")], "GET", "/livez"), 200);
    }
}
