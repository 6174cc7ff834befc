//! A list that grows at the end and is cheap to share: snapshots keep the old one while the writer appends.

use std::sync::Arc;

const CHUNK: usize = 256;

/// An append-only list in shared chunks: cloning copies pointers, appending copies at most one chunk.
#[derive(Debug, Clone)]
pub struct Chunks<T> {
    full: Arc<Vec<Arc<Vec<T>>>>,
    tail: Arc<Vec<T>>,
}

impl<T: Clone> Default for Chunks<T> {
    fn default() -> Self {
        Self { full: Arc::default(), tail: Arc::default() }
    }
}

impl<T: Clone> Chunks<T> {
    /// Appends one element.
    pub fn push(&mut self, value: T) {
        let tail = Arc::make_mut(&mut self.tail);
        tail.push(value);
        if tail.len() == CHUNK {
            let chunk = std::mem::take(&mut self.tail);
            Arc::make_mut(&mut self.full).push(chunk);
        }
    }

    /// Number of elements.
    pub fn len(&self) -> usize {
        self.full.len() * CHUNK + self.tail.len()
    }

    /// Whether there is no element.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Element `i`, if there is one.
    pub fn get(&self, i: usize) -> Option<&T> {
        match self.full.get(i / CHUNK) {
            Some(chunk) => chunk.get(i % CHUNK),
            None => self.tail.get(i - self.full.len() * CHUNK),
        }
    }

    /// The newest element.
    pub fn last(&self) -> Option<&T> {
        self.len().checked_sub(1).and_then(|i| self.get(i))
    }

    /// All elements, oldest first.
    pub fn iter(&self) -> impl Iterator<Item = &T> {
        self.full.iter().flat_map(|c| c.iter()).chain(self.tail.iter())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clone_does_not_see_what_is_appended_later() {
        let mut list = Chunks::default();
        (0..1000).for_each(|i| list.push(i));
        let before = list.clone();
        (1000..2000).for_each(|i| list.push(i));
        assert!(before.iter().copied().eq(0..1000));
        assert!(list.iter().copied().eq(0..2000));
        assert_eq!((list.get(999), list.get(1999), list.get(2000)), (Some(&999), Some(&1999), None));
    }
}
