//! The sparse map of one camera: views (its keyframes) and points, who sees what.
//!
//! Lengths are in the map's own unit until a scale is known. Poses are `t_camera_map`: map to camera.

use super::frame::{Frame, NUM_LEVELS, PointId, SCALE_FACTOR, hamming, sigma};
use super::second::InverseDepth;
use nalgebra::{Point3, Vector3};
use percept_geometry::{Pose, Timestamp};
use std::collections::BTreeMap;

/// Number of a view, in the order of creation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct ViewId(pub(super) u32);

/// A keyframe of the camera.
#[derive(Debug, Clone)]
pub(super) struct View {
    pub(super) stamp: Timestamp,
    pub(super) t_camera_map: Pose,
    pub(super) frame: Frame,
    /// How far its features are by a second camera; empty if none said so.
    pub(super) depths: Vec<Option<InverseDepth>>,
    /// The view that it saw most in common with when it came: the spanning tree of the map.
    pub(super) parent: Option<ViewId>,
    /// The parent in this view when it came or was last corrected.
    pub(super) t_camera_parent: Pose,
}

impl View {
    pub(super) fn center(&self) -> Point3<f64> {
        self.t_camera_map.inverse_transform_point(&Point3::origin())
    }

    pub(super) fn depth(&self, feature: u32) -> Option<InverseDepth> {
        self.depths.get(feature as usize).copied().flatten()
    }
}

/// A point that several views see.
#[derive(Debug, Clone)]
pub(super) struct MapPoint {
    pub(super) position: Point3<f64>,
    /// Mean direction from the views to it.
    pub(super) direction: Vector3<f64>,
    /// Nearest and farthest distance at which the pyramid can show it.
    pub(super) range: (f64, f64),
    pub(super) descriptor: [u64; 4],
    /// View and feature, ascending by view.
    pub(super) seen_by: Vec<(ViewId, u32)>,
    /// How often it lay in an image, and how often it was found there.
    pub(super) visible: u32,
    pub(super) found: u32,
    /// The newest view when it came.
    pub(super) born: ViewId,
}

impl MapPoint {
    /// The level on which a camera at this distance sees it as it was described.
    pub(super) fn level_at(&self, distance: f64) -> u8 {
        let level = ((self.range.1 / distance).ln() / SCALE_FACTOR.ln()).ceil();
        level.clamp(0.0, NUM_LEVELS as f64 - 1.0) as u8
    }

    /// Whether a camera at this distance can find it.
    pub(super) fn in_range(&self, distance: f64) -> bool {
        distance >= 0.8 * self.range.0 && distance <= 1.2 * self.range.1
    }
}

/// Views and points.
#[derive(Debug, Clone, Default)]
pub(super) struct Map {
    pub(super) views: BTreeMap<ViewId, View>,
    pub(super) points: BTreeMap<PointId, MapPoint>,
    next_view: u32,
    next_point: u32,
}

impl Map {
    /// Bytes, about.
    pub(super) fn memory_bytes(&self) -> usize {
        let views: usize =
            self.views.values().map(|v| size_of::<View>() + v.frame.memory_bytes() + size_of_val(&v.depths[..])).sum();
        let seen: usize = self.points.values().map(|p| p.seen_by.capacity()).sum();
        views + self.points.len() * size_of::<(PointId, MapPoint)>() + seen * size_of::<(ViewId, u32)>()
    }

    pub(super) fn add_view(&mut self, stamp: Timestamp, t_camera_map: Pose, frame: Frame) -> ViewId {
        let id = ViewId(self.next_view);
        self.next_view += 1;
        for (feature, point) in frame.points.iter().enumerate() {
            if let Some(p) = point.and_then(|p| self.points.get_mut(&p)) {
                p.seen_by.push((id, feature as u32));
            }
        }
        let view = View { stamp, t_camera_map, frame, depths: vec![], parent: None, t_camera_parent: Pose::identity() };
        self.views.insert(id, view);
        let parent = self.covisible(id).first().map(|&(p, _)| p);
        self.set_parent(id, parent);
        id
    }

