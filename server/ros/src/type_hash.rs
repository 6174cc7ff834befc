//! The hash of a message's definition, by which ROS 2 tells versions of it apart.

use crate::description::{self, Definitions};
use sha2::{Digest, Sha256};

/// RIHS01: SHA-256 of the canonical JSON of a type's description (REP-2016); since ROS 2 Iron.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum TypeHash {
    /// The 32 bytes of the SHA-256.
    Rihs01([u8; 32]),
    /// ROS 2 Humble knows no hashes and writes this instead.
    NotSupported,
}

/// Why a text is no type hash.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("'{text}' is no type hash: write RIHS01_ and 64 hexadecimal digits, or TypeHashNotSupported")]
pub struct TypeHashError {
    /// Its beginning.
    text: String,
}

const PREFIX: &str = "RIHS01_";
const NOT_SUPPORTED: &str = "TypeHashNotSupported";

impl TypeHash {
    /// That of the message `name`, whose definition and those that it needs are in `definitions`.
    pub fn of(name: &str, definitions: &Definitions) -> Self {
        Self::Rihs01(Sha256::digest(description::canonical_json(name, definitions)).into())
    }
}

impl std::fmt::Display for TypeHash {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Rihs01(bytes) => {
                f.write_str(PREFIX)?;
                bytes.iter().try_for_each(|b| write!(f, "{b:02x}"))
            }
            Self::NotSupported => f.write_str(NOT_SUPPORTED),
        }
    }
}

impl std::str::FromStr for TypeHash {
    type Err = TypeHashError;

    fn from_str(text: &str) -> Result<Self, TypeHashError> {
        let error = || TypeHashError { text: text.chars().take(80).collect() };
        if text == NOT_SUPPORTED {
            return Ok(Self::NotSupported);
        }
        let digits = text.strip_prefix(PREFIX).filter(|d| d.len() == 64).ok_or_else(error)?;
        let mut bytes = [0; 32];
        for (byte, pair) in bytes.iter_mut().zip(digits.as_bytes().as_chunks::<2>().0) {
            let digit = |c: u8| char::from(c).to_digit(16).ok_or_else(error);
            *byte = (digit(pair[0])? * 16 + digit(pair[1])?) as u8;
        }
        Ok(Self::Rihs01(bytes))
    }
}
