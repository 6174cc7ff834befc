//! What ROS 2 nodes on `rmw_zenoh_cpp` write on a zenoh network: keys, liveliness tokens, attachments. Text and bytes alone.
//!
//! Source: ros2/rmw_zenoh, `docs/design.md` and what `rmw_zenoh_cpp` 0.2 to 0.10 writes. Subscribe by [`subscription_key`],
//! whose type hash is a wildcard: nodes of ROS 2 Humble and those of later releases write different hashes for one type.

mod attachment;
mod key;
mod qos;
mod token;

pub use attachment::{Attachment, AttachmentError};
pub use key::{DataKey, subscription_key, topic_key, type_key};
pub use qos::{Durability, History, Liveliness, Qos, QosDuration, Reliability};
pub use token::{Endpoint, EntityKind, LivelinessToken, liveliness_key};

/// Why a text is no key, no token, or no part of one.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{what} '{text}': {part} is '{found}', expected {expected}")]
pub struct KeyError {
    /// What was read: `data key`, `liveliness token`.
    pub what: &'static str,
    /// Its beginning.
    pub text: String,
    /// The part that is wrong.
    pub part: &'static str,
    /// What stands there.
    pub found: String,
    /// What would have been right.
    pub expected: &'static str,
}

impl KeyError {
    pub(crate) fn new(what: &'static str, text: &str, part: &'static str, found: &str, expected: &'static str) -> Self {
        let short = |s: &str| s.chars().take(200).collect();
        Self { what, text: short(text), part, found: short(found), expected }
    }
}

/// A topic without slashes at its ends, if zenoh takes it as a part of a key.
pub(crate) fn bare_topic(topic: &str) -> Result<&str, KeyError> {
    let bare = topic.trim_matches('/');
    let is_chunk = |chunk: &str| !chunk.is_empty() && !chunk.contains(['*', '$', '?', '#']) && !chunk.starts_with('@');
    if bare.split('/').all(is_chunk) {
        Ok(bare)
    } else {
        let expected = "names parted by single slashes, without *, $, ?, # and leading @";
        Err(KeyError::new("topic", topic, "topic", bare, expected))
    }
}
