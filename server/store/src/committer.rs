//! One task that makes batches durable: whoever waits while a flush runs shares the next one.
//!
//! Batches become durable in the order of the queue. A group is one SlateDB batch, so each caller's part
//! is all or nothing too.

use std::sync::Arc;
use std::time::Duration;

use slatedb::config::{CloseOptions, FlushOptions, FlushType};
use slatedb::{CloseReason, Db, WriteBatch, WriteHandle};
use tokio::sync::{mpsc, oneshot, watch};

use crate::error::StoreError;
use crate::keys::Key;
use crate::node::Life;
use crate::observed::Failures;
use crate::store::Record;

/// Largest group, so that a flush stays short. A larger single batch is a group of its own.
const MAX_GROUP_BYTES: usize = 8 << 20;

/// How long a commit waits for an earlier stalled one to get through before it fails too.
const STALLED_GRACE: Duration = Duration::from_millis(200);

/// How long closing waits for the last records to become a sorted table.
const TABLE_PATIENCE: Duration = Duration::from_secs(2);

/// What the committer is asked for.
pub(crate) enum Request {
    /// Make a batch durable.
    Commit {
        /// Records to write.
        puts: Vec<Record>,
        /// Records to delete first.
        deletes: Vec<Key>,
        /// Keys and values together.
        num_bytes: usize,
        /// Where the outcome goes.
        done: oneshot::Sender<Result<(), StoreError>>,
    },
    /// Flush, close, end.
    Close {
        /// Where the outcome goes.
        done: oneshot::Sender<Result<(), StoreError>>,
    },
}

/// The task's state.
pub(crate) struct Committer {
    /// The records.
    pub(crate) db: Db,
    /// This writer's epoch.
    pub(crate) epoch: u64,
    /// Failures of SlateDB's writes.
    pub(crate) failures: watch::Receiver<Failures>,
    /// When to give up waiting.
    pub(crate) timeout: Duration,
    /// Where data are shared: as long as it lasts, nobody else can have taken over.
    pub(crate) life: Option<Arc<Life>>,
    /// A write that was reported as failed but may still get through.
    pub(crate) stalled: Option<WriteHandle>,
}

impl Committer {
    /// Serves the queue until it is closed or asked to close.
    pub(crate) async fn run(mut self, mut queue: mpsc::Receiver<Request>) {
        let mut closing = None;
        let mut next = queue.recv().await;
        while let Some(request) = next.take() {
            match request {
                Request::Commit { puts, deletes, num_bytes, done } => {
                    let mut group = Group::default();
                    group.add(puts, deletes, num_bytes, done);
                    next = group.fill(&mut queue);
                    self.commit(group).await;
                }
                Request::Close { done } => {
                    closing = Some(done);
                    break;
                }
            }
            if next.is_none() {
                next = queue.recv().await;
            }
        }
        // Waiting callers see their channel dropped, which they report as `Closed`.
        drop(queue);
        let outcome = self.close().await;
        if let Some(done) = closing {
            let _ = done.send(outcome);
        } else if let Err(error) = outcome {
            tracing::warn!(%error, "dropped store did not close cleanly");
        }
    }

    async fn commit(&mut self, group: Group) {
        let mut outcome = self.check_life();
        if outcome.is_ok() {
            outcome = if group.is_empty { self.settle_stalled().await } else { self.write(group.batch).await };
            // While it was written the process may have been stopped for long.
            outcome = outcome.and_then(|()| self.check_life());
        }
        for done in group.waiting {
            // A caller that stopped waiting does not care.
            let _ = done.send(outcome.clone());
        }
    }

    fn check_life(&self) -> Result<(), StoreError> {
        let is_over = self.life.as_ref().is_some_and(|life| !life.is_alive());
        if is_over { Err(StoreError::Fenced { epoch: self.epoch }) } else { Ok(()) }
    }

    async fn write(&mut self, batch: WriteBatch) -> Result<(), StoreError> {
        self.settle_stalled().await?;
        self.failures.borrow_and_update();
        // SlateDB makes writers wait while too much is on its way to the disk.
        let handle = match tokio::time::timeout(self.timeout, self.db.write(batch)).await {
            Ok(written) => written.map_err(|error| self.explain("write", error))?,
            Err(_) => return Err(self.reason_for_stall()),
        };
        let durable = async {
            self.db.flush().await?;
            handle.await_durable().await
        };
        let outcome = tokio::select! {
            outcome = durable => return outcome.map_err(|error| self.explain("flush", error)),
            () = full(self.failures.clone()) => Err(StoreError::Full),
            () = tokio::time::sleep(self.timeout) => Err(self.reason_for_stall()),
        };
        self.stalled = Some(handle);
        outcome
    }

