//! Request bodies, read up to the limit.

use super::super::status;
use super::refused::Refused;
use axum::body::Body;
use axum::http::{HeaderMap, StatusCode, header};
use bytes::{Bytes, BytesMut};
use futures::StreamExt;
use percept_service::reason;
use percept_service::{Error, Limits};
use std::error::Error as _;

/// Room for what stands around the bytes of a message.
const AROUND_BYTES: usize = 64 << 10;

/// A JSON body holds its bytes as base64: four characters for three.
fn limit_of(limits: &Limits) -> usize {
    (limits.max_message_bytes / 3).saturating_mul(4).saturating_add(AROUND_BYTES)
}

/// All of a body.
///
/// # Errors
/// `MESSAGE_TOO_LARGE`; `CONTENT_ENCODING_UNSUPPORTED` (415); `BODY_BROKEN` if the sender went away, `BODY_TOO_SLOW` (408) if
/// it sent too slowly; `MEMORY_EXHAUSTED`.
pub(super) async fn read(body: Body, headers: &HeaderMap, limits: &Limits) -> Result<Bytes, Refused> {
    let encoding = headers.get(header::CONTENT_ENCODING).map(|v| v.to_str().unwrap_or("unreadable"));
    if let Some(encoding) = encoding.filter(|e| !e.eq_ignore_ascii_case("identity")) {
        let message = format!("content-encoding is {encoding:?}; send the body as it is");
        return Err(Refused::http(StatusCode::UNSUPPORTED_MEDIA_TYPE, reason::CONTENT_ENCODING_UNSUPPORTED, message));
    }
    let limit = limit_of(limits);
    let too_large = |size: u64| -> Refused {
        let message =
            format!("the body has at least {size} bytes, the limit is {limit}; send less at a time, or downsample");
        Error::exhausted(reason::MESSAGE_TOO_LARGE, "", message).into()
    };
    let declared = headers.get(header::CONTENT_LENGTH).and_then(|v| v.to_str().ok()?.parse::<u64>().ok());
    if let Some(size) = declared.filter(|size| *size > limit as u64) {
        return Err(too_large(size));
    }
    let mut stream = body.into_data_stream();
    let mut all = BytesMut::new();
    while let Some(chunk) = stream.next().await {
        let chunk = chunk.map_err(|e| broken(&e))?;
        if all.len() + chunk.len() > limit {
            return Err(too_large((all.len() + chunk.len()) as u64));
        }
        // A declared length is believed only as far as bytes arrive: growth is by doubling.
        all.extend_from_slice(&chunk);
    }
    Ok(all.freeze())
}

/// What the listener says of a body that it broke off, or that the sender left.
fn broken(error: &axum::Error) -> Refused {
    let mut cause = error.source();
    while let Some(inner) = cause {
        if let Some(said) = inner.downcast_ref::<tonic::Status>() {
            let problem = status::from_grpc(said);
            return match problem.reason() {
                reason::BODY_TOO_SLOW => {
                    Refused::http(StatusCode::REQUEST_TIMEOUT, reason::BODY_TOO_SLOW, said.message())
                }
                _ => problem.into(),
            };
        }
        cause = inner.source();
    }
    Error::invalid(reason::BODY_BROKEN, "", format!("the body ended early: {error}")).into()
}
