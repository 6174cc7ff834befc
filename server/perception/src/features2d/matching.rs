//! Matching by brute force: each descriptor's nearest of the other image, if it is clearly the nearest.

use super::distance::{BinarySet, ByteSet, Nearest, nearest};
use super::{Descriptors, FeatureError, within};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// How [`match_features`] decides.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MatchParams {
    /// Lowe's test: the nearest has to be nearer than this times the second nearest, 0 to 1; 1 takes every nearest.
    pub ratio: f64,
    /// Keep a match only if each is the other's nearest.
    pub mutual: bool,
    /// Greatest distance: bits of 256, or Euclidean between bytes (a descriptor is about 512 long); none: any.
    pub max_distance: Option<f64>,
}

impl Default for MatchParams {
    fn default() -> Self {
        Self { ratio: 0.75, mutual: false, max_distance: None }
    }
}

impl MatchParams {
    /// Checks every field.
    ///
    /// # Errors
    /// `OutOfRange` naming the field.
    pub fn validate(&self) -> Result<(), FeatureError> {
        within("ratio", self.ratio, 1e-6, 1.0, "above 0, at most 1")?;
        match self.max_distance {
            Some(d) => within("max_distance", d, 0.0, 1e6, "at least 0"),
            None => Ok(()),
        }
    }
}

/// Two features that look alike.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FeatureMatch {
    /// In the first set.
    pub query_index: u32,
    /// In the second set.
    pub train_index: u32,
    /// Differing bits, or Euclidean distance.
    pub distance: f32,
}

/// Most descriptors of a set.
const LIMIT: usize = 1 << 20;
/// Queries a task.
const CHUNK: usize = 64;

/// For each descriptor of `query` its nearest of `train`, in order of the queries; exact. Of equally near ones the
/// first counts. A ratio below 1 needs a second nearest to compare with: one lone `train` descriptor matches nothing.
///
/// **Source:** Lowe 2004, section 7.1 (ratio test).
///
/// # Errors
/// `Params`, `KindsDiffer`, `TooManyDescriptors` (more than a million).
pub fn match_features(
    query: &Descriptors,
    train: &Descriptors,
    params: &MatchParams,
) -> Result<Vec<FeatureMatch>, FeatureError> {
    params.validate()?;
    if let Some(&count) = [query.len(), train.len()].iter().find(|&&n| n > LIMIT) {
        return Err(FeatureError::TooManyDescriptors { count, limit: LIMIT });
    }
    let (forward, backward, squared) = match (query, train) {
        (Descriptors::Binary(q), Descriptors::Binary(t)) => {
            let search = |q: &[[u64; 4]], t: &[[u64; 4]]| {
                let set = BinarySet::new(t);
                all_nearest(q.len(), t.len(), |i, out| set.distances(&q[i], out))
            };
            (search(q, t), params.mutual.then(|| search(t, q)), false)
        }
        (Descriptors::Bytes(q), Descriptors::Bytes(t)) => {
            let (q, t) = (ByteSet::new(q), ByteSet::new(t));
            let search =
                |q: &ByteSet, nq: usize, t: &ByteSet, nt: usize| all_nearest(nq, nt, |i, out| t.distances(q, i, out));
            let (nq, nt) = (query.len(), train.len());
            (search(&q, nq, &t, nt), params.mutual.then(|| search(&t, nt, &q, nq)), true)
        }
        _ => return Err(FeatureError::KindsDiffer),
    };
    let measure = |d: u32| if squared { f64::from(d).sqrt() } else { f64::from(d) };
    let mut out = Vec::new();
    for (i, found) in forward.iter().enumerate() {
        let Some(n) = found else { continue };
        let distance = measure(n.distance);
        let distinct = params.ratio >= 1.0 || (n.second < u32::MAX && distance < params.ratio * measure(n.second));
        let near = params.max_distance.is_none_or(|most| distance <= most);
        let returned = backward.as_ref().is_none_or(|b| b[n.index as usize].is_some_and(|m| m.index == i as u32));
        if distinct && near && returned {
            out.push(FeatureMatch { query_index: i as u32, train_index: n.index, distance: distance as f32 });
        }
    }
    Ok(out)
}

/// The nearest of each query, by a function that gives its distances to all.
fn all_nearest(queries: usize, count: usize, distances: impl Fn(usize, &mut [u32]) + Sync) -> Vec<Option<Nearest>> {
    let mut out = vec![None; queries];
    out.par_chunks_mut(CHUNK).enumerate().for_each(|(c, part)| {
        let mut row = vec![0; count];
        for (i, found) in part.iter_mut().enumerate() {
            distances(c * CHUNK + i, &mut row);
            *found = nearest(&row);
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn binary(first_words: &[u64]) -> Descriptors {
        Descriptors::Binary(first_words.iter().map(|&w| [w, 0, 0, 0]).collect())
    }

    #[test]
    fn an_ambiguous_nearest_is_no_match() {
        let train = binary(&[0b1, 0b10, 0xffff]);
        let any = MatchParams { ratio: 1.0, ..MatchParams::default() };
        let found = match_features(&binary(&[0, 0xfffe]), &train, &any).unwrap();
        assert_eq!(found.iter().map(|m| m.train_index).collect::<Vec<_>>(), [0, 2]);
        let clear = match_features(&binary(&[0, 0xfffe]), &train, &MatchParams::default()).unwrap();
        assert_eq!(clear.len(), 1);
        assert_eq!((clear[0].query_index, clear[0].train_index, clear[0].distance), (1, 2, 1.0));
    }

    #[test]
    fn mutual_matches_are_one_to_one() {
        let params = MatchParams { ratio: 1.0, mutual: true, max_distance: None };
        let found = match_features(&binary(&[0b111, 0b1]), &binary(&[0b1, 0xff00]), &params).unwrap();
        assert_eq!(found.len(), 1);
        assert_eq!((found[0].query_index, found[0].train_index), (1, 0));
    }

    #[test]
    fn nothing_matches_nothing_and_kinds_do_not_mix() {
        let none = Descriptors::Bytes(vec![]);
        assert!(match_features(&none, &none, &MatchParams::default()).unwrap().is_empty());
        assert!(match_features(&binary(&[1]), &binary(&[]), &MatchParams::default()).unwrap().is_empty());
        assert!(match_features(&binary(&[1]), &binary(&[1]), &MatchParams::default()).unwrap().is_empty());
        let mixed = match_features(&binary(&[1]), &none, &MatchParams::default());
        assert_eq!(mixed, Err(FeatureError::KindsDiffer));
        let bad = MatchParams { ratio: f64::NAN, ..MatchParams::default() };
        assert!(match_features(&none, &none, &bad).is_err());
    }
}
