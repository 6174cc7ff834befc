//! LZF, as PCL uses it for `binary_compressed`.
//!
//! Source: Lehmann, LibLZF's stream format. A control byte below 32 starts `c + 1` literals; otherwise
//! its upper three bits are a length (7: one more byte follows), its lower five and the next byte a distance.

use super::FORMAT;
use crate::{FormatError, Place};

/// Most bytes that one byte of input can become: three bytes copy at most 264.
const MAX_EXPANSION: u64 = 88;

/// `expected` bytes from a stream; the caller has compared `expected` with its limits.
///
/// # Errors
/// `Truncated` if the stream cannot hold or does not give that many bytes, `Malformed` if it gives more or
/// refers to bytes before its start.
pub(super) fn decompress(input: &[u8], expected: usize) -> Result<Vec<u8>, FormatError> {
    let truncated = |available: usize| FormatError::Truncated {
        format: FORMAT,
        field: "compressed data",
        needed: expected as u64,
        available: available as u64,
    };
    if expected as u64 > (input.len() as u64).saturating_mul(MAX_EXPANSION) {
        return Err(truncated(input.len()));
    }
    let malformed =
        |at: usize, expected| FormatError::malformed(FORMAT, Place::Byte(at as u64), "compressed data", b"", expected);
    let mut out = Vec::with_capacity(expected);
    let mut at = 0;
    while at < input.len() {
        let start = at;
        let control = usize::from(input[at]);
        at += 1;
        if control < 32 {
            let literals = input.get(at..at + control + 1).ok_or_else(|| truncated(out.len()))?;
            at += literals.len();
            out.extend_from_slice(literals);
        } else {
            let mut next = || {
                let byte = input.get(at).copied();
                at += 1;
                byte.map(usize::from)
            };
            let mut length = control >> 5;
            if length == 7 {
                length += next().ok_or_else(|| truncated(out.len()))?;
            }
            let distance = ((control & 31) << 8) + next().ok_or_else(|| truncated(out.len()))? + 1;
            let from = out.len().checked_sub(distance).ok_or_else(|| malformed(start, "a distance within the data"))?;
            copy_within(&mut out, from, length + 2);
        }
        if out.len() > expected {
            return Err(malformed(start, "no more data than declared"));
        }
    }
    if out.len() == expected { Ok(out) } else { Err(truncated(out.len())) }
}

/// Most bytes of a copy, and how far back it may reach.
const MAX_LENGTH: usize = 264;
const MAX_DISTANCE: usize = 1 << 13;

/// A stream that [`decompress`] takes back: the newest earlier place with the same three bytes is copied from.
pub(super) fn compress(input: &[u8]) -> Vec<u8> {
    const HASH_BITS: u32 = 14;
    let hash = |b: &[u8]| {
        let key = u32::from_le_bytes([b[0], b[1], b[2], 0]);
        (key.wrapping_mul(0x9e37_79b1) >> (32 - HASH_BITS)) as usize
    };
    // Places are kept plus one, so that 0 is none.
    let mut places = vec![0usize; 1 << HASH_BITS];
    let mut out = Vec::with_capacity(input.len() / 2 + 16);
    let (mut at, mut literals) = (0, 0);
    while at + 3 <= input.len() {
        let place = &mut places[hash(&input[at..at + 3])];
        let from = std::mem::replace(place, at + 1);
        let distance = (at + 1).saturating_sub(from);
        if from == 0 || distance > MAX_DISTANCE || input[from - 1..from + 2] != input[at..at + 3] {
            at += 1;
            continue;
        }
        let limit = MAX_LENGTH.min(input.len() - at);
        let length = (3..limit).find(|&k| input[from - 1 + k] != input[at + k]).unwrap_or(limit);
        append_literals(&mut out, &input[literals..at]);
        let (code, offset) = (length - 2, distance - 1);
        let high = (offset >> 8) as u8;
        if code < 7 {
            out.push(((code as u8) << 5) | high);
        } else {
            out.extend([(7 << 5) | high, (code - 7) as u8]);
        }
        out.push(offset as u8);
        at += length;
        literals = at;
    }
    append_literals(&mut out, &input[literals..]);
    out
}

fn append_literals(out: &mut Vec<u8>, literals: &[u8]) {
    for run in literals.chunks(32) {
        out.push((run.len() - 1) as u8);
        out.extend_from_slice(run);
    }
}

/// Appends `length` bytes from `from` on; they may run into what is being appended.
fn copy_within(out: &mut Vec<u8>, from: usize, length: usize) {
    if from + length <= out.len() {
        out.extend_from_within(from..from + length);
    } else {
        for i in from..from + length {
            out.push(out[i]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn literals_and_overlapping_copies() {
        // "ab", then 5 bytes from distance 2: "ababa".
        assert_eq!(decompress(&[1, b'a', b'b', 3 << 5, 1], 7).unwrap(), b"abababa");
        // A long copy: 7 + 10 + 2 bytes of the one before.
        assert_eq!(decompress(&[0, b'x', 7 << 5, 10, 0], 20).unwrap(), [b'x'; 20]);
    }

    #[test]
    fn broken_streams_are_errors() {
        assert!(matches!(decompress(&[1, b'a', b'b', 3 << 5, 2], 7), Err(FormatError::Malformed { .. })));
        assert!(matches!(decompress(&[1, b'a', b'b', 3 << 5], 7), Err(FormatError::Truncated { .. })));
        assert!(matches!(decompress(&[1, b'a', b'b'], 1), Err(FormatError::Malformed { .. })));
        assert!(matches!(decompress(&[0, b'a'], usize::MAX), Err(FormatError::Truncated { .. })));
    }

    proptest! {
        #[test]
        fn what_is_compressed_comes_back(data in prop::collection::vec(0u8..4, 0..3000), repeat in 1usize..20) {
            let data = data.repeat(repeat);
            prop_assert_eq!(decompress(&compress(&data), data.len()).unwrap(), data);
        }

        #[test]
        fn random_streams_never_panic(input in prop::collection::vec(any::<u8>(), 0..200), expected in 0usize..5000) {
            if let Ok(out) = decompress(&input, expected) {
                prop_assert_eq!(out.len(), expected);
            }
        }
    }
}
