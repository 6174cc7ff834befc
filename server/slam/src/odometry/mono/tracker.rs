//! Images in, camera poses in the map's unit out: starts the map, follows it, adds to it, finds itself again.

use super::frame::{Frame, Lens, PointId};
use super::known_steps::KnownSteps;
use super::local;
use super::map::{Map, MapPoint, ViewId};
use super::places::Places;
use super::pose::{self, PlacedCamera};
use super::second::InverseDepth;
use super::start::{MIN_POINTS, Reference, TwoViews};
use super::{MonoParams, loops, search, triangulation};
use crate::tracking::{LostReason, Waiting};
use nalgebra::{Point2, Point3, Vector2};
use percept_geometry::{Pose, Timestamp};
use percept_perception::features2d::{Descriptors, MatchParams, match_features};
use percept_perception::multiview::{RansacParams, solve_pnp};

/// Radius in which the last image's points are looked for, pixels of their level; doubled if too few are found.
/// ORB-SLAM2's code has 15. Halved 24.9, doubled 28.0 ([`super`]).
const FOLLOW_PX: f64 = 12.0;
/// Fewer points found than this are no basis for a pose. As in ORB-SLAM2's code.
const MIN_FOLLOWED: usize = 20;
/// A pose rests on so many points of the local map; after a loss on more. Both as in ORB-SLAM2's code.
const MIN_TRACKED: usize = 30;
const MIN_RELOCALISED: usize = 50;
/// Views whose points are looked for in an image. ORB-SLAM2's code has 80. Halved 31.7, doubled 25.1 ([`super`]).
const LOCAL_VIEWS: usize = 20;
/// A view comes when less than this share of the points of the best view is found... ORB-SLAM2's code has 0.9. Halved,
/// the camera is lost after a quarter of the recording, doubled (always) 26.5 ([`super`]).
const VIEW_SHARE: f64 = 0.85;
/// ... and not sooner after the last than this, in images, unless tracking is about to break. Halved 25.0, doubled
/// 25.3; the second halved and doubled 25.1 ([`super`]).
const MIN_VIEW_GAP: usize = 3;
const WEAK: usize = 80;
/// Lost with a map of fewer views, the map is given up at once. ORB-SLAM2's code gives up maps of up to 5.
const YOUNG_VIEWS: usize = 4;

/// A feature is a point at once if a second camera tells its distance to one part in so many. ORB-SLAM2 has 40 baselines:
/// 13 pixels at a focal length of 520. ATE (Sim3) of the views of `evaluate mono-sim 2|4|5 --second 120 --seconds 30`
/// with 5: 19, 14 and 24 mm; with 10: 14, 12 and 63; with 20: 13, 16 and 16.
const SURE_DEPTH: f64 = 13.0;

/// What became of an image.
#[derive(Debug, Clone)]
pub(super) enum Outcome {
    /// No map yet.
    Waiting(Waiting),
    /// With this image the map began.
    Started,
    /// Placed in the map.
    Placed(PlacedCamera),
    Lost(LostReason),
}

/// The tracker of one camera.
pub(super) struct Tracker {
    pub(super) map: Map,
    /// How the camera moved between views by another source, metres.
    pub(super) known: KnownSteps,
    /// Whether the map's unit is the metre.
    pub(super) is_metric: bool,
    /// A loop was closed: where past views were before.
    pub(super) corrected: Option<Vec<(ViewId, Pose)>>,
    pub(super) places: Places,
    params: MonoParams,
    reference: Option<Reference>,
    last: Option<(Frame, Pose)>,
    /// Motion of the camera over the last image: t_now_previous.
    pub(super) motion: Option<Pose>,
    /// Later images than the last placed one were lost: what hints say of the motion since then, t_now_last.
    lost_way: Option<Pose>,
    pub(super) newest: Option<ViewId>,
    since_view: usize,
}

impl Tracker {
    pub(super) fn new(params: &MonoParams) -> Self {
        Self {
            map: Map::default(),
            known: KnownSteps::default(),
            is_metric: false,
            corrected: None,
            places: Places::default(),
            params: params.clone(),
            reference: None,
            last: None,
            motion: None,
            lost_way: None,
            newest: None,
            since_view: 0,
        }
    }

    pub(super) fn has_map(&self) -> bool {
        self.last.is_some()
    }

