//! Furniture: what each piece is built of, and where there is room for it.

use super::WorldParams;
use super::layout::Room;
use crate::rng::{Purpose, stream};
use crate::solid::{PlanarFrame, Shape, Solid};
use crate::texture::{Material, Pattern};
use nalgebra::{Point2, Vector2};
use percept_geometry::{Aabb3, ObjectClass};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{FRAC_PI_2, PI};

/// Free space between two pieces, metres.
const APART_M: f64 = 0.35;
/// Free space between a piece and a wall, for all but shelves, metres.
const WALL_GAP_M: f64 = 0.12;
/// Places tried for a piece before it is left out.
const ATTEMPTS: usize = 80;

/// A piece of furniture: shapes in a frame whose origin is on the floor under its middle.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Piece {
    pub(crate) class: ObjectClass,
    pub(crate) frame: PlanarFrame,
    pub(crate) parts: Vec<Shape>,
    pub(crate) material: Material,
}

impl Piece {
    /// Smallest box around the parts, in the piece's frame.
    pub(crate) fn bounds(&self) -> Aabb3 {
        let mut out = Aabb3::empty();
        for part in &self.parts {
            out.grow(&part.bounds().min);
            out.grow(&part.bounds().max);
        }
        out
    }

    /// The parts, placed.
    pub(crate) fn solids(&self, object: u32) -> impl Iterator<Item = Solid> + '_ {
        self.parts.iter().map(move |&shape| Solid {
            shape,
            frame: self.frame,
            material: self.material,
            object: Some(object),
        })
    }

    /// Corners of the footprint in the world, counter-clockwise.
    fn footprint(&self) -> [Point2<f64>; 4] {
        let b = self.bounds();
        [(b.min.x, b.min.y), (b.max.x, b.min.y), (b.max.x, b.max.y), (b.min.x, b.max.y)]
            .map(|(x, y)| self.frame.xy_to_world(&Point2::new(x, y)))
    }

    /// Whether any of the points is nearer to the footprint than `clearance`, metres.
    fn is_near(&self, points: &[Point2<f64>], clearance: f64) -> bool {
        let b = self.bounds();
        points.iter().any(|p| {
            let q = self.frame.to_local(&nalgebra::Point3::new(p.x, p.y, 0.0)).xy();
            let d = (b.min.xy() - q).sup(&(q - b.max.xy())).map(|c| c.max(0.0));
            d.norm_squared() < clearance * clearance
        })
    }
}

/// Keep-out lines: points of a path and how far from them a piece has to stay, metres.
pub(crate) struct KeepOut<'a> {
    pub(crate) points: &'a [Point2<f64>],
    pub(crate) clearance_m: f64,
}

