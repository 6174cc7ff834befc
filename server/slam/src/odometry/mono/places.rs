//! Which views may show the same place as an image: votes of descriptors that agree in a few drawn bits.
//!
//! **Source:** Gionis, Indyk and Motwani, "Similarity search in high dimensions via hashing", 1999 (bit sampling).

use super::map::ViewId;
use rustc_hash::FxHashMap;
use std::collections::BTreeMap;

/// Tables, and bits of a key: of two descriptors that differ in 26 bits of 256 half meet in some table. (1 - 26/256)^18
/// = 0.145 for each of four tables: 1 - (1 - 0.145)^4 = 0.47.
const TABLES: usize = 4;
const KEY_BITS: usize = 18;

/// Descriptors of all views by drawn bits.
#[derive(Debug, Clone)]
pub(super) struct Places {
    bits: [[u8; KEY_BITS]; TABLES],
    tables: [FxHashMap<u32, Vec<ViewId>>; TABLES],
}

impl Default for Places {
    fn default() -> Self {
        // Bits drawn without replacement by a fixed linear congruence.
        let mut order: Vec<u8> = (0..=255).collect();
        let mut state = 12345u32;
        for i in (1..order.len()).rev() {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            order.swap(i, (state >> 8) as usize % (i + 1));
        }
        let bits = std::array::from_fn(|t| std::array::from_fn(|k| order[t * KEY_BITS + k]));
        Self { bits, tables: std::array::from_fn(|_| FxHashMap::default()) }
    }
}

impl Places {
    fn keys<'a>(&'a self, descriptors: &'a [[u64; 4]], table: usize) -> impl Iterator<Item = u32> + 'a {
        let bits = &self.bits[table];
        descriptors
            .iter()
            .map(move |d| bits.iter().fold(0, |key, &b| key << 1 | (d[usize::from(b >> 6)] >> (b & 63) & 1) as u32))
    }

    pub(super) fn insert(&mut self, id: ViewId, descriptors: &[[u64; 4]]) {
        for t in 0..TABLES {
            let keys: Vec<u32> = self.keys(descriptors, t).collect();
            for key in keys {
                let views = self.tables[t].entry(key).or_default();
                if views.last() != Some(&id) {
                    views.push(id);
                }
            }
        }
    }

    pub(super) fn remove(&mut self, id: ViewId, descriptors: &[[u64; 4]]) {
        for t in 0..TABLES {
            let keys: Vec<u32> = self.keys(descriptors, t).collect();
            for key in keys {
                if let Some(views) = self.tables[t].get_mut(&key) {
                    views.retain(|v| *v != id);
                    if views.is_empty() {
                        self.tables[t].remove(&key);
                    }
                }
            }
        }
    }

    /// Views by their votes, most first. A vote counts the less, the more views share it.
    pub(super) fn candidates(&self, descriptors: &[[u64; 4]]) -> Vec<(ViewId, f64)> {
        let mut votes = BTreeMap::<ViewId, f64>::new();
        for t in 0..TABLES {
            for views in self.keys(descriptors, t).filter_map(|key| self.tables[t].get(&key)) {
                let share = 1.0 / views.len() as f64;
                views.iter().for_each(|&v| *votes.entry(v).or_default() += share);
            }
        }
        let mut out: Vec<(ViewId, f64)> = votes.into_iter().collect();
        out.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_view_seen_again_with_noise_is_voted_first() {
        let mut state = 7u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            state ^ state >> 29
        };
        let mut places = Places::default();
        let views: Vec<Vec<[u64; 4]>> =
            (0..40).map(|_| (0..300).map(|_| std::array::from_fn(|_| random())).collect()).collect();
        for (i, d) in views.iter().enumerate() {
            places.insert(ViewId(i as u32), d);
        }
        // A tenth of the bits differ, and only every third descriptor is there.
        let noisy = |d: &[u64; 4], i: usize| {
            std::array::from_fn(|w| d[w] ^ 0x0101_0401_1001_0011u64.rotate_left((i * 7 + w) as u32))
        };
        let again: Vec<[u64; 4]> = views[17].iter().enumerate().step_by(3).map(|(i, d)| noisy(d, i)).collect();
        assert_eq!(places.candidates(&again)[0].0, ViewId(17));
        places.remove(ViewId(17), &views[17]);
        assert!(places.candidates(&again).iter().all(|c| c.0 != ViewId(17)));
    }
}
