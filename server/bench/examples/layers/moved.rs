//! A cabinet that stands somewhere for one lap, and elsewhere from then on.
//!
//! Its old place is seen again with the first keyframe after the move of which at least twenty beams pass through. From then on it is
//! asked after each keyframe what is left of it in each layer, of what was there when it was moved: keyframes that looked through the old
//! place, and seconds between those that followed each other, until no more than a twentieth is left, and what is at the end. A robot that
//! stands makes no keyframes.

use crate::Failure;
use crate::bodies::{Body, with_bodies};
use crate::drive::{Sensor, drive, simulation};
use crate::figures::Row;
use nalgebra::{Point2, Point3, Vector3};
use percept_geometry::{Aabb3, KeyframeId, Voxel};
use percept_mapping::{Map, MapEntry, MapParams, MeshOptions, Occupancy, Storey};
use percept_sim::{Simulation, World, WorldParams};

/// The cabinet, metres.
const SIZE_M: [f64; 3] = [0.6, 0.45, 1.5];
/// Its distance from the middle of the lane, and from what stands there.
const FROM_LANE_M: f64 = 0.6;
const FROM_THINGS_M: f64 = 0.35;
/// Beams through its old place by which that is seen.
const BEAMS: usize = 20;

/// Seconds and keyframes that looked through a place until nearly all of it was gone.
type Gone = (f64, usize);

/// What is left in a place, by layer: cells, points, voxels, triangles, cells with something on the ground.
type Left = [usize; 5];

const LAYERS: [[&str; 3]; 5] = [
    ["grid: all but 5 % gone, s", "grid: the same, looks", "grid: left at last"],
    ["cloud: all but 5 % gone, s", "cloud: the same, looks", "cloud: left at last"],
    ["voxels: all but 5 % gone, s", "voxels: the same, looks", "voxels: left at last"],
    ["surface: all but 5 % gone, s", "surface: the same, looks", "surface: left at last"],
    ["heights: all but 5 % gone, s", "heights: the same, looks", "heights: left at last"],
];

pub(crate) fn world(sensor: Sensor, seed: u64, params: &MapParams) -> Result<Row, Failure> {
    let simulation = simulation(
        sensor,
        seed,
        2,
        WorldParams { rooms: 1, furniture_per_m2: 0.2, room_min_m: 5.5, room_max_m: 7.0, ..WorldParams::default() },
    )?;
    let world = simulation.world();
    let places = places(&simulation);
    let [Some(old), .., Some(new)] = [places.first(), places.last()] else {
        return Ok(none());
    };
    let (old, new) = (*old, *new);
    let moves_s = 0.5 * simulation.duration_s();
    let mut map = Map::new(*params)?;
    let (mut before, mut looks, mut gone) = (None::<Left>, 0, [None::<Gone>; 5]);
    let (mut now, mut in_view_s, mut looked_at): (_, f64, Option<f64>) = (Left::default(), 0.0, None);
    for (i, k) in drive(&simulation, sensor).iter().enumerate() {
        let is_moved = k.at_s >= moves_s;
        if is_moved && before.is_none() {
            before = Some(left(&map, &old)?);
        }
        let body = Body::Block(if is_moved { new } else { old });
        let scan = with_bodies(world, &[body], k);
        let passing = passing(&k.sensor(), scan.hits.positions.iter().map(|p| k.t_world_base * p.cast::<f64>()), &old);
        map.insert(KeyframeId(i as u64), &MapEntry::at(k.t_world_base), scan)?;
        let Some(before) = before else { continue };
        if passing >= BEAMS {
            looks += 1;
            in_view_s += looked_at.map_or(0.0, |before| k.at_s - before);
        }
        looked_at = (passing >= BEAMS).then_some(k.at_s);
        if looks == 0 {
            continue;
        }
        now = left(&map, &old)?;
        for layer in 0..5 {
            let is_gone = 20 * now[layer] <= before[layer];
            // What comes back was not gone.
            gone[layer] = if is_gone { gone[layer].or(Some((in_view_s, looks))) } else { None };
        }
        if std::env::var_os("LAYERS_MOVED").is_some() {
            println!("  {:.1} s, {looks} looks, {passing} beams: {now:?} of {before:?}", in_view_s);
        }
    }
    let mut row = vec![("looks through the old place", looks as f64)];
    for layer in 0..5 {
        let was_there = before.is_some_and(|b| b[layer] > 0);
        let figure = |f: fn(Gone) -> f64| gone[layer].filter(|_| was_there).map_or(f64::NAN, f);
        row.push((LAYERS[layer][0], figure(|g| g.0)));
        row.push((LAYERS[layer][1], figure(|g| g.1 as f64)));
        let share = now[layer] as f64 / before.map_or(f64::NAN, |b| b[layer] as f64);
        row.push((LAYERS[layer][2], share));
    }
    Ok(row)
}

