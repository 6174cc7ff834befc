//! A made scene, cut and moved: the truth is exact.

use super::*;
use nalgebra::{Point3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Boxes of many sizes on a floor, sampled on their faces.
fn scene(seed: u64) -> Vec<Point3<f32>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut out = Vec::new();
    for _ in 0..25 {
        let at = Vector3::new(rng.random_range(-4.0..4.0), rng.random_range(-4.0..4.0), 0.0);
        let size = Vector3::from_fn(|_, _| rng.random_range(0.2..1.6f32));
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), rng.random_range(0.0..3.0f32));
        for _ in 0..700 {
            let mut p = Vector3::from_fn(|i, _| rng.random_range(0.0..size[i]));
            let face = rng.random_range(0..3);
            p[face] = if rng.random_range(0..2) == 0 { 0.0 } else { size[face] };
            out.push(Point3::from(turn * p + at));
        }
    }
    for _ in 0..6000 {
        out.push(Point3::new(rng.random_range(-5.0..5.0), rng.random_range(-5.0..5.0), 0.0));
    }
    out
}

fn cut(points: &[Point3<f32>], keep: impl Fn(&Point3<f32>) -> bool, t: &Pose, seed: u64) -> PointCloud {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut noisy = |p: &Point3<f32>| p + Vector3::from_fn(|_, _| rng.random_range(-0.01..0.01f32));
    let kept: Vec<_> = points.iter().filter(|p| keep(p)).map(&mut noisy).collect();
    PointCloud::from_positions(kept).transformed(t)
}

fn moved() -> Pose {
    Pose::from_parts(Vector3::new(3.0, -7.0, 2.0).into(), UnitQuaternion::from_euler_angles(2.0, -0.8, 1.5))
}

#[test]
fn parts_of_a_scene_that_overlap_by_half_are_laid_over_each_other_from_anywhere() {
    let points = scene(1);
    let target = cut(&points, |p| p.x < 1.5, &Pose::identity(), 2);
    let source = cut(&points, |p| p.x > -1.5, &moved(), 3);
    for method in [GlobalMethod::Consistency, GlobalMethod::Ransac] {
        let params = GlobalParams { voxel_size_m: 0.1, method, ..GlobalParams::default() };
        let found = register_global(&source, &target, &params).unwrap();
        let off = found.t_target_source * moved();
        assert!(off.translation.vector.norm() < 0.05 && off.rotation.angle() < 0.02, "{method:?} {off} {found:?}");
        assert_eq!(found, register_global(&source, &target, &params).unwrap());
    }
}

#[test]
fn scenes_that_have_nothing_in_common_are_not_said_to_match() {
    for seed in 10..14 {
        let target = cut(&scene(seed), |_| true, &Pose::identity(), 2);
        let source = cut(&scene(seed + 100), |_| true, &moved(), 3);
        let params = GlobalParams { voxel_size_m: 0.1, ..GlobalParams::default() };
        let found = register_global(&source, &target, &params).unwrap();
        assert_ne!(found.outcome, GlobalOutcome::Found, "{found:?}");
    }
}

/// A road between two walls with boxes along it: points of both, evenly spread, x along the road.
fn street(seed: u64, num_boxes: usize) -> Vec<Point3<f32>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut out = Vec::new();
    for _ in 0..60_000 {
        out.push(Point3::new(rng.random_range(0.0..100.0), rng.random_range(-7.0..7.0), 0.0));
        let side = if rng.random_range(0..2) == 0 { -7.0 } else { 7.0 };
        out.push(Point3::new(rng.random_range(0.0..100.0), side, rng.random_range(0.0..8.0)));
    }
    for _ in 0..num_boxes {
        let at = Vector3::new(rng.random_range(0.0..100.0), rng.random_range(-6.5..5.0f32), 0.0);
        let size = Vector3::new(rng.random_range(0.4..5.0), rng.random_range(0.4..1.5), rng.random_range(1.0..3.0f32));
        for _ in 0..(120.0 * size.x.max(1.0)) as usize {
            let mut p = Vector3::from_fn(|i, _| rng.random_range(0.0..size[i]));
            let face = rng.random_range(0..3);
            p[face] = if rng.random_range(0..2) == 0 { 0.0 } else { size[face] };
            out.push(Point3::from(p + at));
        }
    }
    out
}

/// Two stretches of 55 m of a street of 100 m: a tenth of it in common.
fn stretches(points: &[Point3<f32>], seed: u64) -> (PointCloud, PointCloud) {
    let target = cut(points, |p| p.x < 55.0, &Pose::identity(), seed);
    (cut(points, |p| p.x > 45.0, &moved(), seed + 1), target)
}

#[test]
fn stretches_of_a_street_are_not_said_to_be_found_where_they_only_slid_along_its_walls() {
    for seed in 0..6 {
        let (source, target) = stretches(&street(seed, 12), seed);
        let params = GlobalParams { voxel_size_m: 0.5, ..GlobalParams::default() };
        let found = register_global(&source, &target, &params).unwrap();
        let off = found.t_target_source * moved();
        let right = off.translation.vector.norm() < 0.5 && off.rotation.angle() < 0.03;
        assert!(right || found.outcome != GlobalOutcome::Found, "{seed}: {off} {found:?}");
    }
}

#[test]
fn two_bare_walls_and_a_road_do_not_say_where_along_them() {
    let (source, target) = stretches(&street(1, 0), 1);
    let params = GlobalParams { voxel_size_m: 0.5, ..GlobalParams::default() };
    let found = register_global(&source, &target, &params).unwrap();
    assert_ne!(found.outcome, GlobalOutcome::Found, "{found:?}");
    let (source, target) = (described(&source), described(&target));
    let evidence = evidence::Evidence::new(&source, &target, 0.5);
    assert!(evidence.compare(&moved().inverse()).of.log_ratio < 5.0);
}

