//! Names of records: paths of segments, ordered as text; and where a session keeps what.
//!
//! A number in a key is written as 16 hexadecimal digits, most significant first, so that the order of
//! the text is the order of the numbers. Where a session keeps what is said by the functions at the end.

use std::fmt;
use std::sync::Arc;

use crate::error::{StoreError, shortened};

/// Most bytes of a key.
pub const MAX_KEY_BYTES: usize = 1024;

/// First segment of the records that the store keeps for itself; callers cannot name it.
pub(crate) const RESERVED: &str = "_store";

/// Name of a record: non-empty segments joined by `/`, ordered bytewise.
///
/// A segment is any text without `/` and without control characters; the whole has at most
/// [`MAX_KEY_BYTES`] bytes, and the first segment is not `_store`.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Key(Arc<str>);

impl Key {
    /// Joins segments to a key.
    ///
    /// # Errors
    /// [`StoreError::InvalidKey`] if there are none, or one breaks the rules above.
    pub fn new<'a>(segments: impl IntoIterator<Item = &'a str>) -> Result<Self, StoreError> {
        let mut path = String::new();
        for segment in segments {
            check_segment(segment)?;
            if !path.is_empty() {
                path.push('/');
            }
            path.push_str(segment);
        }
        Self::checked(path)
    }

    /// Reads a key from its text, e.g. `sessions/a/meta`.
    ///
    /// # Errors
    /// [`StoreError::InvalidKey`] as for [`Key::new`].
    pub fn parse(text: &str) -> Result<Self, StoreError> {
        Self::new(text.split('/'))
    }

    /// The key one segment deeper.
    ///
    /// # Errors
    /// [`StoreError::InvalidKey`] as for [`Key::new`].
    pub fn child(&self, segment: &str) -> Result<Self, StoreError> {
        check_segment(segment)?;
        Self::checked(format!("{}/{segment}", self.0))
    }

    /// The key one segment deeper, the segment being a number of 16 hexadecimal digits.
    ///
    /// # Errors
    /// [`StoreError::InvalidKey`] if the key grows too long.
    pub fn numbered(&self, number: u64) -> Result<Self, StoreError> {
        self.child(&number_segment(number))
    }

    /// The number in the last segment, if [`Key::numbered`] could have written it.
    #[must_use]
    pub fn number(&self) -> Option<u64> {
        let last = self.0.rsplit('/').next()?;
        let number = u64::from_str_radix(last, 16).ok()?;
        (number_segment(number) == last).then_some(number)
    }

    /// The segments, outermost first.
    pub fn segments(&self) -> impl Iterator<Item = &str> {
        self.0.split('/')
    }

    /// The whole as text.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// All keys below this one, itself excluded.
    #[must_use]
    pub fn prefix(&self) -> Prefix {
        Prefix(format!("{}/", self.0).into())
    }

    /// A key of the store's own, or one read back from it.
    pub(crate) fn trusted(path: &str) -> Self {
        Self(path.into())
    }

    fn checked(path: String) -> Result<Self, StoreError> {
        let requirement = if path.is_empty() {
            "at least one segment"
        } else if path.len() > MAX_KEY_BYTES {
            "at most 1024 bytes"
        } else if path.split('/').next() == Some(RESERVED) {
            "outside `_store`, which the store keeps for itself"
        } else {
            return Ok(Self(path.into()));
        };
        Err(StoreError::InvalidKey { segment: shortened(&path), requirement })
    }
}

impl fmt::Display for Key {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.0)
    }
}

impl fmt::Debug for Key {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "Key({})", self.0)
    }
}

/// A set of keys: all that begin with given segments.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Prefix(Arc<str>);

impl Prefix {
    /// Every key of the callers.
    #[must_use]
    pub fn everything() -> Self {
        Self("".into())
    }

    /// All keys below these segments.
    ///
    /// # Errors
    /// [`StoreError::InvalidKey`] as for [`Key::new`].
    pub fn new<'a>(segments: impl IntoIterator<Item = &'a str>) -> Result<Self, StoreError> {
        Ok(Key::new(segments)?.prefix())
    }

    /// The text that all its keys begin with: empty, or ending in `/`.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

/// `state`: how far the session has come.
#[must_use]
pub fn state() -> Key {
    Key::trusted("state")
}

/// `meta`: what is declared and set, as last changed.
#[must_use]
pub fn meta() -> Key {
    Key::trusted("meta")
}

/// `keyframes/<n>`.
#[must_use]
pub fn keyframe(number: u64) -> Key {
    numbered("keyframes", number)
}

/// All keyframes, in order.
#[must_use]
pub fn keyframes() -> Prefix {
    Prefix("keyframes/".into())
}

/// `loops/<n>`.
#[must_use]
pub fn loop_closure(number: u64) -> Key {
    numbered("loops", number)
}

/// All loops, in order.
#[must_use]
pub fn loop_closures() -> Prefix {
    Prefix("loops/".into())
}

/// `trajectory/<ticket of its first entry>`: one entry, or a chunk of them.
#[must_use]
pub fn trajectory(ticket: u64) -> Key {
    numbered("trajectory", ticket)
}

/// The whole trajectory, in order.
#[must_use]
pub fn trajectories() -> Prefix {
    Prefix("trajectory/".into())
}

/// `objects/<n>`.
#[must_use]
pub fn object(number: u64) -> Key {
    numbered("objects", number)
}

/// All objects, in order.
#[must_use]
pub fn objects() -> Prefix {
    Prefix("objects/".into())
}

/// `objects`: all objects in one record, as sessions of format 1 have it.
#[must_use]
pub fn objects_in_one() -> Key {
    Key::trusted("objects")
}

fn numbered(folder: &str, number: u64) -> Key {
    Key::trusted(&format!("{folder}/{}", number_segment(number)))
}

fn number_segment(number: u64) -> String {
    format!("{number:016x}")
}

fn check_segment(segment: &str) -> Result<(), StoreError> {
    let requirement = if segment.is_empty() {
        "non-empty"
    } else if segment.contains('/') {
        "without `/`"
    } else if segment.chars().any(char::is_control) {
        "without control characters"
    } else {
        return Ok(());
    };
    Err(StoreError::InvalidKey { segment: shortened(segment), requirement })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_order_of_numbered_keys_is_the_order_of_the_numbers() {
        let numbers = [0, 1, 9, 10, 255, 256, 1 << 32, u64::MAX];
        let keys: Vec<Key> = numbers.iter().map(|&number| keyframe(number)).collect();
        assert!(keys.is_sorted());
        assert_eq!(keys.iter().map(|key| key.number().unwrap()).collect::<Vec<_>>(), numbers);
        assert_eq!(meta().number(), None);
    }

    #[test]
    fn a_prefix_ends_at_a_segment() {
        let prefix = Prefix::new(["objects"]).unwrap();
        assert_eq!(prefix, objects());
        assert!(object(7).as_str().starts_with(prefix.as_str()));
        assert!(!objects_in_one().as_str().starts_with(prefix.as_str()));
    }

    #[test]
    fn segments_that_could_name_something_else_are_refused() {
        for bad in ["", "a/b", "a\nb", "a\0"] {
            assert!(matches!(Key::new(["x", bad]), Err(StoreError::InvalidKey { .. })), "{bad:?}");
        }
        assert!(Key::new([]).is_err());
        assert!(Key::new(["_store", "x"]).is_err());
        assert!(Key::new([&*"k".repeat(MAX_KEY_BYTES)]).is_ok());
        assert!(Key::new([&*"k".repeat(MAX_KEY_BYTES + 1)]).is_err());
    }
}
