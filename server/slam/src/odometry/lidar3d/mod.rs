//! 3D lidars: each sweep is placed in a local map of voxels with a Gaussian each.
//!
//! The same defaults serve a room and a street: the voxel's size is learned from the first sweep. Sweep to
//! thinned points (here and [`sweep`]), map ([`levels`] of [`voxels`]), points to map ([`mod@align`]), which finds the motion during
//! the sweep along with the pose.
//!
//! Where a constant says "halved" and "doubled", these are the ATE of `evaluate handheld lidar-handheld-livox` and where
//! `evaluate kitti-tracking lidar-kitti-tracking-0000` ends, millimetres: 11.8 and 9.9 with the constants as they are. The first has
//! 55 quick steps of a narrow view, and tears (300 and more) where the map is too coarse, too fine or too stiff for it.

pub(crate) mod align;
pub(crate) mod levels;
mod meeting;
pub(crate) mod sight;
pub(crate) mod sweep;
pub(crate) mod voxels;

use crate::deskew;
use crate::downsample::Thinner;
use crate::inertial::Curve;
use crate::odometry::model::SweepFound;
use crate::odometry::{After, Found, LocalModel, Prediction, Registration};
use crate::param_error::{ParamError, check_range};
use crate::scan::Scan;
use crate::tracking::LostReason;
use align::{Problem, agility, align_and_tell};
use levels::Levels;
use nalgebra::{Point3, Vector6};
use percept_geometry::{KeyframeScan, Pose, cloud};
use serde::{Deserialize, Serialize};
use sight::{Contradiction, Sight};
use std::collections::VecDeque;
use std::sync::Arc;
use sweep::{Instants, Motion, Sweep};

/// Parameters of 3D lidar odometry.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Lidar3dParams {
    /// Nearer points are the robot itself, metres from the sensor, 0 to 10.
    pub min_range_m: f64,
    /// Farther points are not used, metres, 1 to 1000.
    pub max_range_m: f64,
    /// Edge of the local map's voxels, metres, 0.05 to 5; none learns it from the first sweep.
    pub voxel_size_m: Option<f64>,
    /// Most iterations on the fine map, 1 to 200.
    pub max_iterations: usize,
    /// Least share of the points that must meet the map, 0.01 to 1.
    pub min_overlap_ratio: f64,
    /// Of those, least share near its surfaces, 0.01 to 1.
    pub min_inlier_ratio: f64,
    /// Whether to undo the motion during a sweep where points carry times.
    pub deskew: bool,
}

impl Default for Lidar3dParams {
    fn default() -> Self {
        Self {
            min_range_m: 0.3,
            max_range_m: 100.0,
            voxel_size_m: None,
            max_iterations: 15,
            min_overlap_ratio: 0.2,
            min_inlier_ratio: 0.5,
            deskew: true,
        }
    }
}

impl Lidar3dParams {
    /// Checks every field.
    ///
    /// # Errors
    /// [`ParamError`] with field, value and remedy.
    pub fn validate(&self) -> Result<(), ParamError> {
        let (max, size) = (self.max_range_m, self.voxel_size_m.unwrap_or(1.0));
        check_range("lidar3d.min_range_m", self.min_range_m, (0.0, 10.0), "within 0 to 10", "use 0.3")?;
        check_range("lidar3d.max_range_m", max, (1.0, 1000.0), "within 1 to 1000", "use 100")?;
        check_range("lidar3d.max_range_m", max, (self.min_range_m, 1000.0), "above min_range_m", "use 100")?;
        check_range("lidar3d.voxel_size_m", size, (0.05, 5.0), "within 0.05 to 5", "leave it out")?;
        let iterations = self.max_iterations as f64;
        check_range("lidar3d.max_iterations", iterations, (1.0, 200.0), "within 1 to 200", "use 15")?;
        let (overlap, inliers) = (self.min_overlap_ratio, self.min_inlier_ratio);
        check_range("lidar3d.min_overlap_ratio", overlap, (0.01, 1.0), "within 0.01 to 1", "use 0.2")?;
        check_range("lidar3d.min_inlier_ratio", inliers, (0.01, 1.0), "within 0.01 to 1", "use 0.5")
    }
}

