//! Tokens of an identity provider, true and forged.

use base64::Engine;
use base64::engine::general_purpose::URL_SAFE_NO_PAD as B64;
use percept_identity::{
    Access, AuthMode, AuthSettings, Authenticator, Credentials, JwtSettings, KeySet, Principal, Reason,
    discovered_jwks_url, discovery_url,
};
use proptest::prelude::*;
use ring::rand::SystemRandom;
use ring::signature::{self, EcdsaKeyPair, Ed25519KeyPair, KeyPair, RsaKeyPair};
use serde_json::{Value, json};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

const ISSUER: &str = "https://id.example/site";
const NOW: u64 = 1_000_000;

/// Made for these tests by `openssl genpkey -algorithm RSA -pkeyopt rsa_keygen_bits:2048 -outform DER`; ring makes none.
const RSA_KEY: &[u8] = include_bytes!("rsa-2048.der");

/// A provider with a key of each type.
struct Provider {
    ed: Ed25519KeyPair,
    ec: EcdsaKeyPair,
    rsa: RsaKeyPair,
}

impl Provider {
    fn new() -> Self {
        let random = SystemRandom::new();
        let ed = Ed25519KeyPair::generate_pkcs8(&random).unwrap();
        let curve = &signature::ECDSA_P256_SHA256_FIXED_SIGNING;
        let ec = EcdsaKeyPair::generate_pkcs8(curve, &random).unwrap();
        Self {
            ed: Ed25519KeyPair::from_pkcs8(ed.as_ref()).unwrap(),
            ec: EcdsaKeyPair::from_pkcs8(curve, ec.as_ref(), &random).unwrap(),
            rsa: RsaKeyPair::from_der(RSA_KEY).unwrap(),
        }
    }

    fn modulus(&self) -> Vec<u8> {
        ring::rsa::PublicKeyComponents::<Vec<u8>>::from(self.rsa.public()).n
    }

    fn jwks(&self) -> Value {
        let point = self.ec.public_key().as_ref();
        let rsa = ring::rsa::PublicKeyComponents::<Vec<u8>>::from(self.rsa.public());
        json!({"keys": [
            {"kty": "OKP", "crv": "Ed25519", "kid": "ed", "use": "sig", "x": B64.encode(self.ed.public_key())},
            {"kty": "EC", "crv": "P-256", "kid": "ec", "x": B64.encode(&point[1..33]), "y": B64.encode(&point[33..])},
            {"kty": "RSA", "kid": "rsa", "alg": "RS256", "n": B64.encode(&rsa.n), "e": B64.encode(&rsa.e)},
            {"kty": "RSA", "kid": "any", "n": B64.encode([&[0][..], &rsa.n].concat()), "e": B64.encode(&rsa.e)},
            {"kty": "RSA", "kid": "enc", "use": "enc", "n": B64.encode(&rsa.n), "e": B64.encode(&rsa.e)},
            {"kty": "oct", "kid": "shared", "k": B64.encode("secret")},
            {"kty": "strange"}, 7,
        ]})
    }

    fn sign(&self, alg: &str, signed: &[u8]) -> Vec<u8> {
        let random = SystemRandom::new();
        let rsa = |by: &'static dyn signature::RsaEncoding| {
            let mut out = vec![0; self.rsa.public().modulus_len()];
            self.rsa.sign(by, &random, signed, &mut out).unwrap();
            out
        };
        match alg {
            "EdDSA" => self.ed.sign(signed).as_ref().to_vec(),
            "ES256" => self.ec.sign(&random, signed).unwrap().as_ref().to_vec(),
            "RS256" => rsa(&signature::RSA_PKCS1_SHA256),
            "RS512" => rsa(&signature::RSA_PKCS1_SHA512),
            "PS256" => rsa(&signature::RSA_PSS_SHA256),
            other => panic!("{other}"),
        }
    }

    fn token(&self, alg: &str, kid: &str) -> String {
        signed(&json!({"alg": alg, "kid": kid, "typ": "JWT"}), &claims(), |bytes| self.sign(alg, bytes))
    }
}

