//! Occupied space, as points or voxels: its ground, places on it, and beams through it.

use super::GivenOptions;
use super::lattice::best_of_squares;
use crate::MappingError;
use crate::blocks::{BLOCK, BlockKey, locate};
use nalgebra::{Point3, Vector3};
use percept_geometry::{Cell, PointCloud, Voxel};
use rustc_hash::{FxHashMap, FxHashSet};
use std::collections::BTreeMap;

/// So many views stand along the range of one: what is seen from a place is seen from several, and a robot that is there is within a
/// square of one of them. Squares have edges between these, metres.
const VIEWS_A_RANGE: f64 = 8.0;
const SQUARE_M: (f64, f64) = (2.0, 5.0);
/// Squares are larger where there would be more views.
pub(super) const MOST_VIEWS: usize = 1_000;
/// What stands over the ground lower than this leaves no room for a robot, metres.
const HEADROOM_M: f64 = 1.2;
/// Ground hangs together over steps up to this, metres: a kerb, a stair.
const STEP_M: f64 = 0.25;
/// Ground of less area than this that hangs on nothing is a piece of furniture, square metres.
const LEAST_GROUND_M2: f64 = 4.0;
/// Ground is within this of where robots stood, up or down, metres: ramps between one keyframe and the next, and what a map is off by.
const NEAR_FLOOR_M: f64 = 0.5;
/// Where a robot stood there is room around, metres, and one place speaks for so much, too.
const STOOD_ROOM_M: f64 = 1.0;
/// A part of the ground is large if it has this share of the largest part.
const LARGE: f64 = 0.2;

/// Occupied space.
#[derive(Debug, Clone)]
pub struct GivenSpace {
    pub(super) voxel_m: f64,
    /// Points of each voxel, by their numbers in `points`.
    pub(super) occupied: FxHashMap<Voxel, Vec<u32>>,
    pub(super) points: PointCloud,
    pub(super) open: Open,
    /// Points of the floor on which robots stood.
    stood: Vec<Point3<f64>>,
}

/// What is seen through, a bit a voxel: a beam asks for hundreds of voxels, many in one block.
#[derive(Debug, Clone)]
pub(super) enum Open {
    /// Whatever is not among these, which are occupied.
    AllBut(FxHashMap<BlockKey, Bits>),
    /// These, which are known to be free.
    Only(FxHashMap<BlockKey, Bits>),
}

/// Voxels of a block.
pub(super) type Bits = [u64; 8];
/// Heights of the ground, voxels.
pub(super) type Ground = FxHashMap<Cell, i32>;

impl Open {
    fn block(&self, key: BlockKey) -> Option<&Bits> {
        let (Self::AllBut(blocks) | Self::Only(blocks)) = self;
        blocks.get(&key)
    }

    /// Whether a voxel of a block is open, by its slot there.
    fn is_open(&self, block: Option<&Bits>, slot: u16) -> bool {
        let is_set = block.is_some_and(|bits| bits[usize::from(slot / 64)] >> (slot % 64) & 1 == 1);
        is_set == matches!(self, Self::Only(_))
    }
}

fn blocks_of(voxels: impl Iterator<Item = Voxel>) -> FxHashMap<BlockKey, Bits> {
    let mut out: FxHashMap<BlockKey, Bits> = FxHashMap::default();
    for (block, slot) in voxels.map(locate) {
        out.entry(block).or_default()[usize::from(slot / 64)] |= 1 << (slot % 64);
    }
    out
}

