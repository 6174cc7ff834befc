//! Values that are worked out when they are first asked for, on a rayon pool.
//!
//! A thread that waits for parts of its work does other work of the pool meanwhile, which may ask for the same value: where whoever comes
//! second waits for the first, as at a `LazyLock` or in `OnceLock::get_or_init`, that thread waits for itself. So nobody waits here:
//! two that come at once both work it out, and the first value stays.

use std::sync::{Arc, Mutex, OnceLock, PoisonError};

/// The value in a cell, worked out if there is none; `make` gives the same every time.
pub(crate) fn worked_out<T>(cell: &OnceLock<T>, make: impl FnOnce() -> T) -> &T {
    if let Some(value) = cell.get() {
        return value;
    }
    let made = make();
    cell.get_or_init(|| made)
}

/// A value, or how to work it out: what it is made of is let go once it is there.
pub(crate) struct Later<T> {
    value: OnceLock<T>,
    work: Mutex<Option<Arc<dyn Fn() -> T + Send + Sync>>>,
}

impl<T> Later<T> {
    /// One that is there.
    pub(crate) fn now(value: T) -> Self {
        Self { value: OnceLock::from(value), work: Mutex::default() }
    }

    /// One to be worked out.
    pub(crate) fn of(work: Arc<dyn Fn() -> T + Send + Sync>) -> Self {
        Self { value: OnceLock::new(), work: Mutex::new(Some(work)) }
    }

    /// The value.
    pub(crate) fn get(&self) -> &T {
        loop {
            if let Some(value) = self.value.get() {
                return value;
            }
            // It goes once the value is there.
            let work = self.work.lock().unwrap_or_else(PoisonError::into_inner).clone();
            if let Some(work) = work {
                worked_out(&self.value, || work());
                *self.work.lock().unwrap_or_else(PoisonError::into_inner) = None;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::time::Duration;

    /// In time, or the thread that waits for itself is left behind.
    fn in_time<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> T {
        let (done, told) = std::sync::mpsc::channel();
        std::thread::spawn(move || done.send(work()));
        told.recv_timeout(Duration::from_secs(20)).unwrap()
    }

    #[test]
    fn work_that_asks_for_its_own_value_does_not_wait_for_itself() {
        // As a thread of a pool does that takes other work up while its own is under way.
        let value = in_time(|| {
            let cell = Arc::new(OnceLock::new());
            let inner = Arc::clone(&cell);
            *worked_out(&cell, || {
                assert_eq!(*worked_out(&inner, || 7), 7);
                8
            })
        });
        assert_eq!(value, 7, "the first value stays");
    }

    #[test]
    fn many_that_ask_at_once_on_a_pool_all_get_it() {
        let sum = in_time(|| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap();
            let made = Arc::new(AtomicUsize::new(0));
            for _ in 0..200 {
                let made = Arc::clone(&made);
                let later = Arc::new(Later::of(Arc::new(move || {
                    made.fetch_add(1, Ordering::Relaxed);
                    use rayon::prelude::*;
                    (0..5_000usize).into_par_iter().with_min_len(100).map(|i| i % 7).sum::<usize>()
                })));
                pool.scope(|scope| {
                    (0..6).for_each(|_| {
                        let later = Arc::clone(&later);
                        scope.spawn(move |_| assert_eq!(*later.get(), 14_995));
                    });
                });
            }
            made.load(Ordering::Relaxed)
        });
        assert!((200..=1200).contains(&sum));
        assert_eq!(*Later::now(3).get(), 3);
    }
}