fn none() -> Row {
    let mut row = vec![("looks through the old place", f64::NAN)];
    row.extend(LAYERS.iter().flatten().map(|name| (*name, f64::NAN)));
    row
}

/// Where a cabinet fits, away from the lane, from walls and from what stands there; in order of x, then y.
fn places(simulation: &Simulation) -> Vec<Aabb3> {
    let (world, size): (&World, Vector3<f64>) = (simulation.world(), SIZE_M.into());
    let lane: Vec<Point2<f64>> = simulation.truth(5.0).iter().map(|t| t.value.translation.vector.xy().into()).collect();
    let mut out = vec![];
    let extent = world.extent();
    let steps = |length: f64| (0..(length / 0.1) as i32).map(|i| f64::from(i) * 0.1 + 0.03);
    for (x, y) in steps(extent.x).flat_map(|x| steps(extent.y).map(move |y| (x, y))) {
        let place = Aabb3 { min: Point3::new(x, y, 0.0), max: Point3::new(x, y, 0.0) + size };
        let away = |p: &Point2<f64>| (p - p.sup(&place.min.xy()).inf(&place.max.xy())).norm() >= FROM_LANE_M;
        let columns = (0..=3).flat_map(|i| (0..=3).map(move |j| (f64::from(i) / 3.0, f64::from(j) / 3.0)));
        let is_apart = columns.flat_map(|(u, v)| (1..=8).map(move |h| (u, v, 0.2 * f64::from(h)))).all(|(u, v, z)| {
            let p = Point3::new(x + u * size.x, y + v * size.y, z);
            world.surface_distance(&p) >= FROM_THINGS_M.min(z - 1e-6)
        });
        if is_apart && lane.iter().all(away) && world.rooms().iter().any(|r| r.contains(&place.center().xy())) {
            out.push(place);
        }
    }
    out
}

/// Beams that pass through all of a place.
fn passing(sensor: &Point3<f64>, ends: impl Iterator<Item = Point3<f64>>, place: &Aabb3) -> usize {
    let passes = |end: Point3<f64>| {
        let direction = end - sensor;
        let (mut enter, mut leave) = (0f64, f64::INFINITY);
        for i in 0..3 {
            let (a, b) = ((place.min[i] - sensor[i]) / direction[i], (place.max[i] - sensor[i]) / direction[i]);
            (enter, leave) = (enter.max(a.min(b)), leave.min(a.max(b)));
        }
        enter < leave && leave < 1.0
    };
    ends.filter(|end| passes(*end)).count()
}

fn left(map: &Map, place: &Aabb3) -> Result<Left, Failure> {
    let (layers, margin) = (map.layers(), Vector3::new(0.1, 0.1, 0.1));
    // The floor under it belongs to it no more than the sides of cells that it shares with others.
    let place = Aabb3 { min: place.min - margin + Vector3::z() * 0.25, max: place.max + margin };
    let cloud = layers.cloud.to_cloud();
    let points = cloud.positions.iter().filter(|p| place.contains(&p.cast())).count();
    let voxels = layers.voxels.within(&place, usize::MAX)?;
    let size = layers.voxels.params().voxel_size_m;
    let voxels = voxels.iter().filter(|(v, l): &&(Voxel, f32)| *l > 0.0 && place.contains(&v.center(size))).count();
    let mesh = layers.surface.mesh(&MeshOptions { region: Some(place), ..MeshOptions::default() })?;
    let geometry = layers.occupancy.geometry();
    let (Some(low), Some(high)) = (geometry.cell(&place.min.xy()), geometry.cell(&place.max.xy())) else {
        return Err("the place has no cell".into());
    };
    let grid = layers.occupancy.region(low, high, 1_000_000)?;
    let cells = grid.cells.iter().filter(|v| **v >= crate::occupied::OCCUPIED).count();
    let heights = layers.height.region(low, high, Storey::Highest, 1_000_000)?;
    let stands = heights.top_m.iter().filter(|t| **t > 0.2).count();
    Ok([cells, points, voxels, mesh.triangles.len(), stands])
}