impl GivenSpace {
    /// Points as they come, in voxels of this edge (metres).
    ///
    /// # Errors
    /// `InvalidParam` for an edge that is not positive, `PointTooFar` for points that are not finite or beyond all numbers of voxels.
    pub fn of_points(points: PointCloud, voxel_m: f64) -> Result<Self, MappingError> {
        if !(voxel_m.is_finite() && voxel_m > 0.0) {
            let remedy = "choose a positive number of metres";
            return Err(MappingError::InvalidParam { field: "voxel_size_m", value: voxel_m, remedy });
        }
        let mut occupied: FxHashMap<Voxel, Vec<u32>> = FxHashMap::default();
        for (k, p) in points.positions.iter().enumerate() {
            let voxel = Voxel::containing(&p.cast(), voxel_m).ok_or(MappingError::PointTooFar)?;
            occupied.entry(voxel).or_default().push(k as u32);
        }
        let open = Open::AllBut(blocks_of(occupied.keys().copied()));
        Ok(Self { voxel_m, occupied, points, open, stood: vec![] })
    }

    /// Voxels that are known to be occupied, and those known to be free.
    ///
    /// # Errors
    /// As [`Self::of_points`].
    pub fn of_voxels(
        occupied: &[Voxel],
        free: impl Iterator<Item = Voxel>,
        voxel_m: f64,
    ) -> Result<Self, MappingError> {
        let centers = occupied.iter().map(|v| v.center(voxel_m).cast::<f32>()).collect();
        Ok(Self { open: Open::Only(blocks_of(free)), ..Self::of_points(PointCloud::from_positions(centers), voxel_m)? })
    }

    /// The same with points of the floor on which robots stood while they saw it (metres, as the points): ground is at these heights
    /// alone, and around them also where nothing of it was seen, as by a lidar that hardly looks down.
    #[must_use]
    pub fn with_stood(mut self, mut stood: Vec<Point3<f64>>) -> Self {
        let square = |p: &Point3<f64>| (p.coords * 2.0 / STOOD_ROOM_M).map(|v| v.floor() as i64);
        stood.retain(|p| p.iter().all(|v| v.is_finite()));
        stood.sort_by_key(|p| (square(p).x, square(p).y, square(p).z));
        stood.dedup_by_key(|p| square(p));
        self.stood = stood;
        self
    }

    /// Voxels known to be free; none if all are that are not occupied.
    pub(super) fn free(&self) -> impl Iterator<Item = Voxel> {
        let blocks = match &self.open {
            Open::Only(blocks) => Some(blocks),
            Open::AllBut(_) => None,
        };
        let of_block = |((x, y, z), bits): (&BlockKey, &Bits)| {
            let (low, bits) = ((x * BLOCK, y * BLOCK, z * BLOCK), *bits);
            let is_set = move |slot: &i32| bits[*slot as usize / 64] >> (slot % 64) & 1 == 1;
            (0..BLOCK.pow(3)).filter(is_set).map(move |slot| {
                Voxel::new(low.0 + slot % BLOCK, low.1 + slot / BLOCK % BLOCK, low.2 + slot / (BLOCK * BLOCK))
            })
        };
        blocks.into_iter().flatten().flat_map(of_block)
    }

    pub(super) fn is_open(&self, voxel: Voxel) -> bool {
        let (block, slot) = locate(voxel);
        self.open.is_open(self.open.block(block), slot)
    }

    /// Places to look from: the sensor's height above the ground.
    pub(super) fn places(&self, ground: &Ground, options: &GivenOptions) -> Vec<Voxel> {
        let up = self.up(options);
        let mut ranked: Vec<(Cell, f32)> = ground.iter().map(|(c, z)| (*c, self.room_around(*c, *z + up))).collect();
        ranked.sort_by_key(|(c, _)| *c);
        let (nearest, farthest) = SQUARE_M;
        let square_m = (options.range_max_m / VIEWS_A_RANGE).clamp(nearest, farthest);
        let mut edge = (square_m / self.voxel_m).ceil().max(1.0) as i32;
        let mut best = best_of_squares(ranked.iter().copied(), edge);
        while best.len() > MOST_VIEWS {
            edge = edge.saturating_mul(5) / 4 + 1;
            best = best_of_squares(ranked.iter().copied(), edge);
        }
        best.iter().filter_map(|c| ground.get(c).map(|z| Voxel::new(c.x, c.y, z + up))).collect()
    }