/// Fills a room with pieces that keep apart from each other, from the walls and from the paths.
pub(crate) fn furnish(params: &WorldParams, room: &Room, keep_out: &[KeepOut<'_>]) -> Vec<Piece> {
    let mut rng = stream(params.seed, Purpose::Furniture, room.id as u64, 0);
    let near: Vec<(Vec<Point2<f64>>, f64)> = keep_out
        .iter()
        .map(|k| {
            let margin = Vector2::repeat(k.clearance_m);
            let around = Room { id: room.id, min: room.min - margin, max: room.max + margin };
            (k.points.iter().filter(|p| around.contains(p)).copied().collect(), k.clearance_m)
        })
        .collect();
    let mut pieces: Vec<Piece> = Vec::new();
    for class in wish_list((params.furniture_per_m2 * room.area()).round() as usize, room.id) {
        for _ in 0..ATTEMPTS {
            let mut piece = build(class, &mut rng);
            place(&mut piece, room, &mut rng);
            if fits(&piece, room, &pieces, &near) {
                pieces.push(piece);
                break;
            }
        }
    }
    pieces
}

/// Which classes a room gets, large ones first, since they find room less easily.
fn wish_list(count: usize, room: usize) -> Vec<ObjectClass> {
    use ObjectClass::{Box, Chair, Cylinder, Shelf, Table};
    let cycle = [Table, Chair, Shelf, Box, Cylinder, Chair, Shelf, Box, Table, Cylinder];
    let mut list: Vec<ObjectClass> = (0..count).map(|i| cycle[(i + room) % cycle.len()]).collect();
    list.sort_by_key(|class| match class {
        Shelf => 0,
        Table => 1,
        _ => 2,
    });
    list
}

fn fits(piece: &Piece, room: &Room, others: &[Piece], near: &[(Vec<Point2<f64>>, f64)]) -> bool {
    let gap = if piece.class == ObjectClass::Shelf { 0.01 } else { WALL_GAP_M };
    let margin = Vector2::repeat(gap);
    let inner = Room { id: room.id, min: room.min + margin, max: room.max - margin };
    let footprint = piece.footprint();
    footprint.iter().all(|p| inner.contains(p))
        && others.iter().all(|other| polygon_distance(&footprint, &other.footprint()) >= APART_M)
        && near.iter().all(|(points, clearance)| !piece.is_near(points, *clearance))
}

/// Shelves stand with their back to a wall; the rest anywhere, often nearly square to the walls.
fn place(piece: &mut Piece, room: &Room, rng: &mut ChaCha8Rng) {
    let (x, y) = (rng.random_range(room.min.x..room.max.x), rng.random_range(room.min.y..room.max.y));
    if piece.class != ObjectClass::Shelf {
        let square = f64::from(rng.random_range(0..4)) * FRAC_PI_2;
        let turn = if rng.random_bool(0.5) { rng.random_range(-0.15..0.15) } else { rng.random_range(-0.78..0.78) };
        piece.frame = PlanarFrame::new(x, y, square + turn);
        return;
    }
    let back = 0.03 - piece.bounds().min.y;
    piece.frame = match rng.random_range(0..4) {
        0 => PlanarFrame::new(x, room.min.y + back, 0.0),
        1 => PlanarFrame::new(room.max.x - back, y, FRAC_PI_2),
        2 => PlanarFrame::new(x, room.max.y - back, PI),
        _ => PlanarFrame::new(room.min.x + back, y, -FRAC_PI_2),
    };
}

fn build(class: ObjectClass, rng: &mut ChaCha8Rng) -> Piece {
    let parts = match class {
        ObjectClass::Table => table(rng),
        ObjectClass::Chair => chair(rng),
        ObjectClass::Shelf => shelf(rng),
        ObjectClass::Cylinder => {
            let (radius, z_max) = (rng.random_range(0.15..0.3), rng.random_range(0.5..1.1));
            vec![Shape::Cylinder { x: 0.0, y: 0.0, radius, z_min: 0.0, z_max }]
        }
        _ => {
            let size = [(); 3].map(|()| rng.random_range(0.3..0.6));
            vec![Shape::block([0.0, 0.0, 0.5 * size[2]], size)]
        }
    };
    let material = Material { pattern: Pattern::Speckle, color: color(rng), seed: rng.random() };
    Piece { class, frame: PlanarFrame::WORLD, parts, material }
}

/// A saturated colour of any hue.
fn color(rng: &mut ChaCha8Rng) -> [f32; 3] {
    let hue: f32 = rng.random_range(0.0..6.0);
    let dull: f32 = rng.random_range(0.1..0.4);
    [0.0f32, 4.0, 2.0].map(|shift| {
        let f = (((hue + shift) % 6.0 - 3.0).abs() - 1.0).clamp(0.0, 1.0);
        0.95 * (dull + (1.0 - dull) * f)
    })
}

/// Four square legs of side `leg` under a plate of `w` x `d` at height `top`.
fn legs(w: f64, d: f64, leg: f64, top: f64) -> impl Iterator<Item = Shape> {
    [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
        .into_iter()
        .map(move |(sx, sy)| Shape::block([sx * 0.5 * (w - leg), sy * 0.5 * (d - leg), 0.5 * top], [leg, leg, top]))
}

fn table(rng: &mut ChaCha8Rng) -> Vec<Shape> {
    let (w, d, h) = (rng.random_range(1.0..1.5), rng.random_range(0.6..0.9), rng.random_range(0.70..0.76));
    let plate = 0.035;
    let mut parts = vec![Shape::block([0.0, 0.0, h - 0.5 * plate], [w, d, plate])];
    parts.extend(legs(w, d, 0.055, h - plate));
    parts
}

fn chair(rng: &mut ChaCha8Rng) -> Vec<Shape> {
    let (w, d, seat) = (rng.random_range(0.40..0.48), rng.random_range(0.40..0.48), rng.random_range(0.43..0.47));
    let top: f64 = rng.random_range(0.82..0.95);
    let mut parts = vec![
        Shape::block([0.0, 0.0, seat - 0.02], [w, d, 0.04]),
        Shape::block([0.0, -0.5 * d + 0.0175, 0.5 * (seat + top)], [w, 0.035, top - seat]),
    ];
    parts.extend(legs(w, d, 0.04, seat - 0.04));
    parts
}

/// Two sides, a back and boards; the back is at negative y.
fn shelf(rng: &mut ChaCha8Rng) -> Vec<Shape> {
    let (w, d, h) = (rng.random_range(0.7..1.2), rng.random_range(0.28..0.40), rng.random_range(1.6..2.0));
    let board = 0.025;
    let boards = rng.random_range(5..7);
    let mut parts = vec![
        Shape::block([0.0, -0.5 * d + 0.005, 0.5 * h], [w, 0.01, h]),
        Shape::block([-0.5 * (w - board), 0.0, 0.5 * h], [board, d, h]),
        Shape::block([0.5 * (w - board), 0.0, 0.5 * h], [board, d, h]),
    ];
    for i in 0..boards {
        let z = 0.5 * board + f64::from(i) / f64::from(boards - 1) * (h - board);
        parts.push(Shape::block([0.0, 0.0, z], [w, d, board]));
    }
    parts
}

/// Distance between two convex polygons given counter-clockwise, metres; 0 if they touch or overlap.
pub(crate) fn polygon_distance(a: &[Point2<f64>], b: &[Point2<f64>]) -> f64 {
    if percept_geometry::shapes::convex_intersection_area(a, b) > 0.0 {
        return 0.0;
    }
    let one_way = |p: &[Point2<f64>], q: &[Point2<f64>]| {
        p.iter()
            .flat_map(|v| (0..q.len()).map(move |i| segment_distance(v, &q[i], &q[(i + 1) % q.len()])))
            .fold(f64::INFINITY, f64::min)
    };
    one_way(a, b).min(one_way(b, a))
}

fn segment_distance(p: &Point2<f64>, a: &Point2<f64>, b: &Point2<f64>) -> f64 {
    let ab = b - a;
    let s = ((p - a).dot(&ab) / ab.norm_squared()).clamp(0.0, 1.0);
    (p - (a + ab * s)).norm()
}
