//! Places seen again: a keyframe in, loops to earlier keyframes out, each verified by geometry.
//!
//! [`PlaceRecognition`] is what a kind of sensor brings; [`crate::BackEnd`] believes the loops that agree with each other
//! and moves the keyframes.

mod depth;
mod lost;
pub(crate) mod planar;
pub(crate) mod spatial;
mod visual;

use crate::odometry::{OdometryKind, OdometryParams};
use percept_geometry::{Covariance6, KeptScan, KeyframeId, KeyframeScan, Pose};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Keyframes with where base was, base to map as now believed.
pub type KeyframePoses = BTreeMap<KeyframeId, Pose>;

/// A keyframe measured from another one that saw the same place at another time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LoopClosure {
    /// The keyframe that was there before.
    pub from: KeyframeId,
    /// The keyframe that came back.
    pub to: KeyframeId,
    /// Base at `to`, seen from base at `from`.
    pub t_from_to: Pose,
    /// Of that measurement, order x, y, z, rotation x, y, z, right perturbation in `to`.
    pub covariance: Covariance6,
    /// Share of the scan that fits the place, 0 to 1.
    pub inlier_ratio: f64,
}

/// A scan placed among keyframes with no guess.
#[derive(Debug, Clone, PartialEq)]
pub struct Relocalisation {
    /// The keyframe that it was measured from.
    pub keyframe: KeyframeId,
    /// Base, seen from base at the keyframe.
    pub t_keyframe_base: Pose,
    /// Of that measurement, right perturbation in base.
    pub covariance: Covariance6,
    /// Share of the scan that fits the place, 0 to 1.
    pub inlier_ratio: f64,
}

/// What a view says of where the robot is believed to have been when it was taken.
#[derive(Debug, Clone, PartialEq)]
pub enum Evidence {
    /// It fits what the map has there, and was measured to be here.
    Agrees(Relocalisation),
    /// It looks through what the map has there, or shows what the map has looked through.
    Contradicts,
    /// Neither: the map has not seen much of that, or it fits in more than one way.
    Nothing,
}

/// What a kind of sensor brings to find places again. Deterministic. `insert` takes a time that hardly grows with the number
/// of keyframes: what takes long goes on with the next ones.
pub trait PlaceRecognition: Send {
    /// Takes a keyframe in, with the covariance of its pose since the start (right perturbation in base), and answers with
    /// loops that it closes, or that one shortly before it does.
    fn insert(
        &mut self,
        id: KeyframeId,
        scan: &KeptScan,
        drift: &Covariance6,
        poses: &KeyframePoses,
    ) -> Vec<LoopClosure>;

    /// Takes a stored keyframe in, with the earlier ones that loops tie it to: nothing is looked for.
    fn restore(
        &mut self,
        id: KeyframeId,
        scan: &KeptScan,
        drift: &Covariance6,
        poses: &KeyframePoses,
        ties: &[KeyframeId],
    );

    /// Where a scan is among the keyframes taken in; none unless that is certain.
    fn relocalise(&self, scan: &KeyframeScan, poses: &KeyframePoses) -> Option<Relocalisation>;

    /// The same for a robot that has driven since it was lost: `before` is what it saw on the way, oldest first, with base
    /// then seen from base now. Methods that are certain by one scan need no more; one that takes long goes on with
    /// the next call, and says so by [`Self::is_unfinished`].
    fn relocalise_driven(
        &mut self,
        _before: &[(Pose, Arc<KeyframeScan>)],
        scan: &KeyframeScan,
        poses: &KeyframePoses,
    ) -> Option<Relocalisation> {
        self.relocalise(scan, poses)
    }

    /// Whether the newest search for a robot that has driven has not ended yet.
    fn is_unfinished(&self) -> bool {
        false
    }

    /// Whether a search for a robot that has driven goes on in steps of counted work, one a call.
    fn relocalises_in_steps(&self) -> bool {
        false
    }

    /// What a scan says of the place where it is believed to have been taken, base to map: within the decimetres and the degrees
    /// that odometry drifts by in some tens of metres.
    fn check(&mut self, scan: &KeyframeScan, t_map_base: &Pose, poses: &KeyframePoses) -> Evidence;

    /// A keyframe has left the graph.
    fn forget(&mut self, id: KeyframeId);

    /// What it keeps, bytes, about; the scans are the caller's.
    fn memory_bytes(&self) -> usize;
}

/// By how much places are known, at most.
#[derive(Debug, Clone, Copy)]
pub struct PlaceLimits {
    /// Keyframes of a depth camera or a camera.
    pub keyframes: usize,
    /// Submaps of a 3D lidar.
    pub submaps: usize,
}

/// Place recognition for the frames that an odometry registers; none where there is none yet.
pub fn place_recognition(
    kind: OdometryKind,
    params: &OdometryParams,
    limits: PlaceLimits,
) -> Option<Box<dyn PlaceRecognition>> {
    let PlaceLimits { keyframes, submaps } = limits;
    match kind {
        OdometryKind::Lidar2d => Some(Box::new(planar::PlanarPlaces::new(params.lidar2d.max_range_m))),
        OdometryKind::Rgbd => Some(Box::new(depth::DepthPlaces::new(keyframes))),
        OdometryKind::Lidar3d => Some(Box::new(spatial::SpatialRecognition::new(submaps))),
        // A camera's own map closes its loops, too, for its points and their scale; these move what the session has built.
        OdometryKind::Mono => Some(Box::new(visual::VisualPlaces::of_sparse_points(keyframes))),
    }
}
