//! Operations: work that may take long, started by one call and looked after by others.
//!
//! What they do is what the plain calls do, in the same computing lines and with the access that those need
//! (`caller/lasting.rs`); here is what becomes of them. They live in memory ([`shelf`]): a restart forgets them.

mod kind;
mod progress;
mod shelf;

pub use kind::{OperationKind, OperationState};
pub use progress::{HowFar, Progress};
pub(crate) use shelf::Operations;

use super::sessions::{Page, page_by_number};
use crate::{Error, Limits, Result, Service, reason};
use bytes::Bytes;
use futures::future::BoxFuture;
use percept_identity::{Access, Pattern, Principal};
use std::sync::Arc;
use std::time::Duration;

/// Longest that a call waits for the end of an operation.
const LONGEST_WAIT: Duration = Duration::from_secs(60);

/// How long an operation may run.
pub(crate) fn budget(limits: &Limits) -> Duration {
    Duration::from_secs(limits.max_operation_s as u64)
}

/// An operation as its owner sees it.
#[derive(Debug, Clone, PartialEq)]
pub struct Operation {
    /// Names it.
    pub id: String,
    /// What it does.
    pub kind: OperationKind,
    /// The session whose map it is about; empty if none.
    pub session: String,
    /// How it stands.
    pub state: OperationState,
    /// How far it is.
    pub how_far: HowFar,
    /// Whether it was asked to end.
    pub cancel_requested: bool,
    /// Why it has no result.
    pub error: Option<Error>,
    /// Bytes of its result, once it is done.
    pub result_bytes: Option<usize>,
    /// When it was started, nanoseconds since the Unix epoch, as all times here.
    pub create_time_ns: i64,
    /// When it began to run.
    pub run_time_ns: Option<i64>,
    /// When it ended.
    pub end_time_ns: Option<i64>,
    /// When it is forgotten.
    pub expire_time_ns: Option<i64>,
    /// As it was started with.
    pub request_id: String,
}

/// What an operation is started with.
#[derive(Debug, Clone)]
pub struct NewOperation {
    /// What it does.
    pub kind: OperationKind,
    /// The session whose map it is about; empty if none.
    pub session: String,
    /// Makes the start idempotent; empty: not.
    pub request_id: String,
    /// Memory that it holds until it is done.
    pub request_bytes: usize,
    /// What one must be granted to read its result: an access, to a session or, if that is empty, to any.
    pub needs: Vec<(Access, String)>,
}

/// The work of an operation: the encoded parts of its answer.
pub(crate) type Work = Box<dyn FnOnce(Progress) -> BoxFuture<'static, Result<Vec<Bytes>>> + Send>;

/// Which operations a list is of.
#[derive(Debug, Clone, Default)]
pub struct OperationList {
    /// Only those in this state.
    pub state: Option<OperationState>,
    /// Only those about a session whose id fits.
    pub pattern: Option<Pattern>,
    /// Elements of a page: 0 means 100, 1000 at most.
    pub page_size: u32,
    /// From the page before; empty: from the start.
    pub page_token: String,
}

impl OperationList {
    fn wants(&self, operation: &Operation) -> bool {
        self.state.is_none_or(|state| state == operation.state)
            && self.pattern.as_ref().is_none_or(|p| !operation.session.is_empty() && p.matches(&operation.session))
    }
}

/// An owner's operations.
impl Service {
    /// Starts one, or gives the one that was started with the same request id.
    ///
    /// # Errors
    /// `TOO_MANY_OPERATIONS`, `OPERATIONS_FULL`, `STOPPING`.
    pub(crate) fn start_operation(&self, owner: &str, new: NewOperation, work: Work) -> Result<Operation> {
        self.operations.start(owner, new, work)
    }

    /// One that was started with this request id, if that is known still.
    pub(crate) fn started_operation(&self, owner: &str, request_id: &str) -> Option<Operation> {
        self.operations.started(owner, request_id)
    }

    /// How one stands.
    ///
    /// # Errors
    /// `OPERATION_NOT_FOUND`.
    pub(crate) fn operation(&self, owner: &str, id: &str) -> Result<Operation> {
        self.operations.get(owner, id)
    }

    /// Those that are wanted, oldest first.
    ///
    /// # Errors
    /// `PAGE_TOKEN_INVALID`.
    pub(crate) fn list_operations(&self, owner: &str, list: &OperationList) -> Result<Page<Operation>> {
        let all: Vec<Operation> = self.operations.all(owner).into_iter().filter(|o| list.wants(o)).collect();
        page_by_number(&all, |o| o.create_time_ns as u64, list.page_size, &list.page_token)
    }

    /// How one stands once it has ended, or when the time is over.
    ///
    /// # Errors
    /// `OPERATION_NOT_FOUND`; `OUT_OF_RANGE` for a time that is none.
    pub(crate) async fn wait_operation(&self, owner: &str, id: &str, timeout_s: Option<f64>) -> Result<Operation> {
        let timeout_s = timeout_s.unwrap_or(LONGEST_WAIT.as_secs_f64());
        if !(timeout_s.is_finite() && timeout_s >= 0.0) {
            let words = format!("timeout_s is {timeout_s}; it must be 0 or more");
            return Err(Error::invalid(reason::OUT_OF_RANGE, "timeout_s", words));
        }
        let timeout = Duration::from_secs_f64(timeout_s.min(LONGEST_WAIT.as_secs_f64()));
        let mut ended = self.operations.ended(owner, id)?;
        // Over, or forgotten: what follows tells.
        let _ = tokio::time::timeout(timeout, ended.wait_for(|ended| *ended)).await;
        self.operations.get(owner, id)
    }

    /// Ends one that waits, and asks one that runs to end.
    ///
    /// # Errors
    /// `OPERATION_NOT_FOUND`.
    pub(crate) fn cancel_operation(&self, owner: &str, id: &str) -> Result<Operation> {
        self.operations.cancel(owner, id)
    }

    /// The encoded parts of a result.
    ///
    /// # Errors
    /// `OPERATION_NOT_FOUND`, `OPERATION_NOT_DONE`; what the operation failed of; `PERMISSION_DENIED` for who may not do
    /// any more what it did.
    pub(crate) fn operation_result(&self, owner: &str, id: &str, principal: &Principal) -> Result<Arc<Vec<Bytes>>> {
        let may = |(access, session): &(Access, String)| match session.as_str() {
            "" => principal.may_somewhere(*access),
            session => principal.may(*access, session),
        };
        self.operations.result(owner, id, |needs| needs.iter().all(may))
    }

    /// Forgets one that has ended.
    ///
    /// # Errors
    /// `OPERATION_NOT_FOUND`, `OPERATION_UNDER_WAY`.
    pub(crate) fn delete_operation(&self, owner: &str, id: &str) -> Result<()> {
        self.operations.delete(owner, id)
    }
}
