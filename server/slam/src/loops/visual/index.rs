//! Which keyframes have features that look alike: binary descriptors by their words.
//!
//! Source: Norouzi, Punjani, Fleet, "Fast search in Hamming space with multi-index hashing", 2012. Two views of one
//! corner differ by a few dozen of 256 bits, so some of the 16 words of 16 bits are mostly equal. Exact within the words
//! looked up; each hit is checked by its whole distance.

use percept_geometry::KeyframeId;
use rustc_hash::FxHashMap;
use std::collections::BTreeMap;

/// Words of a descriptor.
const WORDS: usize = 16;
/// A word that so many features share tells nothing.
const COMMON: usize = 512;

/// A feature's keyframe and number in it.
type Entry = (KeyframeId, u16);

/// Features by the words of their descriptors.
#[derive(Debug, Default)]
pub(super) struct Index {
    lists: FxHashMap<(u8, u16), Vec<Entry>>,
}

impl Index {
    pub(super) fn insert(&mut self, id: KeyframeId, descriptors: &[[u64; 4]]) {
        for (i, descriptor) in descriptors.iter().enumerate() {
            for key in words(descriptor) {
                self.lists.entry(key).or_default().push((id, i as u16));
            }
        }
    }

    pub(super) fn remove(&mut self, id: KeyframeId, descriptors: &[[u64; 4]]) {
        for key in descriptors.iter().flat_map(words) {
            if let Some(list) = self.lists.get_mut(&key) {
                list.retain(|e| e.0 != id);
                if list.is_empty() {
                    self.lists.remove(&key);
                }
            }
        }
    }

    /// How many of the `query`'s features have one alike in each keyframe, of which at most `bits` differ; `descriptor` gives
    /// an entry's, if it may be compared.
    pub(super) fn votes<'a>(
        &self,
        query: &[[u64; 4]],
        bits: u32,
        descriptor: impl Fn(Entry) -> Option<&'a [u64; 4]>,
    ) -> BTreeMap<KeyframeId, u32> {
        let mut votes: FxHashMap<KeyframeId, (u32, usize)> = FxHashMap::default();
        for (i, q) in query.iter().enumerate() {
            for list in words(q).filter_map(|key| self.lists.get(&key)).filter(|l| l.len() <= COMMON) {
                for &entry in list {
                    let vote = votes.entry(entry.0).or_insert((0, usize::MAX));
                    // A feature votes once for a keyframe.
                    if vote.1 != i && descriptor(entry).is_some_and(|d| distance(q, d) <= bits) {
                        *vote = (vote.0 + 1, i);
                    }
                }
            }
        }
        votes.into_iter().filter(|v| v.1.0 > 0).map(|(id, v)| (id, v.0)).collect()
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
        let look_up = |e: Entry| all.get(usize::from(e.1));
        // Three bits of each are wrong.
        let query: Vec<[u64; 4]> = all.iter().map(|d| [d[0] ^ 0x1001, d[1] ^ 4, d[2], d[3]]).collect();
        let votes = index.votes(&query, 3, look_up);
        assert_eq!(votes[&KeyframeId(3)], 39);
        assert!(votes[&KeyframeId(4)] >= 10);
        index.remove(KeyframeId(3), &all);
        index.remove(KeyframeId(4), &all[..10]);
        assert!(index.lists.is_empty());
    }
}
