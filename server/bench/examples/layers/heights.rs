//! Heights and traversability of furnished rooms on a level floor at z = 0.
//!
//! Ground is judged in cells of ground whose square nothing but the floor reaches into. Where something higher than the step limit
//! truly ended at least three beams below the robot's clearance, a cell has to be impassable; where nothing stands in the footprint
//! around a cell and ground was seen, it has to be passable.

use crate::Failure;
use crate::drive::Beam;
use crate::figures::{Row, quantile, share};
use crate::occupied::Fine;
use percept_geometry::Cell;
use percept_mapping::Storey;
use percept_mapping::height::HeightMap;
use percept_sim::World;
use std::collections::BTreeMap;

/// What is this much higher than the limit has to stop the robot, metres: ranges err by 2 cm.
const MARGIN_M: f64 = 0.03;
/// Beams that a cell's obstacle ended.
const ENDED: usize = 3;

pub(crate) fn judge(world: &World, map: &HeightMap, beams: &[Beam]) -> Result<Row, Failure> {
    let params = *map.params();
    let Some((min, max)) = map.bounds() else { return Err("no heights".into()) };
    let heights = map.region(min, max, Storey::Highest, 100_000_000)?;
    let drivable = map.traversability(min, max, Storey::Highest, 100_000_000)?;
    let fine = Fine::new(world, params.resolution_m, (0.005, params.clearance_m))?;
    let mut ended: BTreeMap<(i32, i32), usize> = BTreeMap::new();
    let stops = |b: &&Beam| {
        b.end.z > params.max_step_m + MARGIN_M
            && b.end.z < params.clearance_m - MARGIN_M
            && b.range_m <= params.range_max()
    };
    for cell in beams.iter().filter(stops).filter_map(|b| map.geometry().cell(&b.end.xy())) {
        *ended.entry((cell.x, cell.y)).or_default() += 1;
    }
    let footprint = (0.5 * params.footprint_m / params.resolution_m).ceil() as i32 * 4;
    let (mut off, mut blocked, mut open) = (vec![], (0, 0, 0), (0, 0, 0));
    for i in 0..heights.ground_m.len() {
        let cell = Cell::new((i % heights.width) as i32 + min.x, (i / heights.width) as i32 + min.y);
        let (ground, t) = (heights.ground_m[i], drivable.traversability[i]);
        if !ground.is_nan() && !fine.reaches(cell, 0) {
            off.push(f64::from(ground.abs()));
        }
        let told = |count: &mut (usize, usize, usize), is_right: bool| {
            count.0 += usize::from(is_right);
            count.1 += usize::from(!is_right && !t.is_nan());
            count.2 += usize::from(t.is_nan());
        };
        if ended.get(&(cell.x, cell.y)).is_some_and(|n| *n >= ENDED) {
            told(&mut blocked, t <= 0.0);
        } else if !ground.is_nan() && !fine.reaches(cell, footprint) {
            told(&mut open, t > 0.0);
        }
    }
    off.sort_by(f64::total_cmp);
    let far = off.iter().filter(|d| **d > 0.05).count();
    let mean = off.iter().sum::<f64>() / off.len() as f64;
    let of = |part: usize, (a, b, c): (usize, usize, usize)| share(part, a + b + c);
    Ok(vec![
        ("heights: cells of ground", off.len() as f64),
        ("heights: ground off, mean, m", mean),
        ("heights: p95, m", quantile(&off, 0.95)),
        ("heights: worst, m", quantile(&off, 1.0)),
        ("heights: share of ground off by more than 5 cm", share(far, off.len())),
        ("heights: obstacles passable", of(blocked.1, blocked)),
        ("heights: obstacles unknown", of(blocked.2, blocked)),
        ("heights: open floor impassable", of(open.1, open)),
        ("heights: open floor unknown", of(open.2, open)),
    ])
}
