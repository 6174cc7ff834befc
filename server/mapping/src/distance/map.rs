//! Distance fields of a map's voxels and of its grid.

use super::cache::{DistanceCache, DistanceTile};
use super::kernel::{MAX_CELLS, Shape, squared_distances};
use crate::composed::Composed;
use crate::layer::{Layer, TileKey};
use crate::layers::MapLayers;
use crate::voxels::{VoxelGrid, VoxelMap};
use crate::{MappingError, OccupancyGrid, OccupancyMap};
use nalgebra::{Point2, Point3, Vector2, Vector3};
use rustc_hash::FxHashMap;
use std::sync::Arc;

/// Edge of a tile, cells; voxels and cells have the same.
const TILE: i32 = 64;

/// Farther than so many metres, or a hundred cells, nothing is told apart.
const USUAL_M: f64 = 2.0;

/// How far the nearest obstacle is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Distance<V> {
    /// From the surface of the nearest obstacle, metres: half a cell from its centre. Negative inside; at most the largest distance.
    pub distance_m: f64,
    /// Which way, and how fast, the distance grows; zero where nothing is near.
    pub gradient: V,
}

/// Distances in the map's voxels; unknown ones are no obstacles.
#[derive(Debug)]
pub struct VoxelDistances<'a> {
    voxels: &'a VoxelMap,
    field: Field<'a>,
}

/// Distances in the map's grid; unknown cells are no obstacles.
#[derive(Debug)]
pub struct GridDistances<'a> {
    grid: &'a OccupancyMap,
    field: Field<'a>,
}

/// Reads tiles, and keeps those that it has read.
#[derive(Debug)]
struct Field<'a> {
    cache: &'a DistanceCache,
    cell_m: f64,
    most: usize,
    tiles: FxHashMap<TileKey, Option<Arc<DistanceTile>>>,
}

/// Cells that are obstacles around a tile: a rim of the largest distance, and all heights at which there are any and a rim.
struct Obstacles {
    shape: Shape,
    first_z: i32,
    set: Vec<bool>,
}

impl MapLayers {
    /// The distance field of the voxels at this moment.
    pub fn voxel_distances(&self) -> VoxelDistances<'_> {
        let field = Field::new(&self.voxel_distances, self.voxels.params().voxel_size_m);
        VoxelDistances { voxels: &self.voxels, field }
    }

    /// The distance field of the grid at this moment: to cells that are more likely occupied than not.
    pub fn grid_distances(&self) -> GridDistances<'_> {
        let field = Field::new(&self.grid_distances, self.occupancy.params().resolution_m);
        GridDistances { grid: &self.occupancy, field }
    }
}

impl VoxelDistances<'_> {
    /// No distance is larger, metres.
    pub fn max_distance_m(&self) -> f64 {
        self.field.max_distance_m()
    }

    /// The distance at a point of the map, linear between the centres of voxels.
    ///
    /// # Errors
    /// `PointTooFar` if it is not finite or has no number.
    pub fn at(&mut self, p: &Point3<f64>) -> Result<Distance<Vector3<f64>>, MappingError> {
        let (corner, share) = self.field.corner(p.coords.as_slice()).ok_or(MappingError::PointTooFar)?;
        let voxels = self.voxels;
        let field = &mut self.field;
        let corners: [f64; 8] = std::array::from_fn(|i| {
            let at = |k: usize| corner[k] + (i >> k & 1) as i32;
            field.distance(
                [at(0), at(1), at(2)],
                |key, most| version_around(voxels, key, most),
                |key, most| around_voxels(voxels, key, most),
            )
        });
        let mix = |axis: usize| {
            let mut sum = (0.0, 0.0);
            for (i, d) in corners.iter().enumerate() {
                let along = |k: usize| if i >> k & 1 == 1 { share[k] } else { 1.0 - share[k] };
                sum.0 += d * (0..3).map(along).product::<f64>();
                let others: f64 = (0..3).filter(|k| *k != axis).map(along).product();
                sum.1 += d * others * if i >> axis & 1 == 1 { 1.0 } else { -1.0 };
            }
            (sum.0, sum.1 / field.cell_m)
        };
        let gradient = Vector3::new(mix(0).1, mix(1).1, mix(2).1);
        Ok(Distance { distance_m: mix(0).0, gradient })
    }
}

