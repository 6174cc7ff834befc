//! The mesh of one block: marching cubes between the centres of its voxels.

use super::block::{SurfaceBlock, UNIT};
use super::cubes::{CASES, EDGES, Edge, edge_from};
use super::mesh::NO_COLOR;
use super::piece::Piece;
use crate::blocks::BlockKey;
use nalgebra::{Point3, Vector3};

/// A block and those around it: `3 x 3 x 3`, its own in the middle. Beyond the seven after it they serve normals alone.
pub(super) struct Neighborhood<'a> {
    blocks: [Option<&'a SurfaceBlock>; 27],
    /// Below this, as stored, a voxel is unknown.
    min_weight: u16,
}

/// Voxels along an edge of what the cubes of a block reach: its own and the first ones of the next.
const REACH: usize = 9;
/// No vertex yet.
const NONE: u32 = u32::MAX;

impl<'a> Neighborhood<'a> {
    /// Of a block by key, as `find` has blocks; `min_weight` in looks.
    pub(super) fn new(key: BlockKey, min_weight: f32, find: impl Fn(BlockKey) -> Option<&'a SurfaceBlock>) -> Self {
        let blocks = std::array::from_fn(|i| {
            let step = |i: usize| (i % 3) as i32 - 1;
            find((key.0 + step(i), key.1 + step(i / 3), key.2 + step(i / 9)))
        });
        Self { blocks, min_weight: (min_weight * UNIT).clamp(1.0, 65535.0).ceil() as u16 }
    }

    /// Block and slot of a voxel, counted from the first of the middle block, -8 to 15.
    #[inline]
    fn locate(&self, v: [i32; 3]) -> Option<(&'a SurfaceBlock, usize)> {
        let [x, y, z] = v.map(|i| (i + 8) as usize);
        let block = self.blocks[(z / 8 * 3 + y / 8) * 3 + x / 8]?;
        Some((block, (z % 8 * 8 + y % 8) * 8 + x % 8))
    }

    /// Distance at a voxel, as stored; none if it is unknown.
    #[inline]
    fn distance(&self, v: [i32; 3]) -> Option<f32> {
        let (block, slot) = self.locate(v)?;
        (block.weight[slot] >= self.min_weight).then(|| f32::from(block.distance[slot]))
    }

    /// How the distance grows around a voxel, along each axis: between its neighbours, or from one to it where the other is
    /// unknown.
    fn gradient(&self, v: [i32; 3]) -> Vector3<f32> {
        let Some(own) = self.distance(v) else { return Vector3::zeros() };
        let along = |axis: usize| {
            let at = |step: i32| {
                let mut beside = v;
                beside[axis] += step;
                self.distance(beside)
            };
            match (at(-1), at(1)) {
                (Some(low), Some(high)) => 0.5 * (high - low),
                (Some(low), None) => own - low,
                (None, Some(high)) => high - own,
                (None, None) => 0.0,
            }
        };
        Vector3::new(along(0), along(1), along(2))
    }

    /// For each row of voxels along x that the cubes of the block reach, a bit a voxel: behind the surface, and known.
    fn rows(&self) -> [[(u16, u16); REACH]; REACH] {
        std::array::from_fn(|z| {
            std::array::from_fn(|y| {
                let start = (z % 8 * 8 + y % 8) * 8;
                let at = ((z / 8 + 1) * 3 + y / 8 + 1) * 3 + 1;
                let (mut behind, mut known) = (0, 0);
                for (block, from, num) in [(self.blocks[at], 0, 8), (self.blocks[at + 1], 8, 1)] {
                    let Some(block) = block else { continue };
                    let (distance, weight) = (&block.distance[start..start + num], &block.weight[start..start + num]);
                    for i in 0..num {
                        behind |= u16::from(distance[i] < 0) << (from + i);
                        known |= u16::from(weight[i] >= self.min_weight) << (from + i);
                    }
                }
                (behind, known)
            })
        })
    }
}

