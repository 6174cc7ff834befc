//! The neighbourhood of a new view: adjusted together, and cleared of what is wrong or superfluous.

use super::bundle_adjustment::{Bundle, Observation, Step};
use super::frame::{Lens, PointId, sigma};
use super::known_steps::KnownSteps;
use super::map::{Map, ViewId};
use super::pose::CHI2;
use nalgebra::Matrix3;
use percept_geometry::Pose;
use std::collections::BTreeMap;

/// Views moved at most, and further views held at most. The first halved 24.9, doubled 25.7 ([`super`]).
const MAX_FREE: usize = 8;
const MAX_HELD: usize = 12;
/// Iterations before and after wrong observations are dropped. ORB-SLAM2's code takes 5 and 10.
const ITERATIONS: (usize, usize) = (4, 5);

/// Adjusts the newest view, those that share most with it, and the points that they see.
pub(super) fn adjust(map: &mut Map, id: ViewId, lens: &Lens, known: Option<&KnownSteps>) {
    let mut free: Vec<ViewId> = map.covisible(id).into_iter().take(MAX_FREE - 1).map(|(v, _)| v).collect();
    free.push(id);
    adjust_views(map, &free, lens, known, ITERATIONS);
}

/// Adjusts these views (but the first of all) and what they see; other views hold the map in place.
pub(super) fn adjust_views(
    map: &mut Map,
    free: &[ViewId],
    lens: &Lens,
    known: Option<&KnownSteps>,
    rounds: (usize, usize),
) {
    let origin = map.views.keys().next().copied();
    let mut free: Vec<ViewId> = free.iter().copied().filter(|v| Some(*v) != origin).collect();
    free.sort_unstable();
    let points = points_of(map, &free);
    let held = held_views(map, &free, &points);
    let Some(mut w) = Window::new(map, &free, &held, points, lens, known) else { return };
    w.bundle.adjust(rounds.0);
    w.drop_outliers(map);
    w.bundle.adjust(rounds.1);
    w.drop_outliers(map);
    w.write_back(map);
}

fn points_of(map: &Map, views: &[ViewId]) -> Vec<PointId> {
    let seen = views.iter().filter_map(|v| map.views.get(v)).flat_map(|v| v.frame.points.iter().flatten().copied());
    let mut points: Vec<PointId> = seen.collect();
    points.sort_unstable();
    points.dedup();
    points
}

/// Views that see the points but do not move, those that see most first.
fn held_views(map: &Map, free: &[ViewId], points: &[PointId]) -> Vec<ViewId> {
    let seen: Vec<Option<PointId>> = points.iter().map(|&p| Some(p)).collect();
    let others = map.sharing(&seen, None).into_iter().filter(|(v, _)| free.binary_search(v).is_err());
    others.take(MAX_HELD).map(|(v, _)| v).collect()
}

/// A bundle and what its numbers stand for.
struct Window {
    bundle: Bundle,
    views: Vec<ViewId>,
    points: Vec<PointId>,
}

impl Window {
    fn new(
        map: &Map,
        free: &[ViewId],
        held: &[ViewId],
        points: Vec<PointId>,
        lens: &Lens,
        known: Option<&KnownSteps>,
    ) -> Option<Self> {
        let views: Vec<ViewId> = free.iter().chain(held).copied().collect();
        let number: BTreeMap<ViewId, u32> = views.iter().enumerate().map(|(i, &v)| (v, i as u32)).collect();
        let cameras: Vec<Pose> = views.iter().filter_map(|v| Some(map.views.get(v)?.t_camera_map)).collect();
        if cameras.len() != views.len() || points.is_empty() || free.is_empty() {
            return None;
        }
        let is_metric = known.is_some();
        let mut bundle = Bundle { cameras, num_free: free.len(), focal: lens.focal, ..Bundle::default() };
        for (k, p) in points.iter().filter_map(|p| map.points.get(p)).enumerate() {
            bundle.points.push(p.position);
            for (view, feature) in &p.seen_by {
                let (Some(&camera), Some(v)) = (number.get(view), map.views.get(view)) else { continue };
                let f = *feature as usize;
                let (pixel, sigma) = (v.frame.pixels[f], sigma(v.frame.octaves[f]));
                let depth = v.depth(*feature).filter(|_| is_metric);
                bundle.observations.push(Observation { camera, point: k as u32, pixel, sigma, depth });
            }
        }
        let steps = known.into_iter().flat_map(|k| &k.0);
        bundle.steps = steps
            .filter_map(|((a, b), step)| {
                let (a, b) = (*number.get(a)?, *number.get(b)?);
                let information = Matrix3::identity() / step.variance;
                Some(Step { a, b, b_in_a: step.t_a_b.translation.vector, information })
            })
            .collect();
        Some(Self { bundle, views, points })
    }

