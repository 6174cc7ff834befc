//! One keyframe as heights: of the ground, of what stands on it and hangs over it, and of the beams that passed.

use super::HeightParams;
use super::beams::{Beams, Window};
use super::bits::Bits;
use super::look::{DEEP_M, Look};
use super::tile::{BLOCK, NUM_BLOCKS, Seen, block_of};
use crate::KeyframeView;
use crate::ground::{Ground, Place};
use crate::layer::TileKey;
use crate::occupancy::{TILE, locate, overlap};
use nalgebra::{Point2, Point3};
use percept_geometry::grid::walk;
use percept_geometry::{Aabb3, Cell as At, GridGeometry, Voxel};

/// What hides behind the edge of a drop is known as one so far, metres.
const HIDDEN_M: f64 = 1.0;

/// What one keyframe says about heights. Depends on the pose and the scan alone, so that many keyframes can be worked on at once.
#[derive(Debug, Clone)]
pub struct HeightUpdate {
    /// Ascending by tile.
    pub(super) tiles: Vec<(TileKey, Seen)>,
    /// Around all that it says.
    pub(super) bounds: Aabb3,
}

/// Cells around the sensor: which of what is gathered belongs to each.
struct Gathered {
    geometry: GridGeometry,
    min: At,
    width: usize,
    /// Row-major; `u32::MAX` for none.
    of_cell: Vec<u32>,
    looks: Vec<Look>,
}

impl HeightUpdate {
    /// Of a keyframe that says nothing.
    pub(super) fn empty() -> Self {
        Self { tiles: vec![], bounds: Aabb3::empty() }
    }

    /// What a keyframe says. Nothing, if heights are not kept or its scan is planar. Points that are not finite, or
    /// beyond the range of the indices, say nothing.
    pub fn new(params: &HeightParams, view: &KeyframeView<'_>) -> Self {
        if !params.enabled || view.scan.planar {
            return Self::empty();
        }
        let (sensor, hits, misses) = (view.sensor(), view.hits(), view.misses());
        let (floor_z, ground) = (view.floor_z(), view.ground(&params.of_ground()));
        let missed: Vec<Place> = misses.iter().map(|p| Place::of(&sensor, p)).collect();
        let ranges = ground.places().iter().chain(&missed).map(|place| f64::from(place.range));
        let range = ranges.filter(|r| r.is_finite()).fold(0.0, f64::max).min(params.range_max());
        let Some(mut gathered) = Gathered::new(params, &sensor, range) else { return Self::empty() };
        let mut beams = Beams::new(params, range);
        let ends = ground.places().iter().zip(hits).chain(missed.iter().zip(misses));
        ends.for_each(|(place, p)| beams.add(place, p.z - sensor.z));
        gathered.gather(params, &sensor, &ground, hits);
        let passed = beams.passed(params, &sensor, &ground, range, gathered.blocks());
        gathered.tiles(passed, floor_z)
    }
}

impl Gathered {
    /// None if it reaches beyond the range of the indices.
    fn new(params: &HeightParams, sensor: &Point3<f64>, range: f64) -> Option<Self> {
        let geometry = GridGeometry::new(params.resolution_m, Point2::origin());
        let half = (range / params.resolution_m).ceil() as i32 + BLOCK;
        let center = Voxel::containing(sensor, params.resolution_m)?;
        let first = |c: i32| Some(c.checked_sub(half)?.div_euclid(BLOCK) * BLOCK);
        let min = At::new(first(center.x)?, first(center.y)?);
        let width = 2 * (half + BLOCK);
        min.x.checked_add(width).and(min.y.checked_add(width))?;
        let width = width as usize;
        Some(Self { geometry, min, width, of_cell: vec![u32::MAX; width * width], looks: vec![] })
    }

    fn blocks(&self) -> Window {
        let min = (self.min.x.div_euclid(BLOCK), self.min.y.div_euclid(BLOCK));
        Window { min, width: self.width / BLOCK as usize }
    }

    /// What is gathered of a cell, begun if need be; none outside of the window.
    fn look_at(&mut self, cell: At, expected: f64) -> Option<u32> {
        let (x, y) = (i64::from(cell.x) - i64::from(self.min.x), i64::from(cell.y) - i64::from(self.min.y));
        let width = self.width as i64;
        if x < 0 || y < 0 || x >= width || y >= width {
            return None;
        }
        let of_cell = &mut self.of_cell[(y * width + x) as usize];
        if *of_cell == u32::MAX {
            *of_cell = self.looks.len() as u32;
            self.looks.push(Look::unseen(expected));
        }
        Some(*of_cell)
    }

