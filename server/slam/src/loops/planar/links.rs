//! How far the drift reaches: the shortest way between keyframes along what ties them together.

use percept_geometry::KeyframeId;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};

/// Keyframes and the lengths of what ties them: motion and closed loops, millimetres of driving that would be as unsure.
#[derive(Debug, Default)]
pub(crate) struct Links {
    of: BTreeMap<KeyframeId, Vec<(KeyframeId, u64)>>,
}

impl Links {
    /// Ties two keyframes with the uncertainty of `metres` of driving.
    pub(crate) fn tie(&mut self, a: KeyframeId, b: KeyframeId, metres: f64) {
        let length = (metres.clamp(0.0, 1e9) * 1e3) as u64;
        for (from, to) in [(a, b), (b, a)] {
            let links = self.of.entry(from).or_default();
            match links.iter_mut().find(|l| l.0 == to) {
                Some(known) => known.1 = known.1.min(length),
                None => links.push((to, length)),
            }
        }
    }

    /// Bytes, about.
    pub(crate) fn memory_bytes(&self) -> usize {
        let links: usize = self.of.values().map(Vec::capacity).sum();
        self.of.len() * size_of::<(KeyframeId, Vec<(KeyframeId, u64)>)>() + links * size_of::<(KeyframeId, u64)>()
    }

    /// Takes a keyframe out; those that it tied stay tied.
    pub(crate) fn remove(&mut self, id: KeyframeId) {
        let Some(links) = self.of.remove(&id) else { return };
        for (k, &(a, to_a)) in links.iter().enumerate() {
            if let Some(others) = self.of.get_mut(&a) {
                others.retain(|l| l.0 != id);
            }
            // A chain through all of them keeps the lengths within twice what they were.
            if let Some(&(b, to_b)) = links.get(k + 1) {
                self.tie(a, b, (to_a + to_b) as f64 * 1e-3);
            }
        }
    }

    /// Metres of driving that the pose of each keyframe seen from `id` is as unsure as (Dijkstra 1959).
    pub(crate) fn distances(&self, id: KeyframeId) -> BTreeMap<KeyframeId, f64> {
        let mut done = BTreeMap::new();
        let mut heap = BinaryHeap::from([(Reverse(0u64), id)]);
        while let Some((Reverse(length), node)) = heap.pop() {
            if done.contains_key(&node) {
                continue;
            }
            done.insert(node, length as f64 * 1e-3);
            for &(next, step) in self.of.get(&node).into_iter().flatten() {
                if !done.contains_key(&next) {
                    heap.push((Reverse(length + step), next));
                }
            }
        }
        done
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_closed_loop_shortens_the_way_and_survives_the_loss_of_a_keyframe() {
        let id = KeyframeId;
        let mut links = Links::default();
        (0..100).for_each(|i| links.tie(id(i), id(i + 1), 0.5));
        assert_eq!(links.distances(id(100))[&id(0)], 50.0);
        links.tie(id(98), id(2), 0.5);
        assert_eq!(links.distances(id(100))[&id(0)], 2.5);
        links.remove(id(98));
        let after = links.distances(id(100))[&id(0)];
        assert!((2.5..=5.0).contains(&after), "{after}");
    }
}