fn described(cloud: &PointCloud) -> Described {
    let params = GlobalParams { voxel_size_m: 0.5, ..GlobalParams::default() };
    Described::new("source", cloud, &params).unwrap()
}

#[test]
fn what_one_cloud_saw_where_the_other_saw_something_else_speaks_against_a_motion() {
    let points = street(3, 40);
    let target = described(&cut(&points, |p| p.x < 70.0, &Pose::identity(), 1));
    let source = described(&cut(&points, |p| p.x > 30.0, &Pose::identity(), 2));
    let evidence = evidence::Evidence::new(&source, &target, 0.5);
    let slid = |s: f64| evidence.compare(&Pose::translation(s, 0.0, 0.0)).of.log_ratio;
    assert!(slid(0.0) > 25.0, "{}", slid(0.0));
    for s in [-30.0, -12.0, -7.0, 7.0, 12.0] {
        assert!(slid(s) < 0.0, "{s}: {}", slid(s));
    }
}

/// Boxes of so many sizes between two corners, by their surfaces.
fn boxes(seed: u64, num: usize, low: Vector3<f32>, high: Vector3<f32>) -> Vec<Point3<f32>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut out = Vec::new();
    for _ in 0..num {
        let size = Vector3::from_fn(|_, _| rng.random_range(0.6..1.8f32));
        let at = Vector3::from_fn(|k, _| rng.random_range(low[k]..high[k] - size[k]));
        for _ in 0..600 {
            let mut p = Vector3::from_fn(|k, _| rng.random_range(0.0..size[k]));
            let face = rng.random_range(0..3);
            p[face] = if rng.random_range(0..2) == 0 { 0.0 } else { size[face] };
            out.push(Point3::from(p + at));
        }
    }
    out
}

#[test]
fn that_one_thing_is_in_both_clouds_is_no_proof_of_one_place() {
    // Such as the same model of a car, in two streets that show nothing else of each other.
    let thing = boxes(5, 14, Vector3::new(0.5, 0.5, 0.5), Vector3::new(7.5, 7.5, 4.0));
    let beside = |seed, x: f32| boxes(seed, 30, Vector3::new(x, -20.0, 0.5), Vector3::new(x + 30.0, 20.0, 4.0));
    let (here, there) = ([thing.clone(), beside(6, -50.0)].concat(), [thing, beside(7, 30.0)].concat());
    let whole = |points: &[Point3<f32>], seed| described(&cut(points, |_| true, &Pose::identity(), seed));
    let of = |source: &[Point3<f32>], target: &[Point3<f32>]| {
        let evidence = evidence::Evidence::new(&whole(source, 1), &whole(target, 2), 0.5);
        evidence.compare(&Pose::identity()).of
    };
    let shared = of(&here, &there);
    assert!(shared.log_ratio > 25.0 && shared.evidence < 12.0, "{shared:?}");
    let same = of(&here, &here);
    assert!(same.evidence > 60.0, "{same:?}");
}

#[test]
fn the_covariance_tells_of_surfaces_that_err_as_a_whole() {
    // Every box of the source is off by its own 2 cm: a few times what independent points would let one expect.
    let params = GlobalParams { voxel_size_m: 0.1, ..GlobalParams::default() };
    let (mut squares, mut count) = (0.0, 0.0);
    for seed in 0..8 {
        let points = scene(seed);
        let mut rng = ChaCha8Rng::seed_from_u64(seed + 50);
        let mut offset = |_| Vector3::from_fn(|_, _| rng.random_range(-0.035..0.035f32));
        let offsets: Vec<Vector3<f32>> = (0..25).map(&mut offset).collect();
        let bent: Vec<Point3<f32>> = points
            .iter()
            .enumerate()
            .map(|(i, p)| p + offsets.get(i / 700).copied().unwrap_or_else(Vector3::zeros))
            .collect();
        let target = cut(&points, |_| true, &Pose::identity(), 2);
        let source = cut(&bent, |_| true, &Pose::identity(), 3);
        let found = register_global(&source, &target, &params).unwrap();
        assert_eq!(found.outcome, GlobalOutcome::Found);
        let off = found.t_target_source.translation.vector;
        for k in 0..2 {
            squares += off[k] * off[k] / found.covariance[(k, k)];
            count += 1.0;
        }
    }
    let sigmas = (squares / count).sqrt();
    // Boxes that lie in one block are taken to err alike, and do not.
    assert!((0.2..3.0).contains(&sigmas), "{sigmas}");
}

#[test]
fn degenerate_clouds_are_answered() {
    let params = GlobalParams { voxel_size_m: 0.1, ..GlobalParams::default() };
    let cloud = |points: Vec<Point3<f32>>| PointCloud::from_positions(points);
    let line = cloud((0..500).map(|i| Point3::new(i as f32 * 0.1, 0.0, 0.0)).collect());
    let plane = cloud((0..2500).map(|i| Point3::new((i % 50) as f32 * 0.1, (i / 50) as f32 * 0.1, 0.0)).collect());
    for (a, b) in [(&line, &line), (&line, &plane)] {
        let found = register_global(a, b, &params).unwrap();
        assert_ne!(found.outcome, GlobalOutcome::Found, "{found:?}");
    }
    let equal = cloud(vec![Point3::origin(); 100]);
    assert!(matches!(
        register_global(&equal, &plane, &params),
        Err(RegistrationError::TooFewPoints { field: "source", num_points: 1, .. })
    ));
    let bad = GlobalParams { voxel_size_m: 0.0, ..params };
    assert!(matches!(
        register_global(&plane, &plane, &bad),
        Err(RegistrationError::BadParam { field: "voxel_size_m", .. })
    ));
}