    /// Nothing is written behind a write that is stuck: it would only pile up in memory.
    async fn settle_stalled(&mut self) -> Result<(), StoreError> {
        let Some(handle) = self.stalled.take() else { return Ok(()) };
        match tokio::time::timeout(STALLED_GRACE, handle.await_durable()).await {
            Ok(outcome) => outcome.map_err(|error| self.explain("flush", error)),
            Err(_) => {
                self.stalled = Some(handle);
                Err(self.reason_for_stall())
            }
        }
    }

    fn reason_for_stall(&self) -> StoreError {
        self.failures.borrow().last.clone().unwrap_or(StoreError::Stalled { waited: self.timeout })
    }

    /// Some errors of a fenced database do not say so themselves; its status does.
    fn explain(&self, operation: &'static str, error: slatedb::Error) -> StoreError {
        match self.db.status().close_reason {
            Some(CloseReason::Fenced) => StoreError::Fenced { epoch: self.epoch },
            // It will not write again in this opening, whatever is tried.
            Some(reason) => {
                tracing::error!(?reason, operation, %error, "a store has closed by itself");
                StoreError::Closed
            }
            None => StoreError::from_slate(operation, self.epoch, error),
        }
    }

    async fn close(&mut self) -> Result<(), StoreError> {
        // Whoever may have lost the data writes nothing more.
        let fenced = self.db.status().close_reason == Some(CloseReason::Fenced) || self.check_life().is_err();
        if self.stalled.is_none() && !fenced {
            // As a sorted table what was written is read quickly by the next opening, and the log's files can go. The log
            // has everything, so that this may fail.
            let table = self.db.flush_with_options(FlushOptions { flush_type: FlushType::MemTable });
            if !matches!(tokio::time::timeout(TABLE_PATIENCE, table).await, Ok(Ok(()))) {
                tracing::debug!("closed without a sorted table; the next opening reads the log");
            }
        }
        let flush_type = (self.stalled.is_none() && !fenced).then_some(FlushType::Wal);
        let options = CloseOptions { flush_type };
        let closed = tokio::time::timeout(self.timeout, self.db.close_with_options(options)).await;
        match closed {
            _ if fenced => Err(StoreError::Fenced { epoch: self.epoch }),
            Ok(outcome) => outcome.map_err(|error| self.explain("close", error)),
            Err(_) => Err(self.reason_for_stall()),
        }
    }
}

/// Returns when a write has failed for want of space.
pub(crate) async fn full(mut failures: watch::Receiver<Failures>) {
    let is_full = |failures: &Failures| failures.count > 0 && matches!(failures.last, Some(StoreError::Full));
    loop {
        if failures.changed().await.is_err() {
            return std::future::pending().await;
        }
        if is_full(&failures.borrow()) {
            return;
        }
    }
}

/// Batches that share a flush.
struct Group {
    batch: WriteBatch,
    is_empty: bool,
    num_bytes: usize,
    waiting: Vec<oneshot::Sender<Result<(), StoreError>>>,
}

impl Default for Group {
    fn default() -> Self {
        Self { batch: WriteBatch::new(), is_empty: true, num_bytes: 0, waiting: Vec::new() }
    }
}

impl Group {
    fn add(
        &mut self,
        puts: Vec<Record>,
        deletes: Vec<Key>,
        num_bytes: usize,
        done: oneshot::Sender<Result<(), StoreError>>,
    ) {
        self.is_empty &= puts.is_empty() && deletes.is_empty();
        for key in deletes {
            self.batch.delete(key.as_str());
        }
        for (key, value) in puts {
            self.batch.put_bytes(key.as_str().as_bytes().to_vec().into(), value);
        }
        self.num_bytes += num_bytes;
        self.waiting.push(done);
    }

    /// Takes what waits in the queue, up to the limit; hands back the first request that is not for here.
    fn fill(&mut self, queue: &mut mpsc::Receiver<Request>) -> Option<Request> {
        while let Ok(request) = queue.try_recv() {
            match request {
                Request::Commit { puts, deletes, num_bytes, done } if self.num_bytes + num_bytes <= MAX_GROUP_BYTES => {
                    self.add(puts, deletes, num_bytes, done);
                }
                other => return Some(other),
            }
        }
        None
    }
}
