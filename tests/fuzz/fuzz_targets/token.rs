//! Credentials: an identity provider's keys, a zero byte, a header `authorization` with a token.
#![no_main]
use percept_identity::{AuthMode, AuthSettings, Authenticator, Credentials, JwtSettings, bearer};
use std::future::Future;
use std::pin::{Pin, pin};
use std::sync::Arc;
use std::task::{Context, Poll, Waker};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let end = bytes.iter().position(|&b| b == 0).unwrap_or(bytes.len());
    let keys = String::from_utf8_lossy(&bytes[..end]).into_owned();
    let Ok(token) = bearer(&bytes[(end + 1).min(bytes.len())..]) else { return };
    let algorithms = ["RS256", "PS384", "ES256", "ES384", "EdDSA"].map(str::to_owned).to_vec();
    let jwt = JwtSettings { issuer: "https://id".to_owned(), algorithms, ..JwtSettings::default() };
    let settings = AuthSettings { mode: AuthMode::Required, jwt, ..AuthSettings::default() };
    let fetch = Arc::new(move || {
        let keys = keys.clone();
        Box::pin(async move { Ok(keys) }) as Pin<Box<dyn Future<Output = Result<String, String>> + Send>>
    });
    let authenticator = Authenticator::open(&settings, fetch).unwrap();
    let credentials = Credentials { token: Some(token), certificate: None };
    let asked = pin!(authenticator.authenticate(&credentials, 0));
    // Nothing in it waits. No signature can be guessed, so that nobody is ever known.
    let Poll::Ready(outcome) = asked.poll(&mut Context::from_waker(Waker::noop())) else { panic!("it waits") };
    assert!(outcome.is_err());
});
