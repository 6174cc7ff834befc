//! The mesh of one block: marching cubes between the centres of its voxels.

use super::block::{SurfaceBlock, UNIT};
use super::cubes::{CASES, EDGES, Edge, edge_from};
use super::mesh_data::NO_COLOR;
use super::piece::Piece;
use crate::blocks::BlockKey;
use nalgebra::{Point3, Vector3};

/// A block and those around it: `3 x 3 x 3`, its own in the middle. Beyond the seven after it they serve normals alone.
struct Neighborhood<'a> {
    blocks: [Option<&'a SurfaceBlock>; 27],
    /// Below this, as stored, a voxel is unknown.
    min_weight: u16,
}

/// Voxels along an edge of what the cubes of a block reach: its own and the first ones of the next.
const REACH: usize = 9;
/// No vertex yet.
const NONE: u32 = u32::MAX;

impl<'a> Neighborhood<'a> {
    /// A block by key and the seven after it, as `find` has them; `min_weight` in looks.
    fn after(key: BlockKey, min_weight: f32, find: &impl Fn(BlockKey) -> Option<&'a SurfaceBlock>) -> Self {
        let mut near = Self { blocks: [None; 27], min_weight: (min_weight * UNIT).clamp(1.0, 65535.0).ceil() as u16 };
        near.fill(key, find, |step| step >= 0);
        near
    }

    /// The rest of them.
    fn complete(&mut self, key: BlockKey, find: &impl Fn(BlockKey) -> Option<&'a SurfaceBlock>) {
        self.fill(key, find, |_| true);
    }

    fn fill(
        &mut self,
        key: BlockKey,
        find: &impl Fn(BlockKey) -> Option<&'a SurfaceBlock>,
        is_wanted: impl Fn(i32) -> bool,
    ) {
        for (i, block) in self.blocks.iter_mut().enumerate() {
            let [x, y, z] = [i, i / 3, i / 9].map(|i| (i % 3) as i32 - 1);
            if block.is_none() && [x, y, z].into_iter().all(&is_wanted) {
                *block = find((key.0 + x, key.1 + y, key.2 + z));
            }
        }
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
        let is_inner = v.iter().all(|i| (1..7).contains(i));
        let Some(block) = self.blocks[13].filter(|_| is_inner) else { return self.gradient_across(v) };
        let slot = ((v[2] * 8 + v[1]) * 8 + v[0]) as usize;
        let own = f32::from(block.distance[slot]);
        let along = |step: usize| {
            let at = |slot: usize| (f32::from(block.distance[slot]), block.weight[slot] >= self.min_weight);
            slope(own, at(slot - step), at(slot + step))
        };
        Vector3::new(along(1), along(8), along(64))
    }

    /// The same across blocks.
    fn gradient_across(&self, v: [i32; 3]) -> Vector3<f32> {
        let Some(own) = self.distance(v) else { return Vector3::zeros() };
        let along = |axis: usize| {
            let at = |step: i32| {
                let mut beside = v;
                beside[axis] += step;
                self.distance(beside).map_or((0.0, false), |distance| (distance, true))
            };
            slope(own, at(-1), at(1))
        };
        Vector3::new(along(0), along(1), along(2))
    }

    /// For each row of voxels along x that the cubes of the block reach, a bit a voxel.
    fn rows(&self) -> [[Row; REACH]; REACH] {
        let mut rows = [[Row::default(); REACH]; REACH];
        for (z, plane) in rows.iter_mut().enumerate() {
            for (y, row) in plane.iter_mut().enumerate() {
                let start = (z % 8 * 8 + y % 8) * 8;
                let at = ((z / 8 + 1) * 3 + y / 8 + 1) * 3 + 1;
                if let Some(block) = self.blocks[at] {
                    let channels = block.distance[start..start + 8].iter().zip(&block.weight[start..start + 8]);
                    for (i, (distance, weight)) in channels.enumerate() {
                        row.behind |= (*distance as u16 >> 15) << i;
                        row.known |= u16::from(*weight >= self.min_weight) << i;
                    }
                }
                if let Some(block) = self.blocks[at + 1] {
                    row.behind |= (block.distance[start] as u16 >> 15) << 8;
                    row.known |= u16::from(block.weight[start] >= self.min_weight) << 8;
                }
            }
        }
        rows
    }
}

/// How distance grows between two voxels beside one, each with whether it is known.
fn slope(own: f32, low: (f32, bool), high: (f32, bool)) -> f32 {
    match (low.1, high.1) {
        (true, true) => 0.5 * (high.0 - low.0),
        (true, false) => own - low.0,
        (false, true) => high.0 - own,
        (false, false) => 0.0,
    }
}

/// Nine voxels, a bit each.
#[derive(Debug, Clone, Copy, Default)]
struct Row {
    /// Whether it lies behind the surface.
    behind: u16,
    known: u16,
}

/// Which cubes between four rows the surface passes, of those that are known: a bit each.
fn crossed(four: &[Row; 4]) -> u16 {
    let both = |bits: u16| bits & bits >> 1;
    let all = |bits: fn(&Row) -> u16| four.iter().fold(0xff, |all, row| all & both(bits(row)));
    all(|row| row.known) & !all(|row| row.behind) & !all(|row| !row.behind)
}

/// The triangles of the cubes whose lowest corners are the voxels of a block, as `find` has blocks: those cubes of which all eight
/// corners are known, with a weight of `min_weight` looks at least.
pub(super) fn extract<'a>(
    key: BlockKey,
    min_weight: f32,
    voxel_size_m: f64,
    find: &impl Fn(BlockKey) -> Option<&'a SurfaceBlock>,
) -> Piece {
    let mut out = Piece::default();
    let mut near = Neighborhood::after(key, min_weight, find);
    let rows = near.rows();
    let four = |z: usize, y: usize| [rows[z][y], rows[z][y + 1], rows[z + 1][y], rows[z + 1][y + 1]];
    if (0..64).all(|i| crossed(&four(i / 8, i % 8)) == 0) {
        return out;
    }
    near.complete(key, find);
    let near = &near;
    let mut vertices = Box::new([NONE; REACH * REACH * REACH * 3]);
    for (z, y) in (0..8).flat_map(|z| (0..8).map(move |y| (z, y))) {
        let four = four(z, y);
        let mut crossed = crossed(&four);
        while crossed != 0 {
            let x = crossed.trailing_zeros() as usize;
            crossed &= crossed - 1;
            let corners = four.iter().enumerate();
            let case = corners.fold(0, |case, (i, row)| case | usize::from(row.behind >> x & 3) << (2 * i));
            let mut number = [NONE; EDGES];
            for triangle in &CASES[case] {
                let corners = triangle.map(|edge| {
                    let number = &mut number[usize::from(edge)];
                    if *number == NONE {
                        *number = vertex(key, near, voxel_size_m, [x, y, z], edge, &mut vertices, &mut out);
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
