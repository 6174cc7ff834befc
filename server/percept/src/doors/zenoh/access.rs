//! Who may what over zenoh, which knows no bearer tokens: users by password and certificates by common name, with rules
//! for keys that zenoh itself enforces, made from the same grants as the other doors'.
//!
//! A key has no tenant in it, and a sample does not say who sent it. So sessions of a key are those of the one tenant
//! whose patterns fit; settings in which two tenants' patterns overlap cannot be said in zenoh's terms and are refused.

use super::super::rest::by_name;
use super::query::{QUESTIONS, RPC};
use super::{Failure, ROOT};
use crate::config::Tls;
use percept_identity::{Access, AuthMode, AuthSettings, Grant, Pattern, Principal, random_token};
use percept_service::CallContext;
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::sync::Arc;

/// How zenoh knows somebody.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Known {
    User(String),
    CommonName(String),
}

pub(super) struct Member {
    known: Known,
    tenant: String,
    grant: Grant,
}

/// In whose name what comes by zenoh is done.
pub(super) enum Policy {
    /// Everybody is this one.
    Open(Arc<Principal>),
    /// Only these, each within its grant.
    Members { members: Vec<Member>, users_file: String },
}

impl Policy {
    /// By the settings of all doors.
    ///
    /// # Errors
    /// What cannot be said in zenoh's terms, with the remedy.
    pub(super) fn of(settings: &AuthSettings, endpoint: &str, tls: &Tls) -> Result<Self, Failure> {
        if settings.mode == AuthMode::None {
            return Ok(Self::Open(Arc::new(Principal::anonymous())));
        }
        let users = settings.zenoh_users.iter().map(|u| Member {
            known: Known::User(u.user.clone()),
            tenant: u.tenant.clone(),
            grant: Grant { access: u.access, sessions: u.sessions.clone() },
        });
        let named = settings.certificates.iter().filter_map(|c| match c.subject.split_once(':') {
            Some(("cn", name)) if endpoint.starts_with("tls/") => Some(Member {
                known: Known::CommonName(name.to_owned()),
                tenant: c.tenant.clone(),
                grant: Grant { access: c.access, sessions: c.sessions.clone() },
            }),
            _ => None,
        });
        let named: Vec<Member> = named.collect();
        if !named.is_empty() && !tls.client_cert_required {
            let words = "auth.certificates has rules with cn: and listen.zenoh is a tls/ endpoint, but zenoh asks for \
                         certificates only where they are required: set tls.client_cert_required = true, or close listen.zenoh \
                         with \"\"";
            return Err(words.into());
        }
        let members: Vec<Member> = users.chain(named).collect();
        if members.is_empty() {
            let words = format!(
                "listen.zenoh is {endpoint:?} and auth.mode is \"required\", but zenoh takes neither keys nor tokens: set \
                 auth.zenoh_users, or a tls/ endpoint and auth.certificates with cn:, or close it with \"\""
            );
            return Err(words.into());
        }
        for (i, a) in members.iter().enumerate() {
            let strangers = members[i + 1..].iter().filter(|b| a.tenant != b.tenant);
            if let Some(b) = strangers.into_iter().find(|b| a.grant.sessions.overlaps(&b.grant.sessions)) {
                let words = format!(
                    "over zenoh the tenants {:?} and {:?} cannot be told apart: their sessions {:?} and {:?} overlap; give \
                     each tenant's sessions a prefix of their own, or close listen.zenoh",
                    a.tenant,
                    b.tenant,
                    a.grant.sessions.as_str(),
                    b.grant.sessions.as_str()
                );
                return Err(words.into());
            }
        }
        Ok(Self::Members { members, users_file: settings.zenoh_users_file.clone() })
    }

    /// Says which of the rules lets nobody in.
    pub(super) fn warn(&self, settings: &AuthSettings) {
        let Self::Members { members, .. } = self else { return };
        let has_names = members.iter().any(|m| matches!(m.known, Known::CommonName(_)));
        if has_names && !settings.zenoh_users.is_empty() {
            tracing::warn!("zenoh asks every peer for a user as well: a certificate alone lets nobody in there");
        }
        for rule in settings.certificates.iter().filter(|c| !c.subject.starts_with("cn:")) {
            let subject = &rule.subject;
            tracing::warn!(subject, "zenoh knows certificates by cn: alone; this one has no access there");
        }
    }

    /// In whose name a sample or query about a session is taken. Zenoh has refused what its sender may not do; what
    /// remains to be asked is whose session it is.
    ///
    /// # Errors
    /// The system gives no random bytes.
    pub(super) fn context(&self, session: &str) -> Result<CallContext, percept_service::Error> {
        let principal = match self {
            Self::Open(principal) => Arc::clone(principal),
            Self::Members { members, .. } => {
                let able: Vec<&Member> = members.iter().filter(|m| m.grant.sessions.matches(session)).collect();
                // Without a tenant it is nobody's, and sees nothing.
                Arc::new(principal(able.first().map_or("", |m| &m.tenant), &able))
            }
        };
        in_name_of(principal)
    }

