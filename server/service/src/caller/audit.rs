//! The audit log: who was refused, and who created, changed or deleted. One structured line each, of the target `audit`;
//! never a secret.

use super::CallContext;
use crate::Error;
use percept_identity::Refusal;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Lines about refusals in a [`PERIOD`]; beyond it they are counted, so that guessing does not fill the disk.
const LINES: u32 = 50;
const PERIOD: Duration = Duration::from_secs(1);

struct Refusals {
    begin: Option<Instant>,
    lines: u32,
    untold: u64,
}

static REFUSALS: Mutex<Refusals> = Mutex::new(Refusals { begin: None, lines: 0, untold: 0 });

/// Whether one more line may be written, and how many were not since the last one.
fn admitted() -> Option<u64> {
    let mut refusals = REFUSALS.lock().unwrap_or_else(PoisonError::into_inner);
    if refusals.begin.is_none_or(|begin| begin.elapsed() >= PERIOD) {
        *refusals = Refusals { begin: Some(Instant::now()), lines: 0, untold: refusals.untold };
    }
    if refusals.lines >= LINES {
        refusals.untold += 1;
        return None;
    }
    refusals.lines += 1;
    Some(std::mem::take(&mut refusals.untold))
}

/// Credentials were not taken.
pub fn unauthenticated(refusal: &Refusal, operation: &str, peer: &str, trace: &str) {
    if let Some(untold) = admitted() {
        let operation: String = operation.chars().take(100).collect();
        let (outcome, cause) = (refusal.reason.name(), refusal.cause.as_str());
        tracing::warn!(target: "audit", operation, outcome, cause, peer, trace, untold, "refused");
    }
}

/// A caller wanted what it may not do, or see.
pub(super) fn refused(context: &CallContext, operation: &str, session: &str, outcome: &str) {
    if let Some(untold) = admitted() {
        let CallContext { principal, trace, peer, .. } = context;
        let session: String = session.chars().take(64).collect();
        let (principal, tenant) = (principal.name.as_str(), principal.tenant.as_str());
        tracing::warn!(target: "audit", principal, tenant, operation, session, outcome, peer, trace, untold, "refused");
    }
}

/// Something that is told when it is done. Dropped before that, it is told, too: the caller went away, and nobody
/// here knows how far it came.
pub(super) struct Act<'a> {
    context: &'a CallContext,
    operation: &'static str,
    session: String,
    ended: bool,
}

impl<'a> Act<'a> {
    pub(super) fn begin(context: &'a CallContext, operation: &'static str, session: &str) -> Self {
        Self { context, operation, session: session.chars().take(64).collect(), ended: false }
    }

    pub(super) fn end<T>(mut self, outcome: &Result<T, Error>) {
        self.ended = true;
        self.tell(outcome.as_ref().err().map_or("OK", |e| e.reason));
    }

    fn tell(&self, outcome: &str) {
        let CallContext { principal, trace, peer, .. } = self.context;
        let (principal, tenant) = (principal.name.as_str(), principal.tenant.as_str());
        let (operation, session) = (self.operation, self.session.as_str());
        tracing::info!(target: "audit", principal, tenant, operation, session, outcome, peer, trace, "done");
    }
}

impl Drop for Act<'_> {
    fn drop(&mut self) {
        if !self.ended {
            self.tell("ABANDONED");
        }
    }
}
