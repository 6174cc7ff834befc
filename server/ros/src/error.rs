//! What can be wrong with a message's bytes: where, what, and what to do about it.

/// Why bytes are not the message that they should be.
#[derive(Debug, Clone, PartialEq)]
pub struct DecodeError {
    /// Type that was read, `sensor_msgs/msg/PointCloud2`.
    pub message: &'static str,
    /// Path of the field, `fields[3].offset`; empty for the message as a whole.
    pub field: String,
    /// Where in the payload, bytes from its beginning, the encapsulation header counted.
    pub byte: u64,
    /// What is wrong.
    pub fault: Fault,
}

impl std::error::Error for DecodeError {}

impl std::fmt::Display for DecodeError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { message, field, byte, fault } = self;
        let dot = if field.is_empty() { "" } else { ", " };
        write!(f, "{message}{dot}{field}, byte {byte}: {fault}")
    }
}

/// What is wrong at a place in a message.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Fault {
    /// The payload ends too soon.
    #[error("needs {needed} bytes, {available} are left; the payload is cut off or of another type")]
    Truncated {
        /// Bytes that the value takes, padding included.
        needed: u64,
        /// Bytes left.
        available: u64,
    },
    /// A sequence declares more than the rest of the payload can hold; nothing was allocated.
    #[error(
        "declares {count} elements of at least {least_bytes} bytes, {available} bytes are left; the payload is cut off or of \
         another type"
    )]
    CountTooLarge {
        /// Declared number of elements.
        count: u64,
        /// Bytes that an element takes at least.
        least_bytes: u64,
        /// Bytes left.
        available: u64,
    },
    /// A string's last byte is not the NUL that CDR counts in its length.
    #[error("a string of {length} bytes ends in {last:#04x}, not in NUL; write CDR strings with their NUL counted")]
    NoTerminator {
        /// Declared length, bytes.
        length: u64,
        /// The last byte.
        last: u8,
    },
    /// A string that is not UTF-8.
    #[error("a string of {length} bytes is not UTF-8 from its byte {at} on; write UTF-8")]
    NotUtf8 {
        /// Declared length, bytes.
        length: u64,
        /// First byte that is not, from the string's beginning.
        at: u64,
    },
    /// The first four bytes name a representation that is not read.
    #[error(
        "encapsulation {found:02x?} is not read; send plain CDR: 00 00 (big endian) or 00 01 (little endian), then two bytes"
    )]
    Encapsulation {
        /// Representation identifier.
        found: [u8; 2],
    },
    /// More follows the last field than padding explains.
    #[error("{extra} bytes follow the last field; the sender's definition has other fields than this type")]
    Trailing {
        /// Bytes that follow.
        extra: u64,
    },
    /// The type has no ROS 1 form, or another one.
    #[error("has no ROS 1 form that is read here; record it from ROS 2")]
    NotInRos1,
}

impl DecodeError {
    /// At a byte; the path is filled in on the way out.
    #[cold]
    pub(crate) fn at(byte: usize, fault: Fault) -> Self {
        Self { message: "", field: String::new(), byte: byte as u64, fault }
    }

    #[cold]
    pub(crate) fn in_field(mut self, name: &str) -> Self {
        let name = name.strip_prefix("r#").unwrap_or(name);
        self.field = match self.field.as_str() {
            "" => name.to_owned(),
            rest if rest.starts_with('[') => format!("{name}{rest}"),
            rest => format!("{name}.{rest}"),
        };
        self
    }

    #[cold]
    pub(crate) fn in_element(mut self, index: usize) -> Self {
        let dot = if self.field.is_empty() || self.field.starts_with('[') { "" } else { "." };
        self.field = format!("[{index}]{dot}{}", self.field);
        self
    }

    #[cold]
    pub(crate) fn in_message(mut self, message: &'static str) -> Self {
        self.message = message;
        self
    }
}

/// Why a message cannot be written.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum EncodeError {
    /// A string or sequence with more elements than its 32-bit length can say.
    #[error(
        "{message}: a sequence of {length} elements is beyond the 4294967295 that a message can hold; send it in parts"
    )]
    TooLong {
        /// Type that was written.
        message: &'static str,
        /// Number of elements.
        length: u64,
    },
    /// The type has no ROS 1 form, or another one.
    #[error("{message} has no ROS 1 form that is written here; write CDR")]
    NotInRos1 {
        /// Type that was to be written.
        message: &'static str,
    },
}
