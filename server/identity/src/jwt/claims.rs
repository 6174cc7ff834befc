//! What a token says, once its signature is believed: issuer, audience, times; name, tenant, grants.

use crate::principal::is_name;
use crate::{Access, Grant, JwtSettings, Pattern, Principal, Reason, Refusal, Standing};
use serde_json::Value;

/// Patterns of one token, at most.
const MAX_PATTERNS: usize = 64;

/// The principal that a payload speaks of.
///
/// # Errors
/// `Invalid`, `Expired`, `NotYetValid`, `WithoutGrant`.
pub(super) fn principal(payload: &[u8], settings: &JwtSettings, now_s: u64) -> Result<Principal, Refusal> {
    let claims: Value = serde_json::from_slice(payload).map_err(|_| Refusal::invalid("the claims are not read"))?;
    if claims.get("iss").and_then(Value::as_str) != Some(settings.issuer.as_str()) {
        return Err(Refusal::invalid("the token is of another issuer"));
    }
    if !texts(claims.get("aud")).contains(&settings.audience.as_str()) {
        return Err(Refusal::invalid("the token is for another audience"));
    }
    let expires_s = expiry(&claims, settings.leeway_s, now_s)?;
    let without = |cause: String| Refusal::new(Reason::WithoutGrant, cause);
    let access = access(claim(&claims, &settings.access_claim))
        .ok_or_else(|| without(format!("the claim {:?} holds no access", settings.access_claim)))?;
    let tenant = match claim(&claims, &settings.tenant_claim) {
        Some(value) => value.as_str(),
        None => Some(settings.default_tenant.as_str()),
    };
    let tenant = tenant
        .filter(|t| is_name(t))
        .ok_or_else(|| without(format!("the claim {:?} holds no tenant", settings.tenant_claim)))?;
    let patterns = patterns(claim(&claims, &settings.sessions_claim))
        .ok_or_else(|| without(format!("the claim {:?} holds no patterns of sessions", settings.sessions_claim)))?;
    let name = claim(&claims, &settings.name_claim).and_then(Value::as_str).unwrap_or_default();
    Ok(Principal {
        name: shown(name),
        tenant: tenant.to_owned(),
        grants: patterns.into_iter().map(|sessions| Grant { access, sessions }).collect(),
        standing: Standing::until(Some(expires_s)),
    })
}

/// When the token ends, leeway included. A token without an end is refused.
fn expiry(claims: &Value, leeway_s: u64, now_s: u64) -> Result<u64, Refusal> {
    // RFC 7519: a number, fractions allowed.
    let time = |name: &str| match claims.get(name) {
        None => Ok(None),
        Some(value) => match value.as_f64() {
            Some(s) if (0.0..1e15).contains(&s) => Ok(Some(s as u64)),
            _ => Err(Refusal::invalid(format!("the claim {name:?} is no time"))),
        },
    };
    let exp = time("exp")?.ok_or_else(|| Refusal::invalid("the token has no end (exp)"))?;
    let end = exp + leeway_s;
    if now_s >= end {
        return Err(Refusal::new(Reason::Expired, format!("the token expired at {exp}")));
    }
    if let Some(begin) = time("nbf")?.filter(|begin| now_s + leeway_s < *begin) {
        return Err(Refusal::new(Reason::NotYetValid, format!("the token begins at {begin}")));
    }
    Ok(end)
}

/// The claim of this name, or the one to which its dots lead.
fn claim<'a>(claims: &'a Value, name: &str) -> Option<&'a Value> {
    if name.is_empty() {
        return None;
    }
    claims.get(name).or_else(|| name.split('.').try_fold(claims, |value, part| value.get(part)))
}

/// A text, or the texts of a list.
fn texts(value: Option<&Value>) -> Vec<&str> {
    match value {
        Some(Value::String(text)) => vec![text],
        Some(Value::Array(list)) => list.iter().filter_map(Value::as_str).collect(),
        _ => vec![],
    }
}

/// The most that the words of a claim give.
fn access(value: Option<&Value>) -> Option<Access> {
    let words = texts(value).into_iter().flat_map(str::split_whitespace);
    words.filter_map(|word| word.strip_prefix("percept:").unwrap_or(word).parse().ok()).max()
}

/// Patterns of a claim: every session if there is no such claim, none at all if one of them is no pattern.
fn patterns(value: Option<&Value>) -> Option<Vec<Pattern>> {
    let Some(value) = value else { return Some(vec![Pattern::all()]) };
    let entries = match value {
        Value::String(_) => 1,
        Value::Array(list) => list.len(),
        _ => return None,
    };
    let words: Vec<&str> = texts(Some(value)).into_iter().flat_map(str::split_whitespace).collect();
    if texts(Some(value)).len() != entries || !(1..=MAX_PATTERNS).contains(&words.len()) {
        return None;
    }
    words.into_iter().map(|word| Pattern::new(word).ok()).collect()
}

