//! Patterns of session ids: literal characters, and `*` for any number of any.

use serde::{Deserialize, Serialize};
use std::fmt;

/// Characters of a pattern, at most: those of an id.
const MAX_LEN: usize = 64;

/// Which session ids a grant is for, such as `robot-7*`.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Pattern(String);

/// A text that is no pattern.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("sessions is {0:?}; write 1 to 64 characters of a-z A-Z 0-9 _ - and * for any others")]
pub struct PatternError(String);

impl Pattern {
    /// Reads a pattern.
    ///
    /// # Errors
    /// Empty, too long, or with characters that no id has.
    pub fn new(text: &str) -> Result<Self, PatternError> {
        let fine = |b: u8| b.is_ascii_alphanumeric() || b"_-*".contains(&b);
        if (1..=MAX_LEN).contains(&text.len()) && text.bytes().all(fine) {
            return Ok(Self(text.to_owned()));
        }
        Err(PatternError(text.chars().take(80).collect()))
    }

    /// The pattern of every session.
    pub fn all() -> Self {
        Self("*".to_owned())
    }

    /// As it was written.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// Whether `id` fits. Linear in both: where the newest `*` fails, it takes one character more.
    pub fn matches(&self, id: &str) -> bool {
        let (pattern, id) = (self.0.as_bytes(), id.as_bytes());
        let (mut p, mut i) = (0, 0);
        let mut star: Option<(usize, usize)> = None;
        while i < id.len() {
            if pattern.get(p) == Some(&b'*') {
                star = Some((p, i));
                p += 1;
            } else if pattern.get(p) == Some(&id[i]) {
                p += 1;
                i += 1;
            } else if let Some((at, taken)) = star {
                star = Some((at, taken + 1));
                p = at + 1;
                i = taken + 1;
            } else {
                return false;
            }
        }
        pattern[p..].iter().all(|&b| b == b'*')
    }

    /// Whether some id fits both.
    pub fn overlaps(&self, other: &Self) -> bool {
        let (a, b) = (self.0.as_bytes(), other.0.as_bytes());
        // reach[j]: the first characters of `a` that were looked at and the first j of `b` have a text in common.
        let mut reach = vec![false; b.len() + 1];
        reach[0] = true;
        for j in 0..b.len() {
            reach[j + 1] = reach[j] && b[j] == b'*';
        }
        for &x in a {
            let mut next = vec![false; b.len() + 1];
            next[0] = reach[0] && x == b'*';
            for (j, &y) in b.iter().enumerate() {
                // A star takes nothing, or one character more of the other.
                let star = (x == b'*' || y == b'*') && (reach[j + 1] || next[j]);
                next[j + 1] = star || (x == y && reach[j]);
            }
            reach = next;
        }
        reach[b.len()]
    }
}

impl TryFrom<String> for Pattern {
    type Error = PatternError;

    fn try_from(text: String) -> Result<Self, PatternError> {
        Self::new(&text)
    }
}

impl From<Pattern> for String {
    fn from(pattern: Pattern) -> Self {
        pattern.0
    }
}

impl fmt::Display for Pattern {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn pattern(text: &str) -> Pattern {
        Pattern::new(text).unwrap()
    }

    #[test]
    fn a_star_stands_for_any_characters_and_all_else_for_itself() {
        for (text, fitting, other) in [
            ("robot-7", &["robot-7"][..], &["robot-70", "arobot-7", "ROBOT-7", ""][..]),
            ("robot-*", &["robot-", "robot-7", "robot-7-a"], &["robot", "xrobot-7"]),
            ("*-a", &["-a", "x-a", "-a-a"], &["-ab", "a"]),
            ("a*b*c", &["abc", "axbxc", "abbcc", "abcbc"], &["acb", "abcx"]),
            ("*", &["", "x"], &[]),
        ] {
            assert!(fitting.iter().all(|id| pattern(text).matches(id)), "{text}");
            assert!(!other.iter().any(|id| pattern(text).matches(id)), "{text}");
        }
    }

    #[test]
    fn what_no_id_can_have_is_refused() {
        for bad in ["", "a/b", "a b", "ü", "a?", "[a]", &"x".repeat(65)] {
            assert!(Pattern::new(bad).is_err(), "{bad}");
        }
        assert!(Pattern::new(&"x".repeat(64)).is_ok());
    }

    /// The definition: `*` takes nothing, or one character and stays.
    fn plainly(pattern: &[u8], id: &[u8]) -> bool {
        match (pattern.split_first(), id.split_first()) {
            (None, None) => true,
            (Some((b'*', rest)), _) if plainly(rest, id) => true,
            (Some((b'*', _)), Some((_, tail))) => plainly(pattern, tail),
            (Some((x, rest)), Some((y, tail))) => x == y && plainly(rest, tail),
            _ => false,
        }
    }

    proptest! {
        #[test]
        fn matching_is_as_defined(text in "[ab*]{1,8}", id in "[ab]{0,8}") {
            prop_assert_eq!(pattern(&text).matches(&id), plainly(text.as_bytes(), id.as_bytes()));
        }

        #[test]
        fn patterns_overlap_where_one_id_fits_both(a in "[ab*]{1,6}", b in "[ab*]{1,6}", id in "[ab]{0,8}") {
            let (a, b) = (pattern(&a), pattern(&b));
            prop_assert_eq!(a.overlaps(&b), b.overlaps(&a));
            if a.matches(&id) && b.matches(&id) {
                prop_assert!(a.overlaps(&b));
            }
        }
    }

    #[test]
    fn disjoint_patterns_do_not_overlap() {
        for (a, b) in [("robot-*", "lift-*"), ("a*b", "a*c"), ("a", "b"), ("a", "a-*")] {
            assert!(!pattern(a).overlaps(&pattern(b)), "{a} {b}");
        }
        for (a, b) in [("robot-*", "*-7"), ("*", "x"), ("a*", "*b"), ("a", "a*")] {
            assert!(pattern(a).overlaps(&pattern(b)), "{a} {b}");
        }
    }
}
