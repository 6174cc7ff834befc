//! Planar lidars: each scan is searched for, then refined, in a local map of recent keyframe scans.
//!
//! Scan to hits with normals ([`sweep`]), map on grids ([`crate::matching::field`]), search ([`crate::matching::search`]), point-to-line
//! refinement ([`refine`]). The robot moves in the plane: z, roll and pitch of odom stay zero.
//!
//! Where a constant says "halved" and "doubled", these are mean errors of checked relations, millimetres, of
//! `planar_log lidar2d-intel --no-odometry --first 3000`, and of the same with `--max-range 6`, where a scan sees little: 15.0 and 26.2
//! with the constants as they are. The second varies by some 4 with anything.

pub(crate) mod refine;
pub(crate) mod sweep;

use crate::covariance::diagonal;
use crate::matching::branch_and_bound::{Fit, Outcome, Pyramid, RIVAL, Region};
use crate::matching::field::{Field, Hit};
use crate::matching::search::{Window, search};
use crate::matching::sight::{Sight, View, contradicted};
use crate::odometry::{After, LocalModel, Prediction, Registration, way_m};
use crate::param_error::{ParamError, check_range};
use crate::scan::Scan;
use crate::tracking::LostReason;
use nalgebra::{Isometry2, Matrix3, Point2, Vector2, Vector6};
use percept_geometry::{KeyframeScan, Pose, se3};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::f64::consts::PI;
use std::sync::Arc;

/// Parameters of planar lidar odometry.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Lidar2dParams {
    /// Farther hits are not used, metres, 1 to 200.
    pub max_range_m: f64,
    /// Cell of the search grid, metres, 0.01 to 0.5.
    pub resolution_m: f64,
    /// A scan joins the local map after so many metres, 0.01 to 10.
    pub insert_distance_m: f64,
    /// Or after so many radians, 0.01 to pi.
    pub insert_angle_rad: f64,
    /// The local map holds the scans of so much motion, metres (a radian counts half a metre), 1 to 1000.
    pub window_m: f64,
    /// Widest search to each side, metres, 0.05 to 5.
    pub max_search_m: f64,
    /// Widest search to each side, radians, 0.02 to pi.
    pub max_search_rad: f64,
    /// Least share of the hits that must lie on the local map, 0.01 to 1.
    pub min_inlier_ratio: f64,
}

impl Default for Lidar2dParams {
    fn default() -> Self {
        Self {
            max_range_m: 25.0,
            resolution_m: 0.05,
            insert_distance_m: 0.3,
            insert_angle_rad: 0.3,
            window_m: 40.0,
            max_search_m: 0.6,
            max_search_rad: 0.5,
            min_inlier_ratio: 0.3,
        }
    }
}

impl Lidar2dParams {
    /// Checks every field.
    ///
    /// # Errors
    /// [`ParamError`] with field, value and remedy.
    pub fn validate(&self) -> Result<(), ParamError> {
        let pi = std::f64::consts::PI;
        check_range("lidar2d.max_range_m", self.max_range_m, (1.0, 200.0), "within 1 to 200", "use 25")?;
        check_range("lidar2d.resolution_m", self.resolution_m, (0.01, 0.5), "within 0.01 to 0.5", "use 0.05")?;
        // The grids take (2.8 range / resolution)^2 bytes and more.
        let cells = self.max_range_m / self.resolution_m;
        check_range("lidar2d.resolution_m", 1.0 / cells, (2.5e-4, 1.0), "max_range_m / 4000 or more", "use 0.05")?;
        let (d, a) = (self.insert_distance_m, self.insert_angle_rad);
        check_range("lidar2d.insert_distance_m", d, (0.01, 10.0), "within 0.01 to 10", "use 0.3")?;
        check_range("lidar2d.insert_angle_rad", a, (0.01, pi), "within 0.01 to pi", "use 0.3")?;
        check_range("lidar2d.window_m", self.window_m, (1.0, 1000.0), "within 1 to 1000", "use 40")?;
        check_range("lidar2d.max_search_m", self.max_search_m, (0.05, 5.0), "within 0.05 to 5", "use 0.6")?;
        check_range("lidar2d.max_search_rad", self.max_search_rad, (0.02, pi), "within 0.02 to pi", "use 0.5")?;
        let ratio = self.min_inlier_ratio;
        check_range("lidar2d.min_inlier_ratio", ratio, (0.01, 1.0), "within 0.01 to 1", "use 0.3")
    }
}

/// A scan of the local map.
struct Kept {
    hits: Vec<Hit>,
    t_base_sensor: Isometry2<f64>,
    t_odom_base: Isometry2<f64>,
    travelled: f64,
}

/// Hits beyond so many are thinned for the search; the refinement uses all. Halved 15.3 and 22.0, doubled as it is
/// ([`self`]): no scan of Intel has more.
const SEARCH_POINTS: usize = 180;