fn claims() -> Value {
    json!({"iss": ISSUER, "aud": "percept", "sub": "ann", "exp": NOW + 100, "percept_tenant": "site-a", "scope": "write"})
}

fn signed(header: &Value, claims: &Value, sign: impl Fn(&[u8]) -> Vec<u8>) -> String {
    let text = format!("{}.{}", B64.encode(header.to_string()), B64.encode(claims.to_string()));
    format!("{text}.{}", B64.encode(sign(text.as_bytes())))
}

/// A server whose provider publishes what is in `published`, and how often it was asked.
struct Server {
    authenticator: Authenticator,
    published: Arc<Mutex<Result<String, String>>>,
    asked: Arc<AtomicUsize>,
}

impl Server {
    fn new(provider: &Provider) -> Self {
        Self::with(Ok(provider.jwks().to_string()), &["RS256", "PS256", "ES256", "EdDSA"])
    }

    fn with(published: Result<String, String>, algorithms: &[&str]) -> Self {
        let algorithms = algorithms.iter().map(|a| (*a).to_owned()).collect();
        let jwt = JwtSettings { issuer: ISSUER.to_owned(), algorithms, ..JwtSettings::default() };
        let settings = AuthSettings { mode: AuthMode::Required, jwt, ..AuthSettings::default() };
        let (published, asked) = (Arc::new(Mutex::new(published)), Arc::new(AtomicUsize::new(0)));
        let (from, count) = (Arc::clone(&published), Arc::clone(&asked));
        let fetch = Arc::new(move || {
            count.fetch_add(1, Ordering::SeqCst);
            let answer = from.lock().unwrap().clone();
            Box::pin(async move { answer }) as std::pin::Pin<Box<dyn Future<Output = _> + Send>>
        });
        Self { authenticator: Authenticator::open(&settings, fetch).unwrap(), published, asked }
    }

    async fn known(&self, token: &str) -> Result<Arc<Principal>, Reason> {
        let credentials = Credentials { token: Some(token.to_owned()), certificate: None };
        self.authenticator.authenticate(&credentials, NOW).await.map_err(|e| e.reason)
    }
}

#[tokio::test]
async fn tokens_of_each_type_of_key_are_taken() {
    let provider = Provider::new();
    let server = Server::new(&provider);
    for (alg, kid) in [("EdDSA", "ed"), ("ES256", "ec"), ("RS256", "rsa"), ("RS256", "any"), ("PS256", "any")] {
        let holder = server.known(&provider.token(alg, kid)).await.unwrap();
        assert_eq!((holder.name.as_str(), holder.tenant.as_str()), ("ann", "site-a"), "{alg}");
        assert!(holder.may(Access::Write, "x"));
    }
    // Without the name of a key, each of the type is tried.
    let nameless = signed(&json!({"alg": "EdDSA"}), &claims(), |bytes| provider.sign("EdDSA", bytes));
    assert!(server.known(&nameless).await.is_ok());
    assert_eq!(server.asked.load(Ordering::SeqCst), 1);
}

#[tokio::test]
async fn no_signature_and_shared_secrets_are_never_taken() {
    let provider = Provider::new();
    // Even an operator who lists them does not get them.
    let server = Server::with(Ok(provider.jwks().to_string()), &["RS256", "HS256", "none", "None"]);
    let hmac = |secret: &[u8]| {
        let key = ring::hmac::Key::new(ring::hmac::HMAC_SHA256, secret);
        move |bytes: &[u8]| ring::hmac::sign(&key, bytes).as_ref().to_vec()
    };
    for kid in ["rsa", "ed", "shared", "absent"] {
        for alg in ["none", "None", "NONE", "", "HS256"] {
            let token = signed(&json!({"alg": alg, "kid": kid}), &claims(), |_| vec![]);
            assert_eq!(server.known(&token).await.unwrap_err(), Reason::Invalid, "{alg} {kid}");
        }
        // The provider's public key as the secret, in the forms that attackers try.
        let secrets =
            [provider.modulus(), RSA_KEY.to_vec(), provider.jwks().to_string().into_bytes(), b"secret".to_vec()];
        for secret in secrets {
            for alg in ["HS256", "RS256"] {
                let token = signed(&json!({"alg": alg, "kid": kid}), &claims(), hmac(&secret));
                assert_eq!(server.known(&token).await.unwrap_err(), Reason::Invalid, "{alg} {kid}");
            }
        }
    }
}

