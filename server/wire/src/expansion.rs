//! How much memory a message takes once it is decoded, told before it is.
//!
//! An empty element of a repeated field has two bytes on the wire and some hundreds in memory. So the elements of a
//! message are counted by its descriptor, nothing being kept, and a message that would take far more memory than it has
//! bytes is refused. Encoding: Protocol Buffers documentation, 'Encoding'.

use crate::json;
use percept_service::reason;
use percept_service::{Error, Result};
use prost::encoding::{DecodeContext, WireType, decode_key, decode_varint, skip_field};
use prost_reflect::{Kind, MessageDescriptor};
use std::collections::HashMap;
use std::sync::OnceLock;

/// What is not larger is not looked at: it cannot take much.
const SMALL_BYTES: usize = 16 << 10;
/// Memory that any message may take, and that a larger one may for each of its bytes. Poses and numbers, of which real
/// messages have many, take three to five.
const FREE_BYTES: usize = 16 << 20;
const MOST_PER_BYTE: usize = 8;
/// Nested deeper nothing is decoded.
const MOST_DEPTH: usize = 100;

/// Whether an encoded message of this type may be decoded.
///
/// # Errors
/// `MESSAGE_EXPANDS`.
pub fn check(full_name: &str, encoded: &[u8]) -> Result<()> {
    if encoded.len() <= SMALL_BYTES {
        return Ok(());
    }
    let Some(message) = json::pool().get_message_by_name(full_name) else { return Ok(()) };
    let most = FREE_BYTES + MOST_PER_BYTE * encoded.len();
    let mut left = most;
    if walk(&message, encoded, MOST_DEPTH, &mut left) {
        return Ok(());
    }
    Err(expands(encoded.len(), most))
}

/// Whether a JSON text of a message may be read: its values are kept as a tree on the way.
///
/// # Errors
/// `MESSAGE_EXPANDS`.
pub fn check_json(text: &[u8]) -> Result<()> {
    if text.len() <= SMALL_BYTES {
        return Ok(());
    }
    let most = FREE_BYTES + MOST_PER_BYTE * text.len();
    let (mut taken, mut is_text, mut is_escaped) = (0, false, false);
    for byte in text {
        match (byte, is_text) {
            _ if is_escaped => is_escaped = false,
            (b'\\', true) => is_escaped = true,
            (b'"', _) => is_text = !is_text,
            // Members of an object, and a message's own table of fields.
            (b'{', false) => taken += 256,
            (b'[' | b',', false) => taken += 32,
            _ => {}
        }
        if taken > most {
            return Err(expands(text.len(), most));
        }
    }
    Ok(())
}

fn expands(num_bytes: usize, most: usize) -> Error {
    let words = format!(
        "the message has {num_bytes} bytes and so many elements that it would take more than {most} in memory; send fewer \
         elements at a time"
    );
    Error::invalid(reason::MESSAGE_EXPANDS, "", words)
}

/// Whether what is decoded of a message fits into what is left; what cannot be decoded is for the decoder to tell.
fn walk(message: &MessageDescriptor, mut encoded: &[u8], depth: usize, left: &mut usize) -> bool {
    let sizes = sizes();
    while !encoded.is_empty() && depth > 0 {
        let Ok((tag, wire_type)) = decode_key(&mut encoded) else { return true };
        if wire_type != WireType::LengthDelimited {
            if skip_field(wire_type, tag, &mut encoded, DecodeContext::default()).is_err() {
                return true;
            }
            continue;
        }
        let part = decode_varint(&mut encoded).ok().and_then(|length| usize::try_from(length).ok());
        let Some((part, rest)) = part.and_then(|length| encoded.split_at_checked(length)) else { return true };
        encoded = rest;
        let Some(field) = message.get_field(tag) else { continue };
        let inner = field.kind();
        if field.is_list() || field.is_map() {
            let size = match &inner {
                Kind::Message(inner) => sizes.get(inner.full_name()).copied().unwrap_or_default(),
                Kind::String | Kind::Bytes => HEAP_BYTES,
                // Packed numbers: eight bytes for each of one at most.
                _ => 0,
            };
            let Some(rest) = left.checked_sub(size) else { return false };
            *left = rest;
        }
        if let Kind::Message(inner) = inner
            && !walk(&inner, part, depth - 1, left)
        {
            return false;
        }
    }
    true
}