/// Sizes to learn from, as shares of the 90th percentile of the ranges; the first that makes planes wins. Steps of the
/// square root of two.
const SIZE_LADDER: [f64; 5] = [1.0 / 28.0, 1.0 / 20.0, 1.0 / 14.0, 1.0 / 10.0, 1.0 / 7.0];
/// Smallest and largest size that is learned, metres: ranges good to 2 or 3 cm make no planes in smaller voxels, and
/// streets none in larger ones. In the narrowest places the last rung may be smaller. Halved 321 and 11.7, doubled 11.4
/// and 9.9 ([`self`]).
const SIZES: (f64, f64) = (0.4, 1.5);
/// Voxels are halved or doubled when the usual range has changed by this factor since their size was learned; halved to
/// this share of the smallest size at least. Just above 2, so that what was halved is not doubled again; 1.1 gives 14.8
/// and 9.9, 4.4 gives 11.8 and 9.9 ([`self`]).
const RANGE_CHANGE: f64 = 2.2;
const SMALLEST: f64 = 0.75;
/// Velocities may change so many times faster than they did of late, and by at least this share of what hands do.
/// `evaluate lidar-sim spinning seconds=30`: the first halved 3.9, doubled 4.3, the second halved 3.7, doubled 4.0 mm
/// (3.6).
const CAUTION: f64 = 2.0;
const LEAST_AGILITY: f64 = 0.15;
/// The most by which a sweep's change of velocity counts more than those of late. `evaluate lidar-sim spinning
/// seconds=30`: halved 3.9, doubled 3.6 mm (3.6).
const QUICKENS: f64 = 2.0;
/// How fast the mean of how far predictions were off rises and falls. `evaluate handheld` on the recording of 55 quick steps:
/// 0.0130 m if it rises by 0.2, 0.0123 by 0.3 and a third, 0.0114 by 0.4 to 1; streets do not tell. Above a third simulated rosettes
/// and an IMU that is mounted wrongly do worse.
const OFF_RATES: (f64, f64) = (0.33, 0.2);
/// Spacing of the points that go into the map, and of those that are registered, voxels. The first halved 292 and 9.3,
/// doubled 30.4 and 9.2; the second halved 11.3 and 6.3 at four times the work, doubled 413 and 13.7 ([`self`]).
const DENSE: f64 = 0.2;
const SPARSE: f64 = 0.7;
/// Where so few points are left, more are registered: narrow views and small rooms. Halved and doubled change nothing
/// on the recordings.
const ENOUGH_POINTS: usize = 2000;
/// Share of the first sweep's points that must meet planes, of voxels of this size or of the coarser levels. Halved
/// 11.8 and 9.9, doubled (never) 11.8 and 17.6 ([`self`]).
const PLANAR_SHARE: f64 = 0.5;

/// Scans that stand for the local map are so many usual ranges and radians apart; so many of them are kept. The bound
/// of the memory and time that [`AFTER_GAP`] takes; what is registered does not depend on it.
const KEEP_EVERY: (f64, f64) = (0.1, 0.5);
const MOST_KEPT: usize = 40;
/// A scan that follows a gap is compared with those within so many usual ranges, and so many at most. As with
/// [`KEEP_EVERY`].
const COMPARED_WITHIN: f64 = 1.0;
const COMPARED: usize = 10;
/// What it has to bring, lest the robot was carried off meanwhile: least share of its points on the local map, most that
/// may contradict of what both saw, and least share that both saw. In simulated buildings, robots that had driven on for
/// 5 s in the dark had 0.95 and more, 0.02 and less; carried to another room 0.99 and less, 0.035 and more.
const AFTER_GAP: (f64, f64, f64) = (0.6, 0.03, 0.25);
/// The same where somebody says that it is there: as of planar lidars.
const AGAINST_WORD: f64 = 0.2;

/// A scan of the local map.
struct Kept {
    sight: Sight,
    t_odom_base: Pose,
}

/// The local map of a lidar and its current sweep.
pub(crate) struct Lidar3d {
    params: Lidar3dParams,
    thinner: Thinner,
    map: Option<Levels>,
    /// Current sweep: what goes into the map, and what is registered.
    dense: Sweep,
    sparse: Sweep,
    /// Base's velocity during the current sweep, m/s and rad/s: as expected, and as last found.
    expected_velocity: Vector6<f64>,
    velocity: Vector6<f64>,
    /// How base moves during sweeps as an IMU feels it: velocities are what is left of that then.
    curve: Option<Arc<Curve>>,
    /// Seconds in which it may have changed from the one to the other.
    elapsed: f64,
    reach: f64,
    /// The 90th percentile of the ranges, metres: its running geometric mean, and when the size was learned.
    usual_range: f64,
    learned_at: f64,
    /// Squares of how far predictions were off at the points, as a running mean; see KISS-ICP, eq. 7.
    deviation2: Option<f64>,
    /// Square of how fast velocities change, as a share of what hands do: rises at once, falls slowly.
    agility2: f64,
    last_trim: Option<Point3<f64>>,
    /// Standard deviation with which the newest sweep was placed, at the usual range, metres.
    sigma: f64,
    /// Sensor to base, of the current sweep.
    t_base_sensor: Pose,
    /// Oldest first.
    kept: VecDeque<Kept>,
}