    /// When the image was taken that a second view is sought for.
    pub(super) fn reference_stamp(&self) -> Option<Timestamp> {
        self.reference.as_ref().map(|r| r.stamp)
    }

    /// The camera's last pose.
    pub(super) fn t_camera_map(&self) -> Option<&Pose> {
        self.last.as_ref().map(|(_, t)| t)
    }

    /// Forgets map and reference.
    pub(super) fn clear(&mut self) {
        *self = Self::new(&self.params);
    }

    /// Where the camera is expected: by the hint (t_now_previous), else as it moved last.
    fn predict(&self, hint: Option<&Pose>) -> Pose {
        let t = self.t_camera_map().copied().unwrap_or_else(Pose::identity);
        let t = self.lost_way.map_or(t, |way| way * t);
        hint.or(self.motion.as_ref()).map_or(t, |m| m * t)
    }

    /// Takes an image in.
    pub(super) fn track(&mut self, stamp: Timestamp, frame: Frame, lens: &Lens, hint: Option<&Pose>) -> Outcome {
        if !self.has_map() {
            return self.start(stamp, frame, lens);
        }
        let mut frame = frame;
        let placed = match self.place(&mut frame, lens, hint) {
            Ok(placed) => Ok(placed),
            Err(reason) => self.relocalise(&mut frame, lens).ok_or(reason),
        };
        match placed {
            Ok(placed) => {
                self.accept(stamp, frame, &placed, lens);
                Outcome::Placed(placed)
            }
            Err(reason) => {
                self.motion = None;
                let before = self.lost_way.unwrap_or_else(Pose::identity);
                self.lost_way = Some(hint.map_or(before, |h| h * before));
                if self.is_young() {
                    self.clear();
                    self.reference = Some(Reference::new(frame, stamp));
                }
                Outcome::Lost(reason)
            }
        }
    }

    /// Whether the map is so small that it is given up when lost.
    pub(super) fn is_young(&self) -> bool {
        self.map.views.len() < YOUNG_VIEWS
    }

    /// Tries to place an image that others of the map need not lead up to.
    pub(super) fn find(&mut self, stamp: Timestamp, mut frame: Frame, lens: &Lens) -> Option<PlacedCamera> {
        let placed = self.relocalise(&mut frame, lens)?;
        self.accept(stamp, frame, &placed, lens);
        Some(placed)
    }

    fn start(&mut self, stamp: Timestamp, frame: Frame, lens: &Lens) -> Outcome {
        let Some(reference) = &mut self.reference else {
            self.reference = Some(Reference::new(frame, stamp));
            return Outcome::Waiting(Waiting::SecondView);
        };
        match reference.pair_with(&frame, stamp, lens, self.params.match_ratio) {
            Err(waiting) => Outcome::Waiting(waiting),
            Ok(found) => match self.begin(stamp, frame, found, lens) {
                Some(()) => Outcome::Started,
                None => Outcome::Waiting(Waiting::NoParallax),
            },
        }
    }

    /// Makes the first two views; the median depth of the first is 1.
    fn begin(&mut self, stamp: Timestamp, frame: Frame, found: TwoViews, lens: &Lens) -> Option<()> {
        let reference = self.reference.take()?;
        let first = self.map.add_view(reference.stamp, Pose::identity(), reference.frame.clone());
        let second = self.map.add_view(stamp, found.t_second_first, frame);
        for (a, b, p) in &found.points {
            self.map.add_point(*p, &[(first, *a), (second, *b)]);
        }
        self.map.set_parent(second, Some(first));
        local::adjust_views(&mut self.map, &[first, second], lens, None, (10, 10));
        let depth = self.map.median_depth(first).unwrap_or(0.0);
        let kept = self.map.points.len();
        if kept < found.points.len() / 2 || kept < MIN_FOLLOWED || depth <= 0.0 {
            self.map = Map::default();
            self.reference = Some(reference);
            return None;
        }
        self.map.rescale(1.0 / depth);
        for id in [first, second] {
            if let Some(v) = self.map.views.get(&id) {
                self.places.insert(id, &v.frame.descriptors);
            }
        }
        let v = self.map.views.get(&second)?;
        self.last = Some((v.frame.clone(), v.t_camera_map));
        self.newest = Some(second);
        self.since_view = 0;
        Some(())
    }

