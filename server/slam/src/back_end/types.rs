//! What the back end is given, and what it answers.

use crate::loops::{LoopClosure, PlaceLimits};
use crate::param_error::{ParamError, check_range};
use percept_geometry::{Correction, Covariance6, KeptScan, KeyframeId, Pose};
use serde::{Deserialize, Serialize};

/// Parameters of the back end.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BackEndParams {
    /// Whether loops are looked for.
    pub enabled: bool,
    /// A loop that moves the map is believed once so many keyframes say the same, 1 to 20.
    pub min_agreeing: usize,
    /// Keyframes by whose features a depth camera or a camera knows places, at most, 100 to 100000: some 20 kB each. Beyond,
    /// every second of the older half goes, so that places stay covered more thinly.
    pub max_visual_keyframes: usize,
    /// Submaps by whose looks a 3D lidar knows places, at most, 10 to 10000: some 30 kB each. Beyond, the oldest goes of a place
    /// that was mapped again, and else the oldest of all.
    pub max_place_submaps: usize,
}

impl Default for BackEndParams {
    fn default() -> Self {
        Self { enabled: true, min_agreeing: 2, max_visual_keyframes: 4096, max_place_submaps: 400 }
    }
}

impl BackEndParams {
    /// By how much places are known, at most.
    pub fn place_limits(&self) -> PlaceLimits {
        PlaceLimits { keyframes: self.max_visual_keyframes, submaps: self.max_place_submaps }
    }

    /// Checks every field.
    ///
    /// # Errors
    /// [`ParamError`] with field, value and remedy.
    pub fn validate(&self) -> Result<(), ParamError> {
        let least = self.min_agreeing as f64;
        check_range("min_agreeing", least, (1.0, 20.0), "within 1 to 20", "use 2")?;
        let (keyframes, submaps) = (self.max_visual_keyframes as f64, self.max_place_submaps as f64);
        let bounds = "within 100 to 100000";
        check_range("max_visual_keyframes", keyframes, (100.0, 1e5), bounds, "use 4096")?;
        check_range("max_place_submaps", submaps, (10.0, 1e4), "within 10 to 10000", "use 400")
    }
}

/// What a back end keeps, bytes, about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct BackEndMemory {
    /// What places are known by.
    pub places: usize,
    /// Keyframes and what ties them.
    pub graph: usize,
}

/// Number of a loop in its session, counted from 0 in the order of finding.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct LoopId(pub u64);

/// What became of a loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LoopState {
    /// Waits for others that say the same.
    Pending,
    /// Holds the map together.
    Active,
    /// Nothing confirmed it in time, or it contradicts what is believed.
    Rejected,
    /// Taken out by the user.
    Vetoed,
}

/// A loop that was found, and what became of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Loop {
    /// Its number.
    pub id: LoopId,
    /// What was measured.
    pub closure: LoopClosure,
    /// What became of it.
    pub state: LoopState,
}

/// A keyframe for the graph.
#[derive(Debug, Clone)]
pub struct BackEndKeyframe {
    /// Its number; ascending.
    pub id: KeyframeId,
    /// Base to map as the map has it. Read of the first keyframe, and of one after a gap that is not `tied`: of all others
    /// the graph knows it from those before.
    pub t_map_base: Pose,
    /// Base in the drifting frame of odometry.
    pub t_odom_base: Pose,
    /// Of that since the start, right perturbation in base.
    pub covariance: Covariance6,
    /// What it saw.
    pub scan: KeptScan,
    /// Whether loops are looked for from here.
    pub recognise: bool,
    /// Whether nothing measured ties it to the keyframe before: the robot was lost in between.
    pub after_gap: bool,
    /// How the caller has found it to lie to an earlier one: as surely a loop as those that place recognition finds. If
    /// another keyframe has come to stand for that one, it is measured from there.
    pub constraint: Option<LoopClosure>,
}

/// What a keyframe, or a veto, changed.
#[derive(Debug, Clone, Default)]
pub struct BackEndUpdate {
    /// Loops that were found or changed their state.
    pub loops: Vec<Loop>,
    /// Keyframes that move now, if any.
    pub correction: Option<Correction>,
    /// Odom to map after the correction; none without one.
    pub t_map_odom: Option<Pose>,
    /// Keyframes that newer ones stand for from now on, ascending; poses after the correction.
    pub merged: Vec<MergedKeyframe>,
    /// Loops that went with them.
    pub dissolved: Vec<LoopId>,
}

/// A keyframe that another one stands for from now on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MergedKeyframe {
    /// The one that is gone.
    pub id: KeyframeId,
    /// The one that stands for it.
    pub into: KeyframeId,
    /// Base at `id`, seen from base at `into`.
    pub t_into_base: Pose,
}
