//! Bodies to messages and messages to bodies: JSON as protobuf defines it, or protobuf itself.

use super::refused::Refused;
use super::strict;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use percept_service::Error;
use percept_service::reason;
use percept_wire::{expansion, json};
use prost::encoding::{DecodeContext, decode_key, skip_field};
use prost_reflect::{DeserializeOptions, DynamicMessage, Kind, MessageDescriptor, SerializeOptions};
use serde_json::{Map, Value};

/// Bodies above it are decoded and encoded beside the threads that serve everyone else.
const LARGE_BYTES: usize = 64 << 10;
/// Media type of a protobuf message.
const PROTOBUF: &str = "application/x-protobuf";

/// How a body is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Format {
    Json,
    Protobuf,
}

/// How the request's body is written.
///
/// Other media types are refused, above all those that a foreign web page may send without asking.
///
/// # Errors
/// `MEDIA_TYPE_UNSUPPORTED` (415).
pub(super) fn content_format(headers: &HeaderMap) -> Result<Format, Refused> {
    let sent = headers.get(header::CONTENT_TYPE).and_then(|v| v.to_str().ok()).unwrap_or_default();
    match sent.split(';').next().unwrap_or_default().trim().to_ascii_lowercase().as_str() {
        "application/json" => Ok(Format::Json),
        PROTOBUF | "application/protobuf" => Ok(Format::Protobuf),
        other => {
            let message = format!("content-type is {other:?}; send application/json, or {PROTOBUF}");
            Err(Refused::http(StatusCode::UNSUPPORTED_MEDIA_TYPE, reason::MEDIA_TYPE_UNSUPPORTED, message))
        }
    }
}

/// Whether a body is worked on beside the threads that serve everyone else.
pub(super) fn is_large(body: &[u8]) -> bool {
    body.len() > LARGE_BYTES
}

/// A message as the rpc takes it.
///
/// # Errors
/// `INTERNAL`.
pub(super) async fn encoded(message: DynamicMessage, is_large: bool) -> Result<Bytes, Error> {
    apart(is_large, move || Bytes::from(prost::Message::encode_to_vec(&message))).await
}

/// A message of a body; an empty body is an empty message.
///
/// # Errors
/// `JSON_INVALID` naming the field, `PROTOBUF_INVALID`.
pub(super) async fn decode(message: MessageDescriptor, format: Format, body: Bytes) -> Result<DynamicMessage, Error> {
    let large = is_large(&body);
    let work = move || match format {
        Format::Json if body.is_empty() => Ok(DynamicMessage::new(message)),
        Format::Json => from_json(&message, &body),
        Format::Protobuf => from_protobuf(&message, body),
    };
    apart(large, work).await?
}

/// Whether the request asks for a message, and not for the file that could be sent.
pub(super) fn wants_message(headers: &HeaderMap) -> bool {
    let accepted = headers.get(header::ACCEPT).and_then(|v| v.to_str().ok()).unwrap_or_default();
    accepted.contains(PROTOBUF) || accepted.contains("application/json")
}

/// The answer, as the request's `Accept` prefers.
///
/// # Errors
/// `INTERNAL`.
pub(super) async fn encode(
    message: MessageDescriptor,
    headers: &HeaderMap,
    answer: Vec<u8>,
) -> Result<Response, Refused> {
    let accepted = headers.get(header::ACCEPT).and_then(|v| v.to_str().ok()).unwrap_or_default();
    if accepted.contains(PROTOBUF) {
        return Ok(([(header::CONTENT_TYPE, PROTOBUF)], answer).into_response());
    }
    let large = answer.len() > LARGE_BYTES;
    let text = apart(large, move || to_json_text(message, &answer)).await??;
    Ok(([(header::CONTENT_TYPE, "application/json")], text).into_response())
}

async fn apart<T: Send + 'static>(large: bool, work: impl FnOnce() -> T + Send + 'static) -> Result<T, Error> {
    if large { tokio::task::spawn_blocking(work).await.map_err(Error::internal) } else { Ok(work()) }
}

fn to_json_text(message: MessageDescriptor, bytes: &[u8]) -> Result<String, Error> {
    let dynamic = DynamicMessage::decode(message, bytes).map_err(Error::internal)?;
    // As `percept_wire::json` writes it, without a tree in between.
    let options = SerializeOptions::new().use_proto_field_name(true).skip_default_fields(false);
    let mut out = Vec::with_capacity(2 * bytes.len() + 64);
    dynamic.serialize_with_options(&mut serde_json::Serializer::new(&mut out), &options).map_err(Error::internal)?;
    String::from_utf8(out).map_err(Error::internal)
}

fn from_json(message: &MessageDescriptor, body: &[u8]) -> Result<DynamicMessage, Error> {
    expansion::check_json(body)?;
    let mut text = serde_json::Deserializer::from_slice(body);
    let read = strict::check(message, body).and_then(|()| {
        let read = DynamicMessage::deserialize_with_options(message.clone(), &mut text, &DeserializeOptions::new())?;
        text.end().map(|()| read)
    });
    read.map_err(|e| {
        let value = serde_json::from_slice(body).ok();
        let fault = |value| first_fault(message, value).or_else(|| strict::first_misfit(message, value));
        let (field, what) = value.as_ref().and_then(fault).unwrap_or_else(|| (String::new(), e.to_string()));
        let place = if field.is_empty() { "body".to_owned() } else { field.clone() };
        Error::invalid(reason::JSON_INVALID, field, format!("{place} is not as {} has it: {what}", message.name()))
    })
}

