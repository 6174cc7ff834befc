//! The one table from our error codes to gRPC status, HTTP status and zenoh error replies.

use crate::telemetry::requests::RefusedWith;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use percept_service::{Error, ErrorCode, observe, trace};
use prost::Message;
use serde_json::json;
use std::collections::HashMap;
use std::time::Duration;
use tonic::{Code, Status};
use tonic_types::{ErrorDetails, StatusExt};

/// Domain of our reasons in `google.rpc.ErrorInfo`.
const DOMAIN: &str = "percept";
/// Names the request's trace in an error.
const TRACE_ID: &str = "trace_id";

/// Names the server to ask instead.
const SERVER: &str = "server";

/// When to try again what was refused for now.
const RETRY_AFTER: Duration = Duration::from_secs(1);

/// Whether the same request may be served a little later.
pub(crate) fn is_for_now(code: ErrorCode, reason: &str) -> bool {
    code == ErrorCode::Unavailable || (code == ErrorCode::ResourceExhausted && !reason.ends_with("_TOO_LARGE"))
}

fn codes(code: ErrorCode) -> (Code, StatusCode) {
    match code {
        ErrorCode::InvalidArgument => (Code::InvalidArgument, StatusCode::BAD_REQUEST),
        ErrorCode::NotFound => (Code::NotFound, StatusCode::NOT_FOUND),
        ErrorCode::AlreadyExists => (Code::AlreadyExists, StatusCode::CONFLICT),
        ErrorCode::FailedPrecondition => (Code::FailedPrecondition, StatusCode::CONFLICT),
        ErrorCode::Aborted => (Code::Aborted, StatusCode::PRECONDITION_FAILED),
        ErrorCode::ResourceExhausted => (Code::ResourceExhausted, StatusCode::TOO_MANY_REQUESTS),
        ErrorCode::Unauthenticated => (Code::Unauthenticated, StatusCode::UNAUTHORIZED),
        ErrorCode::PermissionDenied => (Code::PermissionDenied, StatusCode::FORBIDDEN),
        ErrorCode::Unavailable => (Code::Unavailable, StatusCode::SERVICE_UNAVAILABLE),
        ErrorCode::DeadlineExceeded => (Code::DeadlineExceeded, StatusCode::GATEWAY_TIMEOUT),
        ErrorCode::Internal => (Code::Internal, StatusCode::INTERNAL_SERVER_ERROR),
    }
}

/// As gRPC says it: `google.rpc.Status` with `ErrorInfo` and, for a field, `BadRequest`.
pub(crate) fn grpc(e: Error) -> Status {
    observe::refusal(e.reason);
    let mut details = ErrorDetails::new();
    let trace = trace::current().map(|t| (TRACE_ID.to_owned(), t.trace_id_hex()));
    let server = (!e.server.is_empty()).then(|| (SERVER.to_owned(), e.server));
    details.set_error_info(e.reason, DOMAIN, trace.into_iter().chain(server).collect::<HashMap<_, _>>());
    if !e.field.is_empty() {
        details.add_bad_request_violation(&e.field, &e.message);
    }
    if is_for_now(e.code, e.reason) {
        details.set_retry_info(Some(e.retry_after.unwrap_or(RETRY_AFTER)));
    }
    Status::with_error_details(codes(e.code).0, e.message, details)
}

/// Our error back out of a gRPC status, for the doors that call the same handlers.
pub(crate) fn from_grpc(status: &Status) -> Problem {
    let details = status.get_error_details();
    let reason = details.error_info().map_or("INTERNAL", |i| i.reason.as_str()).to_owned();
    let field =
        details.bad_request().and_then(|b| b.field_violations.first()).map(|v| v.field.clone()).unwrap_or_default();
    let table = [
        ErrorCode::InvalidArgument,
        ErrorCode::NotFound,
        ErrorCode::AlreadyExists,
        ErrorCode::FailedPrecondition,
        ErrorCode::Aborted,
        ErrorCode::ResourceExhausted,
        ErrorCode::Unauthenticated,
        ErrorCode::PermissionDenied,
        ErrorCode::Unavailable,
        ErrorCode::DeadlineExceeded,
    ];
    let code = table.into_iter().find(|c| codes(*c).0 == status.code()).unwrap_or(ErrorCode::Internal);
    let server = details.error_info().and_then(|i| i.metadata.get(SERVER)).cloned().unwrap_or_default();
    let retry_after = details.retry_info().and_then(|retry| retry.retry_delay);
    Problem { code, reason, message: status.message().to_owned(), field, trace_id: trace_id(), server, retry_after }
}

