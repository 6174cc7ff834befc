//! A list that grows at the end and is cheap to share: snapshots keep the old one while the writer appends.

use std::ops::Index;
use std::sync::Arc;

const CHUNK: usize = 256;

/// An append-only list in shared chunks: cloning copies pointers, appending copies at most one chunk.
#[derive(Debug, Clone, PartialEq)]
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

    /// Element `i`, if there is one, to be changed: copies its chunk, if somebody shares it.
    pub fn get_mut(&mut self, i: usize) -> Option<&mut T> {
        let in_tail = i.checked_sub(self.full.len() * CHUNK);
        let chunk = match in_tail {
            Some(_) => &mut self.tail,
            None => &mut Arc::make_mut(&mut self.full)[i / CHUNK],
        };
        Arc::make_mut(chunk).get_mut(in_tail.unwrap_or(i % CHUNK))
    }

    /// Puts another element in the place of element `i`, if there is one.
    pub fn replace(&mut self, i: usize, value: T) {
        if let Some(slot) = self.get_mut(i) {
            *slot = value;
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

    /// How many elements there are before the first for which `is_before` does not hold; it has to hold for none after that.
    pub fn partition_point(&self, is_before: impl Fn(&T) -> bool) -> usize {
        let full = self.full.partition_point(|chunk| chunk.last().is_some_and(&is_before));
        let rest = self.full.get(full).map_or(&self.tail, |chunk| chunk);
        full * CHUNK + rest.partition_point(is_before)
    }

    /// Elements of a range, oldest first.
    pub fn range(&self, range: std::ops::Range<usize>) -> impl Iterator<Item = &T> {
        range.map_while(|i| self.get(i))
    }

    /// The newest element.
    pub fn last(&self) -> Option<&T> {
        self.len().checked_sub(1).and_then(|i| self.get(i))
    }

    /// All elements, oldest first.
    pub fn iter(&self) -> impl DoubleEndedIterator<Item = &T> {
        self.full.iter().flat_map(|c| c.iter()).chain(self.tail.iter())
    }
}

impl<T: Clone> Index<usize> for Chunks<T> {
    type Output = T;

    fn index(&self, i: usize) -> &T {
        match self.full.get(i / CHUNK) {
            Some(chunk) => &chunk[i % CHUNK],
            None => &self.tail[i - self.full.len() * CHUNK],
        }
    }
}

impl<T: Clone> FromIterator<T> for Chunks<T> {
    fn from_iter<I: IntoIterator<Item = T>>(items: I) -> Self {
        let mut out = Self::default();
        items.into_iter().for_each(|item| out.push(item));
        out
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
        assert_eq!((list[0], list[1999]), (0, 1999));
        assert!(list.iter().rev().copied().eq((0..2000).rev()));
    }

    #[test]
    fn a_clone_does_not_see_what_is_changed_later() {
        let mut list: Chunks<i32> = (0..600).collect();
        let before = list.clone();
        for i in [0, 300, 599] {
            *list.get_mut(i).unwrap() = -1;
        }
        assert!(list.get_mut(600).is_none() && before.iter().copied().eq(0..600));
        assert_eq!(list.iter().filter(|i| **i == -1).count(), 3);
    }

    #[test]
    fn elements_are_found_by_their_order() {
        let mut list = Chunks::default();
        for n in 0..700 {
            assert_eq!(list.partition_point(|&i| i < 2 * n), n);
            list.push(2 * n);
        }
        for n in 0..700 {
            assert_eq!((list.partition_point(|&i| i < 2 * n), list.partition_point(|&i| i <= 2 * n)), (n, n + 1));
        }
        assert!(list.range(255..258).copied().eq([510, 512, 514]));
        assert_eq!(list.range(699..900).count(), 1);
    }
}