/// What a scan has to bring that follows a gap in which the robot may have been carried off: least share of its hits on the
/// local map, and most that may contradict of what both saw. In simulated buildings, robots that had driven on for 5 s in
/// the dark had 0.43 and more, 0.05 and less; carried to another room 0.3 to 0.68, and 0.14 and more.
const AFTER_GAP: (f64, f64) = (0.42, 0.07);
/// The same where somebody says that it is there: a person half a metre away hides a seventh of what a lidar sees all around, and a
/// door has been shut.
const AGAINST_WORD: f64 = 0.2;
/// Scans of the local map that it is compared with: so near, metres, and so many at most. Both halved and doubled as it
/// is ([`crate::loops::planar`]).
const COMPARED_M: f64 = 5.0;
const COMPARED: usize = 12;

/// What a scan's hits score at least where it is searched for far away, a share; and places that may fit nearly alike.
/// Both halved and doubled as it is ([`crate::loops::planar`]).
const LEAST_SCORE: f64 = 0.4;
const MOST_RIVALS: usize = 4;
/// Nodes that such a search may visit, a microsecond or so each. Halved and doubled as it is
/// ([`crate::loops::planar`]).
const SEARCH_NODES: usize = 300_000;

/// The local map of a planar lidar and its current scan.
pub(crate) struct Lidar2d {
    params: Lidar2dParams,
    kept: VecDeque<Kept>,
    field: Field,
    /// Hits of the current scan in base.
    hits: Vec<Hit>,
    /// Its sensor.
    t_base_sensor: Isometry2<f64>,
    travelled: f64,
    last: Option<Isometry2<f64>>,
}

impl Lidar2d {
    pub(crate) fn new(params: Lidar2dParams) -> Self {
        let field = Field::new(params.resolution_m, 1.4 * params.max_range_m, Point2::origin());
        let t_base_sensor = Isometry2::identity();
        Self { params, kept: VecDeque::new(), field, hits: vec![], t_base_sensor, travelled: 0.0, last: None }
    }

    fn keep(&mut self, hits: Vec<Hit>, t_base_sensor: Isometry2<f64>, t_odom_base: Isometry2<f64>) {
        self.field.add(&hits, &t_odom_base);
        self.kept.push_back(Kept { hits, t_base_sensor, t_odom_base, travelled: self.travelled });
    }

    /// Scans of the local map around a pose, with what they looked through.
    fn views_around(&self, t: &Isometry2<f64>) -> Vec<View<'_>> {
        let offset = |k: &Kept| k.t_odom_base.translation.vector - t.translation.vector;
        let near: Vec<&Kept> = self.kept.iter().filter(|k| offset(k).norm() < COMPARED_M).collect();
        let mut views = vec![];
        for k in near.iter().step_by(near.len().div_ceil(COMPARED).max(1)) {
            let sight = Sight::new(k.hits.iter().map(|h| h.p), &k.t_base_sensor);
            views.push(View { t_map_base: k.t_odom_base, hits: &k.hits, sight });
        }
        views
    }

    /// Redraws the grids when a good part of the scans is old or the robot nears their border.
    fn redraw(&mut self, here: Point2<f64>) {
        let oldest = self.kept.front().map_or(self.travelled, |k| k.travelled);
        let old = self.travelled - oldest > 1.1 * self.params.window_m;
        if !old && (here - self.field.center()).norm() < 0.3 * self.params.max_range_m {
            return;
        }
        while self.kept.front().is_some_and(|k| self.travelled - k.travelled > self.params.window_m) {
            self.kept.pop_front();
        }
        self.field.reset(here);
        for k in &self.kept {
            self.field.add(&k.hits, &k.t_odom_base);
        }
    }

    fn travel(&mut self, t: &Isometry2<f64>) {
        if let Some(last) = &self.last {
            let d = last.inverse() * t;
            self.travelled += way_m(d.translation.vector.norm(), d.rotation.angle());
        }
        self.last = Some(*t);
    }
}

/// x, y and yaw of a pose.
pub(crate) fn planar(t: &Pose) -> Isometry2<f64> {
    Isometry2::new(Vector2::new(t.translation.x, t.translation.y), se3::yaw(t))
}

/// A pose in the plane as one in space.
fn lifted(t: &Isometry2<f64>) -> Pose {
    se3::from_xy_yaw(t.translation.x, t.translation.y, t.rotation.angle())
}

impl LocalModel for Lidar2d {
    fn prepare(&mut self, scan: &Scan, velocity: &Vector6<f64>) -> Result<(), LostReason> {
        let Scan::Planar(scan) = scan else { return Err(LostReason::UnsuitableScan) };
        self.hits = sweep::hits(scan, self.params.max_range_m, velocity);
        self.t_base_sensor = planar(&scan.t_base_sensor);
        if self.hits.len() < 20 { Err(LostReason::TooFewPoints) } else { Ok(()) }
    }

