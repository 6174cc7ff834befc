//! Places seen again: found by looks, verified by geometry, closed by a graph of similarities, so that the scale that
//! drifted on the way comes back, too.
//!
//! **Source:** Strasdat, Montiel and Davison, "Scale drift-aware large scale monocular SLAM", 2010.

use super::frame::{Frame, Lens, PointId};
use super::map::{Map, ViewId};
use super::places::Places;
use super::search::FAR_BITS;
use super::similarity::Similarity;
use super::triangulation;
use crate::pose_graph::{Edge, Manifold, OptimiseParams, PoseGraph, optimise};
use nalgebra::{Point3, SMatrix, SVector, Vector2};
use percept_perception::features2d::{Descriptors, MatchParams, match_features};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;

/// Views younger than this against the newest are no loop. As in ORB-SLAM2's code.
const MIN_AGE: u32 = 10;
/// Candidates that are tried for a view. Bounds the time of a view. Halved and doubled 25.1 ([`super`]).
const CANDIDATES: usize = 3;
/// Pairs of points that have to agree on a similarity, and points of the old place that then have to be found.
/// ORB-SLAM2's code asks for 20 and 40.
const MIN_PAIRS: usize = 15;
const MIN_FOUND: usize = 45;
/// Of the old place's points that should be visible, the share that has to be. Halved and doubled 25.1 ([`super`]).
const MIN_SHARE: f64 = 0.25;
/// Samples of three pairs. Of pairs of which 0.3 are right, all miss in 4 of 1000 cases: (1 - 0.3^3)^200; ORB-SLAM2's
/// code takes 300 at most.
const SAMPLES: usize = 200;
/// 99 % bound of two squared standard normal numbers.
const CHI2: f64 = 9.21;
/// Radius for further points of the old place, pixels of their level. ORB-SLAM2's code has 10.
const RADIUS_PX: f64 = 8.0;
/// Views that share so many points are tied together when a loop is closed. ORB-SLAM2's code has 100 for its essential
/// graph.
const STRONG: usize = 80;

/// A place seen again.
#[derive(Debug, Clone)]
pub(super) struct Loop {
    pub(super) newest: ViewId,
    pub(super) old: ViewId,
    /// The map, as it is around the old place, to the newest camera.
    s_newest_map: Similarity,
    /// Points of the old place and the newest view's features that show them.
    found: Vec<(PointId, u32)>,
}

/// A pair of points that look alike: in the newest camera and in the old one, with their pixels.
struct Pair {
    newest: Point3<f64>,
    old: Point3<f64>,
    seen: [(Vector2<f64>, f64); 2],
}

/// Whether the newest view shows a place that the map holds without knowing that it is the same.
pub(super) fn detect(map: &Map, places: &Places, newest: ViewId, lens: &Lens, ratio: f64) -> Option<Loop> {
    let view = map.views.get(&newest)?;
    let near: Vec<ViewId> = map.covisible(newest).into_iter().map(|(v, _)| v).collect();
    let is_far = |v: &ViewId| v.0 + MIN_AGE < newest.0 && !near.contains(v);
    let candidates = places.candidates(&view.frame.descriptors).into_iter().map(|(v, _)| v).take(30).filter(is_far);
    candidates.take(CANDIDATES).find_map(|old| verify(map, newest, old, lens, ratio))
}

fn verify(map: &Map, newest: ViewId, old: ViewId, lens: &Lens, ratio: f64) -> Option<Loop> {
    let pairs = pairs(map, newest, old, ratio)?;
    let s_newest_old = agree(&pairs, lens.focal)?;
    let s_newest_map = s_newest_old.compose(&Similarity::of(&map.views.get(&old)?.t_camera_map));
    let found = find_place(map, newest, old, &s_newest_map, lens)?;
    // Once more, with all points of the place that both views show.
    let all = shared(map, newest, old, &found)?;
    let s_newest_old = if all.len() < MIN_PAIRS { s_newest_old } else { refine(&s_newest_old, &all, lens.focal) };
    let s_newest_map = s_newest_old.compose(&Similarity::of(&map.views.get(&old)?.t_camera_map));
    Some(Loop { newest, old, s_newest_map, found })
}

/// The found points that the old view shows and that have a twin in the newest one.
fn shared(map: &Map, newest: ViewId, old: ViewId, found: &[(PointId, u32)]) -> Option<Vec<Pair>> {
    let (a, b) = (map.views.get(&newest)?, map.views.get(&old)?);
    let pair = |&(p, f): &(PointId, u32)| {
        let there = map.points.get(&p)?;
        let (_, g) = there.seen_by.iter().find(|(v, _)| *v == old)?;
        let own = a.frame.points[f as usize].and_then(|own| map.points.get(&own))?;
        Some(Pair {
            newest: a.t_camera_map * own.position,
            old: b.t_camera_map * there.position,
            seen: [a.frame.seen(f as usize), b.frame.seen(*g as usize)],
        })
    };
    Some(found.iter().filter_map(pair).collect())
}

