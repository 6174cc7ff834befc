//! New points: what two views show, but no point of the map explains; and points that are one, made one.

use super::frame::{Frame, Lens, PointId, hamming, sigma};
use super::map::{Map, ViewId};
use super::search::{FAR_BITS, NEAR_BITS, scales_agree};
use super::start::{MIN_PARALLAX, Ray, meet};
use nalgebra::{Matrix3, Point3, Vector2, Vector3};
use percept_geometry::Pose;
use rayon::prelude::*;

/// Views tried with a new one. ORB-SLAM2's code takes 20 of a camera alone and 10 of others. Halved 24.6, doubled 26.0
/// ([`super`]).
const NEIGHBOURS: usize = 10;
/// Views closer together than this share of the depth show no parallax. As in ORB-SLAM2's code.
const MIN_BASELINE: f64 = 0.01;
/// Squared distance from the epipolar line in standard deviations, 95 %.
const LINE_CHI2: f64 = 3.841;

/// A pair of features that are one point, in the map.
struct NewPoint {
    features: (u32, u32),
    position: Point3<f64>,
}

/// Triangulates what the view and its neighbours show and no point explains; returns the new points.
pub(super) fn triangulate(map: &mut Map, id: ViewId, lens: &Lens) -> Vec<PointId> {
    let neighbours: Vec<ViewId> = map.covisible(id).into_iter().take(NEIGHBOURS).map(|(v, _)| v).collect();
    let mut out = vec![];
    for other in neighbours {
        let (Some(view), Some(near)) = (map.views.get(&id), map.views.get(&other)) else { continue };
        let baseline = (view.center() - near.center()).norm();
        let Some(depth) = map.median_depth(other) else { continue };
        if baseline < MIN_BASELINE * depth {
            continue;
        }
        let t_near_view = near.t_camera_map * view.t_camera_map.inverse();
        let t_map_view = view.t_camera_map.inverse();
        for p in pairs(&view.frame, &near.frame, &t_near_view, lens) {
            let seen_by = [(id, p.features.0), (other, p.features.1)];
            out.push(map.add_point(t_map_view * p.position, &seen_by));
        }
    }
    out
}

/// Pairs of free features near each other's epipolar lines that look alike; positions in the first camera.
fn pairs(a: &Frame, b: &Frame, t_b_a: &Pose, lens: &Lens) -> Vec<NewPoint> {
    let free = |f: &Frame| (0..f.len() as u32).filter(|&i| f.points[i as usize].is_none()).collect::<Vec<u32>>();
    let (free_a, free_b) = (free(a), free(b));
    let pixels_b: Vec<Vector2<f64>> = free_b.iter().map(|&i| b.pixels[i as usize]).collect();
    let fundamental = fundamental(t_b_a, lens.focal);
    let epipole = t_b_a.translation.vector;
    let found: Vec<Option<(u32, NewPoint)>> = free_a
        .par_iter()
        .map(|&i| {
            let line = fundamental * a.pixels[i as usize].push(1.0);
            let candidate = along(&line, &epipole, (a, i), (b, &free_b, &pixels_b), lens.focal)?;
            let (rays, octaves) = (
                (Ray::of(a, i, lens), Ray::of(b, candidate.1, lens)),
                (a.octaves[i as usize], b.octaves[candidate.1 as usize]),
            );
            let (position, parallax) = meet(t_b_a, &rays.0, &rays.1, lens.focal)?;
            let distances = (position.coords.norm(), (t_b_a * position).coords.norm());
            let sound = parallax > MIN_PARALLAX && scales_agree(octaves, distances);
            sound.then_some((candidate.0, NewPoint { features: (i, candidate.1), position }))
        })
        .collect();
    // A feature of b that several claim goes to the one that looks most like it.
    let mut claims: Vec<(u32, NewPoint)> = found.into_iter().flatten().collect();
    claims.sort_by_key(|(bits, p)| (*bits, p.features));
    let mut taken = vec![false; b.len()];
    claims.into_iter().map(|(_, p)| p).filter(|p| !std::mem::replace(&mut taken[p.features.1 as usize], true)).collect()
}

/// Takes a pixel of a (with a 1) to its epipolar line in b.
fn fundamental(t_b_a: &Pose, focal: f64) -> Matrix3<f64> {
    let essential = t_b_a.translation.vector.cross_matrix() * t_b_a.rotation.to_rotation_matrix().matrix();
    let k_inverse = Matrix3::from_diagonal(&Vector3::new(1.0 / focal, 1.0 / focal, 1.0));
    k_inverse * essential * k_inverse
}