/// The triangles of the cubes whose lowest corners are the voxels of a block: those of which all eight corners are known.
pub(super) fn extract(key: BlockKey, near: &Neighborhood<'_>, voxel_size_m: f64) -> Piece {
    let mut out = Piece::default();
    let rows = near.rows();
    let mut vertices: Option<Box<[u32; REACH * REACH * REACH * 3]>> = None;
    for (z, y) in (0..8).flat_map(|z| (0..8).map(move |y| (z, y))) {
        let four = [rows[z][y], rows[z][y + 1], rows[z + 1][y], rows[z + 1][y + 1]];
        let both = |bits: u16| bits & bits >> 1;
        let known = four.iter().fold(0xff, |all, row| all & both(row.1));
        let behind = four.iter().fold(0xff, |all, row| all & both(row.0));
        let before = four.iter().fold(0xff, |all, row| all & both(!row.0));
        let mut crossed = known & !behind & !before;
        while crossed != 0 {
            let x = crossed.trailing_zeros() as usize;
            crossed &= crossed - 1;
            let case = four.iter().enumerate().fold(0, |case, (i, row)| case | usize::from(row.0 >> x & 3) << (2 * i));
            let vertices = vertices.get_or_insert_with(|| Box::new([NONE; REACH * REACH * REACH * 3]));
            let mut number = [NONE; EDGES];
            for triangle in &CASES[case] {
                let corners = triangle.map(|edge| {
                    let number = &mut number[usize::from(edge)];
                    if *number == NONE {
                        *number = vertex(key, near, voxel_size_m, [x, y, z], edge, vertices, &mut out);
                    }
                    *number
                });
                out.mesh.triangles.push(corners);
            }
        }
    }
    out
}

/// The number of the vertex on an edge of a cube, which is made if it is new.
fn vertex(
    key: BlockKey,
    near: &Neighborhood<'_>,
    voxel_size_m: f64,
    cube: [usize; 3],
    edge: Edge,
    known: &mut [u32; REACH * REACH * REACH * 3],
    out: &mut Piece,
) -> u32 {
    let (corner, axis) = edge_from(edge);
    let at: [usize; 3] = std::array::from_fn(|i| cube[i] + corner[i]);
    let known = &mut known[((at[2] * REACH + at[1]) * REACH + at[0]) * 3 + axis];
    if *known != NONE {
        return *known;
    }
    *known = out.mesh.positions.len() as u32;
    let low = at.map(|i| i as i32);
    let mut high = low;
    high[axis] += 1;
    // Both are known, on different sides.
    let (a, b) = (near.distance(low).unwrap_or(0.0), near.distance(high).unwrap_or(0.0));
    let share = if a == b { 0.5 } else { a / (a - b) };
    let voxel = [key.0 * 8 + low[0], key.1 * 8 + low[1], key.2 * 8 + low[2]];
    let mut place = voxel.map(|i| f64::from(i) + 0.5);
    place[axis] += f64::from(share);
    out.mesh.positions.push(Point3::from(place.map(|v| (v * voxel_size_m) as f32)));
    let gradient = near.gradient(low) * (1.0 - share) + near.gradient(high) * share;
    out.mesh.normals.push(gradient.try_normalize(0.0).unwrap_or_else(Vector3::zeros));
    let color = |v: [i32; 3]| near.locate(v).and_then(|(block, slot)| block.color_at(slot));
    out.mesh.colors.push(match (color(low), color(high)) {
        (Some(a), Some(b)) => std::array::from_fn(|i| (a[i] + (b[i] - a[i]) * share).round() as u8),
        (Some(one), None) | (None, Some(one)) => one.map(|c| c.round() as u8),
        (None, None) => NO_COLOR,
    });
    if (0..3).any(|other| other != axis && at[other].is_multiple_of(8)) {
        out.rim.push(((voxel, axis as u8), *known));
    }
    *known
}
