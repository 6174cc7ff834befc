//! What was seen along some metres of the way, searched for with no guess in the map or a part of it.
//!
//! Rooms resemble each other, and one view of them all the more. So what stands upright along the way is laid over what
//! does in the map, seen from above ([`crate::matching::branch_and_bound`]); every place in which it fits nearly as
//! well as in the best one is looked at in space; what was seen on the way has to agree with each place, view by
//! view, and only if it does in the best one and in no other is that claimed.

use super::kept::Kept;
use super::submap::{range, voxel_for};
use super::target::{Refused, Target};
use super::walls;
use crate::loops::lost::{Around, CELL_M, MIN_SCORE, Strictness, WITNESSES, spread_out, way_m};
use crate::loops::{Evidence, Relocalisation};
use crate::matching::branch_and_bound::{Fit, Pyramid, RIVAL, Region};
use nalgebra::{Isometry2, Point2, Translation3, UnitQuaternion, Vector2, Vector3};
use percept_geometry::{KeyframeId, KeyframeScan, Pose, se3};
use std::collections::BTreeMap;

/// Places that may fit nearly alike: where there are more, they are not looked at. From above, walls of one view all around fit in up
/// to a dozen places of six simulated rooms (`percept eval slam --sensor lidar3d --scenario kidnap`), and in space in one: with 4, the
/// robot is found after 5 s in the median, with 12 or 24 after 0.4. Each takes some 10 ms. What sees less tells fewer apart.
const MAX_PLACES: usize = 24;
const MAX_PLACES_AHEAD: usize = 4;
/// Directions in which views have to have seen walls, as a share of a full turn, for a robot to be found where it stands: half a turn
/// is what the planar lidars of the recorded logs see, which are (`relocalisation LOG`). A rosette that sees 69 degrees ahead, found
/// where it stood, was in a wrong place in two of eight simulated kidnaps, and in one of them after the way below.
const ALL_AROUND: f64 = 0.5;
/// Else the way since the robot was lost before it is found, and the way whose views are searched for, usual ranges;
/// and the least and most of the first, metres. The first halved 43 and 104, the robot found after 5.3 s, doubled as it
/// is; the way that is searched for, and the bounds, halved and doubled as it is ([`super`]).
const FOUND_AFTER: f64 = 0.25;
const FOUND_AFTER_M: (f64, f64) = (1.0, 10.0);
const QUERY: f64 = 3.0;
/// Fewest points of a query. Halved and doubled as it is ([`super`]).
const FEWEST_POINTS: usize = 30;
/// What the newest view has to bring, and those before. Of the newest view the first at 0.7 and 1.2 times this, the
/// second halved and doubled, as it is, and of those before the same ([`super`]).
const NEWEST: Strictness = Strictness { min_inlier_ratio: 0.75, max_contradicted: 0.04 };
/// What is asked of views along which loops are looked for, or of which enough were taken since the robot was lost.
pub(super) const ALONG_THE_WAY: Wanted = Wanted { most: MAX_PLACES_AHEAD, best: NEWEST };
const WITNESS: Strictness = Strictness { min_inlier_ratio: 0.65, max_contradicted: 0.06 };
/// What a view has to bring where the robot is believed to be, by more than it: what drives in a street contradicts some 6 % of what is
/// known there (`given lidar-kitti-tracking-0000-more --outdoor`). As in the plane ([`super::super::planar`]).
const BELIEVED: Strictness = Strictness { min_inlier_ratio: 0.6, max_contradicted: 0.12 };

/// What a place has to bring to be the one.
#[derive(Debug, Clone, Copy)]
pub(super) struct Wanted {
    /// Places that may fit nearly alike from above.
    most: usize,
    /// What the newest view has to bring in the best one.
    best: Strictness,
}

/// What views from the way say that do not fit a place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Misfits {
    /// That it is not the place: enough where another one fits.
    Count,
    /// Nothing, unless they contradict what is known there: they may show what nobody has seen.
    MaySayNothing,
}

/// Views from some metres of the path, searched for together.
pub(super) struct Query<'a> {
    /// Oldest first, with base then seen from base now.
    before: &'a [(Pose, &'a KeyframeScan)],
    scan: &'a KeyframeScan,
    /// What turns base now level, its x axis kept; if that is not known, it is as level as the keyframe nearest to it.
    r_level_base: Option<UnitQuaternion<f64>>,
    usual_range: f64,
}

