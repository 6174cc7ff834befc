//! Loops close: keyframes go to the back end, corrections come back and move what hangs on them; a robot that was lost
//! is found again among the keyframes.

use super::{FrameReport, MapChange, NewKeyframe, Pipeline, Restored};
use percept_geometry::{Covariance6, KeyframeId, KeyframeScan, Pose, SensorId, SensorSpec, Timestamp, se3};
use percept_slam::loops::{LoopClosure, place_recognition};
use percept_slam::{
    BackEnd, BackEndKeyframe, BackEndUpdate, LoopId, OdometryEstimate, OdometryKind, Relocalisation, Scan,
};
use std::sync::Arc;

/// While adrift, every so many frames are looked for in the whole map, besides those that would be keyframes.
const LOOK_EVERY: u32 = 10;
/// What odometry may drift while a robot is adrift: metres and radians a metre, radians a radian.
const DRIFTS: (f64, f64, f64) = (0.03, 0.01, 0.02);
/// Keyframes of a part of the map that hangs on nothing yet; when there are more, the oldest are given up.
const MOST_FLOATING: usize = 500;

/// A keyframe of a part of the map that hangs on nothing yet.
#[derive(Debug, Clone)]
pub(super) struct Floating {
    stamp: Timestamp,
    sensor: SensorId,
    t_odom_base: Pose,
    scan: Arc<KeyframeScan>,
}

impl Pipeline {
    /// Makes the back end for the kind of sensor that moves the pose, if loops are wanted and can be found.
    pub(super) fn prepare_back_end(&mut self, kind: OdometryKind) {
        if self.back_end.is_none() && self.params.slam.back_end.enabled {
            let params = self.params.slam.back_end.clone();
            self.back_end = place_recognition(kind).map(|r| BackEnd::new(params, r));
        }
    }

    /// Hands a keyframe that is in the map to the back end, and does what follows. `tied` is how it is known to lie to
    /// another one.
    pub(super) fn close_loops(
        &mut self,
        keyframe: &mut NewKeyframe,
        recognise: bool,
        tied: Option<LoopClosure>,
        report: &mut FrameReport,
    ) {
        if let Some(update) = self.tell_back_end(keyframe, recognise, tied) {
            self.follow(update, &mut report.map);
        }
    }

    /// Hands a keyframe that is in the map to the back end; what follows from that.
    fn tell_back_end(
        &mut self,
        keyframe: &mut NewKeyframe,
        recognise: bool,
        tied: Option<LoopClosure>,
    ) -> Option<BackEndUpdate> {
        let t_map_base = self.t_decided_odom() * keyframe.t_odom_base;
        let back_end = self.back_end.as_mut()?;
        keyframe.after_gap = std::mem::take(&mut self.after_gap);
        let node = BackEndKeyframe {
            id: keyframe.info.id,
            t_odom_base: keyframe.t_odom_base,
            covariance: self.odometry.as_ref().map(percept_slam::Odometry::covariance).unwrap_or_default(),
            scan: &keyframe.scan,
            recognise,
            after_gap: keyframe.after_gap,
            tied,
        };
        Some(back_end.insert(&node, &t_map_base))
    }

    /// Notes what changed about loops, and what the map is to become.
    fn follow(&mut self, update: BackEndUpdate, change: &mut MapChange) {
        self.decide(update.correction, update.merged);
        let changed = !update.loops.is_empty() || !update.dissolved.is_empty();
        if let Some(back_end) = self.back_end.as_ref().filter(|_| changed) {
            self.loops = Arc::new(back_end.loops().to_vec());
        }
        change.loops.extend(update.loops);
        change.dissolved.extend(update.dissolved);
    }

    /// Moves every keyframe to where the back end believes it, however little that is, and shows the map that is so: what
    /// waits while frames come in.
    pub fn settle(&mut self) -> MapChange {
        let update = self.back_end.as_mut().map(BackEnd::settle).unwrap_or_default();
        self.change(update)
    }

    /// Takes a loop out of the map, or undoes that; none if there is no such loop. It is among the loops of the answer.
    pub fn veto(&mut self, id: LoopId, vetoed: bool) -> Option<MapChange> {
        let update = self.back_end.as_mut()?.veto(id, vetoed)?;
        Some(self.change(update))
    }

    fn change(&mut self, update: BackEndUpdate) -> MapChange {
        let mut change = MapChange::default();
        self.follow(update, &mut change);
        change.extend(self.finish_revision());
        change
    }

