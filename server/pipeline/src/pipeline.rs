//! One robot's front end, map graph and scene, and the path of a frame through them.

mod annotate;
mod given;
mod report;
mod restore;
mod revise;
mod settings;
#[cfg(test)]
mod tests;
mod told;

pub use given::NotEmpty;
pub use report::FrameReport;
pub use settings::may_change;
pub use told::Told;

use crate::frontend::{FoundAt, Frontend, Keyframe, Registered, View};
use crate::live::{NewestFrames, Seen};
use crate::map_graph::{Doubt, MapGraph, MapUpdate, Probed, UnanchoredView};
use crate::related::RelatedThings;
use crate::rooms::DividedMap;
use crate::scene::Scene;
use crate::second_look::{SecondLook, SecondLooks};
use crate::{
    Executor, FrameError, KeyframeInfo, NewKeyframe, ParamsError, PipelineParams, PoseEstimate, SessionMemory,
    Snapshot, TrajectoryEntry,
};
use nalgebra::Point3;
use percept_geometry::{Covariance6, KeyframeScan, OrientedBox3, Pose, SensorFrame, SensorId, SensorSpec};
use percept_mapping::{MapStore, Submap};
use percept_slam::{OdometryEstimate, OdometryKind, Scan};
use std::sync::Arc;

/// What passes may be so far beside where it is expected, metres: legs and arms swing. And the floor is no part of it, up to there.
const BESIDE_PASSING_M: f64 = 0.15;

/// One robot's SLAM, maps, objects. A single writer; readers use [`Pipeline::snapshot`].
pub struct Pipeline {
    params: Arc<PipelineParams>,
    /// Sensors, odometry, and what that is worth.
    frontend: Frontend,
    /// All poses in the map.
    map_graph: MapGraph,
    /// What the newest frames see.
    newest: NewestFrames,
    /// Where these contradict the map.
    second_looks: SecondLooks,
    /// Objects.
    scene: Scene,
    /// Rooms, once somebody has asked for them.
    divided: DividedMap,
    related: RelatedThings,
    /// Where the robot is now.
    pose: Option<PoseEstimate>,
    /// Where the robot was last found in the map.
    found_at: Option<FoundAt>,
    /// Where the robot starts in a map that was given, base to map, if that was told; until it does.
    start: Option<Pose>,
    /// Where the robot is, base to map, if somebody has said so since the newest frame.
    told: Option<Pose>,
    /// Whether the next frame that is anchored begins a probation: the robot was on one before a restart, or was told where it is.
    doubt: Doubt,
    /// As counted at the newest keyframe; the map counts itself.
    memory: SessionMemory,
}

impl Pipeline {
    /// An empty session.
    ///
    /// # Errors
    /// A parameter out of bounds.
    pub fn new(params: PipelineParams) -> Result<Self, ParamsError> {
        params.validate()?;
        Ok(Self {
            frontend: Frontend::new(params.slam.clone()),
            map_graph: MapGraph::new(&params)?,
            newest: NewestFrames::default(),
            second_looks: SecondLooks::default(),
            scene: Scene::new(&params)?,
            divided: DividedMap::default(),
            related: RelatedThings::default(),
            pose: None,
            found_at: None,
            start: None,
            told: None,
            doubt: Doubt::None,
            memory: SessionMemory::default(),
            params: Arc::new(params),
        })
    }

    /// Recognises places, solves the graph and looks for objects beside frames, on threads of the executor's; without one,
    /// frames do it when they need what comes of it, which is the same.
    pub fn work_beside_frames(&mut self, executor: Arc<dyn Executor>) {
        self.scene.set_executor(Arc::clone(&executor));
        self.map_graph.set_executor(executor);
    }

    /// Adds a sensor, or replaces its declaration. What waits of one whose clock or extrinsics are others now is dropped.
    pub fn declare_sensor(&mut self, spec: SensorSpec) {
        self.frontend.declare_sensor(spec);
    }