impl<'a> Query<'a> {
    pub(super) fn new(
        before: &'a [(Pose, &'a KeyframeScan)],
        scan: &'a KeyframeScan,
        r_level_base: Option<UnitQuaternion<f64>>,
    ) -> Self {
        let usual_range = before.iter().map(|(_, s)| range(s)).fold(range(scan), f64::max);
        Self { before, scan, r_level_base, usual_range }
    }

    /// What a lost robot is found by; none if it has seen too little: that resembles too many places.
    pub(super) fn wanted(&self) -> Option<Wanted> {
        let is_long = way_m(self.before) >= (FOUND_AFTER * self.usual_range).clamp(FOUND_AFTER_M.0, FOUND_AFTER_M.1);
        match (self.sees_all_around(), is_long) {
            (true, true) => Some(Wanted { most: MAX_PLACES, best: NEWEST }),
            (true, false) => Some(Wanted { most: MAX_PLACES, best: Strictness::ALONE }),
            (false, true) => Some(ALONG_THE_WAY),
            (false, false) => None,
        }
    }

    /// Whether walls were seen in enough directions from base, as it stood.
    fn sees_all_around(&self) -> bool {
        let mut seen = Around::default();
        self.near().any(|(t_level_then, scan)| {
            let yaw = se3::yaw(&t_level_then);
            for p in walls::of(scan, &walls::leveling(&t_level_then)) {
                seen.add(f64::from(p.y.atan2(p.x)) + yaw);
            }
            seen.covers(ALL_AROUND)
        })
    }

    /// The views that are searched for, now first, then newest first, with base then seen from base now, levelled.
    fn near(&self) -> impl Iterator<Item = (Pose, &KeyframeScan)> {
        let r_level_base = self.r_level_base.unwrap_or_default();
        let far = QUERY * self.usual_range;
        let before = self.before.iter().rev().filter(move |(t, _)| t.translation.vector.norm() < far);
        let views = std::iter::once((Pose::identity(), self.scan)).chain(before.map(|(t, scan)| (*t, *scan)));
        views.map(move |(t, scan)| (r_level_base * t, scan))
    }

    /// The only place among the known keyframes (base to map) where all of it fits, base now turned from the direction
    /// `heading.0` by `heading.1` at most, radians.
    pub(super) fn find(
        &self,
        kept: &BTreeMap<KeyframeId, Kept>,
        known: &BTreeMap<KeyframeId, Pose>,
        heading: (f64, f64),
        wanted: &Wanted,
    ) -> Option<Relocalisation> {
        // Lengths are told to the search in its cells: one is a voxel.
        let scale = CELL_M / voxel_for(self.usual_range);
        let walls = known.iter().filter_map(|(id, t)| Some((t, &kept.get(id)?.walls)));
        let of_map: Vec<_> = walls.flat_map(|(t, w)| above(t, w).map(|p| p * scale).collect::<Vec<_>>()).collect();
        let query = self.query(scale);
        if query.len() < FEWEST_POINTS {
            return None;
        }
        let pyramid = Pyramid::new(CELL_M, &of_map)?;
        let everywhere = pyramid.everywhere();
        let center = Isometry2::new(everywhere.center.translation.vector, heading.0);
        let region = Region { center, rotation: heading.1, ..everywhere };
        let places = pyramid.optima(&query, &region, MIN_SCORE, (RIVAL, wanted.most));
        let mut places = places?.into_iter();
        let known = (kept, known);
        let best = self.verify(&places.next()?, scale, known, (&wanted.best, Misfits::MaySayNothing))?;
        let is_another = |fit: Fit| self.verify(&fit, scale, known, (&NEWEST, Misfits::Count)).is_some();
        (!places.any(is_another)).then_some(best)
    }

    /// What stands upright along the newest part of the way, from above, base now level.
    fn query(&self, scale: f64) -> Vec<Point2<f64>> {
        let walls = |(t, scan): (Pose, &KeyframeScan)| {
            above(&t, &walls::of(scan, &walls::leveling(&t))).map(|p| p * scale).collect::<Vec<_>>()
        };
        spread_out(self.near().flat_map(walls))
    }

    /// What the newest view measures at a place, if what was seen on the way agrees.
    fn verify(
        &self,
        fit: &Fit,
        scale: f64,
        (kept, poses): (&BTreeMap<KeyframeId, Kept>, &BTreeMap<KeyframeId, Pose>),
        (newest, misfits): (&Strictness, Misfits),
    ) -> Option<Relocalisation> {
        let guess = self.upright(fit, scale, poses)?;
        let witnesses: Vec<&(Pose, &KeyframeScan)> =
            self.before.iter().step_by(self.before.len().div_ceil(WITNESSES).max(1)).collect();
        let places: Vec<Pose> = std::iter::once(guess).chain(witnesses.iter().map(|(t, _)| guess * t)).collect();
        let around = Target::new(kept, poses, &places);
        let found = around.measure(self.scan, &guess, newest).ok()?;
        let (mut agree, mut against) = (0, 0);
        for (t_now_then, scan) in witnesses {
            match around.measure(scan, &(found.t_odom_base * t_now_then), &WITNESS) {
                Ok(_) => agree += 1,
                Err(Refused::Contradicted) => return None,
                // A view that leaves something open says nothing.
                Err(Refused::Open) => {}
                Err(Refused::Misfit) => {
                    let t_map_then = found.t_odom_base * t_now_then;
                    let counts = misfits == Misfits::Count || around.contradicts(scan, &t_map_then, &WITNESS);
                    against += usize::from(counts);
                }
            }
        }
        let (keyframe, t_keyframe_base) = around.seen_from(&found.t_odom_base)?;
        (3 * against <= agree).then_some(Relocalisation {
            keyframe,
            t_keyframe_base,
            covariance: found.covariance,
            inlier_ratio: found.inlier_ratio,
        })
    }

    /// The pose in space of a fit: as high as the nearest keyframe.
    fn upright(&self, fit: &Fit, scale: f64, poses: &BTreeMap<KeyframeId, Pose>) -> Option<Pose> {
        let at = fit.t.translation.vector / scale;
        let distance = |t: &Pose| (t.translation.vector.xy() - at).norm();
        let nearest = poses.values().min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), fit.t.rotation.angle());
        let leveling = self.r_level_base.unwrap_or_else(|| walls::leveling(nearest));
        Some(Pose::from_parts(Translation3::new(at.x, at.y, nearest.translation.z), turn * leveling))
    }
}

