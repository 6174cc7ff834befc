//! Rooms in rows and columns, the walls between them and the doors in those walls.

use super::WorldParams;
use crate::rng::{Purpose, hash_unit, stream};
use crate::solid::{PlanarFrame, Shape, Solid};
use crate::texture::{Material, Pattern};
use nalgebra::Point2;
use rand::RngExt;

/// Thickness of a wall, metres.
pub(crate) const WALL_M: f64 = 0.15;
/// Floor to ceiling, metres.
pub(crate) const HEIGHT_M: f64 = 2.6;
const DOOR_WIDTH_M: f64 = 1.0;
const DOOR_HEIGHT_M: f64 = 2.1;
/// Distance of the robot's ring lane in a room from its walls, metres.
pub(crate) const RING_INSET_M: f64 = 1.4;
/// A room in which a person walks is at least this wide, metres.
const PERSON_ROOM_M: f64 = 5.6;

/// The free rectangle of a room between its walls, world frame, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Room {
    /// Index of the room.
    pub id: usize,
    /// Corner with the smallest coordinates.
    pub min: Point2<f64>,
    /// Corner with the largest coordinates.
    pub max: Point2<f64>,
}

impl Room {
    /// Whether `p` lies in the room.
    pub fn contains(&self, p: &Point2<f64>) -> bool {
        p.x >= self.min.x && p.x <= self.max.x && p.y >= self.min.y && p.y <= self.max.y
    }

    /// Width along x times depth along y, square metres.
    pub fn area(&self) -> f64 {
        (self.max.x - self.min.x) * (self.max.y - self.min.y)
    }
}

/// A door opening between two rooms, without a leaf.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Door {
    /// The rooms that it joins, the smaller index first.
    pub rooms: (usize, usize),
    /// Middle of the opening, world frame, metres.
    pub center: Point2<f64>,
    /// Whether the wall runs along x (one passes along y).
    pub wall_along_x: bool,
    /// Width of the opening, metres.
    pub width_m: f64,
    /// Height of the opening, metres.
    pub height_m: f64,
}

/// Rooms, doors and the solids of floor, ceiling and walls.
pub(crate) struct Layout {
    pub(crate) rooms: Vec<Room>,
    pub(crate) doors: Vec<Door>,
    pub(crate) solids: Vec<Solid>,
    /// Rooms in a row.
    pub(crate) columns: usize,
    /// The room in which the person walks.
    pub(crate) person_room: Option<usize>,
}

/// The grid of rooms: where each column and row begins, and how wide it is.
struct Lines {
    x: Vec<f64>,
    width: Vec<f64>,
    y: Vec<f64>,
    depth: Vec<f64>,
    rooms: usize,
}

impl Lines {
    fn columns(&self) -> usize {
        self.width.len()
    }

    fn rows(&self) -> usize {
        self.depth.len()
    }

    /// The room in this column and row, if there is one.
    fn room(&self, column: isize, row: isize) -> Option<usize> {
        let inside = column >= 0 && row >= 0 && (column as usize) < self.columns() && (row as usize) < self.rows();
        let id = row.max(0) as usize * self.columns() + column.max(0) as usize;
        (inside && id < self.rooms).then_some(id)
    }
}

/// Draws the rooms and builds what encloses them.
pub(crate) fn generate(params: &WorldParams) -> Layout {
    let mut rng = stream(params.seed, Purpose::Layout, 0, 0);
    let num_rooms = if params.corridor_m.is_some() { 1 } else { params.rooms };
    let columns = (num_rooms as f64).sqrt().ceil() as usize;
    let rows = num_rooms.div_ceil(columns);
    let mut draw =
        |n: usize| -> Vec<f64> { (0..n).map(|_| rng.random_range(params.room_min_m..=params.room_max_m)).collect() };
    let (mut width, mut depth) = (draw(columns), draw(rows));
    let person_room = (params.person && params.corridor_m.is_none()).then(|| rng.random_range(0..num_rooms));
    if let Some(length_m) = params.corridor_m {
        (width, depth) = (vec![length_m], vec![params.room_min_m]);
    }
    if let Some(room) = person_room {
        let (column, row) = (room % columns, room / columns);
        width[column] = width[column].max(PERSON_ROOM_M);
        depth[row] = depth[row].max(PERSON_ROOM_M);
    }
    let starts = |sizes: &[f64]| -> Vec<f64> {
        sizes.iter().chain([&0.0]).scan(WALL_M, |at, size| Some(std::mem::replace(at, *at + size + WALL_M))).collect()
    };
    let lines = Lines { x: starts(&width), y: starts(&depth), width, depth, rooms: num_rooms };
    let rooms = (0..num_rooms)
        .map(|id| {
            let (c, r) = (id % columns, id / columns);
            let min = Point2::new(lines.x[c], lines.y[r]);
            Room { id, min, max: Point2::new(min.x + lines.width[c], min.y + lines.depth[r]) }
        })
        .collect();
    let mut layout = Layout { rooms, doors: vec![], solids: slabs(&lines, params.seed), columns, person_room };
    for row in 0..=lines.rows() as isize {
        for column in 0..=lines.columns() as isize {
            let mut between = |a: Option<usize>, b: Option<usize>, along_x: bool| {
                let at = rng.random_range(0.0..=1.0);
                add_wall(&mut layout, &lines, (column as usize, row as usize), a, b, along_x, at, params.seed);
            };
            if row < lines.rows() as isize {
                between(lines.room(column - 1, row), lines.room(column, row), false);
            }
            if column < lines.columns() as isize {
                between(lines.room(column, row - 1), lines.room(column, row), true);
            }
        }
    }
    layout
}