    /// Of everybody, each tenant once.
    ///
    /// # Errors
    /// The system gives no random bytes.
    pub(super) fn contexts(&self) -> Result<Vec<CallContext>, percept_service::Error> {
        let principals = match self {
            Self::Open(principal) => vec![Arc::clone(principal)],
            Self::Members { members, .. } => {
                let tenants: BTreeSet<&str> = members.iter().map(|m| m.tenant.as_str()).collect();
                let of = |tenant: &str| members.iter().filter(|m| m.tenant == tenant).collect::<Vec<_>>();
                tenants.into_iter().map(|tenant| Arc::new(principal(tenant, &of(tenant)))).collect()
            }
        };
        principals.into_iter().map(in_name_of).collect()
    }

    /// Settings of zenoh that enforce it: key and JSON.
    pub(super) fn settings(&self) -> Vec<(&'static str, String)> {
        let Self::Members { members, users_file } = self else { return vec![] };
        let mut settings = vec![("access_control", access_control(members).to_string())];
        if !users_file.is_empty() {
            settings.push(("transport/auth/usrpwd/dictionary_file", Value::from(users_file.as_str()).to_string()));
        }
        settings
    }
}

fn principal(tenant: &str, members: &[&Member]) -> Principal {
    let grants = members.iter().map(|m| m.grant.clone()).collect();
    Principal { name: "zenoh".to_owned(), tenant: tenant.to_owned(), grants, ..Principal::anonymous() }
}

fn in_name_of(principal: Arc<Principal>) -> Result<CallContext, percept_service::Error> {
    let trace = random_token().map_err(percept_service::Error::internal)?;
    Ok(CallContext { principal, deadline: None, trace, peer: "zenoh".to_owned() })
}

/// A pattern as a chunk of a key expression, in zenoh's canonical form.
fn chunk(pattern: &Pattern) -> String {
    let mut parts: Vec<&str> = pattern.as_str().split('*').collect();
    // Stars side by side say what one says.
    let (first, last) = (parts.remove(0), parts.pop());
    let Some(last) = last else { return first.to_owned() };
    let inner = parts.into_iter().filter(|p| !p.is_empty());
    let joined = std::iter::once(first).chain(inner).chain([last]).collect::<Vec<_>>().join("$*");
    if joined == "$*" { "*".to_owned() } else { joined }
}

fn access_control(members: &[Member]) -> Value {
    let everywhere = format!("{ROOT}/**");
    // What the door itself declares is told to everybody who is known; it names no session.
    let declared = ["declare_subscriber", "declare_queryable", "declare_liveliness_subscriber"];
    let mut rules = vec![rule("door", &declared, "egress", &[everywhere])];
    let (mut subjects, mut policies) = (vec![], vec![]);
    for (i, member) in members.iter().enumerate() {
        let session = chunk(&member.grant.sessions);
        let below = format!("{ROOT}/{session}/**");
        let (hears, asks, told) = (format!("hears-{i}"), format!("asks-{i}"), format!("told-{i}"));
        let heard = ["declare_subscriber", "declare_liveliness_subscriber", "liveliness_query"];
        rules.push(rule(&hears, &heard, "ingress", std::slice::from_ref(&below)));
        rules.push(rule(&asks, &["query"], "ingress", &questions(&session, member.grant.access)));
        rules.push(rule(&told, &["put", "reply", "liveliness_token"], "egress", &[below]));
        let mut allowed = vec!["door".to_owned(), hears, asks, told];
        if member.grant.access >= Access::Write {
            let (sends, lives) = (format!("sends-{i}"), format!("lives-{i}"));
            rules.push(rule(&sends, &["put"], "ingress", &[format!("{ROOT}/{session}/*/frame")]));
            rules.push(rule(&lives, &["liveliness_token"], "ingress", &[format!("{ROOT}/{session}/*/alive")]));
            allowed.extend([sends, lives]);
        }
        let subject = format!("member-{i}");
        subjects.push(match &member.known {
            Known::User(name) => json!({"id": subject, "usernames": [name]}),
            Known::CommonName(name) => json!({"id": subject, "cert_common_names": [name]}),
        });
        policies.push(json!({"rules": allowed, "subjects": [subject]}));
    }
    json!({"enabled": true, "default_permission": "deny", "rules": rules, "subjects": subjects, "policies": policies})
}

/// Keys of what somebody with this access may ask of the sessions of a chunk.
fn questions(session: &str, access: Access) -> Vec<String> {
    let rpcs = by_name::all().filter(|rpc| rpc.access <= access).map(|rpc| format!("{RPC}/{}", rpc.name));
    let asked = QUESTIONS.into_iter().map(str::to_owned).chain(rpcs);
    asked.map(|question| format!("{ROOT}/{session}/{question}")).collect()
}

