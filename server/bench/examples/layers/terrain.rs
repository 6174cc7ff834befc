//! Ramps, platforms and a pit in a bare room: heights, and where a robot can drive.
//!
//! Truth is told from the bodies alone. An edge where the ground jumps by more than 0.13 m must not be driven: cells of a body whose
//! centre is within 0.15 m of one have to be impassable, as have those that lie 0.25 m and more within the ramp of 14 degrees. What is
//! outside of a body may be told either way there: how far the robot's middle keeps from an edge is the planner's to say. Cells whose
//! centre is 0.4 m and more from such edges and from that ramp, and that lie on the floor, on the ramp of 7 degrees or on the platform of
//! 0.05 m, have to be passable, the edges of that platform included. Jumps between 0.06 and 0.13 m are not asked for within 0.4 m: the limit
//! is 0.1. Cells of which nothing is known are counted apart. What is behind an edge that cannot be driven (the top of the platform of
//! 0.16 m, the floor of the pit) may be told either way.

use crate::Failure;
use crate::bodies::{Body, with_bodies};
use crate::drive::{Sensor, drive, simulation};
use crate::figures::{Row, quantile, share};
use nalgebra::{Point2, Point3};
use percept_geometry::{Aabb3, Cell, KeyframeId};
use percept_mapping::{Map, MapEntry, MapParams, Storey};
use percept_sim::WorldParams;

/// Edge of the body in a corner of the inner room, and how far apart those begin, metres.
const EDGE_M: f64 = 1.4;
const APART_M: f64 = 3.4;

struct Terrain {
    bodies: Vec<Body>,
    /// Places on edges, and by how much the ground jumps there, metres.
    edges: Vec<(Point2<f64>, f64)>,
}

impl Terrain {
    /// Five bodies around a corner of the place inside of the lane, shifted by one from world to world.
    fn new(corner: Point2<f64>, seed: u64) -> Self {
        let tan = |degrees: f64| degrees.to_radians().tan();
        let slots = [(0.0, 0.0), (APART_M, 0.0), (0.0, APART_M), (APART_M, APART_M), (0.5 * APART_M, 0.5 * APART_M)];
        let slot = |i: u64| slots[((i + seed) % 5) as usize];
        let bounds = |i: u64, low: f64, high: f64| {
            let (x, y) = (corner.x + slot(i).0 + 0.013 * seed as f64 % 0.1, corner.y + slot(i).1);
            Aabb3 { min: Point3::new(x, y, low), max: Point3::new(x + EDGE_M, y + EDGE_M, high) }
        };
        let bodies = vec![
            Body::Ramp(bounds(0, 0.0, EDGE_M * tan(7.0))),
            Body::Ramp(bounds(1, 0.0, EDGE_M * tan(14.0))),
            Body::Block(bounds(2, 0.0, 0.05)),
            Body::Block(bounds(3, 0.0, 0.16)),
            Body::Pit(bounds(4, -0.4, 0.0)),
        ];
        let mut edges = vec![];
        for body in &bodies {
            let b = body.bounds();
            for i in 0..=28 {
                let s = f64::from(i) / 28.0;
                let (x, y) = (b.min.x + s * EDGE_M, b.min.y + s * EDGE_M);
                for p in [(b.min.x, y), (b.max.x, y), (x, b.min.y), (x, b.max.y)].map(|(x, y)| Point2::new(x, y)) {
                    edges.push((p, height(body, &p).abs()));
                }
            }
        }
        Self { bodies, edges }
    }

    fn at(&self, p: &Point2<f64>) -> Option<&Body> {
        self.bodies.iter().find(|b| {
            let b = b.bounds();
            p.x >= b.min.x && p.x <= b.max.x && p.y >= b.min.y && p.y <= b.max.y
        })
    }

    /// To the nearest edge with a jump from `low` up, metres.
    fn to_edge(&self, p: &Point2<f64>, low: f64) -> f64 {
        self.edges.iter().filter(|(_, jump)| *jump >= low).map(|(q, _)| (p - q).norm()).fold(f64::INFINITY, f64::min)
    }
}

/// Height of a body's surface where it lies over or under `p`.
fn height(body: &Body, p: &Point2<f64>) -> f64 {
    let b = body.bounds();
    match body {
        Body::Block(_) => b.max.z,
        Body::Ramp(_) => (p.x - b.min.x) / (b.max.x - b.min.x) * b.max.z,
        Body::Pit(_) => b.min.z,
    }
}

/// What has to be of a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Truth {
    BlockedByStep,
    BlockedByPit,
    BlockedBySlope,
    OpenFloor,
    OpenRamp,
    OpenPlatform,
}

const TRUTHS: [(Truth, [&str; 2]); 6] = [
    (Truth::BlockedByStep, ["steps passable", "steps unknown"]),
    (Truth::BlockedByPit, ["rim of the pit passable", "rim of the pit unknown"]),
    (Truth::BlockedBySlope, ["ramp of 14 degrees passable", "ramp of 14 degrees unknown"]),
    (Truth::OpenFloor, ["floor impassable", "floor unknown"]),
    (Truth::OpenRamp, ["ramp of 7 degrees impassable", "ramp of 7 degrees unknown"]),
    (Truth::OpenPlatform, ["platform of 5 cm impassable", "platform of 5 cm unknown"]),
];

