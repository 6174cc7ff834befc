//! Tokens checked with keys that are fetched when they are needed, and not more often than they may be.

use super::claims;
use super::jwk::{KeySet, Unverified};
use super::token::{Algorithm, Token};
use crate::{JwtSettings, Principal, Reason, Refusal};
use std::fs;
use std::future::Future;
use std::path::PathBuf;
use std::pin::Pin;
use std::sync::{Arc, PoisonError, RwLock};
use std::time::{Duration, Instant, SystemTime};
use tokio::sync::Mutex;

/// Fetches the provider's keys: the JWKS as text, or why not.
pub type FetchKeys = Arc<dyn Fn() -> Pin<Box<dyn Future<Output = Result<String, String>> + Send>> + Send + Sync>;

/// Keys are fetched at most once in this time, whatever tokens say: a token may name any key.
const FETCH_PAUSE: Duration = Duration::from_secs(10);
/// Keys older than this are fetched again, so that one that the provider has taken back ends here, too.
const MAX_AGE: Duration = Duration::from_secs(600);

/// What tells one state of the file from another.
type Stamp = (SystemTime, u64);

enum Source {
    File {
        path: PathBuf,
        seen: Option<Stamp>,
        /// The state of the file that was not taken, and why: told once.
        told: Option<(Option<Stamp>, String)>,
    },
    Fetched {
        fetch: FetchKeys,
        tried: Option<Instant>,
        got: Option<Instant>,
    },
}

/// Checks tokens of one issuer.
pub struct JwtVerifier {
    settings: JwtSettings,
    allowed: Vec<Algorithm>,
    keys: RwLock<Arc<KeySet>>,
    /// Locked by the one who fetches; the others wait for what that one gets.
    source: Mutex<Source>,
}

impl JwtVerifier {
    /// With the keys of `jwks_file`, or else with those that `fetch` gets.
    ///
    /// # Errors
    /// The file cannot be read or holds no key.
    pub fn open(settings: &JwtSettings, fetch: FetchKeys) -> Result<Self, String> {
        let (source, keys) = if settings.jwks_file.is_empty() {
            (Source::Fetched { fetch, tried: None, got: None }, KeySet::default())
        } else {
            let path = PathBuf::from(&settings.jwks_file);
            let seen = stamp(&path);
            let keys = read(&path)?;
            (Source::File { path, seen, told: None }, keys)
        };
        Ok(Self {
            settings: settings.clone(),
            allowed: settings.algorithms.iter().filter_map(|a| Algorithm::named(a)).collect(),
            keys: RwLock::new(Arc::new(keys)),
            source: Mutex::new(source),
        })
    }

    /// The holder of a token.
    ///
    /// # Errors
    /// Every [`Reason`] but `Missing` and `Revoked`.
    pub(crate) async fn authenticate(&self, text: &str, now_s: u64) -> Result<Principal, Refusal> {
        let token = Token::parse(text).map_err(Refusal::invalid)?;
        let verified = match self.keys().verify(&token, &self.allowed) {
            Err(Unverified::UnknownKey) => {
                let there_are_some = self.fetch_again().await;
                match self.keys().verify(&token, &self.allowed) {
                    Err(Unverified::UnknownKey) if !there_are_some => {
                        let cause = "no key of the provider could be had";
                        return Err(Refusal::new(Reason::ProviderUnavailable, cause));
                    }
                    outcome => outcome,
                }
            }
            outcome => outcome,
        };
        verified.map_err(|e| match e {
            Unverified::Wrong(cause) => Refusal::invalid(cause),
            Unverified::UnknownKey => Refusal::invalid("the token names a key that the provider does not have"),
        })?;
        claims::principal(&token.payload, &self.settings, now_s)
    }

    fn keys(&self) -> Arc<KeySet> {
        Arc::clone(&self.keys.read().unwrap_or_else(PoisonError::into_inner))
    }

    fn put(&self, keys: KeySet) {
        *self.keys.write().unwrap_or_else(PoisonError::into_inner) = Arc::new(keys);
    }

    /// Fetches the keys if it is time; whether there are any after it.
    async fn fetch_again(&self) -> bool {
        let mut source = self.source.lock().await;
        if let Source::Fetched { fetch, tried, got } = &mut *source
            && tried.is_none_or(|at| at.elapsed() >= FETCH_PAUSE)
        {
            *tried = Some(Instant::now());
            match fetch().await.and_then(|text| KeySet::parse(&text)) {
                Ok(keys) => {
                    tracing::info!(issuer = self.settings.issuer, keys = keys.len(), "identity provider's keys taken");
                    *got = Some(Instant::now());
                    self.put(keys);
                }
                Err(cause) => {
                    tracing::error!(issuer = self.settings.issuer, cause, "identity provider's keys cannot be had");
                }
            }
        }
        !self.keys().is_empty()
    }

    /// Reads the file again if it has changed, and fetches keys that have grown old. Call it every second or so.
    pub async fn refresh(&self) {
        let old = {
            let mut source = self.source.lock().await;
            match &mut *source {
                Source::File { path, seen, told } => {
                    let now = stamp(path);
                    if now != *seen {
                        match read(path) {
                            Ok(keys) => {
                                (*seen, *told) = (now, None);
                                self.put(keys);
                            }
                            // Tried again every time: what was withdrawn in it is not in force yet.
                            Err(cause) => {
                                let why = Some((now, cause));
                                if *told != why {
                                    *told = why;
                                    let cause = told.as_ref().map(|(_, cause)| cause.as_str());
                                    tracing::error!(cause, "auth.jwt.jwks_file is not taken; its last keys stay");
                                }
                            }
                        }
                    }
                    false
                }
                Source::Fetched { got, .. } => got.is_some_and(|at| at.elapsed() >= MAX_AGE),
            }
        };
        if old {
            self.fetch_again().await;
        }
    }
}

fn stamp(path: &PathBuf) -> Option<Stamp> {
    let meta = fs::metadata(path).ok()?;
    Some((meta.modified().ok()?, meta.len()))
}

fn read(path: &PathBuf) -> Result<KeySet, String> {
    let wrong = |problem: String| {
        let shown = path.display();
        format!("jwt.jwks_file is {shown}, which cannot be used: {problem}; give the provider's public keys (JWKS)")
    };
    let text = fs::read_to_string(path).map_err(|e| wrong(e.to_string()))?;
    let keys = KeySet::parse(&text).map_err(wrong)?;
    if keys.is_empty() {
        return Err(wrong("it holds no public key for signatures".to_owned()));
    }
    Ok(keys)
}
