//! Which observation belongs to which track.

use crate::{ObjectState, Observation, TrackerParams, assignment::assign, overlap, track::Track};
use percept_geometry::{ObjectClass, OrientedBox3, Timestamp};

/// Price of leaving a track without an observation; above every price of a pair.
const UNMATCHED: f64 = 2.0;
/// Price of a pair that cannot be.
const IMPOSSIBLE: f64 = 1e6;

/// For each track the index of its observation, so that the sum of prices is least over all of those that are asked for.
pub(crate) fn associate(
    tracks: &[Track],
    observations: &[Observation],
    stamp: Timestamp,
    params: &TrackerParams,
    is_asked: impl Fn(&Track) -> bool,
) -> Vec<Option<usize>> {
    let mut pairs = Vec::new();
    for (t, track) in tracks.iter().enumerate().filter(|(_, track)| is_asked(track)) {
        let predicted = track.predicted(stamp, params.coast_s);
        for (o, observation) in observations.iter().enumerate() {
            if track.state == ObjectState::Moving && !track.may_be_at(&observation.bbox, stamp) {
                continue;
            }
            if let Some(price) = price(track, &predicted, observation, params) {
                pairs.push((t, o, price));
            }
        }
    }
    let mut out = vec![None; tracks.len()];
    for group in connected(tracks.len(), observations.len(), &pairs) {
        solve(&group, &mut out);
    }
    out
}

/// Price of the pair, 0..2; none if it cannot be.
///
/// Overlapping boxes may belong together whatever their class. Boxes apart need to be near, of like size, and of a
/// class that does not contradict; and what is gone only comes back into its place.
fn price(track: &Track, predicted: &OrientedBox3, observation: &Observation, params: &TrackerParams) -> Option<f64> {
    let distance = (predicted.center() - observation.bbox.center()).norm();
    let reach = 0.5 * (predicted.size.norm() + observation.bbox.size.norm());
    if distance > reach.max(params.association_distance_m) {
        return None;
    }
    let seen = overlap::upright(&observation.bbox);
    let iou = overlap::iou(predicted, &seen);
    let likely = track.belief.probability(observation.class);
    if iou < params.min_iou {
        let fits = track.state != ObjectState::Gone
            && distance <= params.association_distance_m
            && size_ratio(predicted, &seen) <= params.max_size_ratio
            && (likely >= 0.05 || observation.class == ObjectClass::Unknown);
        if !fits {
            return None;
        }
    }
    let closeness = (1.0 - distance / params.association_distance_m.max(reach)).clamp(0.0, 1.0);
    let standing = match (track.state, track.id) {
        (ObjectState::Gone, _) => 0.2,
        (_, None) => 0.05,
        _ => 0.0,
    };
    Some(1.5 - 0.75 * iou - 0.75 * closeness + 0.2 * (1.0 - likely) + standing)
}

/// Largest ratio of like lengths: height to height, footprint diagonal to footprint diagonal.
fn size_ratio(a: &OrientedBox3, b: &OrientedBox3) -> f64 {
    let ratio = |a: f64, b: f64| if a > b { a / b } else { b / a };
    ratio(a.size.z, b.size.z).max(ratio(a.size.xy().norm(), b.size.xy().norm()))
}

/// Pairs that have nothing to do with each other are solved apart: a large scene is many small problems.
fn connected(tracks: usize, observations: usize, pairs: &[(usize, usize, f64)]) -> Vec<Vec<(usize, usize, f64)>> {
    let mut root: Vec<usize> = (0..tracks + observations).collect();
    fn find(root: &mut [usize], mut i: usize) -> usize {
        while root[i] != i {
            root[i] = root[root[i]];
            i = root[i];
        }
        i
    }
    for &(t, o, _) in pairs {
        let (a, b) = (find(&mut root, t), find(&mut root, tracks + o));
        root[a.max(b)] = a.min(b);
    }
    let mut groups: std::collections::BTreeMap<usize, Vec<(usize, usize, f64)>> = std::collections::BTreeMap::new();
    for &pair in pairs {
        groups.entry(find(&mut root, pair.0)).or_default().push(pair);
    }
    groups.into_values().collect()
}

fn solve(group: &[(usize, usize, f64)], out: &mut [Option<usize>]) {
    if let [(t, o, _)] = *group {
        out[t] = Some(o);
        return;
    }
    let distinct = |mut v: Vec<usize>| {
        v.sort_unstable();
        v.dedup();
        v
    };
    let tracks = distinct(group.iter().map(|p| p.0).collect());
    let observations = distinct(group.iter().map(|p| p.1).collect());
    // Each track has a column of its own for 'none'.
    let columns = observations.len() + tracks.len();
    let mut cost = vec![IMPOSSIBLE; tracks.len() * columns];
    for row in 0..tracks.len() {
        cost[row * columns + observations.len() + row] = UNMATCHED;
    }
    for &(t, o, price) in group {
        if let (Ok(row), Ok(column)) = (tracks.binary_search(&t), observations.binary_search(&o)) {
            cost[row * columns + column] = price;
        }
    }
    for (row, column) in assign(&cost, tracks.len(), columns).into_iter().enumerate() {
        if column < observations.len() && cost[row * columns + column] < IMPOSSIBLE {
            out[tracks[row]] = Some(observations[column]);
        }
    }
}
