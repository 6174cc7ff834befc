//! The map of a recorded street: what was driven over is free and can be driven, what stands beside it is not; skipped where the data
//! are absent.

#![allow(clippy::unwrap_used, clippy::panic, reason = "all of it is tests")]

use nalgebra::Point2;
use percept_formats::dataset;
use percept_geometry::Cell;
use percept_mapping::{Occupancy, Storey};
use percept_pipeline::{Pipeline, PipelineParams, Snapshot};
use std::path::Path;

percept_recorded::tests! {
    a_street_is_free_where_the_car_drove: "lidar-kitti-tracking-0000";
    the_ground_is_under_the_car_and_can_be_driven_where_it_drove: "lidar-kitti-tracking-0000";
    the_same_street_farther_on: "lidar-kitti-tracking-0000-more";
}

fn a_street_is_free_where_the_car_drove(data: &Path) {
    street(&data.join("lidar-kitti-tracking-0000"));
}

fn the_same_street_farther_on(data: &Path) {
    street(&data.join("lidar-kitti-tracking-0000-more"));
}

/// With a floor taken for a plane under the lidar 2.7 and 7 % of these cells were occupied.
fn street(path: &Path) {
    let snapshot = driven(path, PipelineParams::default());
    let way: Vec<Point2<f64>> = snapshot.trajectory().map(|(t, _)| t.translation.vector.xy().into()).collect();
    let grid = snapshot.layers.occupancy.dense(4_000_000).unwrap();
    assert!(grid.width >= 600 && grid.height >= 600, "{} x {} cells", grid.width, grid.height);
    let (mut known, mut occupied) = (0, 0);
    for (i, value) in grid.cells.iter().enumerate().filter(|(_, v)| **v >= 0) {
        let center = grid.geometry.center(Cell::new((i % grid.width) as i32, (i / grid.width) as i32));
        if way.iter().any(|p| (p - center).norm() <= 1.0) {
            (known, occupied) = (known + 1, occupied + usize::from(*value >= 60));
        }
    }
    assert!(known > 1_000 && 100 * occupied <= known, "{occupied} of {known} cells");
    let share =
        grid.cells.iter().filter(|v| **v >= 60).count() as f64 / grid.cells.iter().filter(|v| **v >= 0).count() as f64;
    assert!((0.04..0.15).contains(&share), "{share:.3} of what is known is occupied");
}

/// What there is at the end of a recording.
fn driven(path: &Path, params: PipelineParams) -> Snapshot {
    let recording = dataset::open(path).unwrap();
    let mut pipeline = Pipeline::new(params).unwrap();
    recording.sensors.iter().for_each(|s| pipeline.declare_sensor(s.clone()));
    for frame in recording.frames(None) {
        pipeline.process(&frame.unwrap()).unwrap();
    }
    pipeline.settle();
    pipeline.snapshot()
}

fn the_ground_is_under_the_car_and_can_be_driven_where_it_drove(data: &Path) {
    let mut params = PipelineParams::default();
    params.map.height.enabled = true;
    let snapshot = driven(&data.join("lidar-kitti-tracking-0000"), params);
    let heights = &snapshot.layers.height;
    let (min, max) = heights.bounds().unwrap();
    let ground = heights.region(min, max, Storey::Highest, 4_000_000).unwrap();
    let drivable = heights.traversability(min, max, Storey::Highest, 4_000_000).unwrap();
    let way: Vec<_> = snapshot.trajectory().map(|(t, _)| t.translation.vector).collect();
    let mut off: Vec<f64> = vec![];
    for p in &way {
        let cell = ground.geometry.cell(&Point2::from(p.xy())).and_then(|cell| ground.index(cell));
        let z = cell.map_or(f32::NAN, |i| ground.ground_m[i]);
        off.extend((!z.is_nan()).then_some((f64::from(z) - p.z).abs()));
    }
    off.sort_by(f64::total_cmp);
    let (mut known, mut passable) = (0, 0);
    for (i, t) in drivable.traversability.iter().enumerate().filter(|(_, t)| !t.is_nan()) {
        let center = drivable.geometry.center(Cell::new((i % drivable.width) as i32, (i / drivable.width) as i32));
        if way.iter().any(|p| (p.xy() - center.coords).norm() <= 1.0) {
            (known, passable) = (known + 1, passable + usize::from(*t > 0.0));
        }
    }
    assert!(2 * off.len() > way.len() && off[off.len() - 1] < 0.1, "{} of {} places: {off:?}", off.len(), way.len());
    assert!(known > 1_000 && 100 * passable >= 95 * known, "{passable} of {known} cells");
}
