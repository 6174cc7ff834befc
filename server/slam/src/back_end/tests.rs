//! A drive on a circle with made loops, true and false.

use super::*;
use crate::loops::LoopClosure;
use crate::odometry::OdometryKind;
use percept_geometry::{KeptScan, PointCloud, SensorId, Timestamp};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

/// Answers with what was written down for a keyframe, and notes how well each one's place was known, metres.
#[derive(Default)]
struct Script {
    loops: BTreeMap<u64, Vec<LoopClosure>>,
    asked: Arc<Mutex<BTreeMap<u64, f64>>>,
}

impl PlaceRecognition for Script {
    fn memory_bytes(&self) -> usize {
        0
    }

    fn restore(&mut self, _: KeyframeId, _: &KeptScan, _: &Covariance6, _: &KeyframePoses, _: &[KeyframeId]) {}

    fn insert(&mut self, id: KeyframeId, _: &KeptScan, drift: &Covariance6, _: &KeyframePoses) -> Vec<LoopClosure> {
        self.asked.lock().unwrap().insert(id.0, drift[(0, 0)].max(drift[(1, 1)]).sqrt());
        self.loops.remove(&id.0).unwrap_or_default()
    }

    fn relocalise(&self, _: &KeyframeScan, _: &KeyframePoses) -> Option<Relocalisation> {
        None
    }

    fn check(&mut self, _: &KeyframeScan, _: &Pose, _: &KeyframePoses) -> Evidence {
        Evidence::Nothing
    }

    fn forget(&mut self, _: KeyframeId) {}
}

const ROUND: u64 = 80;
const SIGMA: f64 = 0.01;

/// Poses of two and a half rounds, half a metre apart.
fn truth() -> Vec<Pose> {
    circle(ROUND * 5 / 2)
}

fn circle(keyframes: u64) -> Vec<Pose> {
    let turn = std::f64::consts::TAU / ROUND as f64;
    let step = se3::from_xy_yaw(0.5, 0.0, turn);
    let mut poses = vec![Pose::identity()];
    for _ in 1..keyframes {
        poses.push(poses[poses.len() - 1] * step);
    }
    poses
}

fn noise(rng: &mut ChaCha8Rng, sigma_t: f64, sigma_r: f64) -> Pose {
    let mut one = |s: f64| s * (rng.random::<f64>() + rng.random::<f64>() + rng.random::<f64>() - 1.5) * 2.0;
    se3::from_xy_yaw(one(sigma_t), one(sigma_t), one(sigma_r))
}

fn measured(from: u64, to: u64, t_from_to: Pose) -> LoopClosure {
    let covariance = Covariance6::identity() * SIGMA * SIGMA;
    LoopClosure { from: KeyframeId(from), to: KeyframeId(to), t_from_to, covariance, inlier_ratio: 0.9 }
}

fn true_loop(rng: &mut ChaCha8Rng, truth: &[Pose], from: u64, to: u64) -> LoopClosure {
    let t_from_to = truth[from as usize].inverse() * truth[to as usize] * noise(rng, SIGMA, SIGMA);
    measured(from, to, t_from_to)
}

fn scan() -> Arc<KeyframeScan> {
    Arc::new(KeyframeScan {
        stamp: Timestamp(0),
        sensor: SensorId("lidar".to_owned()),
        t_base_sensor: Pose::identity(),
        base_height_m: 0.0,
        hits: PointCloud::default(),
        misses: vec![],
        planar: true,
        features: None,
    })
}

/// Drives with odometry that turns a little too far; the back end, and where the map has the keyframes.
fn drive(rng: &mut ChaCha8Rng, loops: BTreeMap<u64, Vec<LoopClosure>>) -> (BackEnd, Vec<Pose>) {
    drive_along(rng, &truth(), Box::new(Script { loops, ..Script::default() }))
}

