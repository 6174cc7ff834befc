//! Whether things keep their identity.

use crate::best_pairs;
use crate::detection::share;
use serde::Serialize;
use std::collections::BTreeMap;

/// One box of a frame: a true object (`Some` number), a tracked one, or both where they match.
pub type IdentityPair = (Option<i64>, Option<i64>);

/// How well tracks keep to true objects, over all frames. Counts are of boxes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct IdentityScore {
    /// Boxes of true objects.
    pub num_true: usize,
    /// Boxes of tracks.
    pub num_tracked: usize,
    /// Matches between an object and the one track that is taken for it.
    pub num_identified: usize,
    /// Times that an object goes on under another track than that which had it before.
    pub num_switches: usize,
    /// 2 identified / (true + tracked); `None` if both are 0.
    pub idf1: Option<f64>,
}

/// Scores the pairs of all frames, in the order of the frames: each true box, alone or with the track that matches it,
/// and each tracked box that matches none.
///
/// Source: Ristani et al., "Performance measures and a data set for multi-target, multi-camera tracking", 2016: the
/// one-to-one assignment of whole tracks to whole objects that explains most boxes. Switches: Bernardin and
/// Stiefelhagen, "Evaluating multiple object tracking performance: the CLEAR MOT metrics", 2008.
pub fn identity_score(pairs: &[IdentityPair]) -> IdentityScore {
    let number = |ids: Vec<i64>| {
        let mut numbers = BTreeMap::new();
        for id in ids {
            let next = numbers.len();
            numbers.entry(id).or_insert(next);
        }
        numbers
    };
    let objects = number(pairs.iter().filter_map(|p| p.0).collect());
    let tracks = number(pairs.iter().filter_map(|p| p.1).collect());
    let mut together = vec![vec![0.0; tracks.len()]; objects.len()];
    let (mut last, mut num_switches) = (BTreeMap::new(), 0);
    for (object, track) in pairs.iter().filter_map(|p| Some((p.0?, p.1?))) {
        together[objects[&object]][tracks[&track]] += 1.0;
        num_switches += usize::from(last.insert(object, track).is_some_and(|before| before != track));
    }
    let num_identified = best_pairs(&together, 1.0).iter().map(|&(o, t)| together[o][t] as usize).sum();
    let num_true = pairs.iter().filter(|p| p.0.is_some()).count();
    let num_tracked = pairs.iter().filter(|p| p.1.is_some()).count();
    let idf1 = share(2 * num_identified, num_true + num_tracked);
    IdentityScore { num_true, num_tracked, num_identified, num_switches, idf1 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_track_that_changes_counts_for_its_longer_half() {
        // Object 1 is followed for three frames by track 7, then by 8, and missed once; track 9 is nothing.
        let on = |track| (Some(1), Some(track));
        let score = identity_score(&[on(7), on(7), on(7), on(8), (Some(1), None), (None, Some(9))]);
        assert_eq!((score.num_true, score.num_tracked, score.num_identified, score.num_switches), (5, 5, 3, 1));
        assert_eq!(score.idf1, Some(0.6));
    }

    #[test]
    fn a_track_stands_for_one_object_only() {
        // Track 7 hops from object 1 to object 2, which track 8 had before.
        let pairs = [(Some(1), Some(7)), (Some(1), Some(7)), (Some(2), Some(8)), (Some(2), Some(7))];
        let score = identity_score(&pairs);
        assert_eq!((score.num_identified, score.num_switches, score.idf1), (3, 1, Some(0.75)));
        assert_eq!(identity_score(&[]).idf1, None);
    }
}
