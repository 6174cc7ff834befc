//! Who calls, for gRPC and REST alike: header and certificate become a [`CallContext`] among the request's extensions.
//!
//! A call without credentials that hold is refused here, before its body is read, unless its path is open. A handler
//! cannot forget to ask: without the context it gets no operation of the service.

use super::listener::{ClientCertificate, PeerIdentity};
use super::status;
use axum::body::{Body, HttpBody};
use axum::extract::Request;
use axum::http::request::Parts;
use axum::http::{Extensions, HeaderMap, HeaderValue, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use percept_identity::{
    Access, AuthMode, Authenticator, CertificateNames, Credentials, Principal, bearer, now_s, random_token,
};
use percept_service::reason;
use percept_service::{CallContext, Error, ErrorCode, caller::audit, observe};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Paths of health and of pages that hold nothing but themselves.
const OPEN: [&str; 5] = ["/", "/healthz", "/livez", "/readyz", "/favicon.ico"];
const OPEN_SERVICE: &str = "/grpc.health.v1.Health/";
/// Open where `auth.open_documents` says so.
const DOCUMENTS: [&str; 3] = ["/docs", "/openapi.json", "/reasons"];
const REFLECTION: &str = "/grpc.reflection.";
const METRICS: &str = "/metrics";
/// A session as Foxglove opens it. There the key may be in the query as RFC 6750, section 2.3, has it: Foxglove sends no headers.
const FOXGLOVE: (&str, &str) = ("/v1/sessions/", "/foxglove");
const ACCESS_TOKEN: &str = "access_token=";

/// How a door says no.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Door {
    Grpc,
    Rest,
}

/// Tells who calls.
#[derive(Clone)]
pub(crate) struct Gate {
    authenticator: Arc<Authenticator>,
}

impl Gate {
    pub(crate) fn new(authenticator: Arc<Authenticator>) -> Self {
        Self { authenticator }
    }

    /// Lets a request of an open path, or of somebody who is known, on to the door.
    pub(crate) async fn admit(self, door: Door, request: Request, next: Next) -> Response {
        let (mut parts, body) = request.into_parts();
        match self.identified(&parts).await {
            Ok(context) => {
                parts.extensions.insert(context);
            }
            Err(error) if !self.is_open(parts.uri.path()) => return refused(door, error, &body),
            Err(_) => {}
        }
        if parts.uri.path() == METRICS
            && let Err(error) = self.may_read_metrics(&parts.extensions)
        {
            return refused(door, error, &body);
        }
        next.run(Request::from_parts(parts, body)).await
    }

    fn is_open(&self, path: &str) -> bool {
        let settings = self.authenticator.settings();
        OPEN.contains(&path)
            || path.starts_with(OPEN_SERVICE)
            || (settings.open_documents && (DOCUMENTS.contains(&path) || path.starts_with(REFLECTION)))
            || (settings.open_metrics && path == METRICS)
    }

    /// They sum up what all tenants do.
    fn may_read_metrics(&self, extensions: &Extensions) -> Result<(), Error> {
        if self.authenticator.settings().open_metrics {
            return Ok(());
        }
        if context(extensions)?.principal.may_everywhere(Access::Admin) {
            return Ok(());
        }
        let words = "metrics need admin access to every session; ask for a key that has it, or set auth.open_metrics";
        Err(Error::new(ErrorCode::PermissionDenied, reason::PERMISSION_DENIED, words))
    }

    async fn identified(&self, parts: &Parts) -> Result<CallContext, Error> {
        let (peer, certificate) = peer(&parts.extensions);
        let trace = trace()?;
        match self.principal(parts, certificate).await {
            Ok(principal) => Ok(CallContext { principal, deadline: deadline(&parts.headers), trace, peer }),
            Err(refusal) => {
                // Probes and browsers ask for open paths without credentials all the time.
                let is_open = self.is_open(parts.uri.path());
                if !is_open {
                    audit::unauthenticated(&refusal, parts.uri.path(), &peer, &trace);
                }
                let error = Error::from(refusal);
                if !is_open {
                    observe::login_refused(error.reason);
                }
                Err(error)
            }
        }
    }

    async fn principal(
        &self,
        parts: &Parts,
        certificate: Option<CertificateNames>,
    ) -> Result<Arc<Principal>, percept_identity::Refusal> {
        if self.authenticator.settings().mode == AuthMode::None {
            // Nobody is asked, so that nothing said can be wrong.
            return self.authenticator.authenticate(&Credentials::default(), now_s()).await;
        }
        let mut values = parts.headers.get_all(header::AUTHORIZATION).iter();
        let token = match (values.next(), values.next(), in_query(parts)) {
            (None, _, None) => None,
            (None, _, Some(key)) => Some(bearer(format!("Bearer {key}").as_bytes())?),
            (Some(value), None, None) => Some(bearer(value.as_bytes())?),
            // Which of two is meant, whoever stands before this server may see otherwise.
            _ => Some(bearer(b"")?),
        };
        self.authenticator.authenticate(&Credentials { token, certificate }, now_s()).await
    }
}

