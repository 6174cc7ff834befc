//! Keyframes and the back end around an odometry, as the pipeline has them.

use percept_geometry::{KeyframeId, Pose};
use percept_slam::loops::place_recognition;
use percept_slam::{
    BackEnd, BackEndKeyframe, BackEndParams, BackEndUpdate, KeyframeParams, KeyframePolicy, LoopState, Odometry,
    OdometryEstimate, OdometryKind, OdometryNoise, OdometryParams, Scan,
};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;

pub(crate) struct Mapping {
    policy: KeyframePolicy,
    back_end: BackEnd,
    t_odom_keyframe: Vec<Pose>,
    /// Keyframes that others stand for, and their poses in those.
    merged: BTreeMap<KeyframeId, (KeyframeId, Pose)>,
    /// The keyframe before each frame, and the frame's pose in it.
    frames: Vec<(usize, Pose)>,
    milliseconds: Vec<f64>,
}

impl Mapping {
    /// None for a kind of sensor that places are not recognised with.
    pub(crate) fn new(kind: OdometryKind) -> Option<Self> {
        Some(Self {
            policy: KeyframePolicy::new(KeyframeParams::default()),
            back_end: BackEnd::new(
                BackEndParams::default(),
                OdometryNoise::of(kind),
                place_recognition(kind, &OdometryParams::default(), BackEndParams::default().place_limits())?,
            ),
            t_odom_keyframe: vec![],
            merged: BTreeMap::new(),
            frames: vec![],
            milliseconds: vec![],
        })
    }

    pub(crate) fn frame(&mut self, odometry: &Odometry, e: &OdometryEstimate, scan: &Scan) {
        if !e.state.is_lost() && self.policy.consider(&e.t_odom_base) {
            self.keyframe(odometry, e, scan);
        }
        let last = self.t_odom_keyframe.len().saturating_sub(1);
        let anchor = self.t_odom_keyframe.get(last).copied().unwrap_or_else(Pose::identity);
        self.frames.push((last, anchor.inverse() * e.t_odom_base));
    }

    fn keyframe(&mut self, odometry: &Odometry, e: &OdometryEstimate, scan: &Scan) {
        let id = KeyframeId(self.t_odom_keyframe.len() as u64);
        let kept = Arc::new(odometry.keyframe_scan(e.stamp, &"laser".into(), scan));
        self.t_odom_keyframe.push(e.t_odom_base);
        let keyframe = BackEndKeyframe {
            id,
            t_map_base: e.t_odom_base,
            t_odom_base: e.t_odom_base,
            covariance: e.covariance,
            scan: kept.into(),
            recognise: true,
            after_gap: false,
            constraint: None,
        };
        let start = Instant::now();
        let update = self.back_end.insert(&keyframe);
        self.merge(&update);
        self.milliseconds.push(start.elapsed().as_secs_f64() * 1e3);
    }

    /// Poses of all frames, carried by the corrected keyframes before them.
    pub(crate) fn finish(&mut self) -> Vec<Pose> {
        let update = self.back_end.settle();
        self.merge(&update);
        let poses = self.back_end.poses();
        let at = |(k, t): &(usize, Pose)| {
            let (mut id, mut t) = (KeyframeId(*k as u64), *t);
            while let Some((into, t_into_base)) = self.merged.get(&id) {
                (id, t) = (*into, t_into_base * t);
            }
            poses.get(&id).map_or(t, |anchor| anchor * t)
        };
        self.frames.iter().map(at).collect()
    }

    fn merge(&mut self, update: &BackEndUpdate) {
        self.merged.extend(update.merged.iter().map(|m| (m.id, (m.into, m.t_into_base))));
    }

    pub(crate) fn report(&self) {
        let mut ms = self.milliseconds.clone();
        ms.sort_by(f64::total_cmp);
        let at = |q: f64| ms.get((ms.len().saturating_sub(1) as f64 * q) as usize).copied().unwrap_or(0.0);
        let count = |state| self.back_end.loops().iter().filter(|l| l.state == state).count();
        println!(
            "{} keyframes, loops: {} active, {} pending, {} rejected; back end ms p50 {:.1} p99 {:.1} max {:.1} sum {:.0}",
            self.t_odom_keyframe.len(),
            count(LoopState::Active),
            count(LoopState::Pending),
            count(LoopState::Rejected),
            at(0.5),
            at(0.99),
            at(1.0),
            ms.iter().sum::<f64>()
        );
    }
}