    /// Takes one frame in. Parallel work runs on the current rayon pool.
    ///
    /// # Errors
    /// Bad input, by variant; nothing was changed.
    pub fn process(&mut self, frame: &SensorFrame) -> Result<FrameReport, FrameError> {
        let Some(view) = self.frontend.take(frame)? else { return Ok(FrameReport::default()) };
        let mut map = self.revise(Some(view.stamp), |graph, update| graph.take_answers(view.stamp, update));
        let report = if view.is_of_pose_sensor { self.follow(&view) } else { self.look_beside(&view) };
        self.map_graph.build_on();
        map.extend(report.map);
        Ok(FrameReport { map, ..report })
    }

    /// A view that moves the pose.
    fn follow(&mut self, view: &View) -> FrameReport {
        let (stamp, sensor) = (view.stamp, &view.spec.id);
        if view.has_taken_over {
            self.frontend.hand_over(view, &self.map_graph.recent_keyframes(sensor));
        }
        if self.pose.is_none() {
            self.come_into_given(view);
            if self.params.slam.localisation_only && self.map_graph.keyframes().is_empty() {
                self.frontend.wait_to_be_found();
            }
        }
        let is_mapped = |t_odom_base: &Pose| self.map_graph.is_mapped(sensor, t_odom_base);
        let Registered { mut estimate, kind, led_by, is_doubtful, moved_along, moved } =
            self.frontend.register(view, is_mapped);
        if moved_along {
            self.map_graph.forget_gathered();
        }
        self.map_graph.prepare(kind);
        self.map_graph.move_without_scale(&moved);
        let mut update = MapUpdate::default();
        let told = self.go_where_told((view, kind), &mut estimate, &mut update);
        let is_placed_anew = matches!(told, Some(Told::Placed | Told::Believed));
        if !estimate.scale.is_metric() {
            self.map_graph.wait_for_scale(|| self.frontend.up(stamp), &estimate.t_odom_base);
        } else {
            estimate = self.relocalise((view, kind), is_doubtful, estimate, &mut update);
        }
        let tracking = self.frontend.tracking();
        let (is_anchored, is_tentative) = (tracking.is_anchored(), tracking.is_tentative());
        let before_joined = if is_anchored { self.join_waiting(&mut update) } else { None };
        self.move_objects(&update.moved);
        // What it has not seen it adds nothing to the map by, nor what may come along with it.
        let is_mapping = is_anchored && !self.params.slam.localisation_only;
        let is_keyframe_due = is_mapping && led_by.is_none() && !self.frontend.may_move_along();
        let wanted = || self.second_looks.is_due(sensor, stamp);
        let keyframe = if is_keyframe_due { self.frontend.keyframe(view, &estimate, wanted) } else { None };
        let seen = keyframe.as_ref().map(Keyframe::ends);
        let keyframe = keyframe.map(|k| self.add(k, &view.scan, before_joined.as_ref()));

        estimate.state = self.frontend.told(&estimate);
        let pose = self.pose_of(&estimate);
        let pose = PoseEstimate { led_by, is_relocalised: pose.is_relocalised || is_placed_anew, ..pose };
        self.pose = Some(pose.clone());
        self.keep_newest(view, &pose, is_anchored || is_tentative, seen);
        // What is not certain counts as placed until it is taken back.
        let is_placed = is_anchored || (is_tentative && !pose.state.is_lost());
        let trajectory = self.extend_trajectory(sensor, &pose, is_placed, keyframe.as_ref());
        if is_anchored {
            self.map_graph.look_for_parts(stamp, sensor, keyframe.as_ref().map(|k| k.info.id));
        }
        let MapUpdate { change: map, joined, mended, .. } = update;
        FrameReport { pose: Some(pose), trajectory, keyframe, joined, mended, map, told }
    }

    /// A view of a second sensor adds to the map, and leads while the pose sensor is silent.
    fn look_beside(&mut self, view: &View) -> FrameReport {
        if self.frontend.register_second(view) {
            return FrameReport::default();
        }
        let led = self.frontend.lead(view).map(|estimate| self.go_on(view, &estimate)).unwrap_or_default();
        FrameReport { keyframe: self.keyframe_beside(view), ..led }
    }