    /// Begins the map with the reference alone, in metres, by what a second camera says of its features. Whether it did.
    pub(super) fn begin_in_metres(&mut self, depths: Vec<Option<InverseDepth>>, lens: &Lens) -> bool {
        let sure = depths.iter().flatten().filter(|d| is_sure(d)).count();
        let Some(reference) = self.reference.take_if(|_| sure >= MIN_POINTS && self.last.is_none()) else {
            return false;
        };
        let id = self.map.add_view(reference.stamp, Pose::identity(), reference.frame.clone());
        self.places.insert(id, &reference.frame.descriptors);
        self.is_metric = true;
        self.newest = Some(id);
        self.since_view = 0;
        self.last = Some((reference.frame, Pose::identity()));
        self.add_depths(id, depths, lens);
        true
    }

    /// The reference, or the last image where it is a view without depths: what is asked of a second camera.
    pub(super) fn wants_depths(&self) -> Option<&Frame> {
        match (&self.last, self.newest.and_then(|id| self.map.views.get(&id))) {
            (None, _) => self.reference.as_ref().map(|r| &r.frame),
            (Some(_), Some(view)) if self.since_view == 0 && view.depths.is_empty() => Some(&view.frame),
            _ => None,
        }
    }

    /// What a second camera says of the last image, which is a view, in metres: points at once, and the scale from the next
    /// adjustment on. Adjusting here as well took 4 ms an image more and was no better: ATE (Sim3) of the views of
    /// `evaluate mono-sim 2|3|4|5 --second 120 --seconds 30` 14, 28, 12 and 63 mm (12, 85, 20 and 57).
    pub(super) fn see_depths(&mut self, depths: Vec<Option<InverseDepth>>, lens: &Lens) {
        if let Some(id) = self.newest.filter(|_| self.is_metric && self.since_view == 0) {
            self.add_depths(id, depths, lens);
        }
    }

    fn add_depths(&mut self, id: ViewId, depths: Vec<Option<InverseDepth>>, lens: &Lens) {
        let Some(view) = self.map.views.get_mut(&id).filter(|v| v.frame.len() == depths.len()) else { return };
        let t_map_view = view.t_camera_map.inverse();
        let is_new = |(f, d): (usize, &Option<InverseDepth>)| {
            let d = d.filter(|d| is_sure(d) && view.frame.points[f].is_none())?;
            Some((f as u32, t_map_view * view.frame.at_depth(f, lens, 1.0 / d.value)))
        };
        let new: Vec<(u32, Point3<f64>)> = depths.iter().enumerate().filter_map(is_new).collect();
        view.depths = depths;
        for (feature, position) in new {
            self.map.add_point(position, &[(id, feature)]);
        }
        self.keep_view_as_last(id);
    }

    fn keep_view_as_last(&mut self, id: ViewId) {
        if let Some(v) = self.map.views.get(&id) {
            self.last = Some((v.frame.clone(), v.t_camera_map));
        }
    }

    /// Places an image near the prediction.
    fn place(&mut self, frame: &mut Frame, lens: &Lens, hint: Option<&Pose>) -> Result<PlacedCamera, LostReason> {
        let Some((last, _)) = &self.last else { return Err(LostReason::TooFewCorrespondences) };
        let predicted = self.predict(hint);
        for radius in [1.0, 2.5] {
            frame.points.fill(None);
            let count = search::follow(frame, last, &self.map, &predicted, lens, radius * FOLLOW_PX);
            if count >= MIN_FOLLOWED
                && let Some(found) = settle(frame, &self.map, &predicted, lens)
                && found.num_inliers >= MIN_FOLLOWED / 2
            {
                return self.among_local(frame, &found, lens, MIN_TRACKED);
            }
        }
        let Some(id) = self.newest else { return Err(LostReason::TooFewCorrespondences) };
        let found = against_view(frame, &self.map, id, lens, self.params.match_ratio)
            .ok_or(LostReason::TooFewCorrespondences)?;
        self.among_local(frame, &found, lens, MIN_TRACKED)
    }

