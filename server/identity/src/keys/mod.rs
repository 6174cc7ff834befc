//! Keys that percept makes: `pk_<id>_<secret>`, the secret 256 random bits, shown once.
//!
//! Kept is the SHA-256 of the whole text. A slow hash protects secrets that people choose, which can be guessed; of 256
//! random bits not even a fast hash can be searched, and a slow one would cost every request. The digests are
//! compared in constant time.

pub(crate) mod file;
pub(crate) mod ring;

use crate::random::{RandomError, random_bytes};
use base64::Engine;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;

/// What every key begins with, so that scanners of leaked secrets can know one.
pub(crate) const PREFIX: &str = "pk_";
/// Characters of an id: 48 bits in hex.
const ID_LEN: usize = 12;

/// SHA-256 of a key's whole text.
pub(crate) fn digest(text: &str) -> [u8; 32] {
    let mut out = [0; 32];
    out.copy_from_slice(::ring::digest::digest(&::ring::digest::SHA256, text.as_bytes()).as_ref());
    out
}

/// Lower-case hex.
pub(crate) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

/// Bytes of hex of both cases; none if it is not 32 of them.
pub(crate) fn unhex32(text: &str) -> Option<[u8; 32]> {
    if text.len() != 64 || !text.bytes().all(|b| b.is_ascii_hexdigit()) {
        return None;
    }
    let mut out = [0; 32];
    for (byte, pair) in out.iter_mut().zip(text.as_bytes().chunks(2)) {
        *byte = u8::from_str_radix(std::str::from_utf8(pair).ok()?, 16).ok()?;
    }
    Some(out)
}

/// A new id and the text of its key.
pub(crate) fn fresh() -> Result<(String, String), RandomError> {
    let id = hex(&random_bytes::<{ ID_LEN / 2 }>()?);
    let text = format!("{PREFIX}{id}_{}", URL_SAFE_NO_PAD.encode(random_bytes::<32>()?));
    Ok((id, text))
}

/// The id in a key's text; none if it is no key.
pub(crate) fn id_of(text: &str) -> Option<&str> {
    let (id, secret) = text.strip_prefix(PREFIX)?.split_once('_')?;
    let fine = id.len() == ID_LEN && secret.len() == 43 && id.bytes().all(|b| b.is_ascii_hexdigit());
    fine.then_some(id)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fresh_key_has_its_id_in_it_and_256_bits_behind() {
        let (id, text) = fresh().unwrap();
        assert_eq!(id_of(&text), Some(id.as_str()));
        let secret = text.strip_prefix(&format!("pk_{id}_")).unwrap();
        assert_eq!(URL_SAFE_NO_PAD.decode(secret).unwrap().len(), 32);
        assert_ne!(fresh().unwrap().1, text);
    }

    #[test]
    fn what_is_no_key_has_no_id() {
        let (_, text) = fresh().unwrap();
        for bad in ["", "pk_", "pk__", "pk_0123_x", &text[..text.len() - 1], &format!("{text}x"), &text[1..]] {
            assert_eq!(id_of(bad), None, "{bad}");
        }
    }

    #[test]
    fn the_digest_is_sha256() {
        // FIPS 180-4, example B.1.
        let abc = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(hex(&digest("abc")), abc);
        assert_eq!(unhex32(abc), Some(digest("abc")));
        assert_eq!(unhex32(&abc[2..]), None);
        assert_eq!(unhex32(&"+1".repeat(32)), None);
    }
}