    fn is_empty(&self) -> bool {
        self.kept.is_empty()
    }

    fn register(&self, prediction: &Prediction) -> Result<Registration, LostReason> {
        let center = planar(&prediction.t_odom_base);
        let c = &prediction.covariance;
        let variances = [c[(0, 0)].max(c[(1, 1)]), c[(5, 5)]].map(|v| v.max(1e-6));
        let window = Window {
            translation: (3.0 * variances[0].sqrt()).clamp(self.params.resolution_m, self.params.max_search_m),
            rotation: (3.0 * variances[1].sqrt()).clamp(0.02, self.params.max_search_rad),
        };
        // The same in x and y, so that no rotation to odom is needed.
        let prior = Matrix3::from_diagonal(&[1.0 / variances[0], 1.0 / variances[0], 1.0 / variances[1]].into());
        let points = sweep::thin(&self.hits, 0.5 * self.params.resolution_m, SEARCH_POINTS);
        let (start, _) = search(&self.field, &points, &center, &prior, &window);
        refine::refine(&self.field, &self.hits, &start, prediction, self.params.min_inlier_ratio)
    }

    fn search(&self, t_odom_base: &Pose, way: f64, turn: f64) -> Option<Vec<Registration>> {
        let center = planar(t_odom_base);
        let reach = way + 2.0 * self.params.max_range_m;
        let is_near = |k: &&Kept| (k.t_odom_base.translation.vector - center.translation.vector).norm() < reach;
        let known = self.kept.iter().filter(is_near).flat_map(|k| k.hits.iter().map(|h| k.t_odom_base * h.p));
        let Some(pyramid) = Pyramid::new(self.params.resolution_m, &known.collect::<Vec<_>>()) else {
            return Some(vec![]);
        };
        let query = sweep::thin(&self.hits, 0.5 * self.params.resolution_m, SEARCH_POINTS);
        let region = Region { center, translation: way, rotation: turn.min(PI) };
        let place = |fit: Fit| {
            let wide = Prediction::within(lifted(&fit.t), diagonal(way / 3.0, turn / 3.0));
            refine::refine(&self.field, &self.hits, &fit.t, &wide, self.params.min_inlier_ratio).ok()
        };
        let mut search = pyramid.begin(&query, &region, LEAST_SCORE, (RIVAL, MOST_RIVALS));
        let mut nodes = search.num_roots() + SEARCH_NODES;
        match pyramid.go_on(&mut search, &mut nodes)? {
            Outcome::Found(fits) => {
                Some(fits.into_iter().filter_map(place).filter(|found| self.is_certain(found, After::Gap)).collect())
            }
            Outcome::Undecided => None,
        }
    }

    fn integrate(&mut self, t_odom_base: &Pose) {
        let t = planar(t_odom_base);
        self.travel(&t);
        let far = self.kept.back().is_none_or(|k| {
            let d = k.t_odom_base.inverse() * t;
            d.translation.vector.norm() >= self.params.insert_distance_m
                || d.rotation.angle().abs() >= self.params.insert_angle_rad
        });
        self.redraw(Point2::from(t.translation.vector));
        if far {
            let hits = self.hits.clone();
            self.keep(hits, self.t_base_sensor, t);
        }
    }

    fn is_certain(&self, found: &Registration, after: After) -> bool {
        let t = planar(&found.t_odom_base);
        let own = Sight::new(self.hits.iter().map(|h| h.p), &self.t_base_sensor);
        let against = contradicted(&self.field, &self.views_around(&t), (&own, &self.hits), &t);
        let most = if after == After::Word { AGAINST_WORD } else { AFTER_GAP.1 };
        found.inlier_ratio >= AFTER_GAP.0 && against <= most
    }

    fn memory_bytes(&self) -> usize {
        let hits: usize = self.kept.iter().map(|k| k.hits.capacity()).sum();
        self.field.memory_bytes() + self.kept.len() * size_of::<Kept>() + hits * size_of::<Hit>()
    }

    fn clear(&mut self) {
        self.kept.clear();
        let center = self.last.map_or_else(Point2::origin, |t| Point2::from(t.translation.vector));
        self.field.reset(center);
    }

    fn seed(&mut self, t_odom_base_last: &Pose, recent: &[(Pose, Arc<KeyframeScan>)]) {
        let here = planar(t_odom_base_last);
        self.field.reset(Point2::from(here.translation.vector));
        for (t_odom_base, scan) in recent.iter().filter(|(_, k)| k.planar) {
            let t = planar(t_odom_base);
            self.travel(&t);
            let hits = sweep::from_points(&scan.hits.positions, &scan.t_base_sensor);
            self.keep(hits, planar(&scan.t_base_sensor), t);
        }
        self.travel(&here);
    }
}
