use crate::scans::{room, spatial};
use nalgebra::{Point3, Vector3};
use percept_geometry::{Pose, Voxel, se3};
use percept_mapping::{CloudParams, FusedCloud, MappingError};
use proptest::prelude::*;
use std::collections::BTreeMap;

fn no_carving() -> CloudParams {
    CloudParams { carve_weight: 0.0, ..CloudParams::default() }
}

proptest! {
    #[test]
    fn a_keyframe_leaves_the_mean_of_each_voxel(
        points in prop::collection::vec((prop::array::uniform3(-1.0..1.0f32), prop::array::uniform3(0..=255u8)), 1..300),
        x in -2000.0..2000.0f64, yaw in -3.0..3.0f64,
    ) {
        let pose = se3::from_xy_yaw(x, -5.0, yaw);
        let mut scan = spatial(0.0, points.iter().map(|p| Point3::from(p.0)).collect());
        scan.hits.colors = Some(points.iter().map(|p| p.1).collect());
        let params = CloudParams { range_min_m: 0.0, ..no_carving() };
        let mut cloud = FusedCloud::new(params).unwrap();
        cloud.integrate(&pose, &scan).unwrap();
        let mut expected: BTreeMap<Voxel, Vec<_>> = BTreeMap::new();
        for (p, c) in &points {
            let q = pose * Point3::from(*p).cast::<f64>();
            expected.entry(Voxel::containing(&q, 0.05).unwrap()).or_default().push((q, *c));
        }
        let out = cloud.to_cloud();
        prop_assert_eq!(out.len(), expected.len());
        prop_assert_eq!(cloud.len(), expected.len());
        for members in expected.values() {
            let mean = members.iter().fold(Vector3::zeros(), |a, m| a + m.0.coords) / members.len() as f64;
            let color = members.iter().fold(Vector3::zeros(), |a, m| a + Vector3::from(m.1).cast::<f64>())
                / members.len() as f64;
            // f32 resolves 0.1 mm at 2 km.
            let found = (0..out.len()).any(|i| (out.positions[i].coords.cast::<f64>() - mean).norm() < 3e-4
                && (Vector3::from(out.colors.as_ref().unwrap()[i]).cast::<f64>() - color).amax() <= 0.51);
            prop_assert!(found);
        }
    }

    #[test]
    fn points_within_a_ball_are_those_a_full_search_finds(
        points in prop::collection::vec(prop::array::uniform3(-3.0..3.0f32), 1..300),
        center in prop::array::uniform3(-3.0..3.0f64), radius in 0.0..3.0f64,
    ) {
        let mut cloud = FusedCloud::new(no_carving()).unwrap();
        cloud.integrate(&Pose::identity(), &spatial(0.0, points.into_iter().map(Point3::from).collect())).unwrap();
        let center = Point3::from(center);
        let all = cloud.to_cloud().positions;
        let expected = all.iter().filter(|p| (p.cast::<f64>() - center).norm() <= radius).count();
        let found = cloud.points_within(&center, radius).len();
        // A point within f32's rounding of the ball's surface may fall on either side.
        let near = all.iter().filter(|p| ((p.cast::<f64>() - center).norm() - radius).abs() < 1e-6).count();
        prop_assert!(found.abs_diff(expected) <= near);
    }
}

#[test]
fn means_of_keyframes_are_weighed_by_their_number() {
    let mut cloud = FusedCloud::new(no_carving()).unwrap();
    for x in [1.01, 1.02, 1.03] {
        cloud.integrate(&Pose::identity(), &spatial(0.0, vec![Point3::new(x, 0.01, 0.01)])).unwrap();
    }
    let out = cloud.to_cloud();
    assert_eq!(out.len(), 1);
    assert!((out.positions[0].x - 1.02).abs() < 1e-6);
    assert_eq!(out.colors, None);
}

#[test]
fn who_has_left_vanishes_and_what_stands_stays() {
    let mut cloud = FusedCloud::new(CloudParams::default()).unwrap();
    let empty = room(1.0, 3.0, None, 0.008);
    let pillar = room(1.0, 3.0, Some(1.5), 0.008);
    let of_pillar = |cloud: &FusedCloud| {
        let near = cloud.points_within(&Point3::new(1.5, 0.0, 0.9), 0.75);
        near.positions.iter().filter(|p| p.z > 0.2 && p.z < 1.6).count()
    };
    for _ in 0..3 {
        cloud.integrate(&Pose::identity(), &pillar).unwrap();
    }
    let (before, standing) = (of_pillar(&cloud), cloud.len() - of_pillar(&cloud));
    assert!(before > 200, "{before}");
    for i in 0..10 {
        cloud
            .integrate(&se3::from_xy_yaw(0.02 * f64::from(i), 0.013, 0.1 * f64::from(i)), &shifted(&empty, i))
            .unwrap();
    }
    let after = of_pillar(&cloud);
    assert!(after * 50 <= before, "{after} of {before} left");
    assert!(cloud.len() - after >= standing, "{} of {standing} still stand", cloud.len() - after);
}