/// What a list, a text or bytes take beside their content.
const HEAP_BYTES: usize = 32;

/// About what each message of the contract takes by itself, bytes: messages in it are kept within, not apart.
fn sizes() -> &'static HashMap<String, usize> {
    static SIZES: OnceLock<HashMap<String, usize>> = OnceLock::new();
    SIZES.get_or_init(|| {
        let all = json::pool().all_messages();
        all.map(|message| (message.full_name().to_owned(), size(&message, &mut vec![]))).collect()
    })
}

fn size(message: &MessageDescriptor, within: &mut Vec<String>) -> usize {
    if within.iter().any(|name| name == message.full_name()) {
        // Kept apart, for it would have no end.
        return 8;
    }
    within.push(message.full_name().to_owned());
    let of_field = |within: &mut Vec<String>, field: prost_reflect::FieldDescriptor| match field.kind() {
        _ if field.is_list() || field.is_map() => HEAP_BYTES,
        Kind::Message(inner) => 8 + size(&inner, within),
        Kind::String | Kind::Bytes => HEAP_BYTES,
        _ => 16,
    };
    // Of a choice the largest.
    let mut sum = 0;
    for field in message.fields().filter(|field| field.containing_oneof().is_none()) {
        sum += of_field(within, field);
    }
    for choice in message.oneofs() {
        sum += choice.fields().map(|field| of_field(within, field)).max().unwrap_or_default();
    }
    within.pop();
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::v1;
    use prost::{Message, Name};

    #[test]
    fn empty_elements_by_the_million_are_refused() {
        // Field 4 of a creation is its sensors.
        let swelling = [0x22, 0x00].repeat(1 << 20);
        let name = v1::CreateSessionRequest::full_name();
        assert_eq!(check(&name, &swelling).unwrap_err().reason, "MESSAGE_EXPANDS");
        assert!(check(&name, &swelling[..2000]).is_ok());
        assert_eq!(check_json(&b"{},".repeat(1 << 20)).unwrap_err().reason, "MESSAGE_EXPANDS");
    }

    #[test]
    fn what_is_large_and_real_is_not() {
        let pose = v1::Pose {
            translation: Some(v1::Vector3 { x: 1.0, y: 2.0, z: 3.0 }),
            rotation: Some(v1::Quaternion { x: 0.1, y: 0.2, z: 0.3, w: 0.9 }),
        };
        let stamped = v1::StampedPose { stamp_ns: 1 << 60, pose: Some(pose) };
        let compared = v1::EvaluateTrajectoryRequest { reference: vec![stamped; 300_000], ..Default::default() };
        check(&v1::EvaluateTrajectoryRequest::full_name(), &compared.encode_to_vec()).unwrap();
        let cloud =
            v1::PointCloud { num_points: 2_000_000, positions: vec![1; 24_000_000].into(), ..Default::default() };
        check(&v1::PointCloud::full_name(), &cloud.encode_to_vec()).unwrap();
        let ranges = format!("[{}]", ["1.25"; 1_000_000].join(","));
        check_json(ranges.as_bytes()).unwrap();
        let escaped = format!("\"{}\"", "\\\"{".repeat(1 << 20));
        check_json(escaped.as_bytes()).unwrap();
    }

    #[test]
    fn sizes_are_about_those_of_the_compiled_messages() {
        for (name, real) in [
            (v1::SensorSpec::full_name(), size_of::<v1::SensorSpec>()),
            (v1::StampedPose::full_name(), size_of::<v1::StampedPose>()),
            (v1::Session::full_name(), size_of::<v1::Session>()),
        ] {
            let told = sizes()[&name];
            assert!((real / 2..=3 * real).contains(&told), "{name}: {told} bytes told, {real} are");
        }
    }
}