/// Points of both views that look alike, each in its camera.
fn pairs(map: &Map, newest: ViewId, old: ViewId, ratio: f64) -> Option<Vec<Pair>> {
    let (a, b) = (map.views.get(&newest)?, map.views.get(&old)?);
    let shown = |f: &Frame| -> Vec<(PointId, usize)> {
        f.points.iter().enumerate().filter_map(|(i, p)| Some(((*p)?, i))).collect()
    };
    let looks =
        |f: &Frame, s: &[(PointId, usize)]| Descriptors::Binary(s.iter().map(|&(_, i)| f.descriptors[i]).collect());
    let (shown_a, shown_b) = (shown(&a.frame), shown(&b.frame));
    let params = MatchParams { ratio, mutual: true, max_distance: Some(f64::from(FAR_BITS)) };
    let matches = match_features(&looks(&a.frame, &shown_a), &looks(&b.frame, &shown_b), &params).ok()?;
    let pair = |m: &percept_perception::features2d::FeatureMatch| {
        let ((p, f), (q, g)) = (shown_a[m.query_index as usize], shown_b[m.train_index as usize]);
        Some(Pair {
            newest: a.t_camera_map * map.points.get(&p)?.position,
            old: b.t_camera_map * map.points.get(&q)?.position,
            seen: [a.frame.seen(f), b.frame.seen(g)],
        })
    };
    let pairs: Vec<Pair> = matches.iter().filter_map(pair).collect();
    (pairs.len() >= MIN_PAIRS).then_some(pairs)
}

/// Errors of a pair in standard deviations: the old point in the newest image, and the other way round.
fn errors(s: &Similarity, inverse: &Similarity, pair: &Pair, focal: f64) -> [Vector2<f64>; 2] {
    let off = |p: Point3<f64>, (pixel, sigma): (Vector2<f64>, f64)| {
        if p.z <= 1e-6 { Vector2::repeat(1e3) } else { (p.coords.xy() * (focal / p.z) - pixel) / sigma }
    };
    [off(s.apply(&pair.old), pair.seen[0]), off(inverse.apply(&pair.newest), pair.seen[1])]
}

fn fits(s: &Similarity, inverse: &Similarity, pair: &Pair, focal: f64) -> bool {
    errors(s, inverse, pair, focal).iter().all(|e| e.norm_squared() < CHI2)
}

/// The similarity from the old camera to the newest that most pairs agree on.
fn agree(pairs: &[Pair], focal: f64) -> Option<Similarity> {
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut best: (usize, Option<Similarity>) = (0, None);
    for _ in 0..SAMPLES {
        let sample: [usize; 3] = std::array::from_fn(|_| rng.random_range(0..pairs.len()));
        let of = |side: fn(&Pair) -> Point3<f64>| sample.map(|i| side(&pairs[i]));
        let Some(s) = Similarity::between(&of(|p| p.old), &of(|p| p.newest)) else { continue };
        let inverse = s.inverse();
        let count = pairs.iter().filter(|p| fits(&s, &inverse, p, focal)).count();
        if count > best.0 {
            best = (count, Some(s));
        }
    }
    let s = refine(&best.1?, pairs, focal);
    let inverse = s.inverse();
    (pairs.iter().filter(|p| fits(&s, &inverse, p, focal)).count() >= MIN_PAIRS).then_some(s)
}

/// Gauss-Newton with Huber's weights on both images' errors; derivatives by differences (seven unknowns, few pairs).
fn refine(start: &Similarity, pairs: &[Pair], focal: f64) -> Similarity {
    let mut s = *start;
    for _ in 0..8 {
        let h = 1e-6;
        let residuals = |s: &Similarity| -> Vec<Vector2<f64>> {
            let inverse = s.inverse();
            pairs.iter().flat_map(|p| errors(s, &inverse, p, focal)).collect()
        };
        let here = residuals(&s);
        let moved: [Vec<Vector2<f64>>; 7] = std::array::from_fn(|k| {
            let mut d = SVector::<f64, 7>::zeros();
            d[k] = h;
            residuals(&s.step(&d))
        });
        let (mut normal, mut gradient) = (SMatrix::<f64, 7, 7>::identity() * 1e-9, SVector::<f64, 7>::zeros());
        for (i, r) in here.iter().enumerate() {
            let length2 = r.norm_squared();
            // Pairs that do not fit at all are left out.
            if length2 > 9.0 * CHI2 {
                continue;
            }
            let weight = (CHI2 / length2.max(CHI2)).sqrt();
            for axis in 0..2 {
                let j = SVector::<f64, 7>::from_fn(|k, _| (moved[k][i][axis] - r[axis]) / h);
                normal.syger(weight, &j, &j, 1.0);
                gradient.axpy(weight * r[axis], &j, 1.0);
            }
        }
        normal.fill_upper_triangle_with_lower_triangle();
        let Some(step) = normal.cholesky().map(|c| c.solve(&gradient)) else { return s };
        s = s.step(&-step);
        if step.norm() < 1e-7 {
            break;
        }
    }
    s
}

