//! What holds for every call: it is gRPC and not a browser's, and it ends at the deadline that the client gave.

use super::super::listener::Framing;
use super::status;
use axum::body::Body;
use axum::extract::Request;
use axum::http::{HeaderMap, Uri, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use percept_service::reason;
use percept_service::{Error, ErrorCode};
use percept_wire::json;
use std::collections::BTreeSet;
use std::sync::LazyLock;
use std::time::Duration;

/// Paths of the rpcs whose clients stream.
static STREAMED: LazyLock<BTreeSet<String>> = LazyLock::new(|| {
    let services = json::pool().services();
    let methods = services.flat_map(|s| s.methods().collect::<Vec<_>>());
    let streamed = methods.filter(|m| m.is_client_streaming());
    streamed.map(|m| format!("/{}/{}", m.parent_service().full_name(), m.name())).collect()
});

/// What requests at a path consist of.
pub(super) fn framing(uri: &Uri) -> Framing {
    match uri.path() {
        path if STREAMED.contains(path) => Framing::Messages,
        path if path.starts_with("/grpc.reflection.") => Framing::Talk,
        _ => Framing::Message,
    }
}

/// Refuses what is no gRPC; ends a call at its deadline, and with it the work that has not begun.
pub(super) async fn guard(request: Request, next: Next) -> Response {
    let headers = request.headers();
    let media = headers.get(header::CONTENT_TYPE).and_then(|v| v.to_str().ok()).unwrap_or_default();
    // A page that a browser shows may send a few media types without asking, never this one.
    if !media.starts_with("application/grpc") || headers.contains_key(header::ORIGIN) {
        let words = "this door takes gRPC only, from no browser; send application/grpc, or use REST";
        return refused(Error::invalid(reason::MEDIA_TYPE_UNSUPPORTED, "", words));
    }
    match deadline(headers) {
        Ok(None) => next.run(request).await,
        Ok(Some(deadline)) => match tokio::time::timeout(deadline, next.run(request)).await {
            Ok(answer) => answer,
            Err(_) => refused(Error::new(
                ErrorCode::DeadlineExceeded,
                reason::DEADLINE_EXCEEDED,
                "the call's deadline passed",
            )),
        },
        Err(error) => refused(error),
    }
}

fn refused(error: Error) -> Response {
    status::grpc(error).into_http::<Body>().into_response()
}

/// The call's `grpc-timeout`: up to eight digits and a unit.
fn deadline(headers: &HeaderMap) -> Result<Option<Duration>, Error> {
    let Some(value) = headers.get("grpc-timeout") else { return Ok(None) };
    let read = || {
        let text = value.to_str().ok()?;
        let (digits, unit) = text.split_at_checked(text.len().checked_sub(1)?)?;
        let count: u64 = digits.parse().ok().filter(|_| digits.len() <= 8)?;
        Some(match unit {
            "H" => Duration::from_secs(count * 3600),
            "M" => Duration::from_secs(count * 60),
            "S" => Duration::from_secs(count),
            "m" => Duration::from_millis(count),
            "u" => Duration::from_micros(count),
            "n" => Duration::from_nanos(count),
            _ => return None,
        })
    };
    let invalid = || {
        let words = format!("grpc-timeout is {value:?}; send up to eight digits and one of H, M, S, m, u, n");
        Error::invalid(reason::HEADER_INVALID, "grpc-timeout", words)
    };
    read().map(Some).ok_or_else(invalid)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deadlines_are_read_as_the_protocol_has_them() {
        let read =
            |v: &'static str| deadline(&HeaderMap::from_iter([("grpc-timeout".parse().unwrap(), v.parse().unwrap())]));
        assert_eq!(read("250m").unwrap(), Some(Duration::from_millis(250)));
        assert_eq!(read("99999999H").unwrap(), Some(Duration::from_secs(99_999_999 * 3600)));
        assert_eq!(deadline(&HeaderMap::new()).unwrap(), None);
        for bad in ["", "m", "1", "100000000S", "-1S", "1x", "1 S"] {
            assert_eq!(read(bad).unwrap_err().reason, "HEADER_INVALID", "{bad}");
        }
    }

    #[test]
    fn streams_of_clients_are_known_by_the_contract() {
        let at = |path: &'static str| framing(&Uri::from_static(path));
        assert_eq!(at("/percept.v1.SensorsService/StreamFrames"), Framing::Messages);
        assert_eq!(at("/percept.v1.SensorsService/SendFrame"), Framing::Message);
        assert_eq!(at("/percept.v1.SessionsService/WatchSession"), Framing::Message);
    }
}
