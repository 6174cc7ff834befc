//! The pool on which all heavy work runs, so that doors stay responsive whatever is computed.

use crate::{Error, ErrorCode, Result};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{Semaphore, oneshot};

/// A rayon pool reached from async code; requests beyond its permits wait their turn.
#[derive(Clone)]
pub struct ComputePool {
    pool: Arc<rayon::ThreadPool>,
    requests: Arc<Semaphore>,
}

impl ComputePool {
    /// Over an existing pool, with at most `max_concurrent` requests at a time.
    pub fn new(pool: rayon::ThreadPool, max_concurrent: usize) -> Self {
        Self { pool: Arc::new(pool), requests: Arc::new(Semaphore::new(max_concurrent.max(1))) }
    }

    /// Runs a session's work.
    ///
    /// # Errors
    /// `INTERNAL` if the work panicked.
    pub(crate) async fn run<T: Send + 'static>(&self, work: impl FnOnce() -> T + Send + 'static) -> Result<T> {
        let (done, result) = oneshot::channel();
        self.pool.spawn(move || {
            // A panic drops `done`, which the awaiting side sees; it must not take the pool down.
            let outcome = std::panic::catch_unwind(std::panic::AssertUnwindSafe(work));
            if let Ok(value) = outcome {
                let _ = done.send(value);
            }
        });
        result.await.map_err(|_| Error::internal("computation panicked"))
    }

    /// Runs a request's work once a permit is free.
    ///
    /// # Errors
    /// `INTERNAL` if the work panicked, `STOPPING` at the end.
    pub async fn request<T: Send + 'static>(&self, work: impl FnOnce() -> T + Send + 'static) -> Result<T> {
        let _permit = self
            .requests
            .acquire()
            .await
            .map_err(|_| Error::new(ErrorCode::Unavailable, "STOPPING", "the server is stopping; try again"))?;
        self.run(work).await
    }

    /// Runs a request's work as [`request`](Self::request) does, and waits for it no longer than `budget` from its start.
    /// Work that does not look at the time itself goes on to its end, and holds its permit until then.
    ///
    /// # Errors
    /// `COMPUTATION_TOO_LONG`, and those of `request`.
    pub async fn request_within<T: Send + 'static>(
        &self,
        budget: Duration,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T> {
        let permit = Arc::clone(&self.requests)
            .acquire_owned()
            .await
            .map_err(|_| Error::new(ErrorCode::Unavailable, "STOPPING", "the server is stopping; try again"))?;
        let held = move || {
            let out = work();
            drop(permit);
            out
        };
        tokio::time::timeout(budget, self.run(held)).await.map_err(|_| too_long(budget))?
    }
}

/// The answer to a request that computes for longer than it may.
pub(crate) fn too_long(budget: Duration) -> Error {
    let words =
        format!("the request computed for {} ms, its limit; send a smaller cloud or fewer steps", budget.as_millis());
    Error::new(ErrorCode::DeadlineExceeded, "COMPUTATION_TOO_LONG", words)
}
