//! Boxes in images lifted to boxes that are known.

use nalgebra::{Point3, UnitQuaternion, Vector3};
use percept_geometry::{CameraIntrinsics, DepthImage, OrientedBox3, Pose};
use percept_perception::detection::{ImageBox, LiftParams, Lifter, NotLifted};
use rand::{RngExt, SeedableRng};

const CAMERA: CameraIntrinsics = CameraIntrinsics {
    width: 320,
    height: 240,
    fx: 270.0,
    fy: 270.0,
    cx: 159.5,
    cy: 119.5,
    distortion: percept_geometry::Distortion::None,
};

/// 1.3 m above the map's floor, looking along x and down by `pitch`.
fn t_map_camera(pitch: f64) -> Pose {
    let optical = UnitQuaternion::from_euler_angles(-std::f64::consts::FRAC_PI_2, 0.0, -std::f64::consts::FRAC_PI_2);
    let down = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), pitch);
    Pose::from_parts(Vector3::new(0.2, -0.1, 1.3).into(), down * optical)
}

/// Where a ray meets a box, in lengths of the ray.
fn meets(origin: &Point3<f64>, ray: &Vector3<f64>, b: &OrientedBox3) -> Option<f64> {
    let (o, d) = (b.t_frame_box.inverse() * origin, b.t_frame_box.inverse() * ray);
    let (mut near, mut far) = (0.0f64, f64::INFINITY);
    for i in 0..3 {
        let ends = [-0.5, 0.5].map(|s| (s * b.size[i] - o[i]) / d[i]);
        (near, far) = (near.max(ends[0].min(ends[1])), far.min(ends[0].max(ends[1])));
    }
    (near < far && near > 0.0).then_some(near)
}

/// What a depth camera sees of boxes on a floor at z = 0 before a wall at x = 4, with noise that grows with the square of
/// the depth.
fn depth_of(boxes: &[OrientedBox3], t: &Pose, noise: f64) -> DepthImage {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(7);
    let origin = t * Point3::origin();
    let pixel = |i: usize| {
        let ray = t * CAMERA.ray((i % CAMERA.width) as f64, (i / CAMERA.width) as f64).coords;
        let floor = if ray.z < 0.0 { -origin.z / ray.z } else { f64::INFINITY };
        let wall = if ray.x > 0.0 { (4.0 - origin.x) / ray.x } else { f64::INFINITY };
        let things = boxes.iter().filter_map(|b| meets(&origin, &ray, b));
        let z = things.fold(floor.min(wall), f64::min);
        (z + noise * z * z * rng.random_range(-1.7..1.7)) as f32
    };
    DepthImage::new(CAMERA.width, CAMERA.height, (0..CAMERA.width * CAMERA.height).map(pixel).collect()).unwrap()
}

/// The box of a thing in the image, `grown` by a part of its size on each side.
fn seen(b: &OrientedBox3, t: &Pose, grown: f64) -> ImageBox {
    let corners = b.corners().map(|p| CAMERA.project(&(t.inverse() * p)).unwrap());
    let range = |i: usize| {
        let (low, high) = corners.iter().fold((f64::MAX, f64::MIN), |(l, h), p| (l.min(p[i]), h.max(p[i])));
        let more = grown * (high - low);
        // Pixels' centres are half a pixel from their edges.
        [low + 0.5 - more, high + 0.5 + more]
    };
    let ([left_px, right_px], [top_px, bottom_px]) = (range(0), range(1));
    ImageBox { left_px, top_px, right_px, bottom_px }
}

fn standing(x: f64, y: f64, size: [f64; 3], yaw: f64) -> OrientedBox3 {
    OrientedBox3::upright(Point3::new(x, y, 0.5 * size[2]), size.into(), yaw)
}

fn lifter(boxes: &[OrientedBox3], t: &Pose, noise: f64) -> Lifter {
    Lifter::new(&depth_of(boxes, t, noise), &CAMERA, t, &LiftParams::default()).unwrap()
}

#[test]
fn a_box_on_the_floor_is_where_it_stands() {
    let t = t_map_camera(0.5);
    for (yaw, grown) in [(0.5, 0.0), (0.5, 0.1), (-0.8, 0.1), (1.2, 0.05)] {
        let truth = standing(2.0, 0.1, [0.5, 0.35, 0.4], yaw);
        let found = lifter(&[truth], &t, 0.002).lift(&seen(&truth, &t, grown)).unwrap();
        // Its top is seen whole; noise is 1.4 cm at 2.6 m, of which a box holds the ends.
        let iou = found.bbox.iou_upright(&truth);
        assert!(iou > 0.75, "yaw {yaw}, grown {grown}: {iou} {:?} {:?}", found.bbox, truth);
        assert!((found.bbox.center() - truth.center()).norm() < 0.03);
        assert!(found.support_z_m.unwrap().abs() < 0.02, "{:?}", found.support_z_m);
        assert!((found.depth_m - 2.2).abs() < 0.35 && found.num_points > 500, "{found:?}");
    }
}