#[tokio::test]
async fn a_signature_is_believed_only_by_its_own_key_and_method() {
    let provider = Provider::new();
    let server = Server::with(Ok(provider.jwks().to_string()), &["RS256", "RS512", "PS256", "ES256", "EdDSA"]);
    // Another type of key than the name says; another method than the key is for; a key that is not for signatures.
    for (alg, kid) in [("EdDSA", "rsa"), ("RS256", "ed"), ("ES256", "ed"), ("RS512", "rsa"), ("PS256", "rsa")] {
        assert_eq!(server.known(&provider.token(alg, kid)).await.unwrap_err(), Reason::Invalid, "{alg} {kid}");
    }
    assert_eq!(server.known(&provider.token("RS256", "enc")).await.unwrap_err(), Reason::Invalid);
    assert!(server.known(&provider.token("RS512", "any")).await.is_ok());
    // The header says one method, the signature is of another.
    let crossed = signed(&json!({"alg": "PS256", "kid": "any"}), &claims(), |bytes| provider.sign("RS256", bytes));
    assert_eq!(server.known(&crossed).await.unwrap_err(), Reason::Invalid);
    // Another provider's keys under the same names.
    let stranger = Provider::new();
    for (alg, kid) in [("EdDSA", "ed"), ("ES256", "ec")] {
        assert_eq!(server.known(&stranger.token(alg, kid)).await.unwrap_err(), Reason::Invalid);
    }
    // Allowed by the keys, but not by the operator.
    let strict = Server::with(Ok(provider.jwks().to_string()), &["ES256"]);
    assert_eq!(strict.known(&provider.token("EdDSA", "ed")).await.unwrap_err(), Reason::Invalid);
    assert!(strict.known(&provider.token("ES256", "ec")).await.is_ok());
}

#[tokio::test]
async fn a_token_that_brings_its_own_key_or_demands_more_is_refused() {
    let (provider, forger) = (Provider::new(), Provider::new());
    let server = Server::new(&provider);
    let own = forger.jwks()["keys"][0].clone();
    for header in [
        json!({"alg": "EdDSA", "jwk": own}),
        json!({"alg": "EdDSA", "kid": "ed", "jwk": own}),
        json!({"alg": "EdDSA", "kid": "ed", "jku": "https://evil.example/jwks"}),
        json!({"alg": "EdDSA", "kid": "../../etc/passwd"}),
        json!({"alg": "EdDSA", "kid": ["ed"]}),
        json!(["EdDSA"]),
    ] {
        let token = signed(&header, &claims(), |bytes| forger.sign("EdDSA", bytes));
        assert_eq!(server.known(&token).await.unwrap_err(), Reason::Invalid, "{header}");
    }
    let demanding = json!({"alg": "EdDSA", "kid": "ed", "crit": ["exp"]});
    let token = signed(&demanding, &claims(), |bytes| provider.sign("EdDSA", bytes));
    assert_eq!(server.known(&token).await.unwrap_err(), Reason::Invalid);
}

