//! Lean tiles against open ones.

use crate::bytes::Reader;
use crate::layer::Layer;
use crate::occupancy::evidence::Evidence;
use crate::occupancy::marks::Marks;
use crate::occupancy::{OccupancyGrid, OccupancyParams, ScanUpdate};
use crate::{KeyframeView, Occupancy};
use nalgebra::{Point2, Point3};
use percept_geometry::{Cell, GridGeometry, KeyframeScan, PointCloud, Pose, SensorId, Timestamp, se3};
use proptest::prelude::*;
use std::sync::Arc;

/// The same marks cell by cell, as tiles of which every cell is open take them.
fn each(update: &ScanUpdate) -> ScanUpdate {
    let side = update.width as i32;
    let cells = (0..side).flat_map(|y| (0..side).map(move |x| (x, y)));
    let marks = cells.map(|(x, y)| update.at(Cell::new(update.min.x + x, update.min.y + y))).collect();
    ScanUpdate { marks: Marks::Each(marks), ..update.clone() }
}

/// What a sensor at a height (m) sees around it.
fn scan(height: f32, ends: &[[f32; 2]], planar: bool) -> KeyframeScan {
    let end =
        |(i, e): (usize, &[f32; 2])| Point3::new(e[0], e[1], if planar { height } else { 0.3 + 0.1 * (i % 15) as f32 });
    let (hits, misses) = ends.split_at(ends.len() * 3 / 4);
    KeyframeScan {
        stamp: Timestamp(0),
        sensor: SensorId::from("scan"),
        t_base_sensor: Pose::translation(0.1, 0.0, f64::from(height)),
        hits: PointCloud::from_positions(hits.iter().enumerate().map(end).collect()),
        misses: misses.iter().enumerate().map(end).collect(),
        base_height_m: 0.0,
        planar,
        features: None,
    }
}

#[derive(Debug, Clone)]
struct Look {
    at: (f64, f64, f64),
    ends: Vec<[f32; 2]>,
    height: f32,
    planar: bool,
    times: usize,
}

fn looks() -> impl Strategy<Value = Vec<Look>> {
    let at = (-3.0..3.0f64, -3.0..3.0f64, -3.0..3.0f64);
    let ends = prop::collection::vec(prop::array::uniform2(-4.0..4.0f32), 1..60);
    let height = prop_oneof![4 => Just(0.3f32), 1 => Just(0.9f32)];
    let look = (at, ends, height, prop::bool::weighted(0.9), 1..6usize)
        .prop_map(|(at, ends, height, planar, times)| Look { at, ends, height, planar, times });
    prop::collection::vec(look, 1..30)
}

fn encoded(grid: &OccupancyGrid) -> Vec<u8> {
    let mut bytes = vec![];
    grid.encode(&mut bytes);
    bytes
}

fn params(radius: f64) -> OccupancyParams {
    OccupancyParams { footprint_radius_m: radius, ..OccupancyParams::default() }
}

fn updates(params: &OccupancyParams, looks: &[Look]) -> Vec<ScanUpdate> {
    let geometry = GridGeometry::new(params.resolution_m, Point2::origin());
    let update = |look: &Look| {
        let scan = scan(look.height, &look.ends, look.planar);
        let update = ScanUpdate::new(
            params,
            &geometry,
            &KeyframeView::new(&se3::from_xy_yaw(look.at.0, look.at.1, look.at.2), &scan),
        );
        vec![update; look.times]
    };
    looks.iter().flat_map(update).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn a_lean_grid_holds_the_evidence_of_an_open_one(
        looks in looks(), radius in prop_oneof![Just(0.0), Just(0.3)], steps in prop_oneof![Just((0.6, -0.4)), Just((0.85f32, -0.31f32))],
        pause in 0..60usize,
    ) {
        let params = OccupancyParams { hit_log_odds: steps.0, free_log_odds: steps.1, ..params(radius) };
        let (mut lean, mut open) = (OccupancyGrid::new(params).unwrap(), OccupancyGrid::new(params).unwrap());
        let mut copies = vec![];
        for (i, update) in updates(&params, &looks).iter().enumerate() {
            lean.apply(update);
            open.apply(&each(update));
            if i % 20 == 7 {
                copies.push((lean.clone(), open.clone()));
            }
            if i == pause {
                lean.pack();
            } else if i == pause + 9 {
                lean = OccupancyGrid::decode(&params, &mut Reader::new(&encoded(&lean))).unwrap();
            }
        }
        for (lean, open) in copies.iter().chain([&(lean, open)]) {
            prop_assert!(lean == open);
            prop_assert_eq!(lean.bounds(), open.bounds());
            prop_assert_eq!(encoded(lean), encoded(open));
        }
    }
}

#[test]
fn a_grid_that_has_no_more_numbers_opens_its_tiles() {
    let params = params(0.3);
    let look = |i: usize| {
        let end = |k: usize| [(0.1 * (k * i) as f32).cos() * 3.0, (0.1 * (k + i) as f32).sin() * 2.0];
        Look { at: (0.1 * i as f64, 0.0, 0.2), ends: (0..40).map(end).collect(), height: 0.3, planar: true, times: 2 }
    };
    let updates = updates(&params, &(0..20).map(look).collect::<Vec<_>>());
    let (mut full, mut open) = (OccupancyGrid::new(params).unwrap(), OccupancyGrid::new(params).unwrap());
    for (i, update) in updates.iter().enumerate() {
        if i == 10 {
            let kinds = Arc::make_mut(&mut full.kinds);
            for k in (0..65_536).map(|k| k as f32) {
                if kinds.has_room(1) {
                    kinds.number(&Evidence { log_odds: 1.0 + k * 1e-6, ..Evidence::none(&params) });
                }
            }
        }
        full.apply(update);
        open.apply(&each(update));
    }
    assert!(full == open);
    assert_eq!(encoded(&full), encoded(&open));
}
