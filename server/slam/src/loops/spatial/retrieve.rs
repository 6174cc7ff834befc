//! Which submaps look alike from above.

use super::submap::Submap;
use nalgebra::{Point2, Vector2};
use percept_perception::features2d::{MatchParams, match_features};
use std::f64::consts::PI;

/// Most differing bits of 256. Were bits independent, those of different things would differ by 128, with a standard
/// deviation of 8.
const MOST_BITS: f64 = 64.0;
/// Pairs of matches that are tried, and how far apart a match may end, pixels. Of matches of which a tenth are right,
/// all miss in 2 of 100 cases: (1 - 0.1^2)^400.
const TRIES: usize = 400;
const APART_PX: f64 = 3.0;
/// Two matches nearer to each other than this fix no turn, pixels. One that is off by [`APART_PX`] turns them by 0.25
/// rad.
const SPREAD_PX: f64 = 12.0;
/// Fewer agreeing matches come about by chance. Of a hundred false ones in a picture of 192 pixels, three agree with
/// the two of a try within [`APART_PX`] in 7 of 100 000 tries, and in one of [`TRIES`] in 3 of 100 pictures at most.
pub(super) const FEWEST: usize = 5;

/// Numbers of the maps that look most like `map`, at most `count`, the likest first; with at least so many keypoints in
/// agreement. Each other one comes with the most that the pictures may be turned to each other, radians.
pub(super) fn most_alike<'a>(
    map: &Submap,
    others: impl Iterator<Item = (f64, &'a Submap)>,
    count: usize,
    least: usize,
) -> Vec<u64> {
    let scored = others.map(|(most_turn, o)| (agreeing(map, o, most_turn), o.number));
    let mut scored: Vec<(usize, u64)> = scored.filter(|s| s.0 >= least).collect();
    scored.sort_by(|a, b| b.0.cmp(&a.0).then(a.1.cmp(&b.1)));
    scored.truncate(count);
    scored.into_iter().map(|s| s.1).collect()
}

/// How many keypoints of two pictures one turn and shift brings together.
fn agreeing(a: &Submap, b: &Submap, most_turn: f64) -> usize {
    if a.voxel_m != b.voxel_m {
        return 0;
    }
    let params = MatchParams { ratio: 1.0, mutual: true, max_distance: Some(MOST_BITS) };
    let Ok(matches) = match_features(&a.features.descriptors, &b.features.descriptors, &params) else { return 0 };
    let place = |map: &Submap, i: u32| {
        let k = &map.features.keypoints[i as usize];
        Point2::new(f64::from(k.u), f64::from(k.v))
    };
    let pairs: Vec<_> = matches.iter().map(|m| (place(a, m.query_index), place(b, m.train_index))).collect();
    best_agreement(&pairs, most_turn)
}

/// RANSAC over pairs of matches: the most that one rigid motion of the plane brings together.
fn best_agreement(pairs: &[(Point2<f64>, Point2<f64>)], most_turn: f64) -> usize {
    let n = pairs.len();
    let least_cos = most_turn.min(PI).cos();
    if n < FEWEST {
        return 0;
    }
    let mut best = 0;
    for k in 0..TRIES.min(n * (n - 1) / 2) {
        // Steps that differ from round to round meet all pairs in turn.
        let (i, j) = (k % n, (k + 1 + (k / n) * 7) % n);
        let (d, e) = (pairs[j].0 - pairs[i].0, pairs[j].1 - pairs[i].1);
        if d.norm() < SPREAD_PX || (d.norm() - e.norm()).abs() > APART_PX {
            continue;
        }
        // Turn of the plane as a unit complex number: e / d.
        let turn = Vector2::new(d.dot(&e), d.perp(&e)) / (d.norm() * e.norm());
        if turn.x < least_cos {
            continue;
        }
        let moved = |p: &Point2<f64>| {
            let v = p - pairs[i].0;
            pairs[i].1 + Vector2::new(turn.x * v.x - turn.y * v.y, turn.y * v.x + turn.x * v.y)
        };
        let count = pairs.iter().filter(|(p, q)| (moved(p) - q).norm_squared() < APART_PX * APART_PX).count();
        best = best.max(count);
    }
    if best >= FEWEST { best } else { 0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_turned_and_shifted_pattern_is_found_among_false_matches() {
        let pattern = |i: usize| Point2::new((i * 37 % 101) as f64, (i * 53 % 97) as f64);
        let (sin, cos) = 0.7f64.sin_cos();
        let turned = |p: Point2<f64>| Point2::new(cos * p.x - sin * p.y + 40.0, sin * p.x + cos * p.y - 9.0);
        let pairs: Vec<_> =
            (0..60).map(|i| (pattern(i), if i % 3 == 0 { turned(pattern(i)) } else { pattern(i * 13 + 5) })).collect();
        assert!((20..24).contains(&best_agreement(&pairs, PI)), "{}", best_agreement(&pairs, PI));
        assert!((20..24).contains(&best_agreement(&pairs, 0.8)) && best_agreement(&pairs, 0.5) < 8);
        let chance: Vec<_> = (0..40).map(|i| (pattern(i), pattern(i * 13 + 5))).collect();
        assert!(best_agreement(&chance, PI) < 8);
    }
}
