//! Places to be, and the ways between neighbouring ones.

use super::floor::Labels;
use super::{Door, Floor, Room, RoomId, RoomParams};
use nalgebra::Point2;
use percept_geometry::clearance_in_cells;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Number of a place, from 0; anew with each division.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct PlaceId(pub u32);

/// A place to be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    /// Number.
    pub id: PlaceId,
    /// Map frame, metres.
    pub position: Point2<f64>,
    /// From the nearest obstacle, furniture included, or from what is not known, metres.
    pub clearance_m: f64,
    /// The room that it lies in.
    pub room: RoomId,
    /// The door that it lies in, by its place in [`super::Rooms::doors`].
    pub door: Option<usize>,
}

/// A way between two places over free floor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlaceLink {
    /// The places, the smaller number first.
    pub places: (PlaceId, PlaceId),
    /// Its length, over cells, metres.
    pub length_m: f64,
}

/// Lengths of steps over cells, in thousandths: whole numbers are in one order wherever they come from.
const STRAIGHT: u64 = 1000;
const DIAGONAL: u64 = 1414;

/// Lays places over the floor that is free with all that stands there: in doors, where rooms are widest, and in between.
pub(super) fn lay(
    floor: &Floor<'_>,
    labels: &Labels,
    rooms: &[Room],
    doors: &[Door],
    params: &RoomParams,
) -> (Vec<Place>, Vec<PlaceLink>) {
    let resolution = floor.resolution_m();
    let closed: Vec<bool> = (0..floor.cells.len()).map(|i| !floor.is_free(i)).collect();
    let clearance = clearance_in_cells(&closed, floor.width, floor.height);
    let least = (params.place_clearance_m / resolution) as f32;
    let is_wide = |i: usize| !closed[i] && clearance[i] >= least && labels.get(i).is_some();
    let mut spots: Vec<(usize, Option<usize>)> = vec![];
    for (number, door) in doors.iter().enumerate() {
        let reach = (0.5 * door.width_m / resolution).ceil() as usize;
        let near = labels.index(&door.center).into_iter().flat_map(|i| disc(floor, i, reach)).filter(|i| is_wide(*i));
        let off = |i: usize| (floor.center(i) - door.center).norm();
        spots.extend(near.min_by(|a, b| off(*a).total_cmp(&off(*b)).then(a.cmp(b))).map(|i| (i, Some(number))));
    }
    let mut order: Vec<usize> = (0..floor.cells.len()).filter(|i| is_wide(*i)).collect();
    order.sort_by(|a, b| clearance[*b].total_cmp(&clearance[*a]).then(a.cmp(b)));
    let mut taken = Taken::new(floor, params.place_spacing_m);
    spots.iter().for_each(|(i, _)| taken.add(floor.center(*i)));
    for i in order {
        let p = floor.center(i);
        if !taken.is_near(&p) {
            taken.add(p);
            spots.push((i, None));
        }
    }
    let place = |(number, (i, door)): (usize, &(usize, Option<usize>))| Place {
        id: PlaceId(number as u32),
        position: floor.center(*i),
        clearance_m: f64::from(clearance[*i]) * resolution,
        // Only cells of rooms are taken.
        room: labels.get(*i).map_or(RoomId(0), |room| rooms[room].id),
        door: *door,
    };
    let places: Vec<Place> = spots.iter().enumerate().map(place).collect();
    let starts: Vec<usize> = spots.iter().map(|(i, _)| *i).collect();
    (places, links(floor, &starts, is_wide))
}

/// Cells within so many of one, along each axis.
fn disc(floor: &Floor<'_>, i: usize, reach: usize) -> impl Iterator<Item = usize> {
    let (x, y, width, height) = (i % floor.width, i / floor.width, floor.width, floor.height);
    let span = move |v: usize, size: usize| v.saturating_sub(reach)..=(v + reach).min(size - 1);
    span(y, height).flat_map(move |y| span(x, width).map(move |x| y * width + x))
}

