//! Occupied cells against what truly stands in a street: precision and recall.
//!
//! The truth is told from all points of all scans, each placed by the pose of its own scan; no map layer has a part in it. *Ground*: in
//! squares of 0.5 m the fifth hundredth of the heights of all points, and of the nine squares around a place the lowest such. A point
//! *stands* if it is between 0.3 and 1.8 m above that: what is lower may be a camber or a kerb, on which none is asked for, and what is
//! higher passes over the grid's band. Points in a labelled box that moves, a quarter of a metre around it included, stand nowhere: what
//! such a thing leaves in the grid is wrong.
//!
//! - Precision: of the occupied cells, how many have at least two standing points from two scans in them or in the eight cells around.
//!   Where the lowest of the points there are between 0.1 and 0.3 m above the ground (a kerb, a step, low plants) the cell is counted apart,
//!   as neither right nor wrong. Told for all cells, for those within 15 m of the way (the street), and for those within 1 m of it, where
//!   the car drove and nothing stands.
//! - Recall by labelled boxes: of the cells in which at least three points from two scans lie inside of the box of a thing that does not
//!   move, 0.1 m around it included, between 0.2 m above its foot and the band's top, how many are occupied, or one of the eight around.
//! - Recall of all that stands: of the cells within 15 m of the way with standing points from at least fifteen scans, which a car that drives
//!   behind this one stays too briefly for.

use crate::OCCUPIED;
use crate::labels::{self, Label, stands};
use nalgebra::{Point2, Point3};
use percept_geometry::{Cell, Pose};
use percept_mapping::DenseGrid;
use std::collections::{BTreeMap, BTreeSet, HashMap};

/// Edge of a square of ground, metres.
const SQUARE_M: f64 = 0.5;
/// Heights above the ground, metres: from the first on something is no road, from the second on it surely stands, from the third on it
/// passes over a car.
const LOW_M: f64 = 0.1;
const STANDS_FROM_M: f64 = 0.3;
const TOP_M: f64 = 1.8;
/// Points that were seen from farther away are left out: the grid's range is 30 m, metres.
const RANGE_M: f32 = 29.0;
/// Scans that see what stands.
const LONG_SCANS: u32 = 15;
/// How far from the way a street reaches, metres.
const STREET_M: f64 = 15.0;

/// A point of a scan that was placed in the map.
struct Placed {
    frame: u32,
    p: Point3<f32>,
}

/// What was seen in a cell.
#[derive(Default, Clone, Copy)]
struct Seen {
    points: u32,
    first: u32,
    scans: u32,
}

impl Seen {
    fn add(&mut self, frame: u32) {
        self.points += 1;
        // Scans come in order.
        if self.scans == 0 || self.first != frame {
            (self.first, self.scans) = (frame, self.scans + 1);
        }
    }
}

/// All points of a drive.
#[derive(Default)]
pub(crate) struct Points(Vec<Placed>);

impl Points {
    pub(crate) fn add(&mut self, frame: usize, t_map_lidar: &Pose, points: &[Point3<f32>]) {
        let placed = |p: &Point3<f32>| Placed { frame: frame as u32, p: (t_map_lidar * p.cast::<f64>()).cast() };
        let finite = points.iter().filter(|p| p.iter().all(|v| v.is_finite()));
        self.0.extend(finite.filter(|p| p.xy().coords.norm() < RANGE_M).map(placed));
    }

    /// Heights above the ground by point.
    fn heights(&self) -> Vec<f32> {
        let square = |p: &Point3<f32>| [p.x, p.y].map(|v| (f64::from(v) / SQUARE_M).floor() as i32);
        let mut squares: HashMap<[i32; 2], Vec<f32>> = HashMap::new();
        self.0.iter().for_each(|placed| squares.entry(square(&placed.p)).or_default().push(placed.p.z));
        let low = |z: &mut Vec<f32>| {
            z.sort_by(f32::total_cmp);
            z[z.len() / 20]
        };
        let ground: HashMap<[i32; 2], f32> = squares.iter_mut().map(|(key, z)| (*key, low(z))).collect();
        let around = |[x, y]: [i32; 2]| {
            let nine = (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| [x + dx, y + dy]));
            nine.filter_map(|key| ground.get(&key)).copied().fold(f32::INFINITY, f32::min)
        };
        let lowest: HashMap<[i32; 2], f32> = ground.keys().map(|key| (*key, around(*key))).collect();
        self.0.iter().map(|placed| placed.p.z - lowest[&square(&placed.p)]).collect()
    }
}