fn drive_along(rng: &mut ChaCha8Rng, truth: &[Pose], recognition: Box<dyn PlaceRecognition>) -> (BackEnd, Vec<Pose>) {
    let scan = scan();
    let mut back_end = BackEnd::new(BackEndParams::default(), OdometryNoise::of(OdometryKind::Lidar2d), recognition);
    let mut merged: BTreeMap<KeyframeId, MergedKeyframe> = BTreeMap::new();
    let mut told: BTreeMap<LoopId, Loop> = BTreeMap::new();
    let (mut t_odom_base, mut t_map_odom) = (Pose::identity(), Pose::identity());
    let mut map: Vec<Pose> = vec![];
    for k in 0..truth.len() {
        if k > 0 {
            let drift = se3::from_xy_yaw(0.0, 0.0, 0.001);
            t_odom_base *= truth[k - 1].inverse() * truth[k] * drift * noise(rng, 0.002, 0.0005);
        }
        let covariance = Covariance6::identity() * 1e-6 * k as f64;
        let id = KeyframeId(k as u64);
        map.push(t_map_odom * t_odom_base);
        let keyframe = BackEndKeyframe {
            id,
            t_map_base: map[k],
            t_odom_base,
            covariance,
            scan: (&scan).into(),
            recognise: true,
            after_gap: false,
            constraint: None,
        };
        let update = back_end.insert(&keyframe);
        if let Some(t_given_odom) = update.t_map_odom {
            t_map_odom = t_given_odom;
        }
        for (id, t_map_base) in update.correction.into_iter().flat_map(|c| c.t_map_base) {
            map[id.0 as usize] = t_map_base;
        }
        merged.extend(update.merged.iter().map(|m| (m.id, *m)));
        told.extend(update.loops.into_iter().map(|l| (l.id, l)));
        told.retain(|id, _| !update.dissolved.contains(id));
        let off = map[k].inv_mul(&(t_map_odom * t_odom_base));
        let off = off.translation.vector.norm() + off.rotation.angle();
        assert!(off < 1e-6, "odom and the newest keyframe move together, but for rounding: {k}: {off}");
    }
    let settled = back_end.settle();
    told.extend(settled.loops.into_iter().map(|l| (l.id, l)));
    // Whoever stores what was told has all there is.
    assert!(told.values().eq(back_end.loops()));
    for (id, t_map_base) in settled.correction.into_iter().flat_map(|c| c.t_map_base) {
        map[id.0 as usize] = t_map_base;
    }
    // The newest first: what a keyframe merged into may have merged, too.
    for m in merged.values().rev() {
        map[m.id.0 as usize] = map[m.into.0 as usize] * m.t_into_base;
    }
    (back_end, map)
}

/// Root mean square of the distances from the truth, metres; the first keyframe is at the origin of both.
fn rmse(map: &[Pose]) -> f64 {
    let squares = map
        .iter()
        .zip(circle(map.len() as u64))
        .map(|(a, b)| (a.translation.vector - b.translation.vector).norm_squared());
    (squares.sum::<f64>() / map.len() as f64).sqrt()
}

fn true_loops(rng: &mut ChaCha8Rng) -> BTreeMap<u64, Vec<LoopClosure>> {
    let truth = truth();
    (ROUND..truth.len() as u64).step_by(3).map(|k| (k, vec![true_loop(rng, &truth, k - ROUND, k)])).collect()
}

#[test]
fn loops_take_the_drift_out_of_the_map() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let (_, without) = drive(&mut rng, BTreeMap::new());
    let loops = true_loops(&mut rng);
    let (back_end, with) = drive(&mut rng, loops);
    assert!(rmse(&without) > 0.3 && rmse(&with) < 0.08, "{} {}", rmse(&without), rmse(&with));
    assert!(back_end.loops().iter().all(|l| l.state == LoopState::Active));
}

