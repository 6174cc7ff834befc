//! The grid and the voxels against what the true geometry reaches into.
//!
//! The truth of a cell: whether a wall or a piece of furniture reaches into its square between the heights of the grid's band, above the
//! floor. Which cells have to be occupied: those of them in which a beam truly ended within band and range; inside of solids, and on sides
//! that the robot never came to see, a map has nothing to say. What counts as free has to be free of geometry, wherever a beam passed.
//! An error of ranges of 2 cm moves a face across a border between cells, so figures are told twice: to the cell, and *near*: an
//! occupied cell is right if geometry is within half a cell of its square, one that has to be occupied is found if it or one of the eight
//! around it is, and a free one is wrong if geometry reaches into the inner half of its edge.
//!
//! Of a voxel the truth is asked by the distance of its centre from the true surface: within half its diagonal, which the surface has to
//! be to pass through it (*near*: half an edge more), an occupied one is right; within a fifth of its edge, where the surface surely passes,
//! a free one is wrong. Those in which a beam truly ended have to be occupied (*near*: or one that shares a face).

use crate::Failure;
use crate::drive::Beam;
use crate::figures::{Row, share};
use nalgebra::Point3;
use percept_geometry::{Aabb3, Cell, Voxel};
use percept_mapping::voxels::VoxelMap;
use percept_mapping::{Occupancy, OccupancyMap};
use percept_sim::{TrueOccupancy, World};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// Cells from this on are occupied, per cent: what planning takes.
pub(crate) const OCCUPIED: i8 = 60;
/// Cells of the fine truth along the edge of a cell.
const FINE: i32 = 4;

/// True occupancy in cells of a quarter of the grid's.
pub(crate) struct Fine(TrueOccupancy);

impl Fine {
    pub(crate) fn new(world: &World, resolution_m: f64, band_m: (f64, f64)) -> Result<Self, Failure> {
        Ok(Self(world.occupancy(resolution_m / f64::from(FINE), band_m)?))
    }

    /// Whether geometry reaches into the square of a cell of the grid, made larger by `margin` fine cells on each side.
    pub(crate) fn reaches(&self, cell: Cell, margin: i32) -> bool {
        // The fine grid begins a fine cell before the world's corner.
        let (x, y) = (cell.x * FINE + 1, cell.y * FINE + 1);
        let at = |dx: i32, dy: i32| self.0.at(Cell::new(x + dx, y + dy)) == Some(true);
        (-margin..FINE + margin).any(|dy| (-margin..FINE + margin).any(|dx| at(dx, dy)))
    }
}

/// Nine cells.
pub(crate) fn around(cell: Cell) -> impl Iterator<Item = Cell> {
    (-1..=1).flat_map(move |dy| (-1..=1).map(move |dx| Cell::new(cell.x + dx, cell.y + dy)))
}

/// Right, wrong, missed.
#[derive(Default, Clone, Copy)]
struct Count {
    right: usize,
    wrong: usize,
    missed: usize,
}

impl Count {
    fn iou(&self) -> f64 {
        share(self.right, self.right + self.wrong + self.missed)
    }
}

pub(crate) fn judge_grid(world: &World, map: &OccupancyMap, beams: &[Beam]) -> Result<Row, Failure> {
    let params = *map.params();
    let (band, geometry) = ((params.band_min_m, params.band_max_m), map.geometry());
    let grid = map.dense(100_000_000)?;
    let Some((corner, _)) = map.bounds() else { return Err("the grid is empty".into()) };
    let known: BTreeMap<(i32, i32), bool> = (grid.cells.iter().enumerate().filter(|(_, v)| **v >= 0))
        .map(|(i, v)| {
            let (x, y) = ((i % grid.width) as i32 + corner.x, (i / grid.width) as i32 + corner.y);
            ((x, y), *v >= OCCUPIED)
        })
        .collect();
    let is_occupied = |c: Cell| known.get(&(c.x, c.y)) == Some(&true);
    let fine = Fine::new(world, params.resolution_m, band)?;
    let in_band = |b: &&Beam| b.end.z > band.0 && b.end.z < band.1 && b.range_m <= params.range_max();
    let seen: BTreeSet<(i32, i32)> =
        beams.iter().filter(in_band).filter_map(|b| geometry.cell(&b.end.xy())).map(|c| (c.x, c.y)).collect();
    let (mut occupied, mut free, mut near, mut near_free) =
        (Count::default(), Count::default(), Count::default(), Count::default());
    for (&(x, y), &claimed) in &known {
        let cell = Cell::new(x, y);
        let truly = fine.reaches(cell, 0);
        match (claimed, truly) {
            (true, true) => occupied.right += 1,
            (true, false) => (occupied.wrong, free.missed) = (occupied.wrong + 1, free.missed + 1),
            (false, true) => free.wrong += 1,
            (false, false) => free.right += 1,
        }
        match (claimed, fine.reaches(cell, FINE / 2), fine.reaches(cell, -FINE / 4)) {
            (true, true, _) => near.right += 1,
            (true, false, _) => (near.wrong, near_free.missed) = (near.wrong + 1, near_free.missed + 1),
            (false, _, true) => near_free.wrong += 1,
            (false, _, false) => near_free.right += 1,
        }
    }
    for &(x, y) in &seen {
        let cell = Cell::new(x, y);
        occupied.missed += usize::from(!is_occupied(cell));
        near.missed += usize::from(!around(cell).any(is_occupied));
    }
    if std::env::var_os("LAYERS_PICTURE").is_some() {
        picture(&known, &fine, &seen);
    }
    Ok(vec![
        ("grid: occupied IoU", occupied.iou()),
        ("grid: occupied IoU, near", near.iou()),
        ("grid: occupied wrongly, near", share(near.wrong, near.right + near.wrong)),
        ("grid: seen and not occupied, near", share(near.missed, seen.len())),
        ("grid: free IoU", free.iou()),
        ("grid: free IoU, near", near_free.iou()),
        ("grid: free wrongly, near", share(near_free.wrong, near_free.right + near_free.wrong)),
    ])
}

