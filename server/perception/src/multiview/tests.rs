//! Synthetic scenes with wrong correspondences: the truth is exact.

use super::*;
use nalgebra::{Point3, UnitQuaternion, Vector3};
use percept_geometry::{Distortion, Pose, se3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

struct Scene {
    points: Vec<Point3<f64>>,
    a: Vec<Point2<f64>>,
    b: Vec<Point2<f64>>,
    wrong: Vec<bool>,
}

fn cameras() -> (CameraIntrinsics, CameraIntrinsics) {
    let base = CameraIntrinsics::primesense();
    (base, CameraIntrinsics { distortion: Distortion::PlumbBob([0.1, -0.05, 0.001, -0.001, 0.0]), ..base })
}

fn pose(t: [f64; 3], turn: [f64; 3]) -> Pose {
    Pose::from_parts(Vector3::from(t).into(), UnitQuaternion::from_scaled_axis(Vector3::from(turn)))
}

/// Points in camera a's frame, seen by both with half a pixel of noise; every third correspondence is wrong.
fn scene(t_b_a: &Pose, depth: impl Fn(f64, f64, f64) -> f64) -> Scene {
    let (camera_a, camera_b) = cameras();
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut out = Scene { points: vec![], a: vec![], b: vec![], wrong: vec![] };
    while out.points.len() < 240 {
        let (u, v) = (rng.random_range(20.0..620.0), rng.random_range(20.0..460.0));
        let ray = camera_a.ray(u, v);
        let point = Point3::from(ray.coords * depth(ray.x, ray.y, rng.random_range(0.0..1.0)));
        let Some(seen) = camera_b.project(&(t_b_a * point)) else { continue };
        if !(0.0..640.0).contains(&seen.x) || !(0.0..480.0).contains(&seen.y) {
            continue;
        }
        let mut noise = || rng.random_range(-0.8..0.8);
        let (a, mut b) = (Point2::new(u + noise(), v + noise()), Point2::new(seen.x + noise(), seen.y + noise()));
        let wrong = out.points.len().is_multiple_of(3);
        if wrong {
            b = Point2::new(rng.random_range(0.0..640.0), rng.random_range(0.0..480.0));
        }
        out.points.push(point);
        out.a.push(a);
        out.b.push(b);
        out.wrong.push(wrong);
    }
    out
}

fn room(_: f64, _: f64, share: f64) -> f64 {
    1.5 + 4.0 * share
}

#[test]
fn the_relative_pose_comes_out_of_correspondences_of_which_a_third_is_wrong() {
    let (camera_a, camera_b) = cameras();
    let t_b_a = pose([-0.4, 0.05, 0.1], [0.05, -0.2, 0.1]);
    let s = scene(&t_b_a, room);
    let found = estimate_essential(&s.a, &s.b, &camera_a, &camera_b, &RansacParams::default()).unwrap();
    let turned = found.t_b_a.rotation.angle_to(&t_b_a.rotation);
    let bent = found.t_b_a.translation.vector.angle(&t_b_a.translation.vector);
    assert!(turned < 0.004 && bent < 0.02, "{turned} {bent}");
    assert!((found.t_b_a.translation.vector.norm() - 1.0).abs() < 1e-9);
    let right = found.inliers.iter().filter(|&&i| !s.wrong[i]).count();
    assert!(right > 145 && found.inliers.len() - right < 8, "{right} of {}", found.inliers.len());
    assert!(found.num_with_parallax > 100 && found.rmse_px < 0.8);
    let again = estimate_essential(&s.a, &s.b, &camera_a, &camera_b, &RansacParams::default()).unwrap();
    assert_eq!(found, again);
}

#[test]
fn a_scene_a_plane_and_a_turn_are_told_apart() {
    let (camera_a, camera_b) = cameras();
    let params = RansacParams::default();
    let look = |t_b_a: &Pose, depth: &dyn Fn(f64, f64, f64) -> f64| {
        let s = scene(t_b_a, depth);
        estimate_two_view(&s.a, &s.b, &camera_a, &camera_b, &params).unwrap()
    };
    let moved = pose([-0.5, 0.1, 0.1], [0.05, -0.1, 0.05]);
    let of_room = look(&moved, &room);
    assert_eq!((of_room.model, of_room.outcome), (TwoViewModel::Essential, TwoViewOutcome::Pose));
    let of_plane = look(&moved, &|x, y, _| 3.0 / (1.0 + 0.3 * x - 0.2 * y));
    assert_eq!((of_plane.model, of_plane.outcome), (TwoViewModel::Homography, TwoViewOutcome::Planar));
    let turn = pose([0.0; 3], [0.02, 0.15, 0.05]);
    let of_turn = look(&turn, &room);
    assert_eq!(of_turn.outcome, TwoViewOutcome::LittleParallax);
    assert!(of_turn.essential.t_b_a.rotation.angle_to(&turn.rotation) < 0.01);
}

#[test]
fn a_homography_maps_the_plane() {
    let h = nalgebra::Matrix3::new(1.1, 0.05, 12.0, -0.03, 0.95, 7.0, 1e-4, -5e-5, 1.0);
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let (mut a, mut b) = (vec![], vec![]);
    for i in 0..100 {
        let p = Point2::new(rng.random_range(0.0..640.0), rng.random_range(0.0..480.0));
        let q = h * p.coords.push(1.0);
        a.push(p);
        let wrong = if i % 4 == 0 { 40.0 + f64::from(i) } else { 0.0 };
        b.push(Point2::new(q.x / q.z + rng.random_range(-0.3..0.3) + wrong, q.y / q.z + rng.random_range(-0.3..0.3)));
    }
    let found = estimate_homography(&a, &b, &RansacParams::default()).unwrap();
    assert_eq!(found.inliers.len(), 75);
    for (x, y) in [(0.0, 0.0), (639.0, 0.0), (320.0, 240.0), (639.0, 479.0)] {
        let at = |m: &nalgebra::Matrix3<f64>| m * Vector3::new(x, y, 1.0);
        let off = at(&h).xy() / at(&h).z - at(&found.homography).xy() / at(&found.homography).z;
        assert!(off.norm() < 0.5, "{off}");
    }
}

#[test]
fn a_camera_is_found_among_known_points_with_a_covariance_that_holds() {
    let (_, camera) = cameras();
    let t_b_a = pose([-0.4, 0.05, 0.1], [0.05, -0.2, 0.1]);
    let s = scene(&t_b_a, room);
    let found = solve_pnp(&s.points, &s.b, &camera, &RansacParams { threshold_px: 2.0, ..Default::default() }).unwrap();
    let truth = t_b_a.inverse();
    let error = se3::log(&(found.t_world_camera.inverse() * truth));
    assert!(error.norm() < 0.01, "{error}");
    let mahalanobis2 = (error.transpose() * found.covariance.try_inverse().unwrap() * error)[0];
    // Six degrees of freedom: above 30 once in 20,000 times.
    assert!(mahalanobis2 < 30.0, "{mahalanobis2}");
    assert!(found.inliers.iter().filter(|&&i| s.wrong[i]).count() < 4 && found.inliers.len() > 155);
}

#[test]
fn a_point_is_where_its_rays_meet_and_says_how_surely() {
    let (camera_a, camera_b) = cameras();
    let views = [Pose::identity(), pose([0.5, 0.0, 0.0], [0.0, -0.1, 0.0]), pose([0.0, 0.4, 0.1], [0.1, 0.0, 0.0])];
    let cameras = [camera_a, camera_b, camera_a];
    let point = Point3::new(0.2, -0.1, 3.0);
    let pixels: Vec<_> = (0..3).map(|i| cameras[i].project(&(views[i].inverse() * point)).unwrap()).collect();
    let found = triangulate(&pixels, &cameras, &views).unwrap();
    assert!((found.position - point).norm() < 1e-6 && found.in_front && found.rmse_px < 1e-4);
    assert!((found.parallax_rad - 0.2).abs() < 0.05);
    // Depth is less sure than the sides: by about distance over baseline.
    let sigma = found.covariance.diagonal().map(f64::sqrt);
    assert!(sigma.z > 3.0 * sigma.x && sigma.x > 0.001 && sigma.x < 0.01, "{sigma}");
}

#[test]
fn degenerate_input_is_answered_with_what_is_wrong() {
    let (camera, _) = cameras();
    let params = RansacParams::default();
    let some = vec![Point2::new(1.0, 2.0); 4];
    let few = estimate_essential(&some, &some, &camera, &camera, &params);
    assert_eq!(few, Err(MultiviewError::TooFew { got: 4, needed: 6 }));
    let equal = vec![Point2::new(100.0, 200.0); 50];
    assert!(matches!(
        estimate_essential(&equal, &equal, &camera, &camera, &params),
        Err(MultiviewError::NoModel { .. })
    ));
    assert!(matches!(estimate_homography(&equal, &equal, &params), Err(MultiviewError::NoModel { .. })));
    let line: Vec<_> = (0..50).map(|i| Point2::new(f64::from(i) * 10.0, 200.0)).collect();
    assert!(matches!(estimate_homography(&line, &line, &params), Err(MultiviewError::NoModel { .. })));
    let in_line: Vec<_> = (0..50).map(|i| Point3::new(f64::from(i), 0.0, 5.0)).collect();
    assert!(matches!(solve_pnp(&in_line, &line, &camera, &params), Err(MultiviewError::NoModel { .. })));
    assert!(matches!(
        estimate_homography(&equal, &line[..3], &params),
        Err(MultiviewError::Input(percept_geometry::GeometryError::ShapeMismatch { field: "points_b", .. }))
    ));
    let bad = RansacParams { confidence: 1.0, ..params.clone() };
    assert!(matches!(estimate_homography(&equal, &equal, &bad), Err(MultiviewError::Input(_))));
    let nan = vec![Point2::new(f64::NAN, 0.0); 50];
    assert_eq!(estimate_homography(&nan, &nan, &params), Err(MultiviewError::TooFew { got: 0, needed: 5 }));
    let parallel = triangulate(&[Point2::new(5.0, 5.0); 2], &[camera; 2], &[Pose::identity(); 2]);
    assert_eq!(parallel, Err(MultiviewError::NoModel { got: 2, needed: 2 }));
}