#[test]
fn a_hundred_runs_with_false_loops_keep_none_of_them() {
    let truth = truth();
    for seed in 0..100 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut loops = true_loops(&mut rng);
        let (_, undisturbed) = drive(&mut ChaCha8Rng::seed_from_u64(1000 + seed), loops.clone());
        let mut is_false = std::collections::BTreeSet::new();
        for _ in 0..60 {
            let (from, to) = (rng.random_range(0..100u64), rng.random_range(120..truth.len() as u64));
            let turn = rng.random_range(-3.0..3.0);
            let t_from_to = se3::from_xy_yaw(rng.random_range(-3.0..3.0), rng.random_range(-3.0..3.0), turn);
            let off = se3::log(&(t_from_to.inverse() * truth[from as usize].inverse() * truth[to as usize]));
            if off.norm() > 0.5 && to - from != ROUND {
                is_false.insert((from, to));
                loops.entry(to).or_default().push(measured(from, to, t_from_to));
            }
        }
        let (back_end, map) = drive(&mut ChaCha8Rng::seed_from_u64(1000 + seed), loops);
        let kept = |l: &&Loop| l.state == LoopState::Active && is_false.contains(&(l.closure.from.0, l.closure.to.0));
        let kept: Vec<_> =
            back_end.loops().iter().filter(kept).map(|l| (l, back_end.misfit(l.id.0 as usize))).collect();
        assert!(kept.is_empty(), "seed {seed}: {kept:?}");
        let (with, without) = (rmse(&map), rmse(&undisturbed));
        assert!(with < 0.005 + 1.2 * without, "seed {seed}: {with} {without}");
    }
}

#[test]
fn a_false_loop_alone_moves_nothing() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let (_, without) = drive(&mut rng.clone(), BTreeMap::new());
    let wrong = BTreeMap::from([(120, vec![measured(3, 120, se3::from_xy_yaw(0.2, 0.1, 0.0))])]);
    let (back_end, with) = drive(&mut rng, wrong);
    assert_eq!(back_end.loops()[0].state, LoopState::Rejected);
    assert_eq!(with, without);
}

#[test]
fn a_veto_takes_loops_out_and_is_undone() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let (_, without) = drive(&mut rng.clone(), BTreeMap::new());
    let mut made = rng.clone();
    let (mut back_end, with) = drive(&mut rng, true_loops(&mut made));
    let ids: Vec<LoopId> = back_end.loops().iter().map(|l| l.id).collect();
    for &id in &ids {
        assert!(back_end.veto(id, true).is_some());
    }
    let far = |a: &Pose, b: &Pose| (a.translation.vector - b.translation.vector).norm();
    assert!(back_end.poses().values().zip(&without).all(|(a, b)| far(a, b) < 1e-6));
    for &id in &ids {
        assert!(back_end.veto(id, false).is_some());
    }
    assert!(back_end.poses().values().zip(&with).all(|(a, b)| far(a, b) < 0.01));
    assert!(back_end.veto(LoopId(10_000), true).is_none());
}

#[test]
fn what_is_known_of_the_newest_pose_grows_by_drift_and_shrinks_by_loops() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let (without, _) = drive(&mut rng, BTreeMap::new());
    let loops = true_loops(&mut rng);
    let (with, _) = drive(&mut rng, loops);
    let sigma = |b: &BackEnd| (b.drift()[(0, 0)] + b.drift()[(1, 1)]).sqrt();
    assert!(sigma(&with) < 0.5 * sigma(&without), "{} {}", sigma(&with), sigma(&without));
}

/// Measures every third keyframe from the newest one of a round ago or more that stands there.
struct Rounds {
    rng: ChaCha8Rng,
    truth: Vec<Pose>,
    known: std::collections::BTreeSet<u64>,
}

impl PlaceRecognition for Rounds {
    fn memory_bytes(&self) -> usize {
        0
    }

    fn restore(&mut self, _: KeyframeId, _: &KeptScan, _: &Covariance6, _: &KeyframePoses, _: &[KeyframeId]) {}

