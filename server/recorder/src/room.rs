//! What may wait to be written of all recordings together.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Memory that several recordings share for what waits to be written: those that do not know each other, too, take no more.
#[derive(Debug)]
pub struct SharedRoom {
    limit: usize,
    taken: AtomicUsize,
}

impl SharedRoom {
    /// Of so many bytes.
    pub fn of(limit: usize) -> Arc<Self> {
        Arc::new(Self { limit, taken: AtomicUsize::new(0) })
    }

    /// Bytes that wait now, of all recordings.
    pub fn taken(&self) -> usize {
        self.taken.load(Ordering::Relaxed)
    }

    /// A place for so many bytes, if there is; given back when it is dropped.
    pub(crate) fn take(self: &Arc<Self>, num_bytes: usize) -> Option<Place> {
        let fits = |taken: usize| taken.checked_add(num_bytes).filter(|sum| *sum <= self.limit);
        self.taken.fetch_update(Ordering::Relaxed, Ordering::Relaxed, fits).ok()?;
        Some(Place { room: Arc::clone(self), num_bytes })
    }
}

/// What waiting takes of a room.
#[derive(Debug)]
pub(crate) struct Place {
    room: Arc<SharedRoom>,
    pub(crate) num_bytes: usize,
}

impl Drop for Place {
    fn drop(&mut self) {
        self.room.taken.fetch_sub(self.num_bytes, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_room_gives_what_it_has_and_takes_it_back() {
        let room = SharedRoom::of(10);
        let first = room.take(7);
        assert!(first.is_some() && room.take(4).is_none() && room.take(usize::MAX).is_none());
        let second = room.take(3);
        assert_eq!((second.is_some(), room.taken()), (true, 10));
        drop(first);
        assert_eq!(room.taken(), 3);
    }
}
