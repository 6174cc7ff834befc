//! Parts of a file (RFC 9110, section 14) and entity tags (section 13).

use std::ops::Range;

/// What a `Range` header asks for.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Asked {
    /// Everything: no range, more than one, or one that is none; the standard lets a server ignore those.
    Whole,
    /// These bytes, at least one.
    Part(Range<usize>),
    /// Bytes that the file does not have.
    Unsatisfiable,
}

/// What `header` asks of a file of `size` bytes.
pub(super) fn asked(header: Option<&str>, size: usize) -> Asked {
    let read = header.and_then(|h| h.trim().strip_prefix("bytes=")).and_then(|spec| spec.trim().split_once('-'));
    let Some((first, last)) = read else { return Asked::Whole };
    let number = |text: &str| {
        let digits = !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit());
        // More digits than a usize holds lie beyond any file.
        digits.then(|| text.parse().unwrap_or(usize::MAX))
    };
    let (start, end) = match (number(first), number(last)) {
        (Some(first), Some(last)) if first <= last => (first, last.saturating_add(1).min(size)),
        (Some(first), None) if last.is_empty() => (first, size),
        (None, Some(suffix)) if first.is_empty() => (size.saturating_sub(suffix), size),
        _ => return Asked::Whole,
    };
    if start < end { Asked::Part(start..end) } else { Asked::Unsatisfiable }
}

/// Whether a list of entity tags, as in `If-None-Match`, holds `tag` (weak comparison).
pub(super) fn holds(list: &str, tag: &str) -> bool {
    let mut tags = list.split(',').map(|t| t.trim().trim_start_matches("W/"));
    list.trim() == "*" || tags.any(|t| t == tag)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_read_as_the_standard_says() {
        let part = |h, range| assert_eq!(asked(Some(h), 10), Asked::Part(range), "{h}");
        part("bytes=0-0", 0..1);
        part("bytes=2-5", 2..6);
        part("bytes=2-", 2..10);
        part("bytes=-3", 7..10);
        part("bytes=-30", 0..10);
        part("bytes=9-99999999999999999999999", 9..10);
        for whole in ["bytes=5-2", "bytes=0-1,3-4", "lines=1-2", "bytes=-", "bytes=a-b", "bytes=+1-2", ""] {
            assert_eq!(asked(Some(whole), 10), Asked::Whole, "{whole}");
        }
        assert_eq!(asked(None, 10), Asked::Whole);
        for beyond in ["bytes=10-", "bytes=10-20", "bytes=-0"] {
            assert_eq!(asked(Some(beyond), 10), Asked::Unsatisfiable, "{beyond}");
        }
        assert_eq!(asked(Some("bytes=0-"), 0), Asked::Unsatisfiable);
    }

    #[test]
    fn tags_are_found_in_lists() {
        for list in ["*", "\"a\"", "\"b\", \"a\"", "W/\"a\""] {
            assert!(holds(list, "\"a\""), "{list}");
        }
        assert!(!holds("\"ab\"", "\"a\""));
        assert!(!holds("", "\"a\""));
    }
}