    pub(super) fn set_parent(&mut self, id: ViewId, parent: Option<ViewId>) {
        let t_map_parent = parent.and_then(|p| self.views.get(&p)).map(|p| p.t_camera_map.inverse());
        if let Some(view) = self.views.get_mut(&id) {
            view.parent = parent;
            view.t_camera_parent = t_map_parent.map_or_else(Pose::identity, |t| view.t_camera_map * t);
        }
    }

    pub(super) fn newest(&self) -> Option<ViewId> {
        self.views.last_key_value().map(|(&id, _)| id)
    }

    /// A new point and its sightings; its look is the last one's.
    pub(super) fn add_point(&mut self, position: Point3<f64>, seen_by: &[(ViewId, u32)]) -> PointId {
        let id = PointId(self.next_point);
        self.next_point += 1;
        let mut seen_by = seen_by.to_vec();
        seen_by.sort_unstable();
        for &(view, feature) in &seen_by {
            if let Some(v) = self.views.get_mut(&view) {
                v.frame.points[feature as usize] = Some(id);
            }
        }
        let born = self.newest().unwrap_or(ViewId(0));
        let point = MapPoint {
            position,
            direction: Vector3::zeros(),
            range: (0.0, 0.0),
            descriptor: [0; 4],
            seen_by,
            visible: 1,
            found: 1,
            born,
        };
        self.points.insert(id, point);
        self.describe(id);
        id
    }

    /// A view sees a point, which it did not before.
    pub(super) fn see(&mut self, view: ViewId, feature: u32, id: PointId) {
        let (Some(v), Some(p)) = (self.views.get_mut(&view), self.points.get_mut(&id)) else { return };
        if p.seen_by.iter().any(|&(other, _)| other == view) || v.frame.points[feature as usize].is_some() {
            return;
        }
        v.frame.points[feature as usize] = Some(id);
        p.seen_by.push((view, feature));
        p.seen_by.sort_unstable();
    }

    /// Cameras that show a point: views, and their second cameras.
    pub(super) fn num_cameras(&self, p: &MapPoint) -> usize {
        let has_depth = |(v, f): &&(ViewId, u32)| self.views.get(v).is_some_and(|v| v.depth(*f).is_some());
        p.seen_by.len() + p.seen_by.iter().filter(has_depth).count()
    }

    /// A view's second camera does not see a point after all.
    pub(super) fn forget_depth(&mut self, view: ViewId, id: PointId) {
        let Some(p) = self.points.get(&id) else { return };
        let Some(&(_, feature)) = p.seen_by.iter().find(|&&(v, _)| v == view) else { return };
        if let Some(depth) = self.views.get_mut(&view).and_then(|v| v.depths.get_mut(feature as usize)) {
            *depth = None;
        }
        if self.points.get(&id).is_some_and(|p| self.num_cameras(p) < 2) {
            self.remove_point(id);
        }
    }

    /// A view does not see a point after all; a point that fewer than two cameras see is no more.
    pub(super) fn unsee(&mut self, view: ViewId, id: PointId) {
        let Some(p) = self.points.get_mut(&id) else { return };
        let Some(at) = p.seen_by.iter().position(|&(v, _)| v == view) else { return };
        let (_, feature) = p.seen_by.remove(at);
        if let Some(v) = self.views.get_mut(&view) {
            v.frame.points[feature as usize] = None;
        }
        if self.points.get(&id).is_some_and(|p| self.num_cameras(p) < 2) {
            self.remove_point(id);
        }
    }

    pub(super) fn remove_point(&mut self, id: PointId) {
        let Some(p) = self.points.remove(&id) else { return };
        for (view, feature) in p.seen_by {
            if let Some(v) = self.views.get_mut(&view) {
                v.frame.points[feature as usize] = None;
            }
        }
    }

    /// Two points are one: `from` becomes `into`.
    pub(super) fn merge(&mut self, from: PointId, into: PointId) {
        if from == into || !self.points.contains_key(&into) {
            return;
        }
        let Some(p) = self.points.remove(&from) else { return };
        for &(view, feature) in &p.seen_by {
            if let Some(v) = self.views.get_mut(&view) {
                v.frame.points[feature as usize] = None;
            }
            self.see(view, feature, into);
        }
        if let Some(kept) = self.points.get_mut(&into) {
            kept.visible += p.visible;
            kept.found += p.found;
        }
        self.describe(into);
    }