fn rule(id: &str, messages: &[&str], flow: &str, keys: &[String]) -> Value {
    json!({"id": id, "permission": "allow", "flows": [flow], "messages": messages, "key_exprs": keys})
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_identity::{CertificateRule, ZenohUser};

    fn user(name: &str, tenant: &str, access: Access, sessions: &str) -> ZenohUser {
        let sessions = Pattern::new(sessions).unwrap();
        ZenohUser { user: name.to_owned(), tenant: tenant.to_owned(), access, sessions }
    }

    fn settings(users: &[ZenohUser]) -> AuthSettings {
        AuthSettings {
            mode: AuthMode::Required,
            zenoh_users: users.to_vec(),
            zenoh_users_file: "users".to_owned(),
            ..AuthSettings::default()
        }
    }

    #[test]
    fn patterns_are_said_in_zenohs_canonical_form() {
        for (pattern, expected) in [
            ("*", "*"),
            ("robot-7", "robot-7"),
            ("robot-*", "robot-$*"),
            ("*-a", "$*-a"),
            ("a*b*c", "a$*b$*c"),
            ("a**b", "a$*b"),
            ("**", "*"),
        ] {
            let said = chunk(&Pattern::new(pattern).unwrap());
            assert_eq!(said, expected, "{pattern}");
            let key = format!("percept/{said}/pose");
            assert_eq!(zenoh::key_expr::KeyExpr::autocanonize(key.clone()).unwrap().as_str(), key);
        }
    }

    #[test]
    fn an_endpoint_that_knows_nobody_is_refused() {
        let keys = AuthSettings { zenoh_users: vec![], ..settings(&[]) };
        assert!(Policy::of(&keys, "tcp/127.0.0.1:7447", &Tls::default()).is_err());
        let sessions = Pattern::all();
        let subject = "cn:robot-7".to_owned();
        let rule =
            CertificateRule { subject, name: String::new(), tenant: "a".to_owned(), access: Access::Write, sessions };
        let named = AuthSettings { certificates: vec![rule], ..keys };
        let required = Tls { client_cert_required: true, ..Tls::default() };
        assert!(Policy::of(&named, "tcp/127.0.0.1:7447", &required).is_err());
        assert!(Policy::of(&named, "tls/127.0.0.1:7447", &required).is_ok());
        assert!(Policy::of(&named, "tls/127.0.0.1:7447", &Tls::default()).is_err());
    }

    #[test]
    fn tenants_whose_sessions_overlap_are_refused() {
        let two = |a, b| {
            let users = [user("a", "site-a", Access::Write, a), user("b", "site-b", Access::Write, b)];
            Policy::of(&settings(&users), "tcp/127.0.0.1:7447", &Tls::default())
        };
        assert!(two("*", "robot-*").is_err() && two("a-*", "*-7").is_err());
        let policy = two("a-*", "b-*").ok().unwrap();
        let tenant = |session| policy.context(session).unwrap().principal.tenant.clone();
        assert_eq!((tenant("a-1").as_str(), tenant("b-1").as_str(), tenant("c-1").as_str()), ("site-a", "site-b", ""));
        assert!(!policy.context("c-1").unwrap().principal.may_somewhere(Access::Read));
    }

    #[test]
    fn zenoh_takes_the_rules_and_only_writers_may_send() {
        let users = [user("reader", "a", Access::Read, "robot-*"), user("writer", "a", Access::Write, "robot-7")];
        let policy = Policy::of(&settings(&users), "tcp/127.0.0.1:7447", &Tls::default()).ok().unwrap();
        let mut config = zenoh::Config::default();
        for (key, value) in policy.settings() {
            config.insert_json5(key, &value).unwrap();
        }
        let rules: Value = serde_json::from_str(&policy.settings()[0].1).unwrap();
        assert_eq!(rules["default_permission"], "deny");
        let sends: Vec<_> =
            rules["rules"].as_array().unwrap().iter().filter(|r| r["messages"] == json!(["put"])).collect();
        assert_eq!((sends.len(), &sends[0]["key_exprs"]), (1, &json!(["percept/robot-7/*/frame"])));
        let asks: Vec<String> = rules["rules"]
            .as_array()
            .unwrap()
            .iter()
            .filter(|r| r["messages"] == json!(["query"]))
            .map(|r| r["key_exprs"].to_string())
            .collect();
        let may = |i: usize, rpc: &str| asks[i].contains(&format!("/rpc/{rpc}\""));
        assert!(may(0, "LayersService/GetHeights") && !may(0, "SessionsService/SetPose"));
        assert!(may(1, "SessionsService/SetPose") && !may(1, "SessionsService/DeleteSession"));
    }
}