    fn insert(&mut self, id: KeyframeId, _: &KeptScan, _: &Covariance6, _: &KeyframePoses) -> Vec<LoopClosure> {
        self.known.insert(id.0);
        let to = id.0;
        let old = self.known.iter().rev().copied().find(|k| k + ROUND <= to && (to - k).is_multiple_of(ROUND));
        let old = old.filter(|_| to.is_multiple_of(3));
        old.map(|from| true_loop(&mut self.rng, &self.truth, from, to)).into_iter().collect()
    }

    fn relocalise(&self, _: &KeyframeScan, _: &KeyframePoses) -> Option<Relocalisation> {
        None
    }

    fn check(&mut self, _: &KeyframeScan, _: &Pose, _: &KeyframePoses) -> Evidence {
        Evidence::Nothing
    }

    fn forget(&mut self, id: KeyframeId) {
        assert!(self.known.remove(&id.0), "forgotten twice: {id:?}");
    }
}

#[test]
fn a_robot_that_stays_needs_no_more_keyframes_and_its_map_stays_true() {
    let truth = circle(16 * ROUND);
    let rounds = |seed| {
        let (rng, known) = (ChaCha8Rng::seed_from_u64(seed), Default::default());
        Box::new(Rounds { rng, truth: truth.clone(), known })
    };
    let (back_end, map) = drive_along(&mut ChaCha8Rng::seed_from_u64(6), &truth, rounds(7));
    assert!(back_end.poses().len() < 2 * culling::FEWEST, "{} keyframes", back_end.poses().len());
    assert!(back_end.loops().len() < 4 * back_end.poses().len(), "{} loops", back_end.loops().len());
    assert!(rmse(&map) < 0.2, "{}", rmse(&map));
    let newest = &map[map.len() - 100..];
    let worst = newest.iter().zip(&truth[map.len() - 100..]);
    let worst = worst.map(|(a, b)| (a.translation.vector - b.translation.vector).norm()).fold(0.0, f64::max);
    // As without merging: what came last is measured least.
    assert!(worst < 0.25, "{worst}");
    let ids: Vec<_> = back_end.loops().iter().map(|l| l.id).collect();
    assert!(ids.is_sorted());
    assert_eq!(map, drive_along(&mut ChaCha8Rng::seed_from_u64(6), &truth, rounds(7)).1);
}

#[test]
fn a_group_that_contradicts_what_is_believed_takes_nothing_of_it_along() {
    for seed in 0..20 {
        let mut rng = ChaCha8Rng::seed_from_u64(100 + seed);
        let truth = truth();
        let mut loops = true_loops(&mut rng);
        let true_ones = loops.clone();
        let is_true: std::collections::BTreeSet<u64> = loops.keys().copied().collect();
        // Rooms that resemble each other: four keyframes say the same, half a metre and more off.
        let t_wrong =
            se3::from_xy_yaw(rng.random_range(0.5..3.0), rng.random_range(-2.0..2.0), rng.random_range(-0.5..0.5));
        let first = rng.random_range(150..190u64);
        for to in (first..first + 12).filter(|k| !is_true.contains(k)).take(6) {
            let from = to - ROUND;
            let t_from_to =
                truth[from as usize].inverse() * truth[to as usize] * t_wrong * noise(&mut rng, SIGMA, SIGMA);
            loops.entry(to).or_default().push(measured(from, to, t_from_to));
        }
        let (_, undisturbed) = drive(&mut ChaCha8Rng::seed_from_u64(200 + seed), true_ones);
        let (back_end, map) = drive(&mut ChaCha8Rng::seed_from_u64(200 + seed), loops);
        let mut waiting = 0;
        for l in back_end.loops() {
            let right = is_true.contains(&l.closure.to.0);
            let is_decided_right = if right { l.state != LoopState::Rejected } else { l.state != LoopState::Active };
            assert!(is_decided_right, "seed {seed}: {} to {}", l.closure.from.0, l.closure.to.0);
            waiting += usize::from(right && l.state == LoopState::Pending);
        }
        // One that is off by four standard deviations may wait for others.
        assert!(waiting <= 1, "seed {seed}: {waiting}");
        let (with, without) = (rmse(&map), rmse(&undisturbed));
        assert!(with < 0.005 + 1.2 * without, "seed {seed}: {with} {without}");
    }
}