/// The wall at the lower (`along_x`) or left side of grid place `(column, row)`, with a door if it
/// stands between two rooms; `at` in 0..1 places the door.
fn add_wall(
    layout: &mut Layout,
    lines: &Lines,
    (column, row): (usize, usize),
    a: Option<usize>,
    b: Option<usize>,
    along_x: bool,
    at: f64,
    seed: u64,
) {
    if a.is_none() && b.is_none() {
        return;
    }
    let (across, start, length) = if along_x {
        (lines.y[row], lines.x[column], lines.width[column])
    } else {
        (lines.x[column], lines.y[row], lines.depth[row])
    };
    let material = paint(seed, layout.solids.len());
    let mut slab = |from: f64, to: f64, z0: f64, z1: f64| {
        let (middle, span) = (0.5 * (from + to), to - from);
        let (center, size) = if along_x {
            ([middle, across - 0.5 * WALL_M, 0.5 * (z0 + z1)], [span, WALL_M, z1 - z0])
        } else {
            ([across - 0.5 * WALL_M, middle, 0.5 * (z0 + z1)], [WALL_M, span, z1 - z0])
        };
        layout.solids.push(Solid {
            shape: Shape::block(center, size),
            frame: PlanarFrame::WORLD,
            material,
            object: None,
        });
    };
    let (low, high) = (start - WALL_M, start + length + WALL_M);
    let (Some(a), Some(b)) = (a, b) else {
        slab(low, high, 0.0, HEIGHT_M);
        return;
    };
    // The door opens onto the straight part of the ring lanes on both sides.
    let middle = start + RING_INSET_M + at * (length - 2.0 * RING_INSET_M);
    let (left, right) = (middle - 0.5 * DOOR_WIDTH_M, middle + 0.5 * DOOR_WIDTH_M);
    slab(low, left, 0.0, HEIGHT_M);
    slab(right, high, 0.0, HEIGHT_M);
    slab(left, right, DOOR_HEIGHT_M, HEIGHT_M);
    let across = across - 0.5 * WALL_M;
    let center = if along_x { Point2::new(middle, across) } else { Point2::new(across, middle) };
    layout.doors.push(Door {
        rooms: (a.min(b), a.max(b)),
        center,
        wall_along_x: along_x,
        width_m: DOOR_WIDTH_M,
        height_m: DOOR_HEIGHT_M,
    });
}

/// One of a few pale colours.
fn paint(seed: u64, index: usize) -> Material {
    let seed = (seed as u32) ^ (index as u32).wrapping_mul(0x9E37);
    let color = std::array::from_fn(|c| 0.62 + 0.3 * hash_unit(index as i32, c as i32, seed));
    Material { pattern: Pattern::Wall, color, seed }
}

/// Floor and ceiling, 0.1 m thick, under and over everything.
fn slabs(lines: &Lines, seed: u64) -> Vec<Solid> {
    let far = |starts: &[f64]| starts.last().copied().unwrap_or(0.0);
    let (x, y) = (far(&lines.x), far(&lines.y));
    let slab = |z: f64, pattern, color| Solid {
        shape: Shape::block([0.5 * x, 0.5 * y, z], [x, y, 0.1]),
        frame: PlanarFrame::WORLD,
        material: Material { pattern, color, seed: seed as u32 },
        object: None,
    };
    vec![slab(-0.05, Pattern::Floor, [0.62, 0.46, 0.32]), slab(HEIGHT_M + 0.05, Pattern::Ceiling, [0.92, 0.92, 0.9])]
}
