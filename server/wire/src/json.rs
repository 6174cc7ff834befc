//! Any message of the contract as JSON and back: the canonical protobuf mapping with the protos' own field names.
//!
//! Source: Protocol Buffers language guide, 'JSON mapping'. 64-bit integers are strings, bytes are base64.

use percept_service::reason;
use percept_service::{Error, Result};
use prost::Message;
use prost_reflect::{DescriptorPool, DynamicMessage, MessageDescriptor, SerializeOptions};
use serde_json::Value;
use std::sync::OnceLock;

/// The contract's descriptors.
pub fn pool() -> &'static DescriptorPool {
    static POOL: OnceLock<DescriptorPool> = OnceLock::new();
    POOL.get_or_init(|| DescriptorPool::decode(crate::DESCRIPTORS).unwrap_or_default())
}

/// Descriptor of `percept.v1.<name>`.
///
/// # Errors
/// `INTERNAL` if there is none: the name comes from our own tables.
pub fn descriptor(name: &str) -> Result<MessageDescriptor> {
    pool()
        .get_message_by_name(&format!("percept.v1.{name}"))
        .ok_or_else(|| Error::internal(format!("no message {name} in the contract")))
}

/// A message as JSON: every singular field without presence is written, even when it holds its default.
///
/// # Errors
/// `INTERNAL` if `name` is not the type of `message`.
pub fn to_json(name: &str, message: &impl Message) -> Result<Value> {
    let dynamic =
        DynamicMessage::decode(descriptor(name)?, message.encode_to_vec().as_slice()).map_err(Error::internal)?;
    let options = SerializeOptions::new().use_proto_field_name(true).skip_default_fields(false);
    dynamic.serialize_with_options(serde_json::value::Serializer, &options).map_err(Error::internal)
}

/// A message from JSON; unknown fields are refused.
///
/// # Errors
/// `JSON_INVALID` with what the parser found.
pub fn from_json<M: Message + Default>(name: &str, value: Value) -> Result<M> {
    let dynamic = DynamicMessage::deserialize(descriptor(name)?, value)
        .map_err(|e| Error::invalid(reason::JSON_INVALID, "", format!("body is not a {name}: {e}")))?;
    M::decode(dynamic.encode_to_vec().as_slice()).map_err(Error::internal)
}
