//! Request bodies, read up to the limit.

use super::refused::Refused;
use axum::body::Body;
use axum::http::{HeaderMap, header};
use bytes::{Bytes, BytesMut};
use futures::StreamExt;
use percept_service::{Error, Limits};

/// Room for what stands around the bytes of a message.
const AROUND_BYTES: usize = 64 << 10;

/// A JSON body holds its bytes as base64: four characters for three.
fn limit_of(limits: &Limits) -> usize {
    (limits.max_message_bytes / 3).saturating_mul(4).saturating_add(AROUND_BYTES)
}

/// All of a body.
///
/// # Errors
/// `MESSAGE_TOO_LARGE`, `BODY_BROKEN` if the sender went away.
pub(super) async fn read(body: Body, headers: &HeaderMap, limits: &Limits) -> Result<Bytes, Refused> {
    let limit = limit_of(limits);
    let too_large = |size: u64| -> Refused {
        let message =
            format!("the body has at least {size} bytes, the limit is {limit}; send less at a time, or downsample");
        Error::exhausted("MESSAGE_TOO_LARGE", "", message).into()
    };
    let declared = headers.get(header::CONTENT_LENGTH).and_then(|v| v.to_str().ok()?.parse::<u64>().ok());
    if let Some(size) = declared.filter(|size| *size > limit as u64) {
        return Err(too_large(size));
    }
    let mut stream = body.into_data_stream();
    let mut all = BytesMut::new();
    while let Some(chunk) = stream.next().await {
        let chunk = chunk.map_err(|e| Error::invalid("BODY_BROKEN", "", format!("the body ended early: {e}")))?;
        if all.len() + chunk.len() > limit {
            return Err(too_large((all.len() + chunk.len()) as u64));
        }
        // A declared length is believed only as far as bytes arrive: growth is by doubling.
        all.extend_from_slice(&chunk);
    }
    Ok(all.freeze())
}