    /// The pose goes on by a second sensor.
    fn go_on(&mut self, view: &View, estimate: &OdometryEstimate) -> FrameReport {
        let pose = PoseEstimate { led_by: Some(view.spec.id.clone()), ..self.pose_of(estimate) };
        self.pose = Some(pose.clone());
        // A trajectory hangs on keyframes of the sensor that moves the pose.
        let trajectory =
            self.frontend.pose_sensor().cloned().and_then(|s| self.extend_trajectory(&s, &pose, true, None));
        FrameReport { pose: Some(pose), trajectory, ..FrameReport::default() }
    }

    /// Keeps what a view of the pose sensor shows, for a while.
    fn keep_newest(&mut self, view: &View, pose: &PoseEstimate, is_in_map: bool, keyframe: Option<KeyframeScan>) {
        if !is_in_map || pose.is_relocalised {
            self.newest.clear();
            self.second_looks.clear();
        }
        if is_in_map && pose.led_by.is_none() && !pose.state.is_lost() && pose.scale.is_metric() {
            let seen = match keyframe {
                Some(scan) if !matches!(view.scan, Scan::Image(_)) => Some(Seen::Keyframe(Box::new(scan))),
                _ => self.frontend.live(view).map(Seen::Later),
            };
            self.keep(view, seen.map(|seen| (pose.t_odom_base, seen)));
        }
    }

    fn keep(&mut self, view: &View, seen: Option<(Pose, Seen)>) {
        let Some((t_odom_base, scan)) = seen else { return };
        let executor = self.map_graph.executor();
        let of = (&view.spec.id, view.stamp);
        self.newest.take((of.0, of.1, &t_odom_base), scan, &self.params.live, executor);
        let (graph, params) = (&self.map_graph, &self.params.live);
        let map = (graph.t_map_odom(), graph.base_height_m());
        if let Some(compare) = self.newest.comparison(of, params, map, graph.map().layers().occupancy) {
            self.second_looks.compare(of.0, of.1, executor, compare);
        }
        // A planar scan has no heights, by which people are known.
        let has_heights = matches!(view.scan, Scan::Depth(_) | Scan::Cloud(_));
        if has_heights
            && self.scene.wants_news(of.0, of.1)
            && let Some(news) = self.newest.news(of, map, graph.map().layers().occupancy, self.params.detection.range_m)
        {
            self.scene.look_for_passing(of, (&(map.0 * t_odom_base), graph.map().layers().cloud), news);
        }
    }

    /// Puts a view of a second sensor into the map, if it lies far enough from the one before.
    fn keyframe_beside(&mut self, view: &View) -> Option<NewKeyframe> {
        let pose = self.pose.as_ref().filter(|p| !p.state.is_lost() && p.scale.is_metric())?;
        let (stamp, covariance) = (pose.stamp, pose.covariance);
        let is_mapping = !self.frontend.tracking().is_tentative() && !self.params.slam.localisation_only;
        let live = self.frontend.live_beside(view, stamp);
        self.keep(view, live.map(|(t_odom_base, scan)| (t_odom_base, Seen::Later(scan))));
        let wanted = || self.second_looks.is_due(&view.spec.id, view.stamp);
        if !is_mapping {
            return None;
        }
        let keyframe = self.frontend.keyframe_beside(view, (stamp, covariance), wanted)?;
        let near = |sensor: &SensorId, t_odom_base: &Pose| self.map_graph.keyframes_near(sensor, t_odom_base);
        self.frontend.check_extrinsics(&keyframe, near);
        Some(self.add(keyframe, &view.scan, None))
    }

