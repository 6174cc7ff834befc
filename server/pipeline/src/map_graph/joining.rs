//! Parts of the map that hung on nothing join it, or become it: their keyframes enter, and their frames hang on these.

use super::add::Link;
use super::atlas::Recognised;
use super::part::{Part, PartKeyframe};
use super::revising::Decision;
use super::{MapGraph, MapUpdate};
use crate::KeyframeInfo;
use crate::frontend::FoundAt;
use percept_geometry::{Covariance6, KeyframeId, Pose, SensorId, se3};
use percept_mapping::MapKeyframe;
use percept_slam::loops::LoopClosure;
use percept_slam::{MergedKeyframe, OdometryKind, Relocalisation, way_m};
use std::sync::Arc;

/// A part becomes the map once it has so many times its keyframes, and so many at least: a robot that was carried off for a
/// while comes back to the map that it had.
const TAKES_OVER: (usize, usize) = (2, 10);

impl MapGraph {
    /// Puts what an unanchored robot has gathered where it was found to be at `t_odom_found`; whether it could.
    pub(super) fn join(
        &mut self,
        found: &Relocalisation,
        t_odom_found: &Pose,
        pose_sensor: Option<&SensorId>,
        update: &mut MapUpdate,
    ) -> bool {
        if self.keyframes.of(found.keyframe).is_none() {
            return false;
        }
        self.learn_height(found.keyframe, &found.t_keyframe_base);
        self.place_odometry(found.keyframe, &(found.t_keyframe_base * t_odom_found.inverse()));
        self.atlas.begin_anew();
        let gathered = self.relocaliser.begin_anew();
        self.enter_part(gathered, &Pose::identity(), Some((found, t_odom_found)), pose_sensor, update);
        true
    }

    /// Puts a part that waited where the robot was recognised in it, if it was. The robot's keyframe before those that have
    /// joined: its way goes on from there, and with a keyframe at once.
    pub(crate) fn join_waiting(
        &mut self,
        pose_sensor: Option<&SensorId>,
        update: &mut MapUpdate,
    ) -> Option<KeyframeInfo> {
        let Recognised { part, found, t_part_found } = self.take_recognised()?;
        let before = self.keyframes.last()?.clone();
        let t_map_found = self.keyframes.of(found.keyframe)?.t_map_base * found.t_keyframe_base;
        let t_odom_part = self.t_map_odom.inverse() * t_map_found * t_part_found.inverse();
        self.enter_part(part, &t_odom_part, Some((&found, &t_part_found)), pose_sensor, update);
        Some(before)
    }

    /// Makes the part that was gathered the map, if that is by far the smaller one and no search is on: the robot is found where the
    /// part began.
    pub(super) fn take_over(
        &mut self,
        kind: OdometryKind,
        pose_sensor: Option<&SensorId>,
        update: &mut MapUpdate,
    ) -> Option<FoundAt> {
        let least = TAKES_OVER.1.max(TAKES_OVER.0 * self.map.keyframes().len());
        if self.is_given() || self.relocaliser.gathered_without_search().is_none_or(|gathered| gathered < least) {
            return None;
        }
        self.finish_revision(update);
        // Constraints between keyframes of the old map have gone into where they lie.
        let loops = self.constraints.begin_anew(&self.params, kind);
        update.change.dissolved.extend(loops.iter().map(|l| l.id));
        let gathered = self.relocaliser.begin_anew();
        let old = self.map_as_part(gathered.number);
        let begun = gathered.keyframes.first().map(|k| FoundAt {
            t_odom_base: k.t_part_base,
            of_odometry: k.covariance,
            in_map: Covariance6::zeros(),
        });
        let first = self.keyframes.next_id();
        // Its keyframes leave the map, and lie relative to the first one of the new map as odometry had it, until they join.
        let t_first_map = gathered.keyframes.first().map(|k| (self.t_map_odom * k.t_part_base).inverse());
        let merged = old
            .keyframes
            .iter()
            .filter_map(|k| Some(MergedKeyframe { id: k.id?, into: first, t_into_base: t_first_map? * k.t_part_base }));
        let merged: Vec<MergedKeyframe> = merged.collect();
        self.enter_part(gathered, &Pose::identity(), None, pose_sensor, update);
        self.decide(Decision { merged, ..Decision::default() }, update);
        update.mended.extend(self.trajectory.forget(&old.frames));
        update.mended.sort_by_key(|e| e.stamp);
        self.set_aside(old, kind, pose_sensor);
        begun
    }