#[tokio::test]
async fn changed_and_truncated_tokens_are_refused() {
    let provider = Provider::new();
    let server = Server::new(&provider);
    let token = provider.token("EdDSA", "ed");
    let (signed_part, signature) = token.rsplit_once('.').unwrap();
    let header = signed_part.split('.').next().unwrap();
    let more = B64.encode(json!({"scope": "admin"}).to_string());
    for wrong in [
        signed_part.to_owned(),
        format!("{signed_part}."),
        format!("{header}.{more}.{signature}"),
        format!("{header}..{signature}"),
        format!(".{}", token.split_once('.').unwrap().1),
        format!("{token}."),
        format!("{token}="),
        "..".to_owned(),
        format!("{signed_part}.{}", "A".repeat(20_000)),
    ] {
        assert_eq!(server.known(&wrong).await.unwrap_err(), Reason::Invalid, "{wrong}");
    }
    for end in 0..token.len() {
        assert!(server.known(&token[..end]).await.is_err(), "cut at {end}");
    }
}

#[tokio::test]
async fn a_new_key_of_the_provider_is_fetched_once_and_not_at_every_forgery() {
    let provider = Provider::new();
    let server = Server::new(&provider);
    *server.published.lock().unwrap() = Err("down".to_owned());
    assert_eq!(server.known(&provider.token("EdDSA", "ed")).await.unwrap_err(), Reason::ProviderUnavailable);
    let later = Server::new(&provider);
    for i in 0..50 {
        let token = provider.token("EdDSA", &format!("forged-{i}"));
        assert_eq!(later.known(&token).await.unwrap_err(), Reason::Invalid);
    }
    assert_eq!(later.asked.load(Ordering::SeqCst), 1);
    assert!(later.known(&provider.token("EdDSA", "ed")).await.is_ok());
}

#[tokio::test]
async fn keys_of_a_file_are_read_again_when_it_changes() {
    let (old, new) = (Provider::new(), Provider::new());
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("jwks.json");
    std::fs::write(&file, old.jwks().to_string()).unwrap();
    let jwks_file = file.display().to_string();
    let jwt = JwtSettings { issuer: ISSUER.to_owned(), jwks_file, ..JwtSettings::default() };
    let settings = AuthSettings { mode: AuthMode::Required, jwt, ..AuthSettings::default() };
    let authenticator = Authenticator::open(&settings, Arc::new(|| panic!("nothing is fetched"))).unwrap();
    let known = async |token: String| {
        let credentials = Credentials { token: Some(token), certificate: None };
        authenticator.authenticate(&credentials, NOW).await.is_ok()
    };
    assert!(known(old.token("EdDSA", "ed")).await && !known(new.token("EdDSA", "ed")).await);
    // Another length, so that the change shows whatever the resolution of the file's time is.
    std::fs::write(&file, format!("{} ", new.jwks())).unwrap();
    authenticator.refresh_provider().await;
    assert!(!known(old.token("EdDSA", "ed")).await && known(new.token("EdDSA", "ed")).await);
    std::fs::write(&file, "broken").unwrap();
    authenticator.refresh_provider().await;
    assert!(known(new.token("EdDSA", "ed")).await);
}

#[test]
fn an_issuer_is_believed_only_about_itself() {
    assert_eq!(discovery_url("https://id/x/"), "https://id/x/.well-known/openid-configuration");
    let document = |issuer: &str| json!({"issuer": issuer, "jwks_uri": "https://id/keys"}).to_string();
    assert_eq!(discovered_jwks_url("https://id", &document("https://id")).unwrap(), "https://id/keys");
    assert!(discovered_jwks_url("https://id", &document("https://evil")).is_err());
    assert!(discovered_jwks_url("https://id", r#"{"issuer": "https://id"}"#).is_err());
}

proptest! {
    #[test]
    fn no_text_makes_the_reader_fail(text in "[A-Za-z0-9_.-]{0,200}", any in ".{0,100}") {
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        let server = Server::with(Ok("{\"keys\": []}".to_owned()), &["RS256"]);
        runtime.block_on(async {
            assert!(server.known(&text).await.is_err());
            assert!(server.known(&any).await.is_err());
        });
        let _ = KeySet::parse(&any);
    }
}