    /// A view of a robot that nothing anchors in the map, or that was found and may be elsewhere: the estimate as it is, or as it is in
    /// the map where the robot was found. Others are as they are.
    fn relocalise(
        &mut self,
        (view, kind): (&View, OdometryKind),
        is_doubtful: bool,
        estimate: OdometryEstimate,
        update: &mut MapUpdate,
    ) -> OdometryEstimate {
        let frontend = &self.frontend;
        let (unanchored, is_anchored) = (frontend.tracking().unanchored(), frontend.tracking().is_anchored());
        let is_tentative = frontend.tracking().is_tentative();
        let is_doubtful = is_doubtful || self.doubt != Doubt::None;
        let only_localises = self.params.slam.localisation_only && estimate.state.is_tracking();
        if unanchored.is_none() && !is_tentative && !(is_anchored && (is_doubtful || only_localises)) {
            return estimate;
        }
        let seen = UnanchoredView {
            kind,
            sensor: &view.spec.id,
            pose_sensor: frontend.pose_sensor(),
            scan: &view.scan,
            estimate: &estimate,
            usual_inlier_ratio: frontend.usual_inlier_ratio(),
            kept: &|| frontend.kept_of(view),
        };
        let found = if let Some(unanchored) = unanchored {
            self.map_graph.relocalise(&seen, &unanchored, update)
        } else if is_tentative {
            let probed = self.map_graph.probe(&seen, update);
            self.heed(probed, &estimate);
            None
        } else {
            let in_map = self.covariance_of(&estimate);
            // After a restart it is somewhere near, perhaps.
            let was_placed = self.pose.as_ref().is_some_and(|p| p.state.is_tracking() && !p.is_tentative);
            let why = match std::mem::replace(&mut self.doubt, Doubt::None) {
                Doubt::None if is_doubtful || !was_placed => Doubt::LooksAlike,
                why => why,
            };
            if self.map_graph.doubt(&seen, &in_map, why) {
                self.frontend.doubt();
            }
            None
        };
        update.joined.iter().for_each(|k| self.frontend.go_on_from(&k.info.sensor, &k.t_odom_base));
        let Some(found) = found else { return estimate };
        self.found_at = found.at;
        self.frontend.found(found)
    }

    /// What has come of it that the robot was found.
    fn heed(&mut self, probed: Probed, estimate: &OdometryEstimate) {
        match probed {
            Probed::Open(at) => self.found_at = Some(at),
            Probed::Confirmed(at) => {
                self.found_at = Some(at);
                self.frontend.confirm(estimate, true);
            }
            Probed::Withdrawn => self.frontend.confirm(estimate, false),
        }
    }

    /// Lets a part that waited join, if it was found; the robot's keyframe before, which its way goes on from, and with a
    /// keyframe at once.
    fn join_waiting(&mut self, update: &mut MapUpdate) -> Option<KeyframeInfo> {
        let before = self.map_graph.join_waiting(self.frontend.pose_sensor(), update)?;
        self.frontend.forget_keyframes();
        Some(before)
    }

    /// Puts a keyframe into the map, and has objects looked for around it.
    fn add(&mut self, mut keyframe: Keyframe, of: &Scan, before_joined: Option<&KeyframeInfo>) -> NewKeyframe {
        let moving = self.newest.part_moving(&mut keyframe.scan, &keyframe.t_odom_base);
        let stamp = keyframe.scan.stamp;
        let t_map_base = self.map_graph.t_map_odom() * keyframe.t_odom_base;
        leave_out(&mut keyframe.scan, &t_map_base, &self.scene.passing_boxes(stamp));
        if self.second_looks.take_keyframe(&keyframe.scan.sensor, stamp) == Some(SecondLook::Gone) {
            self.map_graph.leave_out_news(&mut keyframe.scan, &keyframe.t_odom_base);
        }
        let keyframe = self.map_graph.add(keyframe, || self.frontend.up(stamp), before_joined);
        self.count_memory();
        self.scene.look_around(self.map_graph.map().layers(), &keyframe, moving, of);
        keyframe
    }

    fn count_memory(&mut self) {
        self.memory = self.map_graph.take_memory(self.frontend.memory_bytes(), self.newest.memory_bytes());
    }

    fn extend_trajectory(
        &mut self,
        sensor: &SensorId,
        pose: &PoseEstimate,
        is_anchored: bool,
        keyframe: Option<&NewKeyframe>,
    ) -> Option<TrajectoryEntry> {
        if pose.scale.is_metric() {
            self.map_graph.extend_trajectory(sensor, (pose.stamp, &pose.t_map_base, is_anchored), keyframe)
        } else {
            self.map_graph.extend_without_scale((pose.stamp, &pose.t_map_base, pose.state.is_tracking()))
        }
    }

