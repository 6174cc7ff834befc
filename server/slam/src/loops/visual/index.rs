//! Which keyframes have features that look alike: binary descriptors by their words.
//!
//! Source: Norouzi, Punjani, Fleet, "Fast search in Hamming space with multi-index hashing", 2012. Two views of one
//! corner differ by a few dozen of 256 bits, so some of the 16 words of 16 bits are mostly equal. Exact within the words
//! looked up; each hit is checked by its whole distance.

use percept_geometry::KeyframeId;
use rustc_hash::FxHashMap;
use std::collections::BTreeMap;

/// Words of a descriptor: its 256 bits in words of 16 bits.
const WORDS: usize = 16;
/// A word that so many features share tells nothing. Halved and doubled as it is ([`super`]).
const COMMON: usize = 512;

/// Features of a keyframe, at most: numbers of eight bits. The size of u8.
pub(super) const MOST_FEATURES: usize = 256;

/// A feature: its keyframe's slot, and its number there. Each feature has sixteen of these, so that they make up most of the memory.
#[derive(Debug, Clone, Copy)]
struct Entry(u32);

impl Entry {
    fn new(slot: u32, feature: usize) -> Self {
        Self(slot << 8 | feature as u32)
    }

    fn slot(self) -> u32 {
        self.0 >> 8
    }

    fn feature(self) -> usize {
        (self.0 & 0xff) as usize
    }
}

/// Features by the words of their descriptors.
#[derive(Debug, Default)]
pub(super) struct Index {
    lists: FxHashMap<(u8, u16), Vec<Entry>>,
    /// Keyframes by slot; none where a keyframe has gone.
    slots: Vec<Option<KeyframeId>>,
    slot_of: BTreeMap<KeyframeId, u32>,
    free: Vec<u32>,
    num_entries: usize,
}

impl Index {
    /// Takes a keyframe's features in, [`MOST_FEATURES`] at most, if it is not there yet.
    pub(super) fn insert(&mut self, id: KeyframeId, descriptors: &[[u64; 4]]) {
        if self.slot_of.contains_key(&id) {
            return;
        }
        let slot = self.free.pop().unwrap_or_else(|| {
            self.slots.push(None);
            self.slots.len() as u32 - 1
        });
        self.slots[slot as usize] = Some(id);
        self.slot_of.insert(id, slot);
        for (i, descriptor) in descriptors.iter().take(MOST_FEATURES).enumerate() {
            for key in words(descriptor) {
                self.lists.entry(key).or_default().push(Entry::new(slot, i));
                self.num_entries += 1;
            }
        }
    }

    pub(super) fn remove(&mut self, id: KeyframeId, descriptors: &[[u64; 4]]) {
        let Some(slot) = self.slot_of.remove(&id) else { return };
        self.slots[slot as usize] = None;
        self.free.push(slot);
        for key in descriptors.iter().flat_map(words) {
            if let Some(list) = self.lists.get_mut(&key) {
                let before = list.len();
                list.retain(|e| e.slot() != slot);
                self.num_entries -= before - list.len();
                if list.is_empty() {
                    self.lists.remove(&key);
                }
            }
        }
    }

    /// Bytes, about: lists grow by doubling.
    pub(super) fn memory_bytes(&self) -> usize {
        let lists = self.lists.capacity() * size_of::<((u8, u16), Vec<Entry>)>();
        lists + 2 * self.num_entries * size_of::<Entry>() + self.slots.len() * size_of::<(KeyframeId, [u32; 2])>()
    }

    /// How many of the `query`'s features have one alike in each keyframe, of which at most `bits` differ; `descriptor` gives
    /// that of a keyframe's feature, if it may be compared.
    pub(super) fn votes<'a>(
        &self,
        query: &[[u64; 4]],
        bits: u32,
        descriptor: impl Fn(KeyframeId, usize) -> Option<&'a [u64; 4]>,
    ) -> BTreeMap<KeyframeId, u32> {
        let mut votes: FxHashMap<u32, (u32, usize)> = FxHashMap::default();
        for (i, q) in query.iter().enumerate() {
            for list in words(q).filter_map(|key| self.lists.get(&key)).filter(|l| l.len() <= COMMON) {
                for &entry in list {
                    let Some(id) = self.slots[entry.slot() as usize] else { continue };
                    let vote = votes.entry(entry.slot()).or_insert((0, usize::MAX));
                    // A feature votes once for a keyframe.
                    if vote.1 != i && descriptor(id, entry.feature()).is_some_and(|d| distance(q, d) <= bits) {
                        *vote = (vote.0 + 1, i);
                    }
                }
            }
        }
        let id = |slot: u32| self.slots[slot as usize];
        votes.into_iter().filter(|v| v.1.0 > 0).filter_map(|(slot, v)| Some((id(slot)?, v.0))).collect()
    }
}

fn words(descriptor: &[u64; 4]) -> impl Iterator<Item = (u8, u16)> + '_ {
    (0..WORDS).map(|k| (k as u8, (descriptor[k / 4] >> (16 * (k % 4))) as u16))
}

/// Bits that differ.
pub(super) fn distance(a: &[u64; 4], b: &[u64; 4]) -> u32 {
    (0..4).map(|k| (a[k] ^ b[k]).count_ones()).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_keyframe_gets_a_vote_for_each_feature_alike_until_it_is_removed() {
        let all: Vec<[u64; 4]> = (1..40u64).map(|k| [k * 0x9e37_79b9_7f4a_7c15, k << 40, !k, k * k]).collect();
        let mut index = Index::default();
        index.insert(KeyframeId(3), &all);
        index.insert(KeyframeId(4), &all[..10]);
        let look_up = |_, feature: usize| all.get(feature);
        // Three bits of each are wrong.
        let query: Vec<[u64; 4]> = all.iter().map(|d| [d[0] ^ 0x1001, d[1] ^ 4, d[2], d[3]]).collect();
        let votes = index.votes(&query, 3, look_up);
        assert_eq!(votes[&KeyframeId(3)], 39);
        assert!(votes[&KeyframeId(4)] >= 10);
        index.remove(KeyframeId(3), &all);
        index.remove(KeyframeId(4), &all[..10]);
        assert!(index.lists.is_empty() && index.num_entries == 0);
        // Slots are used again, and what was there before gets no votes.
        index.insert(KeyframeId(9), &all[..10]);
        let votes = index.votes(&query, 3, look_up);
        assert_eq!((votes.len(), votes[&KeyframeId(9)]), (1, 10));
    }
}