/// Path of the first field that does not fit, and what is wrong with it.
fn first_fault(message: &MessageDescriptor, value: &Value) -> Option<(String, String)> {
    let Value::Object(members) = value else {
        return Some((String::new(), "expected an object".to_owned()));
    };
    for (name, value) in members {
        let field = message.get_field_by_name(name).or_else(|| message.get_field_by_json_name(name));
        let Some(field) = field else {
            let known: Vec<String> = message.fields().map(|f| f.name().to_owned()).collect();
            return Some((name.clone(), format!("no such field; there are {}", known.join(", "))));
        };
        let alone = Value::Object(Map::from_iter([(name.clone(), value.clone())]));
        let Err(e) = DynamicMessage::deserialize(message.clone(), alone) else { continue };
        let inner = match (field.kind(), value) {
            (Kind::Message(inner), Value::Array(items)) if field.is_list() => {
                items.iter().enumerate().find_map(|(i, item)| {
                    first_fault(&inner, item).map(|(path, what)| (joined(&format!("{name}[{i}]"), &path), what))
                })
            }
            (Kind::Message(inner), Value::Object(_)) => {
                first_fault(&inner, value).map(|(path, what)| (joined(name, &path), what))
            }
            _ => None,
        };
        return Some(inner.unwrap_or_else(|| (name.clone(), leaf_fault(&field.kind(), &e))));
    }
    None
}

/// What is wrong with a value that holds no fields; of a choice, with the words that there are.
fn leaf_fault(kind: &Kind, e: &serde_json::Error) -> String {
    let Kind::Enum(choice) = kind else { return e.to_string() };
    // The first says that nothing was chosen.
    let words: Vec<String> = choice.values().filter(|v| v.number() != 0).map(|v| v.name().to_owned()).collect();
    format!("{e}; there are {}", words.join(", "))
}

fn joined(outer: &str, inner: &str) -> String {
    if inner.is_empty() { outer.to_owned() } else { format!("{outer}.{inner}") }
}

fn from_protobuf(message: &MessageDescriptor, body: Bytes) -> Result<DynamicMessage, Error> {
    let invalid =
        |e| Error::invalid(reason::PROTOBUF_INVALID, "", format!("body is not an encoded {}: {e}", message.name()));
    expansion::check(message.full_name(), &body)?;
    // A frame may come as it is, without the request around it, which has field 1 and no other.
    if message.name() == "SendFrameRequest" && !only_field_one(body.clone()) {
        let bare = DynamicMessage::decode(json::descriptor("SensorMessage")?, body).map_err(invalid)?;
        let mut request = DynamicMessage::new(message.clone());
        request.set_field_by_name("message", prost_reflect::Value::Message(bare));
        return Ok(request);
    }
    DynamicMessage::decode(message.clone(), body).map_err(invalid)
}

fn only_field_one(mut body: Bytes) -> bool {
    while !body.is_empty() {
        let Ok((tag, wire_type)) = decode_key(&mut body) else { return true };
        if tag != 1 {
            return false;
        }
        if skip_field(wire_type, tag, &mut body, DecodeContext::default()).is_err() {
            return true;
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_wire::v1;
    use prost::Message;

    fn fault(name: &str, body: &str) -> Error {
        from_json(&json::descriptor(name).unwrap(), body.as_bytes()).unwrap_err()
    }

    #[test]
    fn a_bad_body_names_the_field() {
        let e = fault("SendFrameRequest", r#"{"message": {"depth": {"width_px": "wide"}}}"#);
        assert_eq!((e.reason, e.field.as_str()), ("JSON_INVALID", "message.depth.width_px"));
        let e = fault("CreateSessionRequest", r#"{"sensors": [{}, {"kind": "SONAR"}]}"#);
        assert_eq!(e.field, "sensors[1].kind");
        assert!(e.message.contains("SONAR") && e.message.contains("SENSOR_KIND_LIDAR2D"), "{}", e.message);
        let e = fault("CreateSessionRequest", r#"{"sesion_id": "a"}"#);
        assert_eq!(e.field, "sesion_id");
        assert!(e.message.contains("session_id"), "{e}");
        let e = fault("CreateSessionRequest", r#"{"session_id": "a""#);
        assert!(e.field.is_empty() && e.message.contains("line 1"), "{e}");
        assert_eq!(fault("CreateSessionRequest", "[1]").reason, "JSON_INVALID");
    }

    #[test]
    fn a_frame_may_come_with_or_without_its_request() {
        let message = v1::SensorMessage { sensor_id: "s".to_owned(), stamp_ns: 7, ..Default::default() };
        let request = v1::SendFrameRequest { message: Some(message.clone()) };
        let kind = json::descriptor("SendFrameRequest").unwrap();
        for body in [message.encode_to_vec(), request.encode_to_vec()] {
            let read = from_protobuf(&kind, body.into()).unwrap();
            assert_eq!(read.transcode_to::<v1::SendFrameRequest>().unwrap(), request);
        }
        assert_eq!(from_protobuf(&kind, vec![0xff, 0xff].into()).unwrap_err().reason, "PROTOBUF_INVALID");
    }

    #[test]
    fn other_media_types_are_refused() {
        let headers = |media: &'static str| HeaderMap::from_iter([(header::CONTENT_TYPE, media.parse().unwrap())]);
        assert_eq!(content_format(&headers("application/json; charset=utf-8")).unwrap(), Format::Json);
        assert_eq!(content_format(&headers("application/x-protobuf")).unwrap(), Format::Protobuf);
        assert!(content_format(&headers("text/plain")).is_err());
        assert!(content_format(&HeaderMap::new()).is_err());
    }
}
