//! Work beside the frames, so that no frame waits for it: begun at one frame, wanted at a later one.
//!
//! Whoever comes first does it: the executor, or the frame that needs what comes of it. At which frame that is follows from
//! stamps alone, so that what comes of the same frames is the same, however fast the machine is.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

/// Runs work beside frames, in the order of being told to.
pub trait Executor: Send + Sync {
    /// Runs it some time. It may be dropped instead: whoever needs it does it then.
    fn spawn(&self, work: Box<dyn FnOnce() + Send>);
}

/// Work that was begun, and what comes of it.
pub(crate) struct Task<T>(Arc<Shared<T>>);

struct Shared<T> {
    stage: Mutex<Stage<T>>,
    changed: Condvar,
}

enum Stage<T> {
    Waiting(Box<dyn FnOnce() -> T + Send>),
    Running,
    Done(T),
    /// The work panicked.
    Failed(Box<dyn Any + Send>),
    /// What came of it was fetched.
    Over,
}

impl<T: Send + 'static> Task<T> {
    /// Has work done by the executor; without one, it is done when it is needed.
    pub(crate) fn begin(executor: Option<&Arc<dyn Executor>>, work: impl FnOnce() -> T + Send + 'static) -> Self {
        let stage = Mutex::new(Stage::Waiting(Box::new(work)));
        let shared = Arc::new(Shared { stage, changed: Condvar::new() });
        if let Some(executor) = executor {
            let shared = Arc::clone(&shared);
            executor.spawn(Box::new(move || shared.run()));
        }
        Self(shared)
    }

    /// What came of it, once; does the work if nobody has begun it.
    ///
    /// # Panics
    /// As the work did.
    pub(crate) fn finished(&self) -> T {
        self.0.run();
        let mut stage = self.0.lock();
        loop {
            match std::mem::replace(&mut *stage, Stage::Over) {
                Stage::Done(value) => return value,
                Stage::Failed(panic) => {
                    drop(stage);
                    resume_unwind(panic)
                }
                Stage::Over => resume_unwind(Box::new("the work beside the frames had failed before")),
                other @ (Stage::Waiting(_) | Stage::Running) => *stage = other,
            }
            stage = self.0.changed.wait(stage).unwrap_or_else(PoisonError::into_inner);
        }
    }
}

impl<T> Shared<T> {
    fn lock(&self) -> MutexGuard<'_, Stage<T>> {
        self.stage.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Does the work, unless somebody has begun it.
    fn run(&self) {
        let work = {
            let mut stage = self.lock();
            match std::mem::replace(&mut *stage, Stage::Running) {
                Stage::Waiting(work) => work,
                other => {
                    *stage = other;
                    return;
                }
            }
        };
        // A panic is the session's to bear, not the thread's.
        *self.lock() = match catch_unwind(AssertUnwindSafe(work)) {
            Ok(value) => Stage::Done(value),
            Err(panic) => Stage::Failed(panic),
        };
        self.changed.notify_all();
    }
}