/// The key that a query has, where one may be there.
fn in_query(parts: &Parts) -> Option<&str> {
    let (before, after) = FOXGLOVE;
    let session = parts.uri.path().strip_prefix(before).and_then(|rest| rest.strip_suffix(after));
    let query = parts.uri.query().filter(|_| session.is_some_and(|id| !id.is_empty() && !id.contains('/')))?;
    query.split('&').find_map(|pair| pair.strip_prefix(ACCESS_TOKEN))
}

/// In whose name a request is made.
///
/// # Errors
/// `INTERNAL` if the door has not asked.
pub(crate) fn context(extensions: &Extensions) -> Result<CallContext, Error> {
    extensions.get::<CallContext>().cloned().ok_or_else(|| Error::internal("a request that nobody has identified"))
}

/// Where a request came from, and the names in its certificate.
fn peer(extensions: &Extensions) -> (String, Option<CertificateNames>) {
    let Some(identity) = extensions.get::<PeerIdentity>() else { return (String::new(), None) };
    let names = |c: &ClientCertificate| CertificateNames {
        common_name: c.common_name.clone(),
        dns: c.dns_names.clone(),
        uris: c.uris.clone(),
        expires_s: c.expires_s,
    };
    (identity.address.to_string(), identity.certificate.as_deref().map(names))
}

/// The request's trace, as errors and the log name it.
fn trace() -> Result<String, Error> {
    match percept_service::trace::current() {
        Some(context) => Ok(context.trace_id_hex()),
        None => random_token().map_err(Error::internal),
    }
}

/// Until when a gRPC caller waits.
fn deadline(headers: &HeaderMap) -> Option<Instant> {
    let text = headers.get("grpc-timeout")?.to_str().ok()?;
    let (digits, unit) = text.split_at_checked(text.len().checked_sub(1)?)?;
    let count: u64 = digits.parse().ok().filter(|_| digits.len() <= 8)?;
    let timeout = match unit {
        "H" => Duration::from_secs(count * 3600),
        "M" => Duration::from_secs(count * 60),
        "S" => Duration::from_secs(count),
        "m" => Duration::from_millis(count),
        "u" => Duration::from_micros(count),
        "n" => Duration::from_nanos(count),
        _ => return None,
    };
    Instant::now().checked_add(timeout)
}

fn refused(door: Door, error: Error, body: &Body) -> Response {
    let unauthenticated = error.code == ErrorCode::Unauthenticated;
    let mut response = match door {
        Door::Grpc => status::grpc(error).into_http::<Body>(),
        Door::Rest => status::Problem::from(error).into_response(),
    };
    if matches!(door, Door::Rest) && !body.is_end_stream() {
        // The body is not read, so that nothing can follow it: a client is told, instead of finding out.
        response.headers_mut().insert(header::CONNECTION, HeaderValue::from_static("close"));
    }
    if unauthenticated {
        // RFC 6750, section 3.
        response.headers_mut().insert(header::WWW_AUTHENTICATE, HeaderValue::from_static("Bearer realm=\"percept\""));
    }
    response
}

#[cfg(test)]
#[allow(clippy::panic)]
mod tests {
    use super::*;

    #[test]
    fn every_rpc_of_the_contract_has_a_rule_and_every_rule_an_rpc() {
        use percept_service::caller::rules::{About, RULES, rule};
        let (mut named, mut rpcs) = (std::collections::BTreeSet::new(), 0);
        for service in percept_wire::json::pool().services().filter(|s| s.full_name().starts_with("percept.v1.")) {
            for rpc in service.methods() {
                let operation = format!("{}/{}", service.name(), rpc.name());
                let rule = rule(&operation).unwrap_or_else(|| panic!("no rule for {operation}"));
                let fields = ["session_id", "source", "message", "session"];
                // A toolbox's source is a cloud, of a session only sometimes.
                let of_a_session = !service.name().starts_with("Toolbox")
                    && fields.iter().any(|f| rpc.input().get_field_by_name(f).is_some());
                assert_eq!(rule.about == About::Session, of_a_session, "{operation}");
                named.insert(rule.operation);
                rpcs += 1;
            }
        }
        assert!(rpcs > 50);
        assert_eq!(named, RULES.iter().map(|r| r.operation).collect(), "rules without an rpc");
    }

    #[test]
    fn a_deadline_is_as_far_away_as_the_caller_says() {
        let left = |v: &'static str| {
            let headers = HeaderMap::from_iter([("grpc-timeout".parse().unwrap(), v.parse().unwrap())]);
            deadline(&headers).map(|d| d.saturating_duration_since(Instant::now()).as_secs_f64().round())
        };
        assert_eq!((left("30S"), left("2M"), left("90000m")), (Some(30.0), Some(120.0), Some(90.0)));
        assert_eq!((left("x"), left("1x"), left("123456789S"), left("")), (None, None, None, None));
    }
}