/// Which places are taken, by squares of the spacing, with a rim of squares around the floor.
struct Taken {
    spacing_m: f64,
    origin: Point2<f64>,
    columns: usize,
    squares: Vec<Vec<Point2<f64>>>,
}

impl Taken {
    fn new(floor: &Floor<'_>, spacing_m: f64) -> Self {
        // A square is a cell at least: there are no more than there are cells, and the rim.
        let spacing_m = spacing_m.max(floor.resolution_m());
        let squares = |cells: usize| (cells as f64 * floor.resolution_m() / spacing_m).ceil() as usize + 3;
        let (columns, rows) = (squares(floor.width), squares(floor.height));
        Self { spacing_m, origin: floor.geometry.origin, columns, squares: vec![vec![]; columns * rows] }
    }

    /// Column and row, from 1.
    fn square(&self, p: &Point2<f64>) -> (usize, usize) {
        let at = (p - self.origin) / self.spacing_m;
        (at.x as usize + 1, at.y as usize + 1)
    }

    fn add(&mut self, p: Point2<f64>) {
        let (x, y) = self.square(&p);
        self.squares[y * self.columns + x].push(p);
    }

    fn is_near(&self, p: &Point2<f64>) -> bool {
        let (x, y) = self.square(p);
        let rows = (y - 1..=y + 1).map(|y| &self.squares[y * self.columns + x - 1..=y * self.columns + x + 1]);
        rows.flatten().flatten().any(|q| (p - q).norm() < self.spacing_m)
    }
}

/// Ways between places whose surroundings touch: each cell falls to the place that is nearest over free cells.
fn links(floor: &Floor<'_>, starts: &[usize], is_wide: impl Fn(usize) -> bool) -> Vec<PlaceLink> {
    let around = floor.around();
    let mut of: Vec<(u64, u32)> = vec![(u64::MAX, u32::MAX); floor.cells.len()];
    // By lengths of a shortest step: within one, no way is made shorter by another of its own. Source: Dial, "Algorithm 360: shortest-path
    // forest with topological ordering", 1969.
    let mut open: Vec<Vec<(u64, u32, usize)>> = vec![vec![]];
    for (number, i) in starts.iter().enumerate() {
        of[*i] = (0, number as u32);
        open[0].push((0, number as u32, *i));
    }
    let mut at = 0;
    while at < open.len() {
        let Some((length, number, i)) = open[at].pop() else {
            at += 1;
            continue;
        };
        if of[i] != (length, number) {
            continue;
        }
        for next in around.eight(i).filter(|j| is_wide(*j)) {
            let there = (length + step(floor, i, next), number);
            if there < of[next] {
                of[next] = there;
                let steps = (there.0 / STRAIGHT) as usize;
                if open.len() <= steps {
                    open.resize_with(steps + 1, Vec::new);
                }
                open[steps].push((there.0, number, next));
            }
        }
    }
    let mut shortest = BTreeMap::<(u32, u32), u64>::new();
    for i in (0..of.len()).filter(|i| of[*i].1 != u32::MAX) {
        for next in around.eight(i).filter(|j| of[*j].1 != u32::MAX && of[*j].1 > of[i].1) {
            let length = of[i].0 + step(floor, i, next) + of[next].0;
            let known = shortest.entry((of[i].1, of[next].1)).or_insert(u64::MAX);
            *known = (*known).min(length);
        }
    }
    let length_m = |thousandths: u64| thousandths as f64 / STRAIGHT as f64 * floor.resolution_m();
    shortest
        .into_iter()
        .map(|((a, b), length)| PlaceLink { places: (PlaceId(a), PlaceId(b)), length_m: length_m(length) })
        .collect()
}

fn step(floor: &Floor<'_>, a: usize, b: usize) -> u64 {
    if a.abs_diff(b) == 1 || a.abs_diff(b) == floor.width { STRAIGHT } else { DIAGONAL }
}