/// An error as REST and zenoh say it.
#[derive(Debug)]
pub(crate) struct Problem {
    code: ErrorCode,
    reason: String,
    message: String,
    field: String,
    /// Of the request; empty outside of one.
    trace_id: String,
    /// The server to ask instead; empty if that is no matter of where.
    server: String,
    retry_after: Option<Duration>,
}

impl From<Error> for Problem {
    fn from(e: Error) -> Self {
        observe::refusal(e.reason);
        let Error { code, reason, message, field, server, retry_after } = e;
        Self { code, reason: reason.to_owned(), message, field, trace_id: trace_id(), server, retry_after }
    }
}

/// Of the request that is being answered; empty outside of one.
pub(crate) fn trace_id() -> String {
    trace::current().map(|t| t.trace_id_hex()).unwrap_or_default()
}

impl Problem {
    /// Its stable reason.
    pub(crate) fn reason(&self) -> &str {
        &self.reason
    }

    /// Name of the gRPC code.
    pub(crate) const fn code_name(&self) -> &'static str {
        self.code.name()
    }

    /// Encoded `percept.v1.ErrorInfo`, for zenoh's error replies.
    pub(crate) fn to_error_info(&self) -> Vec<u8> {
        let info = percept_wire::v1::ErrorInfo {
            reason: self.reason.clone(),
            message: self.message.clone(),
            field: self.field.clone(),
            code: self.code.name().to_owned(),
            trace_id: self.trace_id.clone(),
            server: self.server.clone(),
            retry_after_s: self.retry_after.map_or(0.0, |after| after.as_secs_f64()),
        };
        info.encode_to_vec()
    }
}

impl IntoResponse for Problem {
    /// `application/problem+json`, RFC 9457.
    fn into_response(self) -> Response {
        // A request that is too large is told so by HTTP's own code.
        let status = match self.reason.as_str() {
            reason if reason.ends_with("_TOO_LARGE") && self.code == ErrorCode::ResourceExhausted => {
                StatusCode::PAYLOAD_TOO_LARGE
            }
            _ => codes(self.code).1,
        };
        let mut body = json!({
            "type": format!("urn:percept:error:{}", self.reason.to_lowercase()),
            "title": status.canonical_reason().unwrap_or("error"),
            "status": status.as_u16(),
            "detail": self.message,
            "reason": self.reason,
            "field": self.field,
            "code": self.code.name(),
            TRACE_ID: self.trace_id,
        });
        if !self.server.is_empty() {
            body[SERVER] = self.server.into();
        }
        let headers = [("content-type", "application/problem+json")];
        let mut response = (status, headers, body.to_string()).into_response();
        if is_for_now(self.code, &self.reason) {
            // Whole seconds are all that HTTP knows.
            let after = self.retry_after.unwrap_or(RETRY_AFTER).as_secs_f64().ceil() as u64;
            response.headers_mut().insert(header::RETRY_AFTER, HeaderValue::from(after));
        }
        response.extensions_mut().insert(RefusedWith(self.code.name()));
        response
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_refused_for_now_says_when_to_try_again() {
        let again = |e: Error| {
            let rest = Problem::from(e.clone()).into_response().headers().contains_key(header::RETRY_AFTER);
            assert_eq!(rest, grpc(e).get_details_retry_info().is_some(), "the doors agree");
            rest
        };
        assert!(again(Error::exhausted("SERVER_BUSY", "", "")));
        assert!(again(Error::new(ErrorCode::Unavailable, "STOPPING", "")));
        assert!(!again(Error::exhausted("MESSAGE_TOO_LARGE", "", "")));
        assert!(!again(Error::invalid("OUT_OF_RANGE", "x", "")));
    }

    #[test]
    fn where_and_when_to_ask_again_survive_the_way_through_grpc() {
        let problem = from_grpc(&grpc(Error::elsewhere("robot", "two.example:50051")));
        assert_eq!(problem.server, "two.example:50051");
        let slow = Error::too_fast("RATE_LIMITED", "", Duration::from_millis(2500));
        let status = grpc(slow.clone());
        assert_eq!(status.get_details_retry_info().unwrap().retry_delay, Some(Duration::from_millis(2500)));
        for answer in [from_grpc(&status), Problem::from(slow)] {
            assert_eq!(answer.into_response().headers()[header::RETRY_AFTER], "3");
        }
    }

    #[test]
    fn an_error_survives_the_way_through_grpc() {
        let e = Error::invalid("STRIDE_TOO_SMALL", "depth.row_stride_bytes", "too small");
        let problem = from_grpc(&grpc(e));
        assert_eq!(problem.code, ErrorCode::InvalidArgument);
        assert_eq!((problem.reason.as_str(), problem.field.as_str()), ("STRIDE_TOO_SMALL", "depth.row_stride_bytes"));
    }
}
