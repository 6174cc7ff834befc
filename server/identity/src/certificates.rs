//! Principals by the names in their certificates.

use crate::{CertificateRule, Grant, Principal, Reason, Refusal, Standing};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Names in a client's certificate, which the transport has verified.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct CertificateNames {
    /// Common name of the subject.
    pub common_name: Option<String>,
    /// DNS names among the alternative names.
    pub dns: Vec<String>,
    /// URIs among the alternative names, such as SPIFFE ids.
    pub uris: Vec<String>,
    /// When it ends, seconds since the Unix epoch; none: never. A connection may outlive it.
    pub expires_s: Option<u64>,
}

impl CertificateNames {
    /// Whether `subject`, such as `cn:robot-7`, is one of them.
    fn has(&self, subject: &str) -> bool {
        match subject.split_once(':') {
            Some(("cn", name)) => self.common_name.as_deref() == Some(name),
            // RFC 4343: names of hosts do not differ in case.
            Some(("dns", name)) => self.dns.iter().any(|n| n.eq_ignore_ascii_case(name)),
            Some(("uri", name)) => self.uris.iter().any(|n| n == name),
            _ => false,
        }
    }
}

/// Rules in force.
#[derive(Debug, Default)]
pub(crate) struct Rules(Vec<(CertificateRule, Arc<AtomicBool>)>);

impl Rules {
    /// Puts others in force. Calls that go on under a rule that is gone, or has changed in any way, lose their standing.
    pub(crate) fn replace(&mut self, rules: &[CertificateRule]) {
        let mut old = std::mem::take(&mut self.0);
        for rule in rules {
            let same = old.iter().position(|(r, _)| r == rule);
            let revoked = same.map(|k| old.swap_remove(k).1).unwrap_or_default();
            self.0.push((rule.clone(), revoked));
        }
        old.iter().for_each(|(_, revoked)| revoked.store(true, Ordering::Relaxed));
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The principal of the first rule that fits.
    ///
    /// # Errors
    /// `WithoutGrant`.
    pub(crate) fn principal(&self, names: &CertificateNames) -> Result<Principal, Refusal> {
        let (rule, revoked) = self.0.iter().find(|(rule, _)| names.has(&rule.subject)).ok_or_else(|| {
            let shown = names.common_name.as_deref().unwrap_or_default();
            Refusal::new(Reason::WithoutGrant, format!("no rule for the certificate with the common name {shown:?}"))
        })?;
        let name = rule.subject.split_once(':').map_or("", |(_, name)| name);
        Ok(Principal {
            name: if rule.name.is_empty() { name.to_owned() } else { rule.name.clone() },
            tenant: rule.tenant.clone(),
            grants: vec![Grant { access: rule.access, sessions: rule.sessions.clone() }],
            standing: Standing::under(revoked, names.expires_s),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Access, Pattern};

    fn rule(subject: &str, name: &str) -> CertificateRule {
        let sessions = Pattern::new("robot-*").unwrap();
        CertificateRule {
            subject: subject.to_owned(),
            name: name.to_owned(),
            tenant: "site-a".to_owned(),
            access: Access::Write,
            sessions,
        }
    }

    #[test]
    fn a_certificate_is_known_by_any_of_its_names_and_the_first_rule_wins() {
        let mut rules = Rules::default();
        rules.replace(&[rule("cn:robot-7", ""), rule("dns:lift.example", "lift"), rule("uri:spiffe://x/y", "y")]);
        let names = |cn: Option<&str>, dns: &[&str], uris: &[&str]| CertificateNames {
            common_name: cn.map(str::to_owned),
            dns: dns.iter().map(|n| (*n).to_owned()).collect(),
            uris: uris.iter().map(|n| (*n).to_owned()).collect(),
            expires_s: None,
        };
        let name = |names| rules.principal(&names).map(|p| p.name).map_err(|e| e.reason);
        assert_eq!(name(names(Some("robot-7"), &["LIFT.example"], &[])), Ok("robot-7".to_owned()));
        assert_eq!(name(names(Some("other"), &["LIFT.example"], &[])), Ok("lift".to_owned()));
        assert_eq!(name(names(None, &[], &["spiffe://x/y"])), Ok("y".to_owned()));
        // A name of one kind is not one of another.
        assert_eq!(name(names(Some("lift.example"), &["robot-7"], &["robot-7"])), Err(Reason::WithoutGrant));
        let p = rules.principal(&names(Some("robot-7"), &[], &[])).unwrap();
        assert!(p.tenant == "site-a" && p.may(Access::Write, "robot-7") && !p.may(Access::Read, "lift-1"));
    }

    #[test]
    fn who_was_let_in_by_a_rule_that_is_gone_is_not_let_go_on() {
        let mut rules = Rules::default();
        rules.replace(&[rule("cn:robot-7", ""), rule("cn:lift", "")]);
        let named = |cn: &str| CertificateNames { common_name: Some(cn.to_owned()), ..CertificateNames::default() };
        let [robot, lift] = ["robot-7", "lift"].map(|cn| rules.principal(&named(cn)).unwrap());
        // Another order changes nothing for either, less access does.
        rules.replace(&[rule("cn:lift", ""), CertificateRule { access: Access::Read, ..rule("cn:robot-7", "") }]);
        assert!(!robot.standing.holds(0) && lift.standing.holds(0));
        let anew = rules.principal(&named("robot-7")).unwrap();
        assert!(anew.standing.holds(0) && !anew.may(Access::Write, "robot-7"));
        rules.replace(&[]);
        assert!(!anew.standing.holds(0) && !lift.standing.holds(0) && rules.principal(&named("lift")).is_err());
    }
}