#[test]
fn a_gap_stays_one_after_a_restart() {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let truth = truth();
    let scan = scan();
    let gap = 100;
    // Carried while nothing was seen: odometry guesses on, metres off, and loops say where the robot is.
    let t_guess = se3::from_xy_yaw(4.0, -3.0, 0.8);
    let at = |k: usize| if k < gap { truth[k] } else { truth[gap - 1] * t_guess * truth[gap - 1].inverse() * truth[k] };
    let node = |k: usize| BackEndKeyframe {
        id: KeyframeId(k as u64),
        t_map_base: truth[k],
        t_odom_base: at(k),
        covariance: Covariance6::identity() * 1e-6 * k as f64,
        scan: (&scan).into(),
        recognise: true,
        after_gap: k == gap,
        constraint: None,
    };
    let loops = (gap..truth.len()).step_by(4).enumerate().map(|(i, k)| Loop {
        id: LoopId(i as u64),
        closure: true_loop(&mut rng, &truth, k as u64 - ROUND, k as u64),
        state: LoopState::Active,
    });
    let loops: Vec<Loop> = loops.collect();
    let mut back_end =
        BackEnd::new(BackEndParams::default(), OdometryNoise::of(OdometryKind::Lidar2d), Box::new(Script::default()));
    let next = loops.len() as u64;
    back_end.resume((0..truth.len()).map(node), loops.clone(), next + 5);
    let vetoed = back_end.veto(LoopId(3), true).unwrap();
    assert!(vetoed.loops.iter().all(|l| l.id == LoopId(3)), "others go with it");
    let off = back_end.poses().values().zip(&truth).map(|(a, b)| (a.translation.vector - b.translation.vector).norm());
    assert!(off.fold(0.0, f64::max) < 0.1);
    // Undone, it is what it was; and a number is not given twice.
    assert_eq!(back_end.veto(LoopId(3), false).unwrap().loops[0].state, LoopState::Active);
    let (last, new) = (truth.len() - 1, truth.len() as u64);
    let constraint = Some(measured(50, new, truth[50].inverse() * truth[last]));
    let again = back_end.insert(&BackEndKeyframe { id: KeyframeId(new), constraint, ..node(last) });
    assert_eq!(again.loops[0].id, LoopId(next + 5));
}

#[test]
fn after_a_gap_one_measurement_tells_where_places_are_to_be_looked_for() {
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let (truth, scan, gap) = (truth(), scan(), 100);
    let constraint = true_loop(&mut rng, &truth, 20, gap);
    // Told with the keyframe itself where a lost robot was found, or found by place recognition just after the gap.
    for (constraint, found) in
        [(Some(constraint.clone()), BTreeMap::new()), (None, BTreeMap::from([(gap, vec![constraint])]))]
    {
        let recognition = Script { loops: found, ..Script::default() };
        let asked = Arc::clone(&recognition.asked);
        let (first, is_told) = (if constraint.is_some() { gap } else { gap + 1 }, constraint.is_some());
        let mut back_end =
            BackEnd::new(BackEndParams::default(), OdometryNoise::of(OdometryKind::Lidar2d), Box::new(recognition));
        for k in 0..gap + 3 {
            let keyframe = BackEndKeyframe {
                id: KeyframeId(k),
                t_map_base: truth[k as usize],
                t_odom_base: truth[k as usize],
                covariance: Covariance6::identity() * 1e-6 * k as f64,
                scan: (&scan).into(),
                recognise: true,
                after_gap: k == gap,
                constraint: constraint.clone().filter(|_| k == gap),
            };
            back_end.insert(&keyframe);
        }
        let asked = asked.lock().unwrap();
        assert_eq!(is_told, asked[&gap] < 0.1, "{asked:?}");
        assert!((first..gap + 3).all(|k| asked[&k] < 0.1), "{asked:?}");
    }
}