    fn gather(&mut self, params: &HeightParams, sensor: &Point3<f64>, ground: &Ground, points: &[Point3<f64>]) {
        let mut looks = vec![u32::MAX; points.len()];
        for ((p, place), of_point) in points.iter().zip(ground.places()).zip(&mut looks) {
            let Some(patch) = ground.under(place) else { continue };
            let expected = patch.z_at(place.range.into());
            let Some(look) = self.geometry.cell(&p.xy()).and_then(|cell| self.look_at(cell, expected)) else {
                continue;
            };
            *of_point = look;
            self.looks[look as usize].lower(p.z, expected, patch);
            if patch.is_drop && p.z - expected < -DEEP_M {
                self.mark_drop(sensor, p, expected);
            }
        }
        let per_m = 1.0 / Bits::bin_m(params);
        for ((p, place), look) in points.iter().zip(ground.places()).zip(looks) {
            let (Some(look), Some(patch)) = (self.looks.get_mut(look as usize), ground.under(place)) else { continue };
            look.add(params, sensor, p, (place, patch), per_m);
        }
        self.looks.iter_mut().for_each(|look| look.settle(per_m));
    }

    /// From where a beam went below the ground there is none, up to where it ended.
    fn mark_drop(&mut self, sensor: &Point3<f64>, p: &Point3<f64>, expected: f64) {
        let share = (sensor.z - expected) / (sensor.z - p.z);
        if !(0.0..1.0).contains(&share) {
            return;
        }
        let edge = sensor + (p - sensor) * share;
        let hidden = p.xy() - edge.xy();
        let end = edge.xy() + hidden * (HIDDEN_M / hidden.norm().max(1e-9)).min(1.0);
        let geometry = self.geometry;
        walk(&geometry, &edge.xy(), &end, |cell| {
            if let Some(look) = self.look_at(cell, expected) {
                self.looks[look as usize].is_drop = true;
            }
        });
    }

    /// What is gathered, tile by tile, with where beams passed (row-major over the blocks).
    fn tiles(&self, mut passed: Vec<(Bits, f32)>, floor_z: f64) -> HeightUpdate {
        let (blocks, edge) = (self.blocks(), BLOCK as usize);
        // Beams that passed beside what they hit do not speak against it.
        for (i, look) in self.of_cell.iter().enumerate() {
            let Some(look) = self.looks.get(*look as usize).filter(|l| !l.standing.is_empty()) else { continue };
            let block = &mut passed[i / self.width / edge * blocks.width + i % self.width / edge].0;
            *block = block.without(look.standing.widened());
        }
        let mut update = HeightUpdate::empty();
        let last = At::new(self.min.x + self.width as i32 - 1, self.min.y + self.width as i32 - 1);
        let ((low, _), (high, _)) = (locate(self.min), locate(last));
        for key in (low.0..=high.0).flat_map(|x| (low.1..=high.1).map(move |y| (x, y))) {
            let (x0, x1) = overlap(key.0, self.min.x, self.width);
            let (y0, y1) = overlap(key.1, self.min.y, self.width);
            let mut seen = Seen { cells: vec![], passes: vec![] };
            let slot = |x: usize, y: usize| locate(At::new(self.min.x + x as i32, self.min.y + y as i32)).1;
            for y in y0..y1 {
                let row = (x0..x1).zip(&self.of_cell[y * self.width + x0..y * self.width + x1]);
                for (x, look) in row.filter(|(_, look)| **look != u32::MAX) {
                    let cell = self.looks[*look as usize].cell();
                    if cell.is_known() {
                        seen.cells.push((slot(x, y) as u16, cell));
                    }
                }
            }
            // Windows and tiles begin and end with blocks.
            for y in y0 / edge..y1 / edge {
                let row =
                    (x0 / edge..x1 / edge).zip(&passed[y * blocks.width + x0 / edge..y * blocks.width + x1 / edge]);
                for (x, (bits, z)) in row.filter(|(_, (bits, _))| !bits.is_empty()) {
                    seen.passes.push((block_of(slot(x * edge, y * edge)) as u16, *bits, *z));
                }
            }
            update.take(key, seen, self.geometry.resolution_m);
        }
        if !update.tiles.is_empty() {
            let (low, high) = (&mut update.bounds.min.z, &mut update.bounds.max.z);
            (*low, *high) = (low.min(floor_z), high.max(floor_z));
        }
        update
    }
}

impl HeightUpdate {
    fn take(&mut self, key: TileKey, seen: Seen, resolution_m: f64) {
        let at = |slot: usize| ((slot as i32) % TILE, (slot as i32) / TILE);
        let mut grow = |(x, y): (i32, i32), z: f32| {
            let center = |tile: i32, i: i32| (f64::from(tile * TILE + i) + 0.5) * resolution_m;
            self.bounds.grow(&Point3::new(center(key.0, x), center(key.1, y), z.into()));
        };
        for (slot, cell) in &seen.cells {
            let heights = [cell.z, cell.top, cell.overhang];
            heights.iter().filter(|z| z.is_finite()).for_each(|z| grow(at(usize::from(*slot)), *z));
        }
        let per_edge = (NUM_BLOCKS as f64).sqrt() as i32;
        for (block, _, z) in &seen.passes {
            let (x, y) = (i32::from(*block) % per_edge * BLOCK, i32::from(*block) / per_edge * BLOCK);
            grow((x, y), *z);
            grow((x + BLOCK - 1, y + BLOCK - 1), *z);
        }
        if !(seen.cells.is_empty() && seen.passes.is_empty()) {
            self.tiles.push((key, seen));
        }
    }
}
