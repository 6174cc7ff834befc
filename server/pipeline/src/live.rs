//! What the newest frames see: who stands in the way of the robot before a keyframe shows it, what has gone from there, and what
//! moves.
//!
//! Some frames of the last seconds are kept of each sensor, thinned as keyframes are, where odometry has placed them. They are laid
//! over the grid when that is asked for ([`Live::over`]); nothing of it enters the map. And they tell which points of a keyframe
//! belong to what moves ([`NewestFrames::part_moving`]): those do not enter it either.

use crate::beside::Executor;
use crate::later::{Later, worked_out};
use nalgebra::Point3;
use percept_geometry::{KeyframeScan, PointCloud, Pose, SensorId, Timestamp};
use percept_mapping::{Contradicted, LiveFrame, LiveParams, OccupancyMap, Sight, moving};
use percept_slam::keyframe::LaterScan;
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, OnceLock};

/// From one frame that is kept to the next, beside the newest, seconds: a person at a walk leaves the place where they were.
const SPACING_S: f64 = 0.5;
/// So long frames are kept, for what moves; for paths as long as that is wanted. As long as a person takes to cross a room's door.
const KEPT_S: f64 = 2.5;
/// So many frames are asked what moves, of each sensor.
const ASKED: usize = 3;
/// What moves was elsewhere so long ago, seconds: at half a walk, as far as it is wide.
const EARLIER_S: f64 = 0.4;

/// What passes is lower than a door, metres: lamps and ceilings lie over free cells.
const PASSING_M: f64 = 2.05;

/// What a frame shows.
pub(crate) enum Seen {
    /// It became a keyframe.
    Keyframe(Box<KeyframeScan>),
    /// To be thinned when it is wanted.
    Later(LaterScan),
}

/// A frame where odometry has placed it; it is thinned when it is wanted.
struct Frame {
    stamp: Timestamp,
    t_odom_base: Pose,
    scan: Later<KeyframeScan>,
    /// Whether it became a keyframe: it is thinned already.
    is_keyframe: bool,
    sight: OnceLock<Sight>,
}

impl Frame {
    fn sight(&self) -> &Sight {
        worked_out(&self.sight, || Sight::new(&self.t_odom_base, self.scan.get()))
    }

    fn in_map(&self, t_map_odom: &Pose, base_height_m: f64, is_newest: bool) -> LiveFrame {
        let scan = Arc::new(KeyframeScan { base_height_m, ..self.scan.get().clone() });
        LiveFrame { t_map_base: t_map_odom * self.t_odom_base, scan, is_newest }
    }
}

/// What a frame shows where the map says that nothing stands.
pub(crate) struct News {
    /// Map frame, metres.
    pub(crate) points: Vec<Point3<f32>>,
    pub(crate) t_map_base: Pose,
    /// All that it shows, base frame.
    pub(crate) scan: Arc<KeyframeScan>,
}

/// The newest frames of each sensor, oldest first.
#[derive(Default)]
pub(crate) struct NewestFrames {
    by_sensor: BTreeMap<SensorId, VecDeque<Arc<Frame>>>,
    /// What a thinned frame takes, bytes: as much as the sensor's newest keyframe.
    frame_bytes: BTreeMap<SensorId, usize>,
}

