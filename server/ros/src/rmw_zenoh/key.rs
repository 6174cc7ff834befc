//! Keys of data: `<domain>/<topic>/<type>/<hash>`.

use super::{KeyError, bare_topic};
use crate::{TypeHash, TypeName};

/// The key that samples of a topic are put at.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct DataKey {
    /// ROS domain (`ROS_DOMAIN_ID`).
    pub domain: u32,
    /// Topic, with a slash in front: `/robot/points`.
    pub topic: String,
    /// Type.
    pub type_name: TypeName,
    /// Hash of the type; of Humble, [`TypeHash::NotSupported`].
    pub type_hash: TypeHash,
}

const WHAT: &str = "data key";

impl DataKey {
    /// Of a topic, with or without slashes at its ends.
    ///
    /// # Errors
    /// `KeyError` if the topic cannot stand in a key.
    pub fn new(domain: u32, topic: &str, type_name: TypeName, type_hash: TypeHash) -> Result<Self, KeyError> {
        Ok(Self { domain, topic: format!("/{}", bare_topic(topic)?), type_name, type_hash })
    }

    /// From a key as zenoh gives it.
    ///
    /// # Errors
    /// `KeyError` naming the part that is wrong.
    pub fn parse(key: &str) -> Result<Self, KeyError> {
        let error = |part, found: &str, expected| KeyError::new(WHAT, key, part, found, expected);
        let whole = || error("key", key, "<domain>/<topic>/<type>/<hash>");
        let (domain, rest) = key.split_once('/').ok_or_else(whole)?;
        let (rest, hash) = rest.rsplit_once('/').ok_or_else(whole)?;
        let (topic, name) = rest.rsplit_once('/').ok_or_else(whole)?;
        let domain = domain.parse().map_err(|_| error("domain", domain, "a ROS domain, 0 to 232"))?;
        let type_name = TypeName::parse(name).map_err(|_| error("type", name, "package::msg::dds_::Name_"))?;
        let type_hash = hash.parse().map_err(|_| error("type hash", hash, "RIHS01_ and 64 hexadecimal digits"))?;
        Self::new(domain, topic, type_name, type_hash)
    }
}

/// The key itself.
impl std::fmt::Display for DataKey {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { domain, topic, type_name, type_hash } = self;
        write!(f, "{domain}/{}/{}/{type_hash}", topic.trim_matches('/'), type_name.to_dds())
    }
}

impl std::str::FromStr for DataKey {
    type Err = KeyError;

    fn from_str(text: &str) -> Result<Self, KeyError> {
        Self::parse(text)
    }
}

/// What to subscribe to for a topic of a known type, whatever the hash.
///
/// # Errors
/// `KeyError` if the topic cannot stand in a key.
pub fn subscription_key(domain: u32, topic: &str, type_name: &TypeName) -> Result<String, KeyError> {
    Ok(format!("{domain}/{}/{}/*", bare_topic(topic)?, type_name.to_dds()))
}

/// What to subscribe to for a topic whose type is not known yet.
///
/// # Errors
/// `KeyError` if the topic cannot stand in a key.
pub fn topic_key(domain: u32, topic: &str) -> Result<String, KeyError> {
    Ok(format!("{domain}/{}/*/*", bare_topic(topic)?))
}

/// What to subscribe to for all topics of a type.
pub fn type_key(domain: u32, type_name: &TypeName) -> String {
    format!("{domain}/**/{}/*", type_name.to_dds())
}
