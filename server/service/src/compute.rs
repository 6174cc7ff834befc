//! The pool on which all heavy work runs, so that doors stay responsive whatever is computed.

use crate::{Error, ErrorCode, Result};
use std::sync::Arc;
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
}