impl NewestFrames {
    /// Takes a frame in. A newest one that is no longer wanted gives way to it.
    pub(crate) fn take(
        &mut self,
        (sensor, stamp, t_odom_base): (&SensorId, Timestamp, &Pose),
        scan: Seen,
        params: &LiveParams,
        executor: Option<&Arc<dyn Executor>>,
    ) {
        let frames = self.by_sensor.entry(sensor.clone()).or_default();
        // Who goes back in time begins anew.
        if frames.back().is_some_and(|newest| newest.stamp >= stamp) {
            frames.clear();
        }
        frames.retain(|f| stamp.seconds_since(f.stamp) <= params.time_s.max(KEPT_S));
        let len = frames.len();
        let is_close = |a: &Arc<Frame>, b: &Arc<Frame>| {
            let spacing_s = if b.is_keyframe { 0.5 * SPACING_S } else { SPACING_S };
            b.stamp.seconds_since(a.stamp) < spacing_s
        };
        if len >= 2 && is_close(&frames[len - 2], &frames[len - 1]) {
            frames.pop_back();
        } else if let (Some(newest), Some(executor)) = (frames.back(), executor) {
            // It stays: what it came from need not be kept until somebody asks.
            let newest = Arc::clone(newest);
            executor.spawn(Box::new(move || {
                if !newest.scan.get().planar {
                    newest.sight();
                }
            }));
        }
        let is_keyframe = matches!(scan, Seen::Keyframe(_));
        if let Seen::Keyframe(scan) = &scan {
            self.frame_bytes.insert(sensor.clone(), scan.memory_bytes());
        }
        let scan = match scan {
            Seen::Keyframe(scan) => Later::now(*scan),
            Seen::Later(scan) => Later::of(scan),
        };
        let t_odom_base = *t_odom_base;
        frames.push_back(Arc::new(Frame { stamp, t_odom_base, scan, is_keyframe, sight: OnceLock::new() }));
    }

    /// What they take, bytes, about: whether each is thinned by now is not asked, as that hangs on who was faster.
    pub(crate) fn memory_bytes(&self) -> usize {
        let of = |(sensor, frames): (&SensorId, &VecDeque<_>)| {
            frames.len() * self.frame_bytes.get(sensor).copied().unwrap_or_default()
        };
        self.by_sensor.iter().map(of).sum()
    }

    /// The robot may be elsewhere: nothing is known.
    pub(crate) fn clear(&mut self) {
        self.by_sensor.clear();
    }

