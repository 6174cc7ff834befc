//! What sessions may be called and labelled.

use crate::{Error, Result, reason};
use std::collections::BTreeMap;

/// Labels of a session, at most.
const MAX_LABELS: usize = 32;
/// Characters of a label's key, and of its value, at most.
const MAX_LABEL_CHARS: usize = 63;
/// Characters of a display name, at most.
const MAX_DISPLAY_NAME_CHARS: usize = 256;

/// Checks a name for people.
///
/// # Errors
/// `DISPLAY_NAME_INVALID`.
pub(crate) fn check_display_name(name: &str) -> Result<()> {
    let count = name.chars().count();
    if count <= MAX_DISPLAY_NAME_CHARS && !name.chars().any(char::is_control) {
        return Ok(());
    }
    let words = format!(
        "display_name has {count} characters, or control characters; use up to {MAX_DISPLAY_NAME_CHARS} that can be shown"
    );
    Err(Error::invalid(reason::DISPLAY_NAME_INVALID, "display_name", words))
}

/// Checks labels: they have to fit into a selector, a query and a file name.
///
/// # Errors
/// `LABELS_INVALID`, `TOO_MANY_LABELS`.
pub(crate) fn check_labels(labels: &BTreeMap<String, String>) -> Result<()> {
    if labels.len() > MAX_LABELS {
        let words = format!("{} labels, the limit is {MAX_LABELS}", labels.len());
        return Err(Error::invalid(reason::TOO_MANY_LABELS, "labels", words));
    }
    let fine = |text: &str, more: &[u8]| {
        text.len() <= MAX_LABEL_CHARS && text.bytes().all(|b| b.is_ascii_alphanumeric() || more.contains(&b))
    };
    for (key, value) in labels {
        if key.is_empty() || !fine(key, b"_-./") || !fine(value, b"_-.:") {
            let shown: String = format!("{key}={value}").chars().take(140).collect();
            let words = format!(
                "label {shown:?} does not do; use up to {MAX_LABEL_CHARS} characters of a-z A-Z 0-9 _ - . and, in keys, /, \
                 in values, :"
            );
            return Err(Error::invalid(reason::LABELS_INVALID, "labels", words));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_are_checked_at_both_sides_of_their_limits() {
        let label = |k: &str, v: &str| check_labels(&BTreeMap::from([(k.to_owned(), v.to_owned())]));
        assert!(label("site.example/hall", "north:2").is_ok());
        assert!(label(&"k".repeat(63), "").is_ok());
        for (k, v) in [("", "x"), (&"k".repeat(64), ""), ("a b", ""), ("a", "b,c"), ("a=b", "c"), ("a", "ü")] {
            assert_eq!(label(k, v).unwrap_err().reason, "LABELS_INVALID", "{k} {v}");
        }
        let many = |n: usize| check_labels(&(0..n).map(|i| (i.to_string(), String::new())).collect());
        assert!(many(32).is_ok());
        assert_eq!(many(33).unwrap_err().reason, "TOO_MANY_LABELS");
    }
}