/// The views of the newest part of the way, as long as the lidar usually sees; none if that is most of it.
pub(super) fn newest_part<'a, 'b>(
    before: &'a [(Pose, &'b KeyframeScan)],
    scan: &KeyframeScan,
) -> Option<&'a [(Pose, &'b KeyframeScan)]> {
    let part_m = before.iter().map(|(_, s)| range(s)).fold(range(scan), f64::max);
    if way_m(before) < 2.0 * part_m {
        return None;
    }
    let is_old = |k: usize| way_m(&before[k..]) > part_m;
    let old = (0..before.len()).collect::<Vec<_>>().partition_point(|k| is_old(*k));
    Some(&before[old..])
}

/// What a scan says of where it is believed to have been taken, base to map.
pub(super) fn check(
    scan: &KeyframeScan,
    t_map_base: &Pose,
    kept: &BTreeMap<KeyframeId, Kept>,
    poses: &BTreeMap<KeyframeId, Pose>,
) -> Evidence {
    let around = Target::new(kept, poses, &[*t_map_base]);
    match around.measure(scan, t_map_base, &BELIEVED) {
        Ok(found) => around.seen_from(&found.t_odom_base).map_or(Evidence::Nothing, |(keyframe, t_keyframe_base)| {
            Evidence::Agrees(Relocalisation {
                keyframe,
                t_keyframe_base,
                covariance: found.covariance,
                inlier_ratio: found.inlier_ratio,
            })
        }),
        Err(Refused::Contradicted) => Evidence::Contradicts,
        Err(Refused::Misfit) if around.contradicts(scan, t_map_base, &BELIEVED) => Evidence::Contradicts,
        Err(Refused::Open | Refused::Misfit) => Evidence::Nothing,
    }
}

/// Walls of a levelled base from above, in the frame of its pose.
fn above<'a>(t: &Pose, walls: &'a [Point2<f32>]) -> impl Iterator<Item = Point2<f64>> + 'a {
    let t = Isometry2::new(Vector2::new(t.translation.x, t.translation.y), se3::yaw(t));
    walls.iter().map(move |p| t * p.cast::<f64>())
}
