//! Objects found in what a whole drive has seen.

use nalgebra::Point3;
use percept_geometry::{ObjectClass, OrientedBox3, PointCloud, SensorData, Voxel};
use percept_perception::depth::{RayTable, UnprojectParams, unproject_with};
use percept_perception::detection::{DetectionParams, Detector};
use percept_sim::{SensorSuite, SimParams, Simulation};
use std::collections::BTreeMap;

/// Two rooms without a person, seen by a noisy depth camera once a second.
fn drive() -> Simulation {
    let mut params = SimParams { sensors: SensorSuite::only_depth_camera(), ..SimParams::default() };
    params.world.rooms = 2;
    params.world.person = false;
    if let Some(camera) = &mut params.sensors.depth_camera {
        camera.rate_hz = 1.5;
        camera.color = false;
    }
    Simulation::new(params).unwrap()
}

/// Mean of the points of each voxel that at least two frames saw, world frame: a map in its simplest form.
fn fused(simulation: &Simulation) -> PointCloud {
    let spec = &simulation.sensors()[0];
    let rays = RayTable::new(&spec.intrinsics.unwrap()).unwrap();
    let params = UnprojectParams { stride_px: 3, min_depth_m: 0.4, max_depth_m: 5.0 };
    let mut voxels: BTreeMap<Voxel, (u32, u32, Point3<f64>)> = BTreeMap::new();
    for (n, frame) in (1..).zip(simulation.frames()) {
        let SensorData::Depth(depth) = &frame.frame.data else { panic!("a depth camera sends depth") };
        let cloud = unproject_with(depth, None, &rays, &params).unwrap();
        for p in &cloud.transformed(&(frame.t_world_base * spec.t_base_sensor)).positions {
            let p = p.cast::<f64>();
            let voxel = voxels.entry(Voxel::containing(&p, 0.05).unwrap()).or_insert((0, n, p));
            voxel.0 += u32::from(voxel.0 == 0 || voxel.1 != n);
            (voxel.1, voxel.2) = (n, voxel.2 + (p - voxel.2) * 0.1);
        }
    }
    PointCloud::from_positions(voxels.values().filter(|v| v.0 >= 2).map(|v| v.2.cast()).collect())
}

/// Matches of found to true boxes at an overlap of 0.25, each used once: (matches, of them right in class).
fn matched(truth: &[(ObjectClass, OrientedBox3)], found: &[(ObjectClass, OrientedBox3)]) -> (usize, usize) {
    let mut free: Vec<bool> = vec![true; found.len()];
    let (mut hits, mut right) = (0, 0);
    for (class, bbox) in truth {
        let best = (0..found.len())
            .filter(|&i| free[i] && found[i].1.iou_upright(bbox) >= 0.25)
            .max_by(|&a, &b| found[a].1.iou_upright(bbox).total_cmp(&found[b].1.iou_upright(bbox)));
        if let Some(i) = best {
            free[i] = false;
            hits += 1;
            right += usize::from(found[i].0 == *class);
        }
    }
    (hits, right)
}

#[test]
fn four_of_five_objects_of_a_furnished_flat_are_found_and_as_few_are_made_up() {
    let simulation = drive();
    let cloud = fused(&simulation);
    let found: Vec<_> = Detector::new(DetectionParams::default())
        .unwrap()
        .detect(&cloud)
        .unwrap()
        .iter()
        .map(|d| (d.class, d.bbox))
        .collect();
    let truth: Vec<_> = simulation.world().objects_at(0.0).iter().map(|o| (o.class, o.bbox)).collect();
    let (hits, right) = matched(&truth, &found);
    let (precision, recall) = (hits as f64 / found.len() as f64, hits as f64 / truth.len() as f64);
    println!("precision {precision:.3}, recall {recall:.3}, class right {right} of {hits}, {} points", cloud.len());
    assert!(precision >= 0.8 && recall >= 0.8, "precision {precision:.3}, recall {recall:.3}");
    assert!(right * 10 >= hits * 7, "class right {right} of {hits}");
}
