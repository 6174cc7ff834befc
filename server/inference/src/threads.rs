//! The threads that models run on.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Threads for running models, shared by the detectors that are built with them. Clones share them, too.
///
/// They are threads of their own, as the library's operators are spread over a pool: who calls waits for them. Each image
/// is worked on by one of them, in turn: how sums are split over several threads shows in the last bits of a result. The
/// library keeps one more pool for what it computes while models are loaded.
#[derive(Debug, Clone)]
pub struct InferenceThreads(Arc<Turns>);

#[derive(Debug)]
struct Turns {
    /// Of one thread each.
    pools: Vec<Arc<rten::ThreadPool>>,
    next: AtomicUsize,
}

impl InferenceThreads {
    /// So many threads, at least one: as many images are worked on at a time.
    pub fn new(num_threads: usize) -> Self {
        let pools = (0..num_threads.max(1)).map(|_| Arc::new(rten::ThreadPool::with_num_threads(1))).collect();
        Self(Arc::new(Turns { pools, next: AtomicUsize::new(0) }))
    }

    /// To run a model on the thread whose turn it is.
    pub(crate) fn options(&self) -> rten::RunOptions {
        let turn = self.0.next.fetch_add(1, Ordering::Relaxed) % self.0.pools.len();
        rten::RunOptions::default().with_thread_pool(Some(self.0.pools[turn].clone()))
    }
}