/// Prints precision and recall.
pub(crate) fn judge(
    grid: &DenseGrid,
    points: &Points,
    things: &[Label],
    t_map_frames: &BTreeMap<usize, Pose>,
    way: &[Point2<f64>],
) {
    let standing = stands(things, t_map_frames);
    let heights = points.heights();
    let mut boxes: HashMap<usize, Vec<labels::Placed<'_>>> = HashMap::new();
    for label in things {
        if let Some(t) = t_map_frames.get(&label.frame) {
            let yaw = label.yaw + percept_geometry::se3::yaw(t);
            boxes.entry(label.frame).or_default().push((label, t * label.at, yaw));
        }
    }
    let (mut upright, mut low): (HashMap<Cell, Seen>, HashMap<Cell, Seen>) = Default::default();
    let mut labelled: BTreeMap<i64, HashMap<Cell, Seen>> = BTreeMap::new();
    for (placed, height) in points.0.iter().zip(&heights) {
        let p = placed.p.cast::<f64>();
        let Some(cell) = grid.geometry.cell(&p.xy()) else { continue };
        let mut moves = false;
        for (label, at, yaw) in boxes.get(&(placed.frame as usize)).into_iter().flatten() {
            let is_standing = standing.contains(&label.track);
            moves |= !is_standing && inside(label, at, *yaw, &p.xy(), 0.25);
            let over_foot = p.z - at.z;
            if is_standing && (0.2..TOP_M).contains(&over_foot) && inside(label, at, *yaw, &p.xy(), 0.1) {
                labelled.entry(label.track).or_default().entry(cell).or_default().add(placed.frame);
            }
        }
        let height = f64::from(*height);
        if moves || !(LOW_M..TOP_M).contains(&height) {
            continue;
        }
        let of = if height >= STANDS_FROM_M { &mut upright } else { &mut low };
        of.entry(cell).or_default().add(placed.frame);
    }
    let near_way = |within_m: f64| near(grid, way, within_m);
    let is_occupied = |c: &Cell| grid.index(*c).is_some_and(|i| grid.cells[i] >= OCCUPIED);
    let is_near = |of: &HashMap<Cell, Seen>, c: &Cell| {
        around(*c).filter_map(|c| of.get(&c)).fold((0, 0), |s, seen| (s.0 + seen.points, s.1.max(seen.scans)))
    };
    for (name, cells) in [
        ("all", None),
        ("within 15 m of the way", Some(near_way(STREET_M))),
        ("within 1 m of the way", Some(near_way(1.0))),
    ] {
        let (mut right, mut unsure, mut wrong) = (0, 0, vec![]);
        for i in (0..grid.cells.len()).filter(|i| grid.cells[*i] >= OCCUPIED) {
            let cell = Cell::new((i % grid.width) as i32, (i / grid.width) as i32);
            if cells.as_ref().is_some_and(|cells| !cells.contains(&(cell.x, cell.y))) {
                continue;
            }
            let (up, under) = (is_near(&upright, &cell), is_near(&low, &cell));
            if up.0 >= 2 && up.1 >= 2 {
                right += 1;
            } else if up.0 + under.0 >= 2 {
                unsure += 1;
            } else {
                wrong.push(grid.geometry.center(cell));
            }
        }
        let judged = right + wrong.len();
        println!(
            "  occupied cells, {name}: {right} of {judged} right, precision {:.4}; {unsure} more on low or once seen things",
            right as f64 / judged.max(1) as f64
        );
        if std::env::var_os("OUTDOORS_WRONG").is_some() {
            wrong.iter().for_each(|p| println!("    wrong at {:.2} {:.2}", p.x, p.y));
        }
    }
    let street = near_way(STREET_M);
    let in_street = |c: &Cell| street.contains(&(c.x, c.y));
    for (track, cells) in &labelled {
        let seen: Vec<&Cell> = cells.iter().filter(|(_, s)| s.points >= 3 && s.scans >= 2).map(|(c, _)| c).collect();
        let found = seen.iter().filter(|c| around(***c).any(|c| is_occupied(&c))).count();
        println!(
            "  labelled box {track}: {found} of {} seen cells occupied, recall {:.4}",
            seen.len(),
            found as f64 / seen.len().max(1) as f64
        );
    }
    let seen: Vec<&Cell> =
        upright.iter().filter(|(c, s)| s.scans >= LONG_SCANS && in_street(c)).map(|(c, _)| c).collect();
    let found = seen.iter().filter(|c| around(***c).any(|c| is_occupied(&c))).count();
    println!(
        "  what stands within 15 m: {found} of {} seen cells occupied, recall {:.4}",
        seen.len(),
        found as f64 / seen.len().max(1) as f64
    );
    if std::env::var_os("OUTDOORS_WRONG").is_some() {
        for c in seen.iter().filter(|c| !around(***c).any(|c| is_occupied(&c))) {
            let (p, s) = (grid.geometry.center(**c), upright[*c]);
            println!("    missed at {:.2} {:.2}: {} points of {} scans", p.x, p.y, s.points, s.scans);
        }
    }
}

fn inside(label: &Label, at: &Point3<f64>, yaw: f64, p: &Point2<f64>, margin: f64) -> bool {
    let (sin, cos) = yaw.sin_cos();
    let d = p - at.xy();
    let (along, across) = (d.x * cos + d.y * sin, d.y * cos - d.x * sin);
    along.abs() <= 0.5 * label.size.0 + margin && across.abs() <= 0.5 * label.size.1 + margin
}

fn around(cell: Cell) -> impl Iterator<Item = Cell> {
    (-1..=1).flat_map(move |dy| (-1..=1).map(move |dx| Cell::new(cell.x + dx, cell.y + dy)))
}

/// Cells within a distance of the way, metres.
fn near(grid: &DenseGrid, way: &[Point2<f64>], within_m: f64) -> BTreeSet<(i32, i32)> {
    let mut out = BTreeSet::new();
    let reach = (within_m / grid.geometry.resolution_m).ceil() as i32;
    for p in way {
        let Some(cell) = grid.geometry.cell(p) else { continue };
        for (dx, dy) in (-reach..=reach).flat_map(|dx| (-reach..=reach).map(move |dy| (dx, dy))) {
            let c = Cell::new(cell.x + dx, cell.y + dy);
            if (grid.geometry.center(c) - p).norm() <= within_m {
                out.insert((c.x, c.y));
            }
        }
    }
    out
}