/// Characters a cell: right occupied `#`, occupied wrongly `X`, free wrongly `o`, seen and missed `m`, free `.`.
fn picture(known: &BTreeMap<(i32, i32), bool>, fine: &Fine, seen: &BTreeSet<(i32, i32)>) {
    let (mut low, mut high) = ((i32::MAX, i32::MAX), (i32::MIN, i32::MIN));
    for k in known.keys() {
        (low, high) = ((low.0.min(k.0), low.1.min(k.1)), (high.0.max(k.0), high.1.max(k.1)));
    }
    for y in (low.1..=high.1).rev() {
        let row = (low.0..=high.0).map(|x| {
            let cell = Cell::new(x, y);
            let is_occupied = |c: Cell| known.get(&(c.x, c.y)) == Some(&true);
            match known.get(&(x, y)) {
                Some(true) if fine.reaches(cell, FINE / 2) => '#',
                Some(true) => 'X',
                _ if seen.contains(&(x, y)) && !around(cell).any(is_occupied) => 'm',
                Some(false) if fine.reaches(cell, -FINE / 4) => 'o',
                Some(false) => '.',
                None => ' ',
            }
        });
        println!("{}", row.collect::<String>());
    }
}

pub(crate) fn judge_voxels(world: &World, map: &VoxelMap, beams: &[Beam]) -> Result<Row, Failure> {
    let size = map.params().voxel_size_m;
    let everything = Aabb3 { min: Point3::from([-100.0; 3]), max: Point3::from([100.0; 3]) };
    let known = map.within(&everything, usize::MAX)?;
    let occupied: BTreeSet<(i32, i32, i32)> =
        known.iter().filter(|(_, l)| *l > 0.0).map(|(v, _)| (v.x, v.y, v.z)).collect();
    let judged: Vec<(bool, f64)> =
        known.par_iter().map(|(v, l)| (*l > 0.0, world.surface_distance(&v.center(size)))).collect();
    let claimed = || judged.iter().filter(|(is_occupied, _)| *is_occupied);
    let half_diagonal = 0.5 * 3f64.sqrt() * size;
    let right = |margin: f64| claimed().filter(|(_, d)| *d <= half_diagonal + margin).count();
    let num_claimed = claimed().count();
    let num_free = judged.len() - num_claimed;
    let free_wrongly = judged.iter().filter(|(is_occupied, d)| !is_occupied && *d <= 0.2 * size).count();
    let in_range = beams.iter().filter(|b| b.range_m <= map.params().range_max());
    let seen: BTreeSet<(i32, i32, i32)> =
        in_range.filter_map(|b| Voxel::containing(&b.end, size)).map(|v| (v.x, v.y, v.z)).collect();
    let faces = |(x, y, z): (i32, i32, i32)| {
        [(x, y, z), (x - 1, y, z), (x + 1, y, z), (x, y - 1, z), (x, y + 1, z), (x, y, z - 1), (x, y, z + 1)]
    };
    let missed = seen.iter().filter(|v| !occupied.contains(v)).count();
    let missed_near = seen.iter().filter(|v| !faces(**v).iter().any(|v| occupied.contains(v))).count();
    let iou = |right: usize, missed: usize| share(right, num_claimed + missed);
    Ok(vec![
        ("voxels: occupied IoU", iou(right(0.0), missed)),
        ("voxels: occupied IoU, near", iou(right(0.5 * size), missed_near)),
        ("voxels: occupied wrongly, near", share(num_claimed - right(0.5 * size), num_claimed)),
        ("voxels: seen and not occupied, near", share(missed_near, seen.len())),
        ("voxels: free wrongly", share(free_wrongly, num_free)),
    ])
}
