//! The service in a caller's name.
//!
//! Doors hold a [`Guarded`] service, with which nothing can be done but to get a [`Caller`]. Each of a caller's
//! operations asks first, in one place ([`Caller::may_with`], [`Caller::may`]), whether the credentials still hold,
//! whether the session can be seen, and whether the access is granted; [`rules`] says what each needs. What a caller
//! may not see is answered exactly as if it did not exist.

pub mod audit;
mod context;
mod detectors;
mod lasting;
mod layers;
mod map_import;
mod navigation;
mod operations;
mod recordings;
pub mod rules;
mod scene;

pub use context::CallContext;
pub use lasting::OperationStart;

use crate::admission::{Held, TenantPlace, limited};
use crate::reason;
use crate::{ComputePool, Error, ErrorCode, Health, Limits, RateLimitedLog, Result, Service, check_id};
use percept_identity::now_s;
use rules::{About, Rule};
use std::sync::Arc;
use std::time::Duration;

/// How often a call that goes on asks whether its credentials still hold.
const ASKED_AGAIN: Duration = Duration::from_secs(1);
/// A sender that is held back is asked about so often at least: quotas may change.
const LONGEST_PAUSE: Duration = Duration::from_secs(1);

/// The service as doors hold it.
#[derive(Clone)]
pub struct Guarded(Service);

impl Guarded {
    /// Around a service.
    pub fn new(service: Service) -> Self {
        Self(service)
    }

    /// Its operations, in the name of somebody who makes a request.
    ///
    /// # Errors
    /// `RATE_LIMITED`.
    pub fn caller(&self, context: CallContext) -> Result<Caller> {
        self.0.compute.admission().request(&context.principal.tenant)?;
        Ok(self.sender(context))
    }

    /// The same for somebody whose frames come one by one, without a request: they are counted by themselves.
    pub fn sender(&self, context: CallContext) -> Caller {
        Caller { service: self.0.clone(), context }
    }

    /// The limits in force.
    pub fn limits(&self) -> &Arc<Limits> {
        self.0.limits()
    }

    /// The threads on which doors decode and encode.
    pub fn compute(&self) -> &ComputePool {
        &self.0.compute
    }

    /// Which of many alike faults are told in the log.
    pub fn faults(&self) -> &RateLimitedLog {
        &self.0.faults
    }

    /// Whether requests are taken, which everybody may know.
    pub fn health(&self) -> &Health {
        self.0.health()
    }
}

/// The operations, in somebody's name.
#[derive(Clone)]
pub struct Caller {
    service: Service,
    context: CallContext,
}

impl Caller {
    /// In whose name.
    pub fn context(&self) -> &CallContext {
        &self.context
    }

    /// The limits in force.
    pub fn limits(&self) -> &Arc<Limits> {
        self.service.limits()
    }

    /// Which of many alike faults are told in the log.
    pub fn faults(&self) -> &RateLimitedLog {
        &self.service.faults
    }

    /// Encodes an answer, or does other work for a question about a session, on the threads for that.
    ///
    /// # Errors
    /// `RATE_LIMITED`, `SERVER_BUSY`, `INTERNAL` if the work panicked.
    pub async fn query<T: Send + 'static>(
        &self,
        session: &str,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T> {
        let asker = self.service.compute.admission().asker(&self.context.principal.tenant, session)?;
        self.service.compute.query(&asker, work).await
    }

    /// Decodes a frame of a session on the threads for frames.
    ///
    /// # Errors
    /// `INTERNAL` if the work panicked.
    pub async fn decode<T: Send + 'static>(
        &self,
        session: &str,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T> {
        let sender = self.service.compute.admission().sender(&self.context.principal.tenant, session);
        self.service.compute.run_for(&sender, work).await
    }

    /// Counts a frame of so many bytes before anything is done with it.
    ///
    /// # Errors
    /// `RATE_LIMITED`.
    pub fn admit_frame(&self, session: &str, num_bytes: usize) -> Result<()> {
        let admission = self.service.compute.admission();
        let admitted = admission.frame(&self.context.principal.tenant, session, num_bytes);
        admitted.map_err(|wait| limited("frames", wait))
    }

    /// The same for a sender that can be held back: comes when the frame may.
    pub async fn pace_frame(&self, session: &str, num_bytes: usize) {
        let admission = self.service.compute.admission();
        while let Err(wait) = admission.frame(&self.context.principal.tenant, session, num_bytes) {
            tokio::time::sleep(wait.min(LONGEST_PAUSE)).await;
        }
    }

