//! Who a caller turned out to be, and what that one may do.

use crate::Pattern;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Tenant of those who are not asked who they are, and of sessions from before there were tenants.
pub const DEFAULT_TENANT: &str = "default";

/// What may be done; each includes the ones before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Access {
    /// Ask: poses, maps, objects, paths, watches.
    Read,
    /// Change: create, declare, send frames, veto; and compute with the toolbox.
    Write,
    /// Take away and maintain: delete, work on the store, metrics.
    Admin,
}

impl Access {
    /// As it is written.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Read => "read",
            Self::Write => "write",
            Self::Admin => "admin",
        }
    }
}

impl fmt::Display for Access {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Access {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let all = [Self::Read, Self::Write, Self::Admin];
        let found = all.into_iter().find(|a| a.name() == text);
        found.ok_or_else(|| format!("{text:?} is no access; write read, write or admin"))
    }
}

/// Access to the sessions that fit a pattern, among those of the holder's tenant.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Grant {
    /// What may be done.
    pub access: Access,
    /// With which sessions.
    pub sessions: Pattern,
}

/// Whether credentials still hold: asked again by calls that go on for long.
#[derive(Debug, Default)]
pub struct Standing {
    /// Shared by all that a rule lets in.
    revoked: Arc<AtomicBool>,
    expires_s: Option<u64>,
}

impl Standing {
    /// Until `expires_s` (seconds since the Unix epoch; none: for good), or until revoked.
    pub fn until(expires_s: Option<u64>) -> Arc<Self> {
        Self::under(&Arc::default(), expires_s)
    }

    /// The same, under something that is revoked for many at once.
    pub(crate) fn under(revoked: &Arc<AtomicBool>, expires_s: Option<u64>) -> Arc<Self> {
        Arc::new(Self { revoked: Arc::clone(revoked), expires_s })
    }

    pub(crate) fn revoke(&self) {
        self.revoked.store(true, Ordering::Relaxed);
    }

    /// Whether they hold at `now_s`.
    pub fn holds(&self, now_s: u64) -> bool {
        !self.revoked.load(Ordering::Relaxed) && self.expires_s.is_none_or(|end| now_s < end)
    }
}

/// Who calls.
#[derive(Debug, Clone)]
pub struct Principal {
    /// For people and the audit log: a key's name, a token's subject, a certificate's name.
    pub name: String,
    /// Whose sessions it can see at all.
    pub tenant: String,
    /// What it may do.
    pub grants: Vec<Grant>,
    /// Whether it still may.
    pub standing: Arc<Standing>,
}

impl Principal {
    /// The one that everybody is where nobody is asked: admin of the tenant `default`.
    pub fn anonymous() -> Self {
        Self {
            name: "anonymous".to_owned(),
            tenant: DEFAULT_TENANT.to_owned(),
            grants: vec![Grant { access: Access::Admin, sessions: Pattern::all() }],
            standing: Arc::default(),
        }
    }

    /// Whether it may do `access` with a session of its tenant.
    pub fn may(&self, access: Access, session: &str) -> bool {
        self.grants.iter().any(|g| g.access >= access && g.sessions.matches(session))
    }

    /// Whether it may do `access` at all: for what belongs to no session.
    pub fn may_somewhere(&self, access: Access) -> bool {
        self.grants.iter().any(|g| g.access >= access)
    }

    /// Whether it may do `access` with every session: for what shows all of them.
    pub fn may_everywhere(&self, access: Access) -> bool {
        self.grants.iter().any(|g| g.access >= access && g.sessions == Pattern::all())
    }
}

/// A name for a person or machine, or of a tenant: 1 to 64 characters that a log line and a file can hold.
pub(crate) fn is_name(text: &str) -> bool {
    (1..=64).contains(&text.len()) && text.bytes().all(|b| b.is_ascii_alphanumeric() || b"_-.@:/".contains(&b))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with(grants: &[(Access, &str)]) -> Principal {
        let grant =
            |(access, sessions): &(Access, &str)| Grant { access: *access, sessions: Pattern::new(sessions).unwrap() };
        Principal { grants: grants.iter().map(grant).collect(), ..Principal::anonymous() }
    }

    #[test]
    fn more_includes_less_and_never_the_other_way() {
        let writer = with(&[(Access::Write, "robot-*")]);
        assert!(writer.may(Access::Read, "robot-7") && writer.may(Access::Write, "robot-7"));
        assert!(!writer.may(Access::Admin, "robot-7"));
        assert!(!writer.may(Access::Read, "lift-1"));
    }

    #[test]
    fn each_grant_stands_for_itself() {
        let mixed = with(&[(Access::Read, "*"), (Access::Write, "a")]);
        assert!(mixed.may(Access::Read, "b") && mixed.may(Access::Write, "a"));
        assert!(!mixed.may(Access::Write, "b"));
        assert!(mixed.may_somewhere(Access::Write) && !mixed.may_somewhere(Access::Admin));
        assert!(mixed.may_everywhere(Access::Read) && !mixed.may_everywhere(Access::Write));
        assert!(!with(&[]).may_somewhere(Access::Read));
    }

    #[test]
    fn a_standing_ends_at_its_second_or_when_revoked() {
        let standing = Standing::until(Some(10));
        assert!(standing.holds(9) && !standing.holds(10));
        let kept = Standing::until(None);
        assert!(kept.holds(u64::MAX));
        kept.revoke();
        assert!(!kept.holds(0));
    }
}
