//! The one table from our error codes to gRPC status, HTTP status and zenoh error replies.

use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use percept_service::{Error, ErrorCode};
use prost::Message;
use serde_json::json;
use tonic::{Code, Status};
use tonic_types::{ErrorDetails, StatusExt};

/// Domain of our reasons in `google.rpc.ErrorInfo`.
const DOMAIN: &str = "percept";

fn codes(code: ErrorCode) -> (Code, StatusCode) {
    match code {
        ErrorCode::InvalidArgument => (Code::InvalidArgument, StatusCode::BAD_REQUEST),
        ErrorCode::NotFound => (Code::NotFound, StatusCode::NOT_FOUND),
        ErrorCode::AlreadyExists => (Code::AlreadyExists, StatusCode::CONFLICT),
        ErrorCode::FailedPrecondition => (Code::FailedPrecondition, StatusCode::CONFLICT),
        ErrorCode::ResourceExhausted => (Code::ResourceExhausted, StatusCode::TOO_MANY_REQUESTS),
        ErrorCode::Unavailable => (Code::Unavailable, StatusCode::SERVICE_UNAVAILABLE),
        ErrorCode::DeadlineExceeded => (Code::DeadlineExceeded, StatusCode::GATEWAY_TIMEOUT),
        ErrorCode::Internal => (Code::Internal, StatusCode::INTERNAL_SERVER_ERROR),
    }
}

/// As gRPC says it: `google.rpc.Status` with `ErrorInfo` and, for a field, `BadRequest`.
pub(crate) fn grpc(e: Error) -> Status {
    let mut details = ErrorDetails::new();
    details.set_error_info(e.reason, DOMAIN, std::collections::HashMap::new());
    if !e.field.is_empty() {
        details.add_bad_request_violation(&e.field, &e.message);
    }
    if e.code == ErrorCode::Unavailable {
        details.set_retry_info(Some(std::time::Duration::from_millis(500)));
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
        ErrorCode::ResourceExhausted,
        ErrorCode::Unavailable,
        ErrorCode::DeadlineExceeded,
    ];
    let code = table.into_iter().find(|c| codes(*c).0 == status.code()).unwrap_or(ErrorCode::Internal);
    Problem { code, reason, message: status.message().to_owned(), field }
}

/// An error as REST and zenoh say it.
#[derive(Debug)]
pub(crate) struct Problem {
    code: ErrorCode,
    reason: String,
    message: String,
    field: String,
}

impl From<Error> for Problem {
    fn from(e: Error) -> Self {
        Self { code: e.code, reason: e.reason.to_owned(), message: e.message, field: e.field }
    }
}

impl Problem {
    /// Encoded `percept.v1.ErrorInfo`, for zenoh's error replies.
    pub(crate) fn to_error_info(&self) -> Vec<u8> {
        let info = percept_wire::v1::ErrorInfo {
            reason: self.reason.clone(),
            message: self.message.clone(),
            field: self.field.clone(),
            code: self.code.name().to_owned(),
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
        let body = json!({
            "type": format!("urn:percept:error:{}", self.reason.to_lowercase()),
            "title": status.canonical_reason().unwrap_or("error"),
            "status": status.as_u16(),
            "detail": self.message,
            "reason": self.reason,
            "field": self.field,
            "code": self.code.name(),
        });
        (status, [("content-type", "application/problem+json")], body.to_string()).into_response()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_survives_the_way_through_grpc() {
        let e = Error::invalid("STRIDE_TOO_SMALL", "depth.row_stride_bytes", "too small");
        let problem = from_grpc(&grpc(e));
        assert_eq!(problem.code, ErrorCode::InvalidArgument);
        assert_eq!((problem.reason.as_str(), problem.field.as_str()), ("STRIDE_TOO_SMALL", "depth.row_stride_bytes"));
    }
}