impl GridDistances<'_> {
    /// No distance is larger, metres.
    pub fn max_distance_m(&self) -> f64 {
        self.field.max_distance_m()
    }

    /// The distance at a point of the map, linear between the centres of cells.
    ///
    /// # Errors
    /// `PointTooFar` if it is not finite or has no number.
    pub fn at(&mut self, p: &Point2<f64>) -> Result<Distance<Vector2<f64>>, MappingError> {
        let (corner, share) =
            self.field.corner(&[p.x, p.y, 0.5 * self.field.cell_m]).ok_or(MappingError::PointTooFar)?;
        let grid = self.grid;
        let field = &mut self.field;
        let d: [f64; 4] = std::array::from_fn(|i| {
            let cell = [corner[0] + (i & 1) as i32, corner[1] + (i >> 1) as i32, 0];
            field.distance(cell, |key, most| version_around(grid, key, most), |key, most| around_cells(grid, key, most))
        });
        let [x, y] = [share[0], share[1]];
        let distance_m = (1.0 - y) * ((1.0 - x) * d[0] + x * d[1]) + y * ((1.0 - x) * d[2] + x * d[3]);
        let gx = (1.0 - y) * (d[1] - d[0]) + y * (d[3] - d[2]);
        let gy = (1.0 - x) * (d[2] - d[0]) + x * (d[3] - d[1]);
        Ok(Distance { distance_m, gradient: Vector2::new(gx, gy) / field.cell_m })
    }
}

impl<'a> Field<'a> {
    fn new(cache: &'a DistanceCache, cell_m: f64) -> Self {
        let most = ((USUAL_M / cell_m).ceil() as usize).clamp(2, MAX_CELLS);
        Self { cache, cell_m, most, tiles: FxHashMap::default() }
    }

    fn max_distance_m(&self) -> f64 {
        (self.most as f64 - 0.5) * self.cell_m
    }

    /// The cell whose centre is the lowest of those around a point, and how far to the next the point lies along each axis.
    fn corner(&self, p: &[f64]) -> Option<([i32; 3], [f64; 3])> {
        let at: [f64; 3] = std::array::from_fn(|k| p[k] / self.cell_m - 0.5);
        let is_sound = at.iter().all(|v| v.abs() < f64::from(i32::MAX / 2));
        is_sound.then(|| (at.map(|v| v.floor() as i32), at.map(|v| v - v.floor())))
    }

    /// Signed distance at a cell's centre, metres.
    fn distance(
        &mut self,
        cell: [i32; 3],
        version: impl FnOnce(TileKey, usize) -> u64,
        around: impl FnOnce(TileKey, usize) -> Option<Obstacles>,
    ) -> f64 {
        let key = (cell[0].div_euclid(TILE), cell[1].div_euclid(TILE));
        let (cache, most) = (self.cache, self.most);
        let tile = self
            .tiles
            .entry(key)
            .or_insert_with(|| cache.tile(key, version(key, most), || around(key, most).map(|o| signed(&o, most))));
        let of_layer = (TILE * TILE) as usize;
        let slot = (cell[1].rem_euclid(TILE) * TILE + cell[0].rem_euclid(TILE)) as usize;
        let square = tile.as_ref().and_then(|t| {
            let layer = usize::try_from(i64::from(cell[2]) - i64::from(t.first_z)).ok()?;
            t.squares.get(layer.checked_mul(of_layer)? + slot).copied()
        });
        let square = square.unwrap_or((most * most) as i16);
        let cells = f64::from(square.unsigned_abs()).sqrt() - 0.5;
        self.cell_m * if square < 0 { -cells } else { cells }
    }
}

/// The newest version of what lies within the largest distance of a tile.
fn version_around<L: Layer>(layer: &Composed<L>, key: TileKey, most: usize) -> u64 {
    tiles_around(key, most).map(|key| layer.changed_at(key)).max().unwrap_or(0)
}