    /// Gives the stored keyframes and loops to the back end.
    pub(super) fn restore_back_end(&mut self, kind: OdometryKind, pose_sensor: &SensorId, restored: &Restored) {
        self.prepare_back_end(kind);
        let Some(back_end) = &mut self.back_end else { return };
        let keyframes = restored.keyframes.iter().enumerate().filter_map(|(i, k)| {
            let scan = k.scan()?;
            let node = BackEndKeyframe {
                id: KeyframeId(i as u64),
                t_odom_base: k.t_odom_base,
                covariance: Covariance6::zeros(),
                scan,
                recognise: scan.sensor == *pose_sensor,
                after_gap: k.after_gap,
                tied: None,
            };
            Some((node, k.t_map_base))
        });
        back_end.resume(keyframes, restored.loops.clone(), restored.next_loop_id);
        self.loops = Arc::new(restored.loops.clone());
    }

    /// A frame of a robot that is adrift: it goes into a part of the map of its own, which joins the map once one of its
    /// frames is found there. Whether that happened with this one.
    pub(super) fn look_around(
        &mut self,
        spec: &SensorSpec,
        scan: &Scan,
        estimate: &OdometryEstimate,
        report: &mut FrameReport,
    ) -> bool {
        if estimate.state.is_lost() {
            return false;
        }
        if !estimate.state.is_tracking() {
            // Odometry has begun anew: what was gathered hangs on nothing any more.
            self.floating.clear();
        }
        let (Some(odometry), Some(frames)) = (&self.odometry, self.anchoring.frames_adrift()) else { return false };
        let is_far = self.floating.last().is_none_or(|last| self.is_keyframe_away(&last.t_odom_base, estimate));
        if !is_far && !frames.is_multiple_of(LOOK_EVERY) {
            return false;
        }
        let mut scan = odometry.keyframe_scan(estimate.stamp, &spec.id, scan);
        scan.base_height_m = self.base_height_m;
        let seen_from = |f: &Floating| (estimate.t_odom_base.inv_mul(&f.t_odom_base), Arc::clone(&f.scan));
        let before: Vec<_> = self.floating.iter().map(seen_from).collect();
        let found = self.back_end.as_ref().and_then(|b| b.relocalise(&before, &scan));
        if is_far {
            if self.floating.len() == MOST_FLOATING {
                self.floating.remove(0);
            }
            let (stamp, sensor, t_odom_base) = (estimate.stamp, spec.id.clone(), estimate.t_odom_base);
            self.floating.push(Floating { stamp, sensor, t_odom_base, scan: Arc::new(scan) });
        }
        let Some(found) = found else { return false };
        self.join(&found, estimate, report)
    }

    fn is_keyframe_away(&self, t_odom_base: &Pose, estimate: &OdometryEstimate) -> bool {
        let params = &self.params.slam.odometry.keyframe;
        let off = t_odom_base.inv_mul(&estimate.t_odom_base);
        off.translation.vector.norm() >= params.distance_m || off.rotation.angle() >= params.angle_rad
    }

    /// Puts the part of the map that hung on nothing where one of its frames was found.
    fn join(&mut self, found: &Relocalisation, estimate: &OdometryEstimate, report: &mut FrameReport) -> bool {
        if self.keyframes.len() as u64 <= found.keyframe.0 {
            return false;
        }
        self.place_odometry(found.keyframe, &(found.t_keyframe_base * estimate.t_odom_base.inverse()));
        self.after_gap = true;
        let floating = std::mem::take(&mut self.floating);
        let last = floating.len().saturating_sub(1);
        for (k, f) in floating.into_iter().enumerate() {
            let t_now_then = estimate.t_odom_base.inv_mul(&f.t_odom_base);
            let mut keyframe = self.enter(f.stamp, &f.sensor, f.t_odom_base, f.scan);
            // The first is tied at once, so that the others are not looked for everywhere; the last, as it was found.
            let tied = (k == 0 || k == last).then(|| self.tie(found, keyframe.info.id, &t_now_then));
            self.close_loops(&mut keyframe, true, tied, report);
            self.policy(&keyframe.info.sensor).resume(&f.t_odom_base);
            report.joined.push(keyframe);
        }
        self.anchoring.found(estimate);
        true
    }

    /// What ties a keyframe to the place where the robot was found to be, `t_now_then` later by odometry.
    fn tie(&self, found: &Relocalisation, to: KeyframeId, t_now_then: &Pose) -> LoopClosure {
        // Meanwhile another keyframe may have come to stand for the one that was recognised.
        let (from, t_from_found) = self.stand_in(found.keyframe);
        let (way, turn) = (t_now_then.translation.vector.norm(), t_now_then.rotation.angle());
        let [t, r] = [DRIFTS.0 * way, DRIFTS.1 * way + DRIFTS.2 * turn].map(|sigma| sigma * sigma);
        let odometry = Covariance6::from_diagonal(&[t, t, t, r, r, r].into());
        LoopClosure {
            from,
            to,
            t_from_to: t_from_found * found.t_keyframe_base * t_now_then,
            covariance: se3::compose_covariance(&found.covariance, t_now_then, &odometry),
            inlier_ratio: found.inlier_ratio,
        }
    }
}
