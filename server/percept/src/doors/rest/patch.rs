//! `PATCH`: the resource as the body, the mask in the query, the tag in `If-Match` (RFC 9110, section 13.1.1).

use super::fields;
use super::refused::Refused;
use super::transcode::{self, Format};
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::Response;
use bytes::Bytes;
use percept_service::Error;
use percept_service::reason;
use prost_reflect::{DynamicMessage, Kind, MessageDescriptor, Value};

/// What the query may say.
pub(super) const MASK: &str = "update_mask";
const TAG: &str = "etag";

/// The request of an update.
///
/// # Errors
/// `QUERY_INVALID`, `HEADER_INVALID`; what is wrong with the body.
pub(super) async fn request(
    input: MessageDescriptor,
    field: &str,
    format: Format,
    body: Bytes,
    parts: &Parts,
) -> Result<DynamicMessage, Refused> {
    let resource = input.get_field_by_name(field).map(|f| f.kind());
    let Some(Kind::Message(resource)) = resource else {
        return Err(Error::internal(format!("{} has no {field}", input.name())).into());
    };
    let mut request = DynamicMessage::new(input.clone());
    request.set_field_by_name(field, Value::Message(transcode::decode(resource, format, body).await?));
    if let Some(paths) = fields::mask(&parts.uri, MASK)? {
        let Some(Kind::Message(mask)) = input.get_field_by_name(MASK).map(|f| f.kind()) else {
            return Err(Error::internal(format!("{} has no mask", input.name())).into());
        };
        let mut said = DynamicMessage::new(mask);
        said.set_field_by_name("paths", Value::List(paths.into_iter().map(Value::String).collect()));
        request.set_field_by_name(MASK, Value::Message(said));
    }
    if let Some(tag) = expected(&parts.headers)? {
        request.set_field_by_name(TAG, Value::String(tag));
    }
    Ok(request)
}

/// The tag that `If-Match` asks for; none if any will do.
fn expected(headers: &HeaderMap) -> Result<Option<String>, Error> {
    let mut values = headers.get_all(header::IF_MATCH).iter();
    let (Some(value), None) = (values.next(), values.next()) else {
        return if headers.contains_key(header::IF_MATCH) { Err(invalid("several")) } else { Ok(None) };
    };
    let text = value.to_str().unwrap_or_default().trim();
    if text == "*" {
        return Ok(None);
    }
    let tag = text.strip_prefix('"').and_then(|t| t.strip_suffix('"')).filter(|t| !t.contains('"') && !t.is_empty());
    tag.map(|t| Some(t.to_owned())).ok_or_else(|| invalid(text))
}

fn invalid(value: &str) -> Error {
    let shown: String = value.chars().take(80).collect();
    let words = format!("if-match is {shown:?}; it must be one entity tag in double quotes, as ETag had it, or *");
    Error::invalid(reason::HEADER_INVALID, "if-match", words)
}

/// Says the tag in `ETag`.
pub(super) fn tell_tag(response: &mut Response, tag: Option<&str>) {
    if let Some(value) = tag.and_then(|tag| HeaderValue::try_from(format!("\"{tag}\"")).ok()) {
        response.headers_mut().insert(header::ETAG, value);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_tag_in_quotes_or_any_is_asked_for() {
        let headers = |v: &'static str| HeaderMap::from_iter([(header::IF_MATCH, v.parse().unwrap())]);
        assert_eq!(expected(&HeaderMap::new()).unwrap(), None);
        assert_eq!(expected(&headers("*")).unwrap(), None);
        assert_eq!(expected(&headers("\"1a-2\"")).unwrap().as_deref(), Some("1a-2"));
        for bad in ["1a-2", "W/\"1a-2\"", "\"a\", \"b\"", "\"\"", ""] {
            assert_eq!(expected(&headers(bad)).unwrap_err().reason, "HEADER_INVALID", "{bad}");
        }
    }
}
