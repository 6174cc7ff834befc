//! What a handler answers when it does not serve a request.

use super::super::status::{self, Problem};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use percept_service::Error;
use serde_json::json;
use tonic::Status;

/// A response that says why, as `application/problem+json` (RFC 9457).
#[derive(Debug)]
pub(super) struct Refused(Box<Response>);

impl Refused {
    /// What only HTTP knows of: a method, a media type, a range.
    pub(super) fn http(status: StatusCode, reason: &str, message: impl Into<String>) -> Self {
        let body = json!({
            "type": format!("urn:percept:error:{}", reason.to_lowercase()),
            "title": status.canonical_reason().unwrap_or("error"),
            "status": status.as_u16(),
            "detail": message.into(),
            "reason": reason,
            "field": "",
            "code": if status == StatusCode::FORBIDDEN { "PERMISSION_DENIED" } else { "INVALID_ARGUMENT" },
            "trace_id": status::trace_id(),
        });
        let response = (status, [(header::CONTENT_TYPE, "application/problem+json")], body.to_string());
        Self(Box::new(response.into_response()))
    }

    /// The same with a header more.
    pub(super) fn with(mut self, name: header::HeaderName, value: &str) -> Self {
        if let Ok(value) = value.parse() {
            self.0.headers_mut().insert(name, value);
        }
        self
    }
}

impl From<Problem> for Refused {
    fn from(problem: Problem) -> Self {
        Self(Box::new(problem.into_response()))
    }
}

impl From<Error> for Refused {
    fn from(e: Error) -> Self {
        Problem::from(e).into()
    }
}

impl From<Status> for Refused {
    fn from(status: Status) -> Self {
        status::from_grpc(&status).into()
    }
}

impl IntoResponse for Refused {
    fn into_response(self) -> Response {
        *self.0
    }
}