/// Points of the old view and its neighbours, found in the newest image by the similarity; none if too few.
fn find_place(map: &Map, newest: ViewId, old: ViewId, s: &Similarity, lens: &Lens) -> Option<Vec<(PointId, u32)>> {
    let view = map.views.get(&newest)?;
    let mut views: Vec<ViewId> = map.covisible(old).into_iter().take(8).map(|(v, _)| v).collect();
    views.push(old);
    let seen = views.iter().filter_map(|v| map.views.get(v)).flat_map(|v| v.frame.points.iter().flatten().copied());
    let mut points: Vec<PointId> = seen.collect();
    points.sort_unstable();
    points.dedup();
    // As a camera in the map around the old place.
    let t_camera_map = s.to_camera();
    let (mut found, mut near, mut visible) = (BTreeMap::new(), vec![], 0usize);
    for id in points {
        let Some(p) = map.points.get(&id) else { continue };
        if lens.project(&(t_camera_map * p.position)).is_none() {
            continue;
        }
        visible += 1;
        if let Some(f) = triangulation::find(&view.frame, &t_camera_map, p, lens, RADIUS_PX, &mut near) {
            found.entry(f).or_insert(id);
        }
    }
    let enough = found.len() >= MIN_FOUND && found.len() as f64 >= MIN_SHARE * (visible as f64).min(400.0);
    enough.then(|| found.into_iter().map(|(f, p)| (p, f)).collect())
}

/// Moves views and points so that the loop closes, and makes one of the points that are one.
pub(super) fn close(map: &mut Map, found: &Loop, lens: &Lens) {
    let Some(corrected) = optimised(map, found) else { return };
    let before: BTreeMap<ViewId, _> = map.views.iter().map(|(&id, v)| (id, v.t_camera_map)).collect();
    for p in map.points.values_mut() {
        // A point moves with the first view that sees it.
        let Some((view, _)) = p.seen_by.first() else { continue };
        if let (Some(t), Some(s)) = (before.get(view), corrected.get(view)) {
            p.position = s.inverse().apply(&(t * p.position));
        }
    }
    for (id, s) in &corrected {
        if let Some(v) = map.views.get_mut(id) {
            v.t_camera_map = s.to_camera();
        }
    }
    join(map, found, lens);
    let (tree, points): (Vec<_>, Vec<PointId>) =
        (map.views.iter().map(|(&id, v)| (id, v.parent)).collect(), map.points.keys().copied().collect());
    tree.into_iter().for_each(|(id, parent)| map.set_parent(id, parent));
    points.into_iter().for_each(|id| map.describe(id));
}

/// Every view's pose with a scale once the loop is closed: what neighbours were to each other is kept as far as possible.
fn optimised(map: &Map, found: &Loop) -> Option<BTreeMap<ViewId, Similarity>> {
    let ids: Vec<ViewId> = map.views.keys().copied().collect();
    let number: BTreeMap<ViewId, u32> = ids.iter().enumerate().map(|(i, &v)| (v, i as u32)).collect();
    // Nodes are camera to map, as poses are.
    let poses: Vec<Similarity> = map.views.values().map(|v| Similarity::of(&v.t_camera_map).inverse()).collect();
    let edge = |from: u32, to: u32, t_from_to: Similarity| Edge {
        from,
        to,
        t_from_to,
        information: SMatrix::<f64, 7, 7>::identity(),
    };
    let mut edges = vec![];
    for (&id, view) in &map.views {
        let strong = map.covisible(id).into_iter().filter(|&(v, n)| n >= STRONG && v < id).map(|(v, _)| v);
        for other in strong.chain(view.parent).collect::<std::collections::BTreeSet<_>>() {
            let (a, b) = (number[&id], *number.get(&other)?);
            edges.push(edge(a, b, poses[a as usize].inverse().compose(&poses[b as usize])));
        }
    }
    let (newest, old) = (*number.get(&found.newest)?, *number.get(&found.old)?);
    edges.push(edge(newest, old, found.s_newest_map.compose(&poses[old as usize])));
    let mut graph = PoseGraph { poses, edges, fixed: vec![0] };
    let report = optimise(&mut graph, &OptimiseParams { max_iterations: 30, ..OptimiseParams::default() }).ok()?;
    let sound = graph.poses.iter().all(|s| s.scale.is_finite() && s.scale > 0.0);
    (sound && report.chi2.is_finite()).then(|| ids.into_iter().zip(graph.poses.iter().map(Manifold::inverse)).collect())
}

/// The old place's points replace those that the newest views made of them anew.
fn join(map: &mut Map, found: &Loop, lens: &Lens) {
    for &(old, feature) in &found.found {
        let own = map.views.get(&found.newest).and_then(|v| v.frame.points[feature as usize]);
        match own {
            Some(own) => map.merge(own, old),
            None => map.see(found.newest, feature, old),
        }
    }
    let place: Vec<PointId> = found.found.iter().map(|&(p, _)| p).collect();
    let around: Vec<ViewId> = map.covisible(found.newest).into_iter().take(10).map(|(v, _)| v).collect();
    for view in around {
        triangulation::fuse_into(map, view, &place, lens, 4.0);
    }
}