/// The empty room as seen from the pose of step `i` above: the same walls in the map.
fn shifted(room: &percept_geometry::KeyframeScan, i: i32) -> percept_geometry::KeyframeScan {
    let t_map_base = se3::from_xy_yaw(0.02 * f64::from(i), 0.013, 0.1 * f64::from(i));
    let mut scan = room.clone();
    scan.hits = scan.hits.transformed(&t_map_base.inverse());
    scan
}

#[test]
fn nothing_that_stands_is_carved_by_looking_again_from_elsewhere() {
    // A low sensor grazes the floor: its beams end far behind the floor that they nearly touch.
    // Dense rings as a depth camera's, and sparse ones as a lidar's of 16 rings.
    for ring_step in [0.01, 0.035] {
        check_that_nothing_is_lost(ring_step);
    }
}

fn check_that_nothing_is_lost(ring_step: f64) {
    let views = |t: &Pose, half: f64| {
        let (cx, cy) = (t.translation.x, t.translation.y);
        let mut hits = Vec::new();
        for row in -(0.4 / ring_step) as i32..=(0.2 / ring_step) as i32 {
            for column in 0..360 {
                let (e, a) = (f64::from(row) * ring_step + 0.003, f64::from(column) * 0.01745);
                let d = [e.cos() * a.cos(), e.cos() * a.sin(), e.sin()];
                let wall = |c: f64, d: f64| if d > 0.0 { (half - c) / d } else { (-half - c) / d.min(-1e-12) };
                let mut r = wall(cx, d[0]).min(wall(cy, d[1]));
                if d[2] < 0.0 {
                    r = r.min(-0.5 / d[2]);
                }
                let p = Point3::new(cx + r * d[0], cy + r * d[1], 0.5 + r * d[2]);
                hits.push((t.inverse() * p).cast::<f32>());
            }
        }
        spatial(0.5, hits)
    };
    let (mut carving, mut keeping) =
        (FusedCloud::new(CloudParams::default()).unwrap(), FusedCloud::new(no_carving()).unwrap());
    for i in 0..12 {
        let t = se3::from_xy_yaw(0.31 * f64::from(i) - 2.0, 0.17 * f64::from(i) - 1.0, 0.2 * f64::from(i));
        let scan = views(&t, 6.0);
        carving.integrate(&t, &scan).unwrap();
        keeping.integrate(&t, &scan).unwrap();
    }
    let lost = keeping.len() - carving.len();
    assert!(lost * 2000 <= keeping.len(), "{ring_step}: {lost} of {} lost", keeping.len());
}

#[test]
fn a_clone_does_not_see_later_changes() {
    let mut cloud = FusedCloud::new(CloudParams::default()).unwrap();
    cloud.integrate(&Pose::identity(), &room(1.0, 2.0, None, 0.05)).unwrap();
    let before = cloud.clone();
    let picture = before.to_cloud();
    cloud.integrate(&Pose::identity(), &room(1.0, 2.5, None, 0.05)).unwrap();
    assert_eq!(before.to_cloud(), picture);
    assert_ne!(cloud, before);
    let bounds = before.bounds();
    assert!((bounds.max.x - 2.0).abs() < 1e-3 && (bounds.min.y + 2.0).abs() < 1e-3);
}

#[test]
fn points_without_meaning_and_lying_channels() {
    let mut cloud = FusedCloud::new(CloudParams::default()).unwrap();
    let nan = f32::NAN;
    let mut scan = spatial(0.0, vec![Point3::new(nan, 0.0, 0.0), Point3::new(50.0, 0.0, 0.0)]);
    cloud.integrate(&Pose::identity(), &scan).unwrap();
    assert!(cloud.is_empty() && cloud.bounds().is_empty() && cloud.to_cloud().is_empty());
    scan.hits.colors = Some(vec![[0; 3]]);
    assert!(matches!(cloud.integrate(&Pose::identity(), &scan), Err(MappingError::Scan(_))));
    let params = CloudParams { voxel_size_m: 1e-6, ..Default::default() };
    assert!(matches!(FusedCloud::new(params), Err(MappingError::InvalidParam { field: "voxel_size_m", .. })));
}
