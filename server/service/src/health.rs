//! Whether the server can do its work, and if not, why: the one source of `/readyz` and of gRPC's health service.
//!
//! Every part that others depend on reports how it fares ([`Health::report`]); the doors follow [`Health::watch`].

use crate::reason;
use crate::{Error, observe};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use tokio::sync::watch;

/// What reports.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Part {
    /// The process: starting, serving, draining.
    Server,
    /// Where everything durable lives.
    Storage,
    /// This server among those that share its data.
    Node,
}

impl Part {
    /// As health answers spell it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Server => "server",
            Self::Storage => "storage",
            Self::Node => "node",
        }
    }
}

/// Why a part cannot do its work.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Reason {
    /// Which part.
    pub part: Part,
    /// Stable, upper-case, e.g. `STORAGE_FULL`.
    pub reason: &'static str,
    /// A sentence for the operator.
    pub message: String,
}

/// Whether requests are taken.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Readiness {
    /// Every part can do its work.
    Ready,
    /// Some cannot; ordered by part, never empty.
    NotReady(Vec<Reason>),
}

impl Readiness {
    /// Whether every part can do its work.
    pub fn is_ready(&self) -> bool {
        *self == Self::Ready
    }

    /// Why not; empty if ready.
    pub fn reasons(&self) -> &[Reason] {
        match self {
            Self::Ready => &[],
            Self::NotReady(reasons) => reasons,
        }
    }
}

/// What all parts report. Cheap to clone; all clones are one.
#[derive(Debug, Clone)]
pub struct Health {
    troubles: Arc<Mutex<BTreeMap<Part, Reason>>>,
    readiness: Arc<watch::Sender<Readiness>>,
}

impl Health {
    /// Of a server that is starting: not ready until [`Part::Server`] reports that it serves.
    pub fn starting() -> Self {
        let health = Self { troubles: Arc::default(), readiness: Arc::new(watch::Sender::new(Readiness::Ready)) };
        health.report(Part::Server, Err((reason::STARTING, "the server is starting; ask again soon")));
        health
    }

    /// Notes that a part can do its work, or why it cannot. Telling the same again changes nothing.
    pub fn report(&self, part: Part, how: Result<(), impl Into<Trouble>>) {
        let mut troubles = self.troubles.lock().unwrap_or_else(PoisonError::into_inner);
        let before = match how {
            Ok(()) => troubles.remove(&part),
            Err(trouble) => {
                let Trouble { reason, message } = trouble.into();
                troubles.insert(part, Reason { part, reason, message })
            }
        };
        let told = troubles.get(&part);
        // That the server starts and ends is told elsewhere.
        if part != Part::Server && before.as_ref().map(|r| r.reason) != told.map(|r| r.reason) {
            match told {
                Some(Reason { reason, message, .. }) => {
                    tracing::warn!(part = part.name(), reason, "not ready: {message}")
                }
                None => tracing::info!(part = part.name(), "ready again"),
            }
        }
        for (told, is_there) in [(before.as_ref(), false), (troubles.get(&part), true)] {
            if let Some(told) = told {
                observe::trouble(part.name(), told.reason, is_there);
            }
        }
        let now = match troubles.values().cloned().collect::<Vec<_>>() {
            reasons if reasons.is_empty() => Readiness::Ready,
            reasons => Readiness::NotReady(reasons),
        };
        observe::ready(now.is_ready());
        // Under the lock, so that two reports at once are told in their order.
        self.readiness.send_if_modified(|told| {
            let is_new = *told != now;
            *told = now;
            is_new
        });
    }

    /// Notes that the server takes no new work any more.
    pub fn draining(&self) {
        self.report(Part::Server, Err((reason::STOPPING, "the server is stopping; use another one")));
    }

    /// How it stands.
    pub fn readiness(&self) -> Readiness {
        self.readiness.borrow().clone()
    }

    /// How it stands, as it changes.
    pub fn watch(&self) -> watch::Receiver<Readiness> {
        self.readiness.subscribe()
    }
}

/// A reason and a sentence.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Trouble {
    reason: &'static str,
    message: String,
}

impl From<(&'static str, &str)> for Trouble {
    fn from((reason, message): (&'static str, &str)) -> Self {
        Self { reason, message: message.to_owned() }
    }
}

impl From<Error> for Trouble {
    fn from(e: Error) -> Self {
        Self { reason: e.reason, message: e.message }
    }
}

/// Nothing went wrong, for `report(part, HEALTHY)`.
pub const HEALTHY: Result<(), Trouble> = Ok(());

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_server_is_ready_once_every_part_is() {
        let health = Health::starting();
        let mut seen = health.watch();
        assert_eq!(health.readiness().reasons()[0].reason, "STARTING");
        health.report(Part::Storage, Err(("STORAGE_FULL", "no space left; free some")));
        health.report(Part::Server, HEALTHY);
        let reasons: Vec<_> = health.readiness().reasons().iter().map(|r| (r.part, r.reason)).collect();
        assert_eq!(reasons, [(Part::Storage, "STORAGE_FULL")]);
        health.report(Part::Storage, HEALTHY);
        assert!(health.readiness().is_ready());
        assert!(seen.has_changed().unwrap());
        assert!(seen.borrow_and_update().is_ready());
    }

    #[test]
    fn the_same_told_again_wakes_nobody() {
        let health = Health::starting();
        health.report(Part::Server, HEALTHY);
        let mut seen = health.watch();
        seen.mark_unchanged();
        health.report(Part::Server, HEALTHY);
        assert!(!seen.has_changed().unwrap());
        health.draining();
        assert!(seen.has_changed().unwrap());
    }
}
