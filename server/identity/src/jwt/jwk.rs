//! An identity provider's public keys (JWKS, RFC 7517).

use super::token::{Algorithm, Token};
use base64::Engine;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use ring::signature as ring_sig;
use serde::Deserialize;

/// More keys than any provider has; beyond it the set is refused.
const MAX_KEYS: usize = 1000;

#[derive(Debug, Clone, PartialEq, Eq)]
enum Material {
    Rsa { n: Vec<u8>, e: Vec<u8> },
    P256(Vec<u8>),
    P384(Vec<u8>),
    Ed25519(Vec<u8>),
}

impl Material {
    /// Whether a key of this type makes such signatures.
    fn makes(&self, algorithm: Algorithm) -> bool {
        use Algorithm as A;
        match self {
            Self::Rsa { .. } => {
                matches!(algorithm, A::Rs256 | A::Rs384 | A::Rs512 | A::Ps256 | A::Ps384 | A::Ps512)
            }
            Self::P256(_) => algorithm == A::Es256,
            Self::P384(_) => algorithm == A::Es384,
            Self::Ed25519(_) => algorithm == A::EdDsa,
        }
    }

    fn verify(&self, algorithm: Algorithm, signed: &[u8], signature: &[u8]) -> bool {
        use Algorithm as A;
        let unparsed = |by: &'static dyn ring_sig::VerificationAlgorithm, key: &[u8]| {
            ring_sig::UnparsedPublicKey::new(by, key).verify(signed, signature).is_ok()
        };
        match self {
            Self::Rsa { n, e } => {
                let by = match algorithm {
                    A::Rs256 => &ring_sig::RSA_PKCS1_2048_8192_SHA256,
                    A::Rs384 => &ring_sig::RSA_PKCS1_2048_8192_SHA384,
                    A::Rs512 => &ring_sig::RSA_PKCS1_2048_8192_SHA512,
                    A::Ps256 => &ring_sig::RSA_PSS_2048_8192_SHA256,
                    A::Ps384 => &ring_sig::RSA_PSS_2048_8192_SHA384,
                    A::Ps512 => &ring_sig::RSA_PSS_2048_8192_SHA512,
                    A::Es256 | A::Es384 | A::EdDsa => return false,
                };
                ring_sig::RsaPublicKeyComponents { n, e }.verify(by, signed, signature).is_ok()
            }
            Self::P256(point) => algorithm == A::Es256 && unparsed(&ring_sig::ECDSA_P256_SHA256_FIXED, point),
            Self::P384(point) => algorithm == A::Es384 && unparsed(&ring_sig::ECDSA_P384_SHA384_FIXED, point),
            Self::Ed25519(key) => algorithm == A::EdDsa && unparsed(&ring_sig::ED25519, key),
        }
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
struct Key {
    kid: Option<String>,
    /// The one algorithm that the provider means it for, if it says so.
    only: Option<Algorithm>,
    material: Material,
}

/// A provider's public keys.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct KeySet {
    keys: Vec<Key>,
}

#[derive(Deserialize)]
struct Jwks {
    keys: Vec<serde_json::Value>,
}

/// Fields of all types of keys.
#[derive(Deserialize)]
struct Jwk {
    kty: String,
    kid: Option<String>,
    #[serde(rename = "use")]
    purpose: Option<String>,
    key_ops: Option<Vec<String>>,
    alg: Option<String>,
    crv: Option<String>,
    n: Option<String>,
    e: Option<String>,
    x: Option<String>,
    y: Option<String>,
}

/// Why no key took a token.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Unverified {
    /// The signature is not allowed, not of a key's type, or wrong.
    Wrong(&'static str),
    /// The provider may have a key by now that is not here.
    UnknownKey,
}

impl KeySet {
    /// Reads a set. Keys that check no signatures, or of types that are not known here, are left out, shared secrets
    /// among them.
    ///
    /// # Errors
    /// What is wrong with the set as a whole.
    pub fn parse(text: &str) -> Result<Self, String> {
        let jwks: Jwks = serde_json::from_str(text).map_err(|e| format!("the keys are no JWKS: {e}"))?;
        if jwks.keys.len() > MAX_KEYS {
            return Err(format!("there are {} keys, the limit is {MAX_KEYS}", jwks.keys.len()));
        }
        let keys = jwks.keys.into_iter().filter_map(|value| key(serde_json::from_value(value).ok()?)).collect();
        Ok(Self { keys })
    }

    /// How many keys can be used.
    pub fn len(&self) -> usize {
        self.keys.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.keys.is_empty()
    }

    /// Checks a token's signature. Of keys without a name, and for tokens that name none, each of the right type is
    /// tried: a signature that fits one of the provider's keys is the provider's.
    pub(super) fn verify(&self, token: &Token, allowed: &[Algorithm]) -> Result<(), Unverified> {
        let named = Algorithm::named(&token.header.alg).filter(|a| allowed.contains(a));
        let algorithm = named.ok_or(Unverified::Wrong("the signature's algorithm is not allowed"))?;
        let kid = token.header.kid.as_deref();
        let meant: Vec<&Key> =
            self.keys.iter().filter(|k| kid.is_none() || k.kid.is_none() || k.kid.as_deref() == kid).collect();
        if meant.is_empty() {
            return Err(Unverified::UnknownKey);
        }
        let fits = |k: &&&Key| k.material.makes(algorithm) && k.only.is_none_or(|only| only == algorithm);
        let mut able = meant.iter().filter(fits).peekable();
        if able.peek().is_none() {
            return Err(Unverified::Wrong("the key makes other signatures"));
        }
        match able.any(|k| k.material.verify(algorithm, token.signed, &token.signature)) {
            true => Ok(()),
            // Providers that do not name their keys change them all the same.
            false if meant.iter().all(|k| k.kid.is_none()) => Err(Unverified::UnknownKey),
            false => Err(Unverified::Wrong("the signature is wrong")),
        }
    }
}

fn key(jwk: Jwk) -> Option<Key> {
    let for_signatures = jwk.purpose.as_deref().is_none_or(|u| u == "sig")
        && jwk.key_ops.as_ref().is_none_or(|ops| ops.iter().any(|op| op == "verify"));
    if !for_signatures {
        return None;
    }
    let bytes = |field: &Option<String>| URL_SAFE_NO_PAD.decode(field.as_deref()?).ok();
    // Some write integers with leading zeros, which ring takes for a mistake.
    let integer = |field: &Option<String>| {
        let bytes = bytes(field)?;
        Some(bytes[bytes.iter().position(|&b| b != 0)?..].to_vec())
    };
    let point = |size: usize| {
        let (x, y) = (bytes(&jwk.x)?, bytes(&jwk.y)?);
        (x.len() == size && y.len() == size).then(|| [&[4][..], &x, &y].concat())
    };
    let material = match (jwk.kty.as_str(), jwk.crv.as_deref()) {
        ("RSA", _) => Material::Rsa { n: integer(&jwk.n)?, e: integer(&jwk.e)? },
        ("EC", Some("P-256")) => Material::P256(point(32)?),
        ("EC", Some("P-384")) => Material::P384(point(48)?),
        ("OKP", Some("Ed25519")) => Material::Ed25519(bytes(&jwk.x).filter(|x| x.len() == 32)?),
        _ => return None,
    };
    let only = match jwk.alg.as_deref() {
        None => None,
        Some(name) => Some(Algorithm::named(name).filter(|a| material.makes(*a))?),
    };
    Some(Key { kid: jwk.kid, only, material })
}