    /// Takes a view out; its children in the tree go to its parent.
    pub(super) fn remove_view(&mut self, id: ViewId) -> Option<View> {
        let view = self.views.remove(&id)?;
        for (feature, point) in view.frame.points.iter().enumerate() {
            let Some(point) = point else { continue };
            let Some(p) = self.points.get_mut(point) else { continue };
            p.seen_by.retain(|&s| s != (id, feature as u32));
            if self.points.get(point).is_some_and(|p| self.num_cameras(p) < 2) {
                self.remove_point(*point);
            }
        }
        let children: Vec<ViewId> = self.views.iter().filter(|(_, v)| v.parent == Some(id)).map(|(&c, _)| c).collect();
        for child in children {
            self.set_parent(child, view.parent);
        }
        Some(view)
    }

    /// Views that share points with this one and how many, most first.
    pub(super) fn covisible(&self, id: ViewId) -> Vec<(ViewId, usize)> {
        self.views.get(&id).map_or_else(Vec::new, |v| self.sharing(&v.frame.points, Some(id)))
    }

    /// Views that see some of these points and how many, most first.
    pub(super) fn sharing(&self, points: &[Option<PointId>], but: Option<ViewId>) -> Vec<(ViewId, usize)> {
        let mut counts = BTreeMap::<ViewId, usize>::new();
        for p in points.iter().flatten().filter_map(|p| self.points.get(p)) {
            p.seen_by.iter().filter(|(v, _)| Some(*v) != but).for_each(|&(v, _)| *counts.entry(v).or_default() += 1);
        }
        let mut out: Vec<(ViewId, usize)> = counts.into_iter().collect();
        // Of equals the newer.
        out.sort_by(|a, b| b.1.cmp(&a.1).then(b.0.cmp(&a.0)));
        out
    }

    /// Look, direction and range of a point from its sightings: the descriptor is the one nearest to all others.
    pub(super) fn describe(&mut self, id: PointId) {
        let Some(p) = self.points.get(&id) else { return };
        let views: Vec<(&View, u32)> = p.seen_by.iter().filter_map(|&(v, f)| Some((self.views.get(&v)?, f))).collect();
        let looks: Vec<&[u64; 4]> = views.iter().map(|(v, f)| &v.frame.descriptors[*f as usize]).collect();
        let median = |i: usize| {
            let mut d: Vec<u32> = looks.iter().map(|o| hamming(o, looks[i])).collect();
            d.sort_unstable();
            d[d.len() / 2]
        };
        let Some(best) = (0..looks.len()).min_by_key(|&i| median(i)) else { return };
        let descriptor = *looks[best];
        let direction: Vector3<f64> = views.iter().map(|(v, _)| (p.position - v.center()).normalize()).sum();
        let (view, feature) = views[views.len() - 1];
        let far = (p.position - view.center()).norm() * sigma(view.frame.octaves[feature as usize]);
        if let Some(p) = self.points.get_mut(&id) {
            p.descriptor = descriptor;
            p.direction = direction.try_normalize(1e-9).unwrap_or_else(Vector3::z);
            p.range = (far / sigma(NUM_LEVELS as u8 - 1), far);
        }
    }

    /// Median depth of the points that a view sees.
    pub(super) fn median_depth(&self, id: ViewId) -> Option<f64> {
        let view = self.views.get(&id)?;
        let points = view.frame.points.iter().flatten().filter_map(|p| self.points.get(p));
        let mut depths: Vec<f64> = points.map(|p| (view.t_camera_map * p.position).z).collect();
        depths.sort_by(f64::total_cmp);
        depths.get(depths.len() / 2).copied()
    }

    /// Multiplies all lengths.
    pub(super) fn rescale(&mut self, by: f64) {
        for view in self.views.values_mut() {
            view.t_camera_map.translation.vector *= by;
            view.t_camera_parent.translation.vector *= by;
        }
        for p in self.points.values_mut() {
            p.position.coords *= by;
            p.range = (p.range.0 * by, p.range.1 * by);
        }
    }
}