    /// Looks for all points of the views around and places the image by them.
    fn among_local(
        &mut self,
        frame: &mut Frame,
        start: &PlacedCamera,
        lens: &Lens,
        needed: usize,
    ) -> Result<PlacedCamera, LostReason> {
        let points = self.local_points(frame);
        search::look_for(frame, &points, &mut self.map, &start.t_camera_map, lens, 1.0);
        let placed = settle(frame, &self.map, &start.t_camera_map, lens).ok_or(LostReason::Degenerate)?;
        if placed.num_inliers < needed { Err(LostReason::TooFewCorrespondences) } else { Ok(placed) }
    }

    /// Points of the views that share most with the image, and of those that share most with the first of them.
    fn local_points(&self, frame: &Frame) -> Vec<PointId> {
        let mut views: Vec<ViewId> =
            self.map.sharing(&frame.points, None).into_iter().take(LOCAL_VIEWS / 2).map(|(v, _)| v).collect();
        if let Some(&best) = views.first() {
            let further: Vec<ViewId> = self.map.covisible(best).into_iter().map(|(v, _)| v).collect();
            let fresh: Vec<ViewId> = further.into_iter().filter(|v| !views.contains(v)).collect();
            views.extend(fresh.into_iter().take(LOCAL_VIEWS / 2));
        }
        let seen = views.iter().filter_map(|v| self.map.views.get(v)).flat_map(|v| v.frame.points.iter().flatten());
        let mut points: Vec<PointId> = seen.copied().collect();
        points.sort_unstable();
        points.dedup();
        points
    }

    /// Places an image anywhere in the map.
    fn relocalise(&mut self, frame: &mut Frame, lens: &Lens) -> Option<PlacedCamera> {
        for (id, _) in self.places.candidates(&frame.descriptors).into_iter().take(4) {
            frame.points.fill(None);
            let Some(found) = against_view(frame, &self.map, id, lens, self.params.match_ratio) else { continue };
            if let Ok(placed) = self.among_local(frame, &found, lens, MIN_RELOCALISED) {
                self.motion = None;
                return Some(placed);
            }
        }
        frame.points.fill(None);
        None
    }

    fn accept(&mut self, stamp: Timestamp, mut frame: Frame, placed: &PlacedCamera, lens: &Lens) {
        for id in frame.points.iter().flatten() {
            if let Some(p) = self.map.points.get_mut(id) {
                p.found += 1;
            }
        }
        // Across a loss the way is not that of one image.
        let followed = self.lost_way.take().is_none();
        self.motion = self.t_camera_map().filter(|_| followed).map(|before| placed.t_camera_map * before.inverse());
        self.since_view += 1;
        if self.wants_view(&frame, placed.num_inliers) {
            self.add_view(stamp, &mut frame, placed, lens);
        } else {
            self.last = Some((frame, placed.t_camera_map));
        }
    }

    fn wants_view(&self, frame: &Frame, num_inliers: usize) -> bool {
        let Some(&(best, _)) = self.map.sharing(&frame.points, None).first() else { return false };
        // Points that only two views see, and no second camera, come and go.
        let settled = self.map.views.len() > 2;
        let stays = |p: &MapPoint| p.seen_by.len() > 2 || self.map.num_cameras(p) > p.seen_by.len();
        let count = |id: ViewId| {
            let points = self.map.views.get(&id).map(|v| v.frame.points.iter().flatten());
            let seen = points.into_iter().flatten().filter_map(|p| self.map.points.get(p));
            seen.filter(|p| !settled || stays(p)).count()
        };
        let fewer = (num_inliers as f64) < VIEW_SHARE * count(best) as f64;
        fewer && (self.since_view >= MIN_VIEW_GAP || num_inliers < WEAK)
    }

    fn add_view(&mut self, stamp: Timestamp, frame: &mut Frame, placed: &PlacedCamera, lens: &Lens) {
        let id = self.map.add_view(stamp, placed.t_camera_map, frame.clone());
        self.places.insert(id, &frame.descriptors);
        self.newest = Some(id);
        self.since_view = 0;
        local::cull_points(&mut self.map, id);
        triangulation::triangulate(&mut self.map, id, lens);
        triangulation::fuse(&mut self.map, id, lens);
        let known = self.is_metric.then_some(&self.known);
        local::adjust(&mut self.map, id, lens, known);
        for (gone, descriptors) in local::cull_views(&mut self.map, id) {
            self.places.remove(gone, &descriptors);
            self.known.bridge(gone);
        }
        self.close_loop(id, lens);
        self.keep_view_as_last(id);
    }