fn truth(terrain: &Terrain, p: &Point2<f64>) -> Option<Truth> {
    let on = terrain.at(p);
    if terrain.to_edge(p, 0.13) <= 0.15 {
        let is_pit = |body: &Body| matches!(body, Body::Pit(_));
        return on.map(|body| if is_pit(body) { Truth::BlockedByPit } else { Truth::BlockedByStep });
    }
    let steep = |b: &Body| matches!(b, Body::Ramp(b) if b.max.z > 0.3);
    if let Some(Body::Ramp(b)) = on.filter(|b| steep(b)) {
        let inside = (p.x - b.min.x).min(b.max.x - p.x).min(p.y - b.min.y).min(b.max.y - p.y);
        return (inside >= 0.25).then_some(Truth::BlockedBySlope);
    }
    let is_near_steep = terrain.bodies.iter().any(|b| steep(b) && outside(b.bounds(), p) < 0.4);
    if terrain.to_edge(p, 0.06) < 0.4 || is_near_steep {
        return None;
    }
    match on {
        None => Some(Truth::OpenFloor),
        Some(Body::Ramp(_)) => Some(Truth::OpenRamp),
        Some(Body::Block(b)) if b.max.z < 0.1 => Some(Truth::OpenPlatform),
        _ => None,
    }
}

/// From a rectangle, metres; 0 inside.
fn outside(b: &Aabb3, p: &Point2<f64>) -> f64 {
    (p - p.sup(&b.min.xy()).inf(&b.max.xy())).norm()
}

pub(crate) fn world(sensor: Sensor, seed: u64, params: &MapParams) -> Result<Row, Failure> {
    let bare =
        WorldParams { rooms: 1, furniture_per_m2: 0.0, room_min_m: 9.0, room_max_m: 9.6, ..WorldParams::default() };
    let simulation = simulation(sensor, seed, 1, bare)?;
    let room = simulation.world().rooms()[0];
    // The lane is 1.4 m from the walls.
    let terrain = Terrain::new(room.min + nalgebra::Vector2::new(2.1, 2.1), seed);
    let mut only = MapParams::default();
    (only.height, only.height.enabled) = (params.height, true);
    let mut map = Map::new(only)?;
    for (i, k) in drive(&simulation, sensor).iter().enumerate() {
        let scan = with_bodies(simulation.world(), &terrain.bodies, k);
        map.insert(KeyframeId(i as u64), &MapEntry::at(k.t_world_base), scan)?;
    }
    let layer = map.layers().height;
    let Some((min, max)) = layer.bounds() else { return Err("no heights".into()) };
    let heights = layer.region(min, max, Storey::Highest, 100_000_000)?;
    let drivable = layer.traversability(min, max, Storey::Highest, 100_000_000)?;
    let (mut off, mut counts) = (vec![], [(0, 0, 0); 6]);
    for i in 0..heights.ground_m.len() {
        let cell = Cell::new((i % heights.width) as i32, (i / heights.width) as i32);
        let p = heights.geometry.center(cell);
        let inside = (p - room.min).inf(&(room.max - p));
        if inside.min() < 0.6 {
            continue;
        }
        let t = drivable.traversability[i];
        let ground = f64::from(heights.ground_m[i]);
        if !ground.is_nan() && terrain.to_edge(&p, 0.02) > 0.1 {
            off.push((ground - terrain.at(&p).map_or(0.0, |b| height(b, &p))).abs());
        }
        let Some(truth) = truth(&terrain, &p) else { continue };
        let Some(number) = TRUTHS.iter().position(|(t, _)| *t == truth) else { continue };
        let is_open = number >= 3;
        let count = &mut counts[number];
        count.0 += 1;
        count.1 += usize::from(!t.is_nan() && (t > 0.0) != is_open);
        count.2 += usize::from(t.is_nan());
    }
    if std::env::var_os("LAYERS_PICTURE").is_some() {
        picture(&terrain, &heights, &drivable.traversability);
    }
    off.sort_by(f64::total_cmp);
    let mut row = vec![
        ("ground off, mean, m", off.iter().sum::<f64>() / off.len() as f64),
        ("ground off, p95, m", quantile(&off, 0.95)),
        ("ground off, worst, m", quantile(&off, 1.0)),
    ];
    for ((_, [wrong, unknown]), (all, num_wrong, num_unknown)) in TRUTHS.iter().zip(counts) {
        row.push((wrong, share(num_wrong, all)));
        row.push((unknown, share(num_unknown, all)));
    }
    Ok(row)
}

/// Characters a cell: what has to be (`S` step, `P` pit, `L` slope) where it is passable, `X` where what is open is impassable, `.`
/// passable, `#` impassable, space unknown.
fn picture(terrain: &Terrain, heights: &percept_mapping::DenseHeights, traversability: &[f32]) {
    for y in (0..heights.height).rev() {
        let row = (0..heights.width).map(|x| {
            let t = traversability[y * heights.width + x];
            let p = heights.geometry.center(Cell::new(x as i32, y as i32));
            match (truth(terrain, &p), t > 0.0, t.is_nan()) {
                (_, _, true) => ' ',
                (Some(Truth::BlockedByStep), true, _) => 'S',
                (Some(Truth::BlockedByPit), true, _) => 'P',
                (Some(Truth::BlockedBySlope), true, _) => 'L',
                (Some(Truth::OpenFloor | Truth::OpenRamp | Truth::OpenPlatform), false, _) => 'X',
                (_, true, _) => '.',
                _ => '#',
            }
        });
        println!("{}", row.collect::<String>());
    }
}