impl Lidar3d {
    pub(crate) fn new(params: Lidar3dParams) -> Self {
        Self {
            params,
            thinner: Thinner::default(),
            map: None,
            dense: Sweep::default(),
            sparse: Sweep::default(),
            expected_velocity: Vector6::zeros(),
            velocity: Vector6::zeros(),
            curve: None,
            elapsed: 0.0,
            reach: 0.0,
            usual_range: 1.0,
            learned_at: 1.0,
            deviation2: None,
            agility2: (0.25f64 / CAUTION).powi(2),
            last_trim: None,
            sigma: 0.0,
            t_base_sensor: Pose::identity(),
            kept: VecDeque::new(),
        }
    }

    /// The smallest size at which the sweep is made of planes: sparse rings need large ones.
    fn learn_size(&mut self, points: &[Point3<f32>], usable: &[u32], range90: f64) -> f64 {
        if let Some(size) = self.params.voxel_size_m {
            return size;
        }
        let smallest = SIZES.0.min(range90 * SIZE_LADDER[SIZE_LADDER.len() - 1]).max(0.1);
        let mut best = (0.0, smallest);
        let mut sizes = SIZE_LADDER.map(|share| (share * range90).clamp(smallest, SIZES.1)).to_vec();
        sizes.dedup();
        for size in sizes {
            let kept = self.thinner.even(points, usable, DENSE * size);
            let kept: Vec<Point3<f64>> = kept.iter().map(|&i| points[i as usize].cast()).collect();
            let mut map = Levels::new(size);
            map.insert(&kept, None);
            let planar = map.planar_share(&kept);
            if planar > best.0 {
                best = (planar, size);
            }
            if planar >= PLANAR_SHARE {
                break;
            }
        }
        best.1
    }

    /// Learns the size from the first points, and halves or doubles it as the usual range changes: out of a door, into
    /// a room. `points` in base; `usable` of them.
    fn adapt(&mut self, points: &[Point3<f32>], usable: &[u32]) {
        let Some(range90) = range90(points, usable) else { return };
        if self.map.is_none() {
            let size = self.learn_size(points, usable, range90);
            self.start_maps(size);
            self.usual_range = range90;
            self.learned_at = range90;
        }
        self.usual_range *= (range90 / self.usual_range).powf(0.1);
        self.reach = (4.0 * self.usual_range).clamp(20.0, self.params.max_range_m.max(20.0));
        let Some(map) = self.map.as_mut().filter(|_| self.params.voxel_size_m.is_none()) else { return };
        if self.usual_range > RANGE_CHANGE * self.learned_at && map.size() * 2.0 <= SIZES.1 {
            map.double();
            self.learned_at *= 2.0;
        } else if self.usual_range * RANGE_CHANGE < self.learned_at && map.size() * 0.5 >= SMALLEST * SIZES.0 {
            map.halve();
            self.learned_at *= 0.5;
        }
    }

    fn start_maps(&mut self, size: f64) {
        self.map = Some(Levels::new(size));
    }

    fn insert(&mut self, points: &[Point3<f32>], t_base_sensor: &Pose, t_odom_base: &Pose) {
        let motion = Motion::of(t_odom_base);
        let moved: Vec<Point3<f64>> = points.iter().map(|p| motion.apply(p)).collect();
        if let Some(map) = &mut self.map {
            // The points count as old as the map that they were placed in: what is new is off by as much as the sweep is.
            let seen_from = t_odom_base * Point3::from(t_base_sensor.translation.vector);
            let new = map.insert(&moved, Some(seen_from));
            map.renewed(new, self.sigma);
        }
    }

    /// Keeps a scan, given by its points in base, if it was taken far enough from the newest kept one.
    fn keep(&mut self, points: &[Point3<f32>], t_base_sensor: &Pose, t_odom_base: &Pose) {
        let is_near = self.kept.back().is_some_and(|k| {
            let d = k.t_odom_base.inv_mul(t_odom_base);
            d.translation.vector.norm() < KEEP_EVERY.0 * self.usual_range && d.rotation.angle() < KEEP_EVERY.1
        });
        if is_near {
            return;
        }
        if self.kept.len() == MOST_KEPT {
            self.kept.pop_front();
        }
        self.kept.push_back(Kept { sight: Sight::new(points, t_base_sensor), t_odom_base: *t_odom_base });
    }