#[test]
fn of_two_things_behind_each_other_the_one_in_the_middle_is_taken() {
    let t = t_map_camera(0.3);
    let (near, far) = (standing(1.8, 0.0, [0.3, 0.3, 0.5], 0.3), standing(3.2, 0.35, [0.5, 0.5, 1.2], 0.0));
    let lifter = lifter(&[near, far], &t, 0.002);
    let found = lifter.lift(&seen(&near, &t, 0.1)).unwrap();
    assert!(found.bbox.iou_upright(&near) > 0.7, "{:?}", found.bbox);
    let found = lifter.lift(&seen(&far, &t, 0.05)).unwrap();
    // Of the far one its front is seen, and what is hidden is not guessed.
    assert!((found.bbox.center().xy() - far.center().xy()).norm() < 0.3, "{:?}", found.bbox);
    assert!((found.bbox.size.z - 1.2).abs() < 0.1, "{:?}", found.bbox);
}

#[test]
fn a_thing_on_a_table_stands_on_the_table() {
    let t = t_map_camera(0.6);
    let table = OrientedBox3::upright(Point3::new(1.6, 0.0, 0.7), Vector3::new(0.9, 1.2, 0.04), 0.0);
    let cup = OrientedBox3::upright(Point3::new(1.5, 0.1, 0.72 + 0.08), Vector3::new(0.12, 0.12, 0.16), 0.4);
    let lifter = lifter(&[table, cup], &t, 0.001);
    let found = lifter.lift(&seen(&cup, &t, 0.1)).unwrap();
    assert!((found.support_z_m.unwrap() - 0.72).abs() < 0.01, "{:?}", found.support_z_m);
    assert!(found.bbox.iou_upright(&cup) > 0.6, "{:?}", found.bbox);
    // The table itself, which ends within its box in the image.
    let found = lifter.lift(&seen(&table, &t, 0.03)).unwrap();
    assert!(found.bbox.size.x > 0.8 && found.bbox.size.y > 0.6, "{:?}", found.bbox);
}

#[test]
fn what_is_seen_does_not_depend_on_where_the_map_lies() {
    let t = t_map_camera(0.5);
    let truth = standing(2.0, 0.1, [0.5, 0.35, 0.4], 0.5);
    let depth = depth_of(&[truth], &t, 0.002);
    let turned = Pose::from_parts(
        Vector3::new(30.0, -20.0, 0.0).into(),
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 2.0),
    );
    let lift = |t: &Pose| Lifter::new(&depth, &CAMERA, t, &LiftParams::default()).unwrap();
    let here = lift(&t).lift(&seen(&truth, &t, 0.05)).unwrap();
    let there = lift(&(turned * t)).lift(&seen(&truth, &t, 0.05)).unwrap();
    assert!(there.bbox.iou_upright(&here.bbox.transformed(&turned)) > 0.95);
    assert_eq!(there.num_points, here.num_points);
}

#[test]
fn where_there_is_nothing_to_lift_the_reason_is_told() {
    let t = t_map_camera(0.4);
    let empty_room = lifter(&[], &t, 0.002);
    let b = |left_px, top_px, right_px, bottom_px| ImageBox { left_px, top_px, right_px, bottom_px };
    assert_eq!(empty_room.lift(&b(100.0, 150.0, 160.0, 200.0)), Err(NotLifted::WithinPlane));
    for outside in
        [b(-50.0, 0.0, -10.0, 50.0), b(400.0, 0.0, 500.0, 50.0), b(f64::NAN, 0.0, 9.0, 9.0), b(9.0, 9.0, 5.0, 20.0)]
    {
        assert_eq!(empty_room.lift(&outside), Err(NotLifted::OutsideImage));
    }
    assert_eq!(empty_room.lift(&b(10.0, 10.0, 14.0, 14.0)), Err(NotLifted::TooFewDepths));
    let blind = DepthImage::new(CAMERA.width, CAMERA.height, vec![0.0; CAMERA.width * CAMERA.height]).unwrap();
    let blind = Lifter::new(&blind, &CAMERA, &t, &LiftParams::default()).unwrap();
    assert_eq!(blind.lift(&b(0.0, 0.0, 320.0, 240.0)), Err(NotLifted::TooFewDepths));
}

#[test]
fn bad_parameters_and_images_of_another_size_are_named() {
    let t = Pose::identity();
    let depth = DepthImage::new(3, 2, vec![1.0; 6]).unwrap();
    assert!(Lifter::new(&depth, &CAMERA, &t, &LiftParams::default()).unwrap_err().to_string().starts_with("depth"));
    let params = LiftParams { middle: 0.0, ..LiftParams::default() };
    let error = Lifter::new(&depth, &CAMERA, &t, &params).unwrap_err();
    assert!(error.to_string().starts_with("middle"), "{error}");
}