    fn pose_of(&self, estimate: &OdometryEstimate) -> PoseEstimate {
        let was_lost = self.pose.as_ref().is_some_and(|p| p.state.is_lost());
        PoseEstimate {
            stamp: estimate.stamp,
            state: estimate.state,
            t_map_base: self.map_graph.t_map_odom() * estimate.t_odom_base,
            t_odom_base: estimate.t_odom_base,
            covariance: self.covariance_of(estimate),
            inlier_ratio: estimate.inlier_ratio,
            rmse_m: estimate.rmse_m,
            degenerate_axes: estimate.degenerate_axes,
            scale: estimate.scale,
            waiting: estimate.waiting,
            is_relocalised: was_lost && estimate.state.is_tracking(),
            is_tentative: estimate.state.is_tracking() && self.map_graph.is_on_probation(),
            led_by: None,
            map_version: self.map_graph.map().version(),
        }
    }

    /// Of the pose in the map.
    fn covariance_of(&self, estimate: &OdometryEstimate) -> Covariance6 {
        let since = |found: FoundAt| found.since(&estimate.t_odom_base, &estimate.covariance);
        self.found_at.map_or(estimate.covariance, since)
    }

    /// What is kept in memory, by part: of the map now, of the rest as counted at the newest keyframe.
    pub fn memory(&self) -> SessionMemory {
        SessionMemory { map: self.map_graph.map().memory(), ..self.memory }
    }

    /// Sets where submaps go that are not in memory, which says how many bytes all of [`Self::memory`] may take before they do.
    pub fn set_map_store(&mut self, store: Arc<dyn MapStore>) {
        self.map_graph.set_store(store);
    }

    /// The submaps that the map is made of, in the order in which they were begun.
    pub fn submaps(&self) -> &[Submap] {
        self.map_graph.map().submaps()
    }

    /// The declaration of a sensor.
    pub fn sensor(&self, id: &SensorId) -> Option<&SensorSpec> {
        self.frontend.sensor(id)
    }

    /// The state as it is now; cheap, and unaffected by what comes later.
    pub fn snapshot(&self) -> Snapshot {
        let (graph, map) = (&self.map_graph, self.map_graph.map());
        Snapshot {
            map_version: map.version(),
            pose: self.pose.clone(),
            trajectory: graph.trajectory().shared(),
            keyframes: graph.keyframes().shared(),
            layers: map.layers(),
            live: self.newest.picture(&self.params.live, &graph.t_map_odom(), graph.base_height_m()),
            memory: self.memory(),
            clock_offsets: self.frontend.clock_offsets(),
            mount_offsets: self.frontend.mount_offsets(),
            imu_faults: self.frontend.imu_faults(),
            wheels_faults: self.frontend.wheels_faults(),
            loops: graph.loops(),
            objects: self.scene.objects(),
            tracked: self.scene.tracked(),
            divided: self.divided.clone(),
            related: self.related.clone(),
            next_object_id: self.scene.next_object_id(),
            params: Arc::clone(&self.params),
        }
    }
}

/// Leaves out of a scan what lies in boxes in the map, and at their sides: who passes is not to enter the map.
fn leave_out(scan: &mut KeyframeScan, t_map_base: &Pose, boxes: &[OrientedBox3]) {
    if scan.planar || boxes.is_empty() {
        return;
    }
    let floor_z = t_map_base.translation.vector.z - scan.base_height_m;
    let grown: Vec<OrientedBox3> =
        boxes.iter().map(|b| OrientedBox3 { size: b.size.add_scalar(2.0 * BESIDE_PASSING_M), ..*b }).collect();
    let stays = |p: &Point3<f32>| {
        let p = t_map_base * p.cast::<f64>();
        p.z < floor_z + BESIDE_PASSING_M || !grown.iter().any(|b| b.contains(&p))
    };
    let kept: Vec<usize> = (0..scan.hits.len()).filter(|i| stays(&scan.hits.positions[*i])).collect();
    if kept.len() < scan.hits.len() {
        scan.hits = scan.hits.select(&kept);
    }
}