    /// The sensor's height above the ground, voxels.
    fn up(&self, options: &GivenOptions) -> i32 {
        ((options.sensor_height_m / self.voxel_m).round() as i32).max(1)
    }

    /// Heights of what a robot can stand on: surfaces with room above that hang together. Of large ones over each other it is the
    /// lower: roofs, and ceilings without a roof, have room above, too. Tops of tables are too small.
    pub(super) fn ground(&self, options: &GivenOptions) -> Ground {
        let up = self.up(options);
        let room = (HEADROOM_M.max(options.sensor_height_m + self.voxel_m) / self.voxel_m).ceil() as i32;
        let mut columns: BTreeMap<Cell, Vec<i32>> = BTreeMap::new();
        self.occupied.keys().for_each(|v| columns.entry(Cell::new(v.x, v.y)).or_default().push(v.z));
        for (cell, heights) in &mut columns {
            heights.sort_unstable();
            let has_room = |k: usize| heights.get(k + 1).is_none_or(|above| above - heights[k] > room);
            let is_open = |z: i32| self.is_open(Voxel::new(cell.x, cell.y, z + up));
            *heights =
                (0..heights.len()).filter(|k| has_room(*k) && is_open(heights[*k])).map(|k| heights[k]).collect();
        }
        let floors = self.floors();
        if !floors.is_empty() {
            let near = (NEAR_FLOOR_M / self.voxel_m).ceil() as i32;
            let is_near =
                |z: i32| floors.get(floors.partition_point(|f| *f < z - near)).is_some_and(|f| *f <= z + near);
            columns.values_mut().for_each(|heights| heights.retain(|z| is_near(*z)));
        }
        let step = (STEP_M / self.voxel_m).ceil() as i32;
        let mut taken: FxHashSet<(Cell, i32)> = FxHashSet::default();
        let mut parts: Vec<Vec<(Cell, i32)>> = vec![];
        for (cell, heights) in &columns {
            for z in heights {
                if !taken.insert((*cell, *z)) {
                    continue;
                }
                let (mut part, mut next) = (vec![(*cell, *z)], 0);
                while let Some((at, z)) = part.get(next).copied() {
                    next += 1;
                    for (x, y) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
                        let beside = Cell::new(at.x + x, at.y + y);
                        for other in columns.get(&beside).into_iter().flatten() {
                            if (other - z).abs() <= step && taken.insert((beside, *other)) {
                                part.push((beside, *other));
                            }
                        }
                    }
                }
                parts.push(part);
            }
        }
        let least = (LEAST_GROUND_M2 / self.voxel_m.powi(2)) as usize;
        let largest = parts.iter().map(Vec::len).max().unwrap_or(0);
        let is_large = |p: &Vec<(Cell, i32)>| p.len() as f64 >= LARGE * largest as f64;
        let height = |p: &Vec<(Cell, i32)>| p.iter().map(|(_, z)| i64::from(*z)).sum::<i64>() / p.len().max(1) as i64;
        parts.sort_by_cached_key(|p| match is_large(p) {
            true => (0, height(p), p.first().copied()),
            false => (1, -(p.len() as i64), p.first().copied()),
        });
        let mut ground = Ground::default();
        for (k, part) in parts.iter().enumerate() {
            let over = part.iter().filter(|(c, _)| ground.contains_key(c)).count();
            if k == 0 || (part.len() >= least && 5 * over < part.len()) {
                part.iter().for_each(|(c, z)| _ = ground.entry(*c).or_insert(*z));
            }
        }
        self.stood.iter().for_each(|p| self.lay_ground(p, up, &mut ground));
        ground
    }

    /// Heights on which robots stood, voxels, ascending: of the voxel below.
    fn floors(&self) -> Vec<i32> {
        let mut floors: Vec<i32> = self.stood.iter().map(|p| self.below(p)).collect();
        floors.sort_unstable();
        floors.dedup();
        floors
    }

    fn below(&self, floor: &Point3<f64>) -> i32 {
        (floor.z / self.voxel_m).round() as i32 - 1
    }

    /// Ground around where a robot stood, where none is known: as far as nothing stands in between.
    fn lay_ground(&self, stood: &Point3<f64>, up: i32, ground: &mut Ground) {
        let z = self.below(stood);
        let cell = |v: f64| (v / self.voxel_m).floor() as i32;
        let start = Cell::new(cell(stood.x), cell(stood.y));
        let reach = (STOOD_ROOM_M / self.voxel_m).ceil() as i32;
        let is_clear = |c: Cell| (1..=up).all(|k| self.is_open(Voxel::new(c.x, c.y, z + k)));
        let (mut next, mut seen) = (vec![start], FxHashSet::from_iter([start]));
        while let Some(at) = next.pop() {
            if !is_clear(at) {
                continue;
            }
            ground.entry(at).or_insert(z);
            for (x, y) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
                let beside = Cell::new(at.x + x, at.y + y);
                let is_far = (beside.x - start.x).abs().max((beside.y - start.y).abs()) > reach;
                if !is_far && seen.insert(beside) {
                    next.push(beside);
                }
            }
        }
    }

    /// How far from a place the next voxel that is not open is, along the axes and diagonals of the plane, voxels; at most 16.
    fn room_around(&self, cell: Cell, z: i32) -> f32 {
        let directions = [(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)];
        let reach =
            |r: &i32| directions.iter().all(|(x, y)| self.is_open(Voxel::new(cell.x + x * r, cell.y + y * r, z)));
        (1..=16).take_while(reach).count() as f32
    }

    /// Goes along a beam from voxel to voxel (Amanatides and Woo 1987), and tells of those that are open.
    pub(super) fn walk(
        &self,
        eye: &Point3<f64>,
        direction: &Vector3<f64>,
        range_m: f64,
        mut passed: impl FnMut(BlockKey, u16),
    ) -> Beam {
        let Some(mut at) = Voxel::containing(eye, self.voxel_m) else { return Beam::Lost };
        let axis = |p: f64, d: f64, cell: i32| {
            if d == 0.0 {
                return (f64::INFINITY, f64::INFINITY);
            }
            let border = (f64::from(cell) + if d > 0.0 { 1.0 } else { 0.0 }) * self.voxel_m;
            ((border - p) / d, self.voxel_m / d.abs())
        };
        let (mut tx, dx) = axis(eye.x, direction.x, at.x);
        let (mut ty, dy) = axis(eye.y, direction.y, at.y);
        let (mut tz, dz) = axis(eye.z, direction.z, at.z);
        let step = |d: f64| if d > 0.0 { 1 } else { -1 };
        let (sx, sy, sz) = (step(direction.x), step(direction.y), step(direction.z));
        let (mut in_block, slot) = locate(at);
        let mut block = self.open.block(in_block);
        if self.open.is_open(block, slot) {
            passed(in_block, slot);
        }
        loop {
            if tx.min(ty).min(tz) > range_m {
                return Beam::Open;
            }
            if tx <= ty && tx <= tz {
                (at.x, tx) = (at.x + sx, tx + dx);
            } else if ty <= tz {
                (at.y, ty) = (at.y + sy, ty + dy);
            } else {
                (at.z, tz) = (at.z + sz, tz + dz);
            }
            let (key, slot) = locate(at);
            if key != in_block {
                (in_block, block) = (key, self.open.block(key));
            }
            if !self.open.is_open(block, slot) {
                return if self.occupied.contains_key(&at) { Beam::Ends(at) } else { Beam::Lost };
            }
            passed(key, slot);
        }
    }
}

/// What becomes of a beam.
pub(super) enum Beam {
    /// It meets something here.
    Ends(Voxel),
    /// It meets nothing within the range.
    Open,
    /// It comes to where nothing is known.
    Lost,
}