    /// Observations that do not fit are dropped from the bundle and from the map.
    fn drop_outliers(&mut self, map: &mut Map) {
        let bundle = &self.bundle;
        let (keep, wrong): (Vec<Observation>, Vec<Observation>) =
            bundle.observations.iter().partition(|o| bundle.chi2(o) <= CHI2);
        let mut keep = keep;
        for o in keep.iter_mut().filter(|o| bundle.depth_chi2(o) > CHI2) {
            o.depth = None;
            map.forget_depth(self.views[o.camera as usize], self.points[o.point as usize]);
        }
        for o in wrong {
            map.unsee(self.views[o.camera as usize], self.points[o.point as usize]);
        }
        self.bundle.observations = keep;
    }

    fn write_back(self, map: &mut Map) {
        for (view, t) in self.views.iter().zip(&self.bundle.cameras).take(self.bundle.num_free) {
            if let Some(v) = map.views.get_mut(view) {
                v.t_camera_map = *t;
            }
        }
        for (id, position) in self.points.iter().zip(&self.bundle.points) {
            if let Some(p) = map.points.get_mut(id) {
                p.position = *position;
            }
            map.describe(*id);
        }
    }
}

/// Views for which a young point has to prove itself. As in ORB-SLAM2's code.
const PROBATION: u32 = 3;

/// Takes out young points that are seldom found where they should be, or that no third camera saw.
pub(super) fn cull_points(map: &mut Map, newest: ViewId) {
    let is_bad = |map: &Map, p: &super::map::MapPoint| {
        let age = newest.0 - p.born.0;
        age <= PROBATION && (f64::from(p.found) < 0.25 * f64::from(p.visible) || (age >= 2 && map.num_cameras(p) <= 2))
    };
    let bad: Vec<PointId> = map.points.iter().filter(|(_, p)| is_bad(map, p)).map(|(&id, _)| id).collect();
    bad.into_iter().for_each(|id| map.remove_point(id));
}

/// Takes out views near the newest whose points others see as well: 90 % of them in three other views at least.
/// Returns which, with their descriptors.
pub(super) fn cull_views(map: &mut Map, newest: ViewId) -> Vec<(ViewId, Vec<[u64; 4]>)> {
    let origin = map.views.keys().next().copied();
    let mut out = vec![];
    for (id, _) in map.covisible(newest) {
        // The last ones are still needed for new points.
        if Some(id) == origin || id.0 + 2 >= newest.0 || !is_redundant(map, id) {
            continue;
        }
        out.extend(map.remove_view(id).map(|view| (id, view.frame.descriptors)));
    }
    out
}

fn is_redundant(map: &Map, id: ViewId) -> bool {
    let Some(view) = map.views.get(&id) else { return false };
    let (mut all, mut redundant) = (0, 0);
    for (feature, point) in view.frame.points.iter().enumerate() {
        let Some(p) = point.and_then(|p| map.points.get(&p)) else { continue };
        all += 1;
        let octave = view.frame.octaves[feature];
        // Only views that see it as finely count.
        let fine = |(v, f): &&(ViewId, u32)| {
            *v != id && map.views.get(v).is_some_and(|v| v.frame.octaves[*f as usize] <= octave + 1)
        };
        redundant += usize::from(p.seen_by.iter().filter(fine).take(3).count() == 3);
    }
    redundant * 10 > all * 9
}
