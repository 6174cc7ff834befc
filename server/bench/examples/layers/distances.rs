//! Distance fields of the grid and of the voxels: against brute force, and what they take.
//!
//! Every tile is read once the map has all but its last keyframes (*full*), and again after each further one, when only what has changed
//! within reach is computed anew (*after a keyframe*). Milliseconds of the processor on one thread, composing the layers' tiles left out.

use crate::Failure;
use crate::drive::Keyframe;
use crate::figures::Row;
use nalgebra::{Point2, Point3};
use percept_geometry::{Aabb3, Cell, KeyframeId};
use percept_mapping::{Map, MapEntry, MapLayers, Occupancy};
use std::sync::Arc;

/// Nothing stands where steps of log-odds cancel out but for what rounding leaves.
const BALANCED: f32 = 1e-4;
/// Keyframes after which tiles are read again.
const LAST: usize = 10;
/// Edge of a tile, cells.
const TILE: f64 = 64.0;
/// Places that are asked for.
const PLACES: u32 = 400;

pub(crate) fn judge(params: &percept_mapping::MapParams, keyframes: &[Keyframe]) -> Result<Row, Failure> {
    rayon::ThreadPoolBuilder::new().num_threads(1).build()?.install(|| {
        let mut map = Map::new(*params)?;
        let (mut grid, mut voxels) = (vec![], vec![]);
        for (i, k) in keyframes.iter().enumerate() {
            map.insert(KeyframeId(i as u64), &MapEntry::at(k.t_world_base), Arc::clone(&k.scan))?;
            if i + LAST + 1 >= keyframes.len() {
                let layers = map.layers();
                let places = places(&layers)?;
                grid.push(timed(|| {
                    let mut field = layers.grid_distances();
                    places.iter().try_for_each(|p| field.at(&p.xy()).map(|_| ()))
                })?);
                voxels.push(timed(|| {
                    let mut field = layers.voxel_distances();
                    places.iter().try_for_each(|p| field.at(p).map(|_| ()))
                })?);
            }
        }
        let again = |ms: &[f64]| ms[1..].iter().sum::<f64>() / (ms.len() - 1) as f64;
        let (off_grid, off_voxels) = off(&map.layers())?;
        Ok(vec![
            ("distances of the grid: off by at most, cells", off_grid),
            ("distances of the grid: full, ms", grid[0]),
            ("distances of the grid: after a keyframe, ms", again(&grid)),
            ("distances of the voxels: off by at most, voxels", off_voxels),
            ("distances of the voxels: full, ms", voxels[0]),
            ("distances of the voxels: after a keyframe, ms", again(&voxels)),
        ])
    })
}

/// A place in each tile of the grid, which voxels share; the layers' own tiles are composed meanwhile.
fn places(layers: &MapLayers) -> Result<Vec<Point3<f64>>, Failure> {
    let Some((min, max)) = layers.occupancy.bounds() else { return Ok(vec![]) };
    layers.occupancy.region(min, max, 100_000_000)?;
    layers.voxels.within(&everything(), usize::MAX)?;
    let edge = TILE * layers.occupancy.params().resolution_m;
    let geometry = layers.occupancy.geometry();
    let (low, high) =
        (geometry.center(min).map(|v| (v / edge).floor()), geometry.center(max).map(|v| (v / edge).floor()));
    let steps = |a: f64, b: f64| (0..=(b - a) as i32).map(move |i| (a + f64::from(i) + 0.5) * edge);
    Ok(steps(low.x, high.x).flat_map(|x| steps(low.y, high.y).map(move |y| Point3::new(x, y, 1.0))).collect())
}

fn everything() -> Aabb3 {
    Aabb3 { min: Point3::from([-100.0; 3]), max: Point3::from([100.0; 3]) }
}

/// The largest difference from brute force over the occupied cells and voxels, in edges, of places nearer than the largest distance.
fn off(layers: &MapLayers) -> Result<(f64, f64), Failure> {
    let dense = layers.occupancy.dense(100_000_000)?;
    let Some((corner, _)) = layers.occupancy.bounds() else { return Err("the grid is empty".into()) };
    let cell = |i: usize| Cell::new(corner.x + (i % dense.width) as i32, corner.y + (i / dense.width) as i32);
    let cells: Vec<Point2<f64>> = (0..dense.cells.len())
        .map(cell)
        .filter(|c| layers.occupancy.log_odds(*c).is_some_and(|l| l > BALANCED))
        .map(|c| layers.occupancy.geometry().center(c))
        .collect();
    let size = layers.voxels.params().voxel_size_m;
    let known = layers.voxels.within(&everything(), usize::MAX)?;
    let voxels: Vec<Point3<f64>> = known.iter().filter(|(_, l)| *l > 0.0).map(|(v, _)| v.center(size)).collect();
    let (mut grid_field, mut voxel_field) = (layers.grid_distances(), layers.voxel_distances());
    let resolution = dense.geometry.resolution_m;
    let (mut off_grid, mut off_voxels) = (0.0f64, 0.0f64);
    for i in 0..PLACES {
        let spread = |m: u32| f64::from(i.wrapping_add(1).wrapping_mul(m) >> 8) / f64::from(1u32 << 24);
        let at = dense.geometry.origin.coords;
        let p = Point3::new(
            at.x + spread(2_654_435_761) * dense.width as f64 * resolution,
            at.y + spread(2_246_822_519) * dense.height as f64 * resolution,
            2.4 * spread(3_266_489_917),
        );
        let exact = cells.iter().map(|c| (c - p.xy()).norm()).fold(f64::INFINITY, f64::min) - 0.5 * resolution;
        let found = grid_field.at(&p.xy())?.distance_m;
        // Inside of an obstacle brute force knows no depth.
        if found >= 0.0 && exact < grid_field.max_distance_m() - 2.0 * resolution {
            off_grid = off_grid.max((found - exact).abs() / resolution);
        }
        let exact = voxels.iter().map(|c| (c - p).norm()).fold(f64::INFINITY, f64::min) - 0.5 * size;
        let found = voxel_field.at(&p)?.distance_m;
        if found >= 0.0 && exact < voxel_field.max_distance_m() - 2.0 * size {
            off_voxels = off_voxels.max((found - exact).abs() / size);
        }
    }
    Ok((off_grid, off_voxels))
}

/// Milliseconds of this thread's processor.
fn timed<E: Into<Failure>>(work: impl FnOnce() -> Result<(), E>) -> Result<f64, Failure> {
    let now = || {
        let t = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
        t.tv_sec as f64 * 1e3 + t.tv_nsec as f64 * 1e-6
    };
    let before = now();
    work().map_err(Into::into)?;
    Ok(now() - before)
}