/// The feature near the line that looks most like feature `i` of a, clearly: bits and number.
fn along(
    line: &Vector3<f64>,
    epipole: &Vector3<f64>,
    (a, i): (&Frame, u32),
    (b, free, pixels): (&Frame, &[u32], &[Vector2<f64>]),
    focal: f64,
) -> Option<(u32, u32)> {
    let norm = line.xy().norm();
    let l = line / norm;
    let widest = LINE_CHI2.sqrt() * sigma(7);
    let look = &a.descriptors[i as usize];
    let (mut best, mut second, mut at) = (NEAR_BITS + 1, NEAR_BITS + 1, None);
    for (k, p) in pixels.iter().enumerate() {
        let distance = (l.x * p.x + l.y * p.y + l.z).abs();
        if distance > widest {
            continue;
        }
        let f = free[k];
        let s = sigma(b.octaves[f as usize]);
        // Near the epipole every point is near every line.
        let from_epipole = (p * epipole.z - epipole.xy() * focal).norm();
        if distance * distance > LINE_CHI2 * s * s || from_epipole < 10.0 * s * epipole.z.abs() {
            continue;
        }
        let bits = hamming(&b.descriptors[f as usize], look);
        if bits < best {
            (second, best, at) = (best, bits, Some(f));
        } else if bits < second {
            second = bits;
        }
    }
    at.filter(|_| f64::from(best) < 0.9 * f64::from(second) || second > NEAR_BITS).map(|f| (best, f))
}

/// Looks for the view's points in its neighbours and for the neighbours' points in the view: sightings are added,
/// points that fall on one feature are made one.
pub(super) fn fuse(map: &mut Map, id: ViewId, lens: &Lens) {
    let neighbours: Vec<ViewId> = map.covisible(id).into_iter().take(NEIGHBOURS).map(|(v, _)| v).collect();
    let points_of = |map: &Map, v: ViewId| -> Vec<PointId> {
        map.views.get(&v).map_or_else(Vec::new, |v| v.frame.points.iter().flatten().copied().collect())
    };
    let own = points_of(map, id);
    for &other in &neighbours {
        fuse_into(map, other, &own, lens, 3.0);
    }
    let mut theirs: Vec<PointId> = neighbours.iter().flat_map(|&v| points_of(map, v)).collect();
    theirs.sort_unstable();
    theirs.dedup();
    fuse_into(map, id, &theirs, lens, 3.0);
    for p in points_of(map, id) {
        map.describe(p);
    }
}

/// Sights `points` in a view where they project within `radius` pixels of their level; returns how many were found.
pub(super) fn fuse_into(map: &mut Map, id: ViewId, points: &[PointId], lens: &Lens, radius: f64) -> usize {
    let mut decisions = vec![];
    if let Some(view) = map.views.get(&id) {
        let mut near = vec![];
        for &p in points {
            let Some(point) = map.points.get(&p) else { continue };
            if point.seen_by.iter().any(|&(v, _)| v == id) {
                continue;
            }
            if let Some(feature) = find(&view.frame, &view.t_camera_map, point, lens, radius, &mut near) {
                decisions.push((p, feature));
            }
        }
    }
    let count = decisions.len();
    for (p, feature) in decisions {
        let there = map.views.get(&id).and_then(|v| v.frame.points[feature as usize]);
        match there {
            None => map.see(id, feature, p),
            Some(q) => {
                let seen = |p: PointId| map.points.get(&p).map_or(0, |p| p.seen_by.len());
                if seen(q) >= seen(p) { map.merge(p, q) } else { map.merge(q, p) }
            }
        }
    }
    count
}

/// The feature that shows a point best, taken or not.
pub(super) fn find(
    frame: &Frame,
    t_camera_map: &Pose,
    point: &super::map::MapPoint,
    lens: &Lens,
    radius: f64,
    near: &mut Vec<u32>,
) -> Option<u32> {
    let at = lens.project(&(t_camera_map * point.position))?;
    let ray = point.position - t_camera_map.inverse_transform_point(&Point3::origin());
    let distance = ray.norm();
    if !point.in_range(distance) || ray.dot(&point.direction) < 0.5 * distance {
        return None;
    }
    let level = point.level_at(distance);
    frame.near(&at, radius * sigma(level), (level.saturating_sub(1), level + 1), near);
    let bits = |f: u32| hamming(&frame.descriptors[f as usize], &point.descriptor);
    let fits = |f: &u32| {
        let s = sigma(frame.octaves[*f as usize]);
        (frame.pixels[*f as usize] - at).norm_squared() < super::pose::CHI2 * s * s || radius > 5.0
    };
    let best = near.iter().copied().filter(fits).min_by_key(|&f| bits(f))?;
    (bits(best) <= NEAR_BITS.min(FAR_BITS)).then_some(best)
}