fn tiles_around(key: TileKey, most: usize) -> impl Iterator<Item = TileKey> {
    let aside = most.div_ceil(TILE as usize) as i32;
    (-aside..=aside).flat_map(move |x| (-aside..=aside).map(move |y| (key.0 + x, key.1 + y)))
}

fn around_voxels(voxels: &VoxelMap, key: TileKey, most: usize) -> Option<Obstacles> {
    let rim = most as i32;
    let (low_x, low_y) = (key.0 * TILE - rim, key.1 * TILE - rim);
    let edge = (TILE + 2 * rim) as usize;
    let tiles = voxels.tiles(tiles_around(key, most));
    let within = |x: i32, y: i32| (0..edge as i32).contains(&(x - low_x)) && (0..edge as i32).contains(&(y - low_y));
    let occupied = || {
        let all = tiles.iter().flat_map(|(_, tile)| tile.voxels());
        all.filter(|(v, log_odds)| *log_odds > 0.0 && within(v.x, v.y)).map(|(v, _)| v)
    };
    let (low_z, high_z) = occupied().fold((i32::MAX, i32::MIN), |(a, b), v| (a.min(v.z), b.max(v.z)));
    if low_z > high_z {
        return None;
    }
    let first_z = low_z - rim;
    let shape =
        Shape { x: edge, y: edge, z: usize::try_from(i64::from(high_z) - i64::from(low_z)).ok()? + 1 + 2 * most };
    if shape.len() > MAX_BOX {
        return None;
    }
    let mut set = vec![false; shape.len()];
    for v in occupied() {
        let [x, y, z] = [v.x - low_x, v.y - low_y, v.z - first_z].map(|k| k as usize);
        set[(z * shape.y + y) * shape.x + x] = true;
    }
    Some(Obstacles { shape, first_z, set })
}

/// Voxels of the largest box that is looked at at once, at some five bytes each: a tile of 2 m of distance and 500 m of height.
const MAX_BOX: usize = 60_000_000;

/// Steps of log-odds that cancel out leave some millionths: nothing stands where that is all.
const BALANCED: f32 = 1e-4;

fn around_cells(grid: &OccupancyMap, key: TileKey, most: usize) -> Option<Obstacles> {
    let rim = most as i32;
    let edge = (TILE + 2 * rim) as usize;
    let (mut set, mut any) = (vec![false; edge * edge], false);
    for (at, tile) in grid.tiles(tiles_around(key, most)) {
        for (slot, _) in tile.log_odds().iter().enumerate().filter(|(_, v)| **v > BALANCED) {
            let x = (at.0 - key.0) * TILE + rim + slot as i32 % TILE;
            let y = (at.1 - key.1) * TILE + rim + slot as i32 / TILE;
            if (0..edge as i32).contains(&x) && (0..edge as i32).contains(&y) {
                (set[y as usize * edge + x as usize], any) = (true, true);
            }
        }
    }
    any.then_some(Obstacles { shape: Shape { x: edge, y: edge, z: 1 }, first_z: 0, set })
}

/// Distances of the tile in the middle of a box of obstacles.
fn signed(obstacles: &Obstacles, most: usize) -> DistanceTile {
    let shape = obstacles.shape;
    let outside = squared_distances(&obstacles.set, shape, most);
    let free: Vec<bool> = obstacles.set.iter().map(|s| !s).collect();
    let inside = squared_distances(&free, shape, most);
    let edge = TILE as usize;
    let mut squares = Vec::with_capacity(edge * edge * shape.z);
    for z in 0..shape.z {
        for y in most..most + edge {
            let row = (z * shape.y + y) * shape.x + most;
            let both = outside[row..row + edge].iter().zip(&inside[row..row + edge]);
            squares.extend(both.map(|(out, inside)| if *out > 0 { *out as i16 } else { -(*inside as i16) }));
        }
    }
    DistanceTile { first_z: obstacles.first_z, squares }
}

/// Both layers' tiles are as wide as those of their distances.
const _: () = assert!(OccupancyGrid::TILE_CELLS == TILE && VoxelGrid::TILE_VOXELS == TILE);