    /// What the current scan, placed here, and those around it contradict each other in: the larger of both directions.
    fn contradicted(&self, t_odom_base: &Pose, velocity: &Vector6<f64>) -> Contradiction {
        let own = Sight::new(&self.dense.at_stamp(velocity), &self.t_base_sensor);
        let away = |k: &&Kept| (k.t_odom_base.translation.vector - t_odom_base.translation.vector).norm();
        let near: Vec<&Kept> = self.kept.iter().filter(|k| away(k) < COMPARED_WITHIN * self.usual_range).collect();
        let some = near.iter().step_by(near.len().div_ceil(COMPARED).max(1));
        own.contradicted(some.map(|k| (&k.sight, t_odom_base.inv_mul(&k.t_odom_base))))
    }

    /// Forgets what is out of reach, now and then.
    fn trim(&mut self, t_odom_base: &Pose) {
        let here = Point3::from(t_odom_base.translation.vector);
        if self.last_trim.is_some_and(|p| (p - here).norm() < 0.1 * self.reach) {
            return;
        }
        self.last_trim = Some(here);
        if let Some(map) = &mut self.map {
            map.remove_far_from(&here, 1.2 * self.reach);
        }
    }
}

/// The 90th percentile of the distances from base, metres, of about a thousand points.
fn range90(points: &[Point3<f32>], usable: &[u32]) -> Option<f64> {
    let step = (usable.len() / 1000).max(1);
    let mut ranges: Vec<f32> = usable.iter().step_by(step).map(|&i| points[i as usize].coords.norm()).collect();
    let k = ranges.len() * 9 / 10;
    (k < ranges.len()).then(|| f64::from(*ranges.select_nth_unstable_by(k, f32::total_cmp).1).max(0.1))
}

impl LocalModel for Lidar3d {
    fn prepare(&mut self, scan: &Scan, velocity: &Vector6<f64>) -> Result<(), LostReason> {
        let Scan::Cloud(scan) = scan else { return Err(LostReason::UnsuitableScan) };
        let (min2, max2) = (self.params.min_range_m.powi(2) as f32, self.params.max_range_m.powi(2) as f32);
        let positions = &scan.cloud.positions;
        let usable: Vec<u32> = (0..positions.len())
            .filter(|&i| {
                let d2 = positions[i].coords.norm_squared();
                cloud::is_finite(&positions[i]) && d2 >= min2 && d2 <= max2
            })
            .map(|i| i as u32)
            .collect();
        if usable.len() < 100 {
            return Err(LostReason::TooFewPoints);
        }
        let offsets = scan.cloud.time_offsets_s.as_deref().filter(|o| self.params.deskew && o.len() == positions.len());
        if offsets.is_none() {
            self.curve = None;
        }
        let curve = self.curve.as_deref();
        let instants = Instants::felt(offsets, curve);
        let still = Vector6::zeros();
        self.expected_velocity = if offsets.is_some() && curve.is_none() { *velocity } else { still };
        self.velocity = self.expected_velocity;
        let in_base = deskew::to_base(&scan.cloud, &scan.t_base_sensor, &self.expected_velocity, curve);
        self.adapt(&in_base, &usable);
        let size = self.map.as_ref().map_or(1.0, Levels::size);
        let dense = self.thinner.even(&in_base, &usable, DENSE * size);
        let mut spacing = SPARSE * size;
        let mut sparse = self.thinner.even(&in_base, &dense, spacing);
        while sparse.len() < ENOUGH_POINTS && spacing > 1.5 * DENSE * size {
            spacing *= 0.7;
            sparse = self.thinner.even(&in_base, &dense, spacing);
        }
        self.t_base_sensor = scan.t_base_sensor;
        let take = |indices: &[u32]| Sweep::new(positions, offsets, &scan.t_base_sensor, &instants, indices);
        (self.dense, self.sparse) = (take(&dense), take(&sparse));
        if self.sparse.len() < 50 { Err(LostReason::TooFewPoints) } else { Ok(()) }
    }

    fn is_empty(&self) -> bool {
        self.map.as_ref().is_none_or(Levels::is_empty)
    }

    fn register(&self, prediction: &Prediction) -> Result<Registration, LostReason> {
        let Some(map) = &self.map else { return Err(LostReason::TooFewCorrespondences) };
        let size = map.size();
        let expected_error = self.deviation2.map_or(2.0 * size, |d| 3.0 * d.sqrt()).max(0.1 * size);
        let problem = Problem {
            sweep: &self.sparse,
            map,
            prediction,
            velocity: self.expected_velocity,
            agility: (CAUTION * self.agility2.sqrt()).clamp(LEAST_AGILITY, 1.0),
            expected_error,
            max_iterations: self.params.max_iterations,
            min_overlap: self.params.min_overlap_ratio,
            min_inlier_ratio: self.params.min_inlier_ratio,
        };
        let (placed, state, told) = align_and_tell(&problem)?;
        let found = SweepFound { velocity: state.velocity, elapsed: problem.elapsed() };
        Ok(Registration { told: Some(told), found: Found::Sweep(found), ..placed })
    }