    /// The caller's place for what lasts, beside the doors' bounds.
    ///
    /// # Errors
    /// `TOO_MANY_STREAMS`, `TOO_MANY_WATCHERS`.
    pub fn hold(&self, held: Held) -> Result<TenantPlace> {
        self.service.compute.admission().hold(&self.context.principal.tenant, held)
    }

    /// Comes when the credentials no longer hold: watches and streams end with it.
    pub async fn ended(&self) -> Error {
        loop {
            tokio::time::sleep(ASKED_AGAIN).await;
            if let Err(e) = self.still_holds() {
                return e;
            }
        }
    }

    /// Who owns clouds that are kept for this caller.
    fn owner(&self) -> String {
        let principal = &self.context.principal;
        // No tenant has a line feed in it.
        format!("{}\n{}", principal.tenant, principal.name)
    }

    fn still_holds(&self) -> Result<()> {
        if self.context.principal.standing.holds(now_s()) {
            return Ok(());
        }
        let words = "the credentials have expired or were revoked; renew them";
        Err(Error::new(ErrorCode::Unauthenticated, reason::CREDENTIALS_EXPIRED, words))
    }

    fn refused(&self, operation: &str, session: &str, error: Error) -> Error {
        audit::refused(&self.context, operation, session, error.reason);
        error
    }

    /// Whether an operation that is about no session may be done. Doors ask it before work of their own, too.
    ///
    /// # Errors
    /// `CREDENTIALS_EXPIRED`, `PERMISSION_DENIED`.
    pub fn may(&self, operation: &'static str) -> Result<()> {
        let rule = rules::own(operation)?;
        self.still_holds().map_err(|e| self.refused(operation, "", e))?;
        if self.context.principal.may_somewhere(rule.access) {
            return Ok(());
        }
        Err(self.refused(operation, "", denied(rule, "")))
    }

    /// Whether an operation may be done with a session that exists. Doors ask it before work of their own, too.
    ///
    /// # Errors
    /// `CREDENTIALS_EXPIRED`; `SESSION_NOT_FOUND` for what this caller may not see; `PERMISSION_DENIED`.
    pub async fn may_with(&self, operation: &'static str, session: &str) -> Result<()> {
        let rule = rules::own(operation)?;
        debug_assert_eq!(rule.about, About::Session);
        check_id("session_id", session)?;
        self.still_holds().map_err(|e| self.refused(operation, session, e))?;
        self.granted(operation, session).await
    }

    /// The same for credentials that held when work was begun in their name.
    async fn granted(&self, operation: &'static str, session: &str) -> Result<()> {
        let (rule, principal) = (rules::own(operation)?, &self.context.principal);
        self.service.registry.look_for(session).await;
        self.service.registry.decided(session).await;
        match self.service.registry.tenant(session) {
            None => return Err(crate::session::registry::not_found(session)),
            Some(tenant) if tenant == principal.tenant && principal.may(percept_identity::Access::Read, session) => {}
            Some(_) => return Err(self.refused(operation, session, crate::session::registry::not_found(session))),
        }
        if principal.may(rule.access, session) {
            return Ok(());
        }
        Err(self.refused(operation, session, denied(rule, session)))
    }

    /// Whether a session may be created. Says nothing about whether there is one.
    fn anew(&self, operation: &'static str, session: &str) -> Result<()> {
        let rule = rules::own(operation)?;
        self.still_holds().map_err(|e| self.refused(operation, session, e))?;
        if self.context.principal.may(rule.access, session) {
            return Ok(());
        }
        Err(self.refused(operation, session, denied(rule, session)))
    }
}

impl Caller {
    /// What is said to one who may create sessions of some names, and gave none.
    fn unnamed(&self, refused: Error) -> Error {
        let grants = self.context.principal.grants.iter().filter(|g| g.access >= percept_identity::Access::Write);
        let names: Vec<&str> = grants.map(|g| g.sessions.as_str()).collect();
        if names.is_empty() || refused.reason != reason::PERMISSION_DENIED {
            return refused;
        }
        let words = format!(
            "no session_id is given, and this key is for sessions of some names: give one of {}",
            names.join(", ")
        );
        Error { message: words, ..refused }
    }
}

fn denied(rule: &Rule, session: &str) -> Error {
    let words = match rule.about {
        About::Session => {
            format!("this needs {} access to the session {session:?}; ask for a key that has it", rule.access)
        }
        About::Nothing => format!("this needs {} access; ask for a key that has it", rule.access),
    };
    Error::new(ErrorCode::PermissionDenied, reason::PERMISSION_DENIED, words)
}