    fn close_loop(&mut self, id: ViewId, lens: &Lens) {
        if !self.params.close_loops {
            return;
        }
        let found = loops::detect(&self.map, &self.places, id, lens, self.params.match_ratio);
        if let Some(found) = found {
            let before: Vec<_> = self.map.views.iter().map(|(id, v)| (*id, v.t_camera_map)).collect();
            loops::close(&mut self.map, &found, lens);
            let known = self.is_metric.then_some(&self.known);
            local::adjust(&mut self.map, id, lens, known);
            // The motion was in the unit before.
            self.motion = None;
            self.corrected = Some(before);
        }
    }

    /// The map points that the last image shows, in its camera.
    pub(super) fn points_in_camera(&self) -> Vec<Point3<f64>> {
        let Some((frame, t)) = &self.last else { return vec![] };
        frame.points.iter().flatten().filter_map(|id| Some(t * self.map.points.get(id)?.position)).collect()
    }

    /// The features of the last image that show map points: pixel of the lens, descriptor, point in the camera.
    pub(super) fn features_in_camera(&self) -> Vec<(Vector2<f64>, [u64; 4], Point3<f64>)> {
        let Some((frame, t)) = &self.last else { return vec![] };
        let one = |(i, id): (usize, &Option<PointId>)| {
            let p = t * self.map.points.get(id.as_ref()?)?.position;
            Some((frame.pixels[i], frame.descriptors[i], p))
        };
        frame.points.iter().enumerate().filter_map(one).collect()
    }

    /// Multiplies all lengths.
    pub(super) fn rescale(&mut self, by: f64) {
        self.map.rescale(by);
        if let Some((_, t)) = &mut self.last {
            t.translation.vector *= by;
        }
        if let Some(m) = &mut self.motion {
            m.translation.vector *= by;
        }
    }
}

fn is_sure(depth: &InverseDepth) -> bool {
    depth.value * depth.weight >= SURE_DEPTH
}

/// The pose by the points found; features whose points do not fit lose them.
fn settle(frame: &mut Frame, map: &Map, start: &Pose, lens: &Lens) -> Option<PlacedCamera> {
    let (sightings, features) = search::sightings(frame, map);
    let placed = pose::place(start, &sightings, lens.focal)?;
    for (fits, f) in placed.inliers.iter().zip(&features) {
        if !fits {
            frame.points[*f as usize] = None;
        }
    }
    Some(placed)
}

/// Places an image by the points of a view, matched by looks alone.
fn against_view(frame: &mut Frame, map: &Map, id: ViewId, lens: &Lens, ratio: f64) -> Option<PlacedCamera> {
    let view = map.views.get(&id)?;
    let shown: Vec<(PointId, usize)> =
        view.frame.points.iter().enumerate().filter_map(|(f, p)| Some(((*p)?, f))).collect();
    let looks = Descriptors::Binary(shown.iter().map(|&(_, f)| view.frame.descriptors[f]).collect());
    let params = MatchParams { ratio, mutual: true, max_distance: Some(f64::from(search::FAR_BITS)) };
    let matches = match_features(&looks, &frame.binary(), &params).ok()?;
    let pairs: Vec<(PointId, usize)> =
        matches.iter().map(|m| (shown[m.query_index as usize].0, m.train_index as usize)).collect();
    if pairs.len() < MIN_FOLLOWED {
        return None;
    }
    let points: Vec<Point3<f64>> = pairs.iter().filter_map(|(p, _)| Some(map.points.get(p)?.position)).collect();
    let pixels: Vec<Point2<f64>> = pairs.iter().map(|&(_, f)| Point2::from(frame.pixels[f])).collect();
    let ransac = RansacParams { threshold_px: 4.0, max_iterations: 300, ..RansacParams::default() };
    let found = solve_pnp(&points, &pixels, &lens.intrinsics(), &ransac).ok()?;
    if found.inliers.len() < MIN_FOLLOWED / 2 {
        return None;
    }
    frame.points.fill(None);
    found.inliers.iter().for_each(|&i| frame.points[pairs[i].1] = Some(pairs[i].0));
    settle(frame, map, &found.t_world_camera.inverse(), lens)
}