    /// Takes out of a keyframe's scan what moves, as the frames before it have it; what that was, base frame.
    pub(crate) fn part_moving(&self, scan: &mut KeyframeScan, t_odom_base: &Pose) -> PointCloud {
        let is_earlier = |f: &&Arc<Frame>| {
            let age = scan.stamp.seconds_since(f.stamp);
            (EARLIER_S..=KEPT_S).contains(&age) && !f.scan.get().planar
        };
        let of_sensor = |frames: &'_ VecDeque<Arc<Frame>>| {
            frames.iter().rev().filter(is_earlier).take(ASKED).map(Arc::clone).collect::<Vec<_>>()
        };
        let frames: Vec<Arc<Frame>> =
            if scan.planar { vec![] } else { self.by_sensor.values().flat_map(of_sensor).collect() };
        let earlier: Vec<&Sight> = frames.iter().map(|f| f.sight()).collect();
        let moves = moving(&earlier, t_odom_base, scan);
        let which = |wanted: bool| -> Vec<usize> { (0..moves.len()).filter(|i| moves[*i] == wanted).collect() };
        let parted = which(true);
        if parted.is_empty() {
            return PointCloud::default();
        }
        let gone = scan.hits.select(&parted);
        scan.hits = scan.hits.select(&which(false));
        gone
    }

    /// Compares a sensor's newest frame with what the map is sure of by so many looks, on whichever thread; none if it is not of that
    /// stamp.
    pub(crate) fn comparison(
        &self,
        (sensor, stamp): (&SensorId, Timestamp),
        params: &LiveParams,
        (t_map_odom, base_height_m): (Pose, f64),
        grid: OccupancyMap,
    ) -> Option<impl FnOnce(f32) -> Contradicted + Send + 'static> {
        let frame = Arc::clone(self.by_sensor.get(sensor)?.back()?);
        let params = *params;
        (frame.stamp == stamp && params.time_s > 0.0).then_some(move |looks| {
            grid.contradicted_by(&params, &frame.in_map(&t_map_odom, base_height_m, true), looks)
        })
    }

    /// Looks in a sensor's newest frame for what lies where the map says that nothing stands, on whichever thread; none if it is not
    /// of that stamp. What is farther away than `range_m` is left out. Not for planar scans: they have no heights.
    pub(crate) fn news(
        &self,
        (sensor, stamp): (&SensorId, Timestamp),
        (t_map_odom, base_height_m): (Pose, f64),
        grid: OccupancyMap,
        range_m: f64,
    ) -> Option<impl FnOnce() -> News + Send + 'static> {
        let frame = Arc::clone(self.by_sensor.get(sensor)?.back()?);
        (frame.stamp == stamp).then_some(move || {
            let LiveFrame { t_map_base, scan, .. } = frame.in_map(&t_map_odom, base_height_m, true);
            let top_z = t_map_base.translation.vector.z - scan.base_height_m + PASSING_M;
            let is_near = |p: &&Point3<f32>| {
                let is_in_reach = f64::from(p.coords.norm_squared()) < range_m * range_m;
                is_in_reach && (t_map_base * p.cast::<f64>()).z < top_z
            };
            let hits: Vec<Point3<f32>> = scan.hits.positions.iter().filter(is_near).copied().collect();
            let near = KeyframeScan {
                stamp: scan.stamp,
                sensor: scan.sensor.clone(),
                t_base_sensor: scan.t_base_sensor,
                base_height_m,
                hits: PointCloud::from_positions(hits),
                misses: vec![],
                planar: scan.planar,
                features: None,
            };
            let is_news = grid.is_news(&t_map_base, &near);
            let points = near.hits.positions.iter().zip(is_news).filter(|(_, is_news)| *is_news);
            let points = points.map(|(p, _)| (t_map_base * p.cast::<f64>()).cast()).collect();
            News { points, t_map_base, scan }
        })
    }

    /// What they see now.
    pub(crate) fn picture(&self, params: &LiveParams, t_map_odom: &Pose, base_height_m: f64) -> Live {
        let newest = self.by_sensor.values().filter_map(|f| f.back()).map(|f| f.stamp).max();
        let is_fresh = |f: &Arc<Frame>| newest.is_some_and(|now| now.seconds_since(f.stamp) <= params.time_s);
        let mut frames = vec![];
        for of_sensor in self.by_sensor.values().filter(|_| params.time_s > 0.0) {
            let fresh = of_sensor.iter().enumerate().filter(|(_, f)| is_fresh(f));
            frames.extend(fresh.map(|(i, f)| (Arc::clone(f), i + 1 == of_sensor.len())));
        }
        frames.sort_by_key(|(f, _)| f.stamp);
        Live(Arc::new(Picture {
            params: *params,
            frames,
            t_map_odom: *t_map_odom,
            base_height_m,
            grid: OnceLock::new(),
        }))
    }
}

/// What the newest frames saw at one moment; cloning costs a reference.
#[derive(Clone, Default)]
pub struct Live(Arc<Picture>);

#[derive(Default)]
struct Picture {
    params: LiveParams,
    /// Oldest first; whether each is its sensor's newest.
    frames: Vec<(Arc<Frame>, bool)>,
    t_map_odom: Pose,
    base_height_m: f64,
    grid: OnceLock<OccupancyMap>,
}

impl Live {
    /// The grid of the same moment with the newest frames laid over it: what they see in the way is occupied, what they see
    /// through is free. Worked out once. Work runs on the current rayon pool.
    pub(crate) fn over(&self, grid: &OccupancyMap) -> OccupancyMap {
        let picture = &*self.0;
        let laid_over = || {
            let frame = |(frame, is_newest): &(Arc<Frame>, bool)| {
                frame.in_map(&picture.t_map_odom, picture.base_height_m, *is_newest)
            };
            grid.under_frames(&picture.params, &picture.frames.iter().map(frame).collect::<Vec<_>>())
        };
        worked_out(&picture.grid, laid_over).clone()
    }

    /// Stamp of the newest frame in it, session's clock.
    pub fn stamp(&self) -> Option<Timestamp> {
        self.0.frames.last().map(|(f, _)| f.stamp)
    }
}

impl std::fmt::Debug for Live {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Live {{ frames: {} }}", self.0.frames.len())
    }
}