/// A provider's name for its user, as a log can hold it.
fn shown(name: &str) -> String {
    let plain = |c: char| if c.is_ascii_graphic() { c } else { '_' };
    let shown: String = name.chars().take(128).map(plain).collect();
    if shown.is_empty() { "unnamed".to_owned() } else { shown }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn settings() -> JwtSettings {
        JwtSettings { issuer: "https://id".to_owned(), ..JwtSettings::default() }
    }

    fn with(changes: Value) -> Value {
        let mut claims = json!({"iss": "https://id", "aud": "percept", "exp": 1000, "sub": "ann",
            "percept_tenant": "site-a", "scope": "openid percept:write"});
        for (name, value) in changes.as_object().unwrap() {
            match value {
                Value::Null => drop(claims.as_object_mut().unwrap().remove(name)),
                value => claims[name] = value.clone(),
            }
        }
        claims
    }

    fn read(changes: Value, now_s: u64) -> Result<Principal, Reason> {
        principal(with(changes).to_string().as_bytes(), &settings(), now_s).map_err(|e| e.reason)
    }

    #[test]
    fn claims_become_name_tenant_and_grants() {
        let p = read(json!({"percept_sessions": ["robot-*", "lift-1"]}), 0).unwrap();
        assert_eq!((p.name.as_str(), p.tenant.as_str()), ("ann", "site-a"));
        assert!(p.may(Access::Write, "robot-7") && p.may(Access::Read, "lift-1") && !p.may(Access::Read, "lift-2"));
        let all = read(json!({"scope": ["read", "admin"], "sub": "a\nb"}), 0).unwrap();
        assert!(all.may(Access::Admin, "x") && all.name == "a_b");
        let mut nested = settings();
        nested.access_claim = "resource_access.percept.roles".to_owned();
        let claims = with(json!({"resource_access": {"percept": {"roles": ["read"]}}})).to_string();
        let p = principal(claims.as_bytes(), &nested, 0).unwrap();
        assert!(p.may(Access::Read, "x") && !p.may(Access::Write, "x"));
    }

    #[test]
    fn a_token_holds_from_its_begin_to_its_end_with_leeway_on_both_sides() {
        assert!(read(json!({}), 1059).is_ok());
        assert_eq!(read(json!({}), 1060).unwrap_err(), Reason::Expired);
        assert!(read(json!({"nbf": 500.5}), 440).is_ok());
        assert_eq!(read(json!({"nbf": 500}), 439).unwrap_err(), Reason::NotYetValid);
        let p = read(json!({}), 0).unwrap();
        assert!(p.standing.holds(1059) && !p.standing.holds(1060));
    }

    #[test]
    fn what_is_meant_for_others_or_says_too_little_is_refused() {
        for (changes, reason) in [
            (json!({"iss": "https://other"}), Reason::Invalid),
            (json!({"iss": null}), Reason::Invalid),
            (json!({"iss": ["https://id"]}), Reason::Invalid),
            (json!({"aud": "other"}), Reason::Invalid),
            (json!({"aud": null}), Reason::Invalid),
            (json!({"aud": ["a", "b"]}), Reason::Invalid),
            (json!({"exp": null}), Reason::Invalid),
            (json!({"exp": "1000"}), Reason::Invalid),
            (json!({"exp": -1}), Reason::Invalid),
            (json!({"exp": 1e300}), Reason::Invalid),
            (json!({"nbf": "x"}), Reason::Invalid),
            (json!({"percept_tenant": null}), Reason::WithoutGrant),
            (json!({"percept_tenant": ""}), Reason::WithoutGrant),
            (json!({"percept_tenant": 7}), Reason::WithoutGrant),
            (json!({"percept_tenant": "a b"}), Reason::WithoutGrant),
            (json!({"scope": null}), Reason::WithoutGrant),
            (json!({"scope": "openid reader"}), Reason::WithoutGrant),
            (json!({"percept_sessions": []}), Reason::WithoutGrant),
            (json!({"percept_sessions": ["a", 1]}), Reason::WithoutGrant),
            (json!({"percept_sessions": "a/b"}), Reason::WithoutGrant),
            (json!({"percept_sessions": {}}), Reason::WithoutGrant),
        ] {
            assert_eq!(read(changes.clone(), 0).unwrap_err(), reason, "{changes}");
        }
        assert!(read(json!({"aud": ["other", "percept"]}), 0).is_ok());
        for payload in [&b""[..], b"[]", b"7", b"{", b"\xff"] {
            assert_eq!(principal(payload, &settings(), 0).unwrap_err().reason, Reason::Invalid);
        }
    }
}