    fn believe(&mut self, placed: &Registration, t_odom_expected: &Pose) {
        let Found::Sweep(found) = &placed.found else { return };
        (self.velocity, self.elapsed) = (found.velocity, found.elapsed);
        let sigma = |from: usize| (from..from + 3).map(|k| placed.covariance[(k, k)]).sum::<f64>().sqrt();
        self.sigma = sigma(0) + self.usual_range * sigma(3);
        let off = t_odom_expected.inv_mul(&placed.t_odom_base);
        let now = off.translation.vector.norm() + 0.25 * self.reach * off.rotation.angle();
        let last2 = self.deviation2.unwrap_or_else(|| self.map.as_ref().map_or(1.0, Levels::size).powi(2));
        let rate = if now * now > last2 { OFF_RATES.0 } else { OFF_RATES.1 };
        self.deviation2 = Some(last2 + rate * (now * now - last2));
    }

    fn integrate(&mut self, t_odom_base: &Pose) {
        if self.dense.instants().duration() > 0.0 && self.curve.is_none() {
            // One sweep that was placed wrongly must not open the door for the next.
            let most2 = QUICKENS.powi(2) * self.agility2;
            let now2 = agility(self.elapsed, &(self.velocity - self.expected_velocity)).powi(2).min(most2);
            self.agility2 += if now2 > self.agility2 { 0.5 } else { 0.1 } * (now2 - self.agility2);
        }
        let points = self.dense.at_stamp(&self.velocity);
        let t_base_sensor = self.t_base_sensor;
        self.insert(&points, &t_base_sensor, t_odom_base);
        self.keep(&points, &t_base_sensor, t_odom_base);
        self.trim(t_odom_base);
    }

    fn is_certain(&self, placed: &Registration, after: After) -> bool {
        let velocity = match &placed.found {
            Found::Sweep(found) => found.velocity,
            _ => self.velocity,
        };
        let against = self.contradicted(&placed.t_odom_base, &velocity);
        let (inliers, most, compared) = AFTER_GAP;
        let most = if after == After::Word { AGAINST_WORD } else { most };
        placed.inlier_ratio >= inliers && against.share() <= most && against.compared() >= compared
    }

    fn sweep_velocity(&self) -> Option<Vector6<f64>> {
        let instants = self.dense.instants();
        (instants.duration() > 0.0).then(|| instants.mean_velocity(&self.velocity))
    }

    fn follow_curve(&mut self, curve: Option<Arc<Curve>>) {
        self.curve = curve;
    }

    fn sweep_curve(&self) -> Option<(Arc<Curve>, Vector6<f64>)> {
        self.curve.clone().map(|curve| (curve, self.velocity))
    }

    fn memory_bytes(&self) -> usize {
        let kept: usize = self.kept.iter().map(|k| size_of::<Kept>() + k.sight.memory_bytes()).sum();
        let sweeps = (self.dense.len() + self.sparse.len()) * size_of::<Point3<f32>>();
        self.map.as_ref().map_or(0, Levels::memory_bytes) + kept + sweeps
    }

    fn clear(&mut self) {
        if let Some(size) = self.map.as_ref().map(Levels::size) {
            self.start_maps(size);
        }
        // The sweep that starts the new map moved as it was expected to.
        (self.elapsed, self.sigma) = (0.0, 0.0);
        self.deviation2 = None;
        self.last_trim = None;
        self.kept.clear();
    }

    fn seed(&mut self, _t_odom_base_last: &Pose, recent: &[(Pose, Arc<KeyframeScan>)]) {
        let scans: Vec<_> = recent.iter().filter(|(_, k)| !k.planar && !k.hits.is_empty()).collect();
        let Some((_, newest)) = scans.last() else { return };
        if self.map.is_none() {
            let all: Vec<u32> = (0..newest.hits.len() as u32).collect();
            self.adapt(&newest.hits.positions, &all);
        }
        for (t_odom_base, scan) in scans {
            self.insert(&scan.hits.positions, &scan.t_base_sensor, t_odom_base);
            self.keep(&scan.hits.positions, &scan.t_base_sensor, t_odom_base);
        }
    }
}