    /// The map as a part, with the frames that were placed in it.
    fn map_as_part(&self, number: u64) -> Part {
        let of = |(id, k): (&KeyframeId, &MapKeyframe)| {
            let scan = self.map.scan(*id)?;
            Some(PartKeyframe {
                id: Some(*id),
                stamp: scan.stamp,
                sensor: k.sensor.clone(),
                t_part_base: k.t_map_base,
                covariance: Covariance6::zeros(),
                scan,
            })
        };
        let mut keyframes: Vec<PartKeyframe> = self.map.keyframes().iter().filter_map(of).collect();
        keyframes.sort_by_key(|k| k.stamp);
        Part { number, keyframes, frames: self.trajectory.placed(&self.keyframes) }
    }

    /// Puts a part into the map where `t_odom_part` has it, and hangs its frames on it. `found` is where it was recognised,
    /// and base to the part there.
    fn enter_part(
        &mut self,
        part: Part,
        t_odom_part: &Pose,
        found: Option<(&Relocalisation, &Pose)>,
        pose_sensor: Option<&SensorId>,
        update: &mut MapUpdate,
    ) {
        let (mut merged, joined) = (vec![], update.joined.len());
        let noise = self.constraints.noise().copied();
        let part_way_m: f64 =
            part.keyframes.windows(2).map(|k| way_between_m(&k[0].t_part_base, &k[1].t_part_base)).sum();
        let last = part.keyframes.len().saturating_sub(1);
        let is_of_pose = |sensor: &SensorId| pose_sensor.is_none_or(|s| s == sensor);
        for (k, f) in part.keyframes.into_iter().enumerate() {
            let after_gap = k == 0;
            let mut scan = f.scan;
            if scan.base_height_m != self.base_height_m {
                Arc::make_mut(&mut scan).base_height_m = self.base_height_m;
            }
            let mut keyframe = self.insert(f.stamp, &f.sensor, t_odom_part * f.t_part_base, scan, after_gap);
            let id = keyframe.info.id;
            // The first is constrained at once, so that the others are not looked for everywhere; the last, as it was found.
            let known = found.filter(|_| k == 0 || k == last);
            let way_m = if k == last { 0.0 } else { part_way_m };
            let constraint = known.zip(noise).map(|((found, t_part_found), noise)| {
                let way_m = way_m.max(way_between_m(t_part_found, &f.t_part_base));
                constraint(found, id, &t_part_found.inv_mul(&f.t_part_base), noise.after(way_m))
            });
            self.constrain(&mut keyframe, f.covariance, is_of_pose(&f.sensor), Link { after_gap, constraint });
            merged.extend(f.id.map(|before| MergedKeyframe { id: before, into: id, t_into_base: Pose::identity() }));
            update.joined.push(keyframe);
        }
        self.decide(Decision { merged, ..Decision::default() }, update);
        let frames = part.frames.iter().map(|(stamp, t_part_base)| (*stamp, t_odom_part * t_part_base));
        let entered = update.joined[joined..].iter().map(|k| &k.info);
        let anchors: Vec<&KeyframeInfo> = entered.filter(|info| is_of_pose(&info.sensor)).collect();
        update.mended.extend(self.trajectory.mend(frames, &anchors));
        update.mended.sort_by_key(|e| e.stamp);
    }
}

fn way_between_m(a: &Pose, b: &Pose) -> f64 {
    let moved = a.inv_mul(b);
    way_m(moved.translation.vector.norm(), moved.rotation.angle())
}

/// The constraint of a keyframe on the place where a part was found, `t_found_then` away by an odometry that is off by these standard
/// deviations, metres and radians.
fn constraint(found: &Relocalisation, to: KeyframeId, t_found_then: &Pose, (t, r): (f64, f64)) -> LoopClosure {
    let odometry = Covariance6::from_diagonal(&[t, t, t, r, r, r].map(|sigma| sigma * sigma).into());
    LoopClosure {
        from: found.keyframe,
        to,
        t_from_to: found.t_keyframe_base * t_found_then,
        covariance: se3::compose_covariance(&found.covariance, t_found_then, &odometry),
        inlier_ratio: found.inlier_ratio,
    }
}
