//! A cloud as patches of surface, and the space that it shows something of.

use super::keypoints::Described;
use nalgebra::{Matrix3, Point3, Vector3};
use percept_geometry::Pose;
use rustc_hash::{FxHashMap, FxHashSet};

/// Edge of a patch, voxels: about the least that differs from its surroundings by itself (a post, the end of a car).
const PATCH: f64 = 4.0;
/// Points looked up of a patch at most, and the fewest that make one.
const MOST_POINTS: usize = 6;
const FEWEST_POINTS: usize = 3;
/// Space is seen where there is surface within two to four voxels: cells of so many voxels, and those around them.
const SEEN: f64 = 2.0;
/// Points coincide within so many voxels, if their normals are within 45 degrees of each other.
pub(super) const COINCIDE: f32 = 1.0;
pub(super) const PARALLEL: f32 = 0.7;

/// What a cloud shows where a patch of the other comes to lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Sight {
    /// Nothing is known of most of the place.
    Unseen,
    /// Surface is around the place and not there, or stands across: a contradiction.
    Other,
    /// The same surface.
    Same,
}

/// Points of a cloud that lie near each other and face one way, with what is known of the space around all of them.
pub(super) struct Patches {
    points: Vec<Point3<f32>>,
    normals: Vec<Vector3<f32>>,
    /// First of each patch's `members`, and their end.
    starts: Vec<u32>,
    /// Looked-up points of all patches with their normals.
    members: Vec<(Point3<f32>, Vector3<f32>)>,
    /// Nearest point to each voxel's middle, where one is near.
    nearest: FxHashMap<u64, u32>,
    seen: Cells,
    size: f32,
}

impl Patches {
    /// Of a thinned cloud; `size` is the edge of its voxels, metres.
    pub(super) fn new(cloud: &Described, size: f64) -> Self {
        let points = cloud.cloud.positions.clone();
        let normals = cloud.cloud.normals.clone().unwrap_or_else(|| vec![Vector3::zeros(); points.len()]);
        let (starts, members) = grouped(&points, &normals, (PATCH * size) as f32);
        let members = members.into_iter().map(|i| (points[i as usize], normals[i as usize])).collect();
        let size = size as f32;
        let coarse = (SEEN as f32) * size;
        let mut seen = Cells::default();
        // Where what was seen ends, the space beside it is not known to be empty.
        let inside = points.iter().zip(&cloud.inside).filter(|(_, inside)| **inside);
        let occupied: FxHashSet<[i32; 3]> = inside.map(|(p, _)| cell(p, coarse)).collect();
        for at in occupied {
            around(1).for_each(|d| seen.insert(std::array::from_fn(|k| at[k] + d[k])));
        }
        let nearest = nearest(&points, size);
        Self { points, normals, starts, members, nearest, seen, size }
    }

    /// Number of patches.
    pub(super) fn len(&self) -> usize {
        self.starts.len() - 1
    }

    /// Points of the cloud, metres.
    pub(super) fn points(&self) -> &[Point3<f32>] {
        &self.points
    }

    /// Index of the point that coincides with one of another cloud, both in this one's frame.
    #[inline(always)]
    pub(super) fn partner(&self, p: &Point3<f32>, normal: &Vector3<f32>) -> Option<usize> {
        let j = *self.nearest.get(&key(cell(p, self.size)))? as usize;
        let near = (p - self.points[j]).norm_squared() <= (COINCIDE * self.size).powi(2);
        (near && normal.dot(&self.normals[j]).abs() >= PARALLEL).then_some(j)
    }

    /// The looked-up points of a patch with their normals.
    #[inline]
    pub(super) fn of(&self, patch: usize) -> &[(Point3<f32>, Vector3<f32>)] {
        &self.members[self.starts[patch] as usize..self.starts[patch + 1] as usize]
    }

    pub(super) fn normal(&self, point: usize) -> &Vector3<f32> {
        &self.normals[point]
    }

    /// Adds to `out` what `other` shows where some patches of this cloud come to lie.
    pub(super) fn sights(&self, other: &Self, t_other_self: &Pose, patches: &[u32], out: &mut Vec<Sight>) {
        let r = t_other_self.rotation.to_rotation_matrix().matrix().cast::<f32>();
        let t = t_other_self.translation.vector.cast::<f32>();
        look(self, other, &r, &t, patches, out);
    }
}

percept_geometry::by_processor! {
    fn look(
        own: &Patches,
        other: &Patches,
        r: &Matrix3<f32>,
        t: &Vector3<f32>,
        patches: &[u32],
        out: &mut Vec<Sight>,
    ) {
        // Plain loops: what a closure of an iterator's does is not compiled for the processor.
        let coarse = SEEN as f32 * other.size;
        for &patch in patches {
            let (mut all, mut seen, mut same) = (0, 0, 0);
            for (p, n) in own.of(patch as usize) {
                let p = Point3::from(r * p.coords + t);
                all += 1;
                if other.seen.contains(cell(&p, coarse)) {
                    seen += 1;
                    same += usize::from(other.partner(&p, &(r * n)).is_some());
                }
                // Most displaced patches lie far from all that was seen: three points tell.
                if all == FEWEST_POINTS && seen == 0 {
                    break;
                }
            }
            out.push(match (2 * seen >= all, 2 * same >= seen) {
                (false, _) => Sight::Unseen,
                (true, true) => Sight::Same,
                (true, false) => Sight::Other,
            });
        }
    }
}

/// A set of cells, a bit each, in cubes of 16 to the side: cells that are asked for lie near each other, and most of them far
/// from all.
#[derive(Default)]
struct Cells {
    /// Cubes that hold a cell, and the box of these.
    cubes: FxHashMap<u64, u32>,
    low: [i32; 3],
    high: [i32; 3],
    bits: Vec<[u64; 64]>,
}

impl Cells {
    fn insert(&mut self, at: [i32; 3]) {
        let cube = at.map(|v| v >> 4);
        let is_first = self.bits.is_empty();
        let i = *self.cubes.entry(key(cube)).or_insert(self.bits.len() as u32) as usize;
        if i == self.bits.len() {
            self.bits.push([0; 64]);
            self.low = std::array::from_fn(|k| if is_first { cube[k] } else { cube[k].min(self.low[k]) });
            self.high = std::array::from_fn(|k| if is_first { cube[k] } else { cube[k].max(self.high[k]) });
        }
        let (word, bit) = place(at);
        self.bits[i][word] |= 1 << bit;
    }

    #[inline(always)]
    fn contains(&self, at: [i32; 3]) -> bool {
        let cube = at.map(|v| v >> 4);
        let is_beyond = |k: usize| cube[k] < self.low[k] || cube[k] > self.high[k];
        if is_beyond(0) || is_beyond(1) || is_beyond(2) {
            return false;
        }
        let Some(&i) = self.cubes.get(&key(cube)) else { return false };
        let (word, bit) = place(at);
        self.bits[i as usize][word] >> bit & 1 == 1
    }
}

/// Word and bit of a cell in its cube.
#[inline]
fn place(at: [i32; 3]) -> (usize, u32) {
    let [x, y, z] = at.map(|v| v as u32 & 15);
    let number = (x << 4 | y) << 4 | z;
    ((number >> 6) as usize, number & 63)
}

/// Points by the cell of `edge` metres that they lie in and the axis that they face most; first members, then all.
fn grouped(points: &[Point3<f32>], normals: &[Vector3<f32>], edge: f32) -> (Vec<u32>, Vec<u32>) {
    let mut ids: FxHashMap<(u64, usize), usize> = FxHashMap::default();
    let mut groups: Vec<Vec<u32>> = Vec::new();
    for (i, (p, n)) in points.iter().zip(normals).enumerate() {
        if *n == Vector3::zeros() {
            continue;
        }
        let id = *ids.entry((key(cell(p, edge)), n.abs().imax())).or_insert(groups.len());
        if id == groups.len() {
            groups.push(vec![]);
        }
        groups[id].push(i as u32);
    }
    let (mut starts, mut members) = (vec![0], Vec::new());
    for group in groups.iter().filter(|g| g.len() >= FEWEST_POINTS) {
        members.extend(group.iter().step_by(group.len().div_ceil(MOST_POINTS)));
        starts.push(members.len() as u32);
    }
    (starts, members)
}

/// For every voxel that a coinciding point could lie in, the point nearest to its middle.
fn nearest(points: &[Point3<f32>], size: f32) -> FxHashMap<u64, u32> {
    // Half a voxel's diagonal more than points may be apart.
    let reach2 = ((COINCIDE + 0.87) * size).powi(2);
    let mut out: FxHashMap<u64, (f32, u32)> = FxHashMap::default();
    for (i, p) in points.iter().enumerate() {
        let at = cell(p, size);
        for d in around(2) {
            let c: [i32; 3] = std::array::from_fn(|k| at[k] + d[k]);
            let middle = Vector3::from(c.map(|v| (v as f32 + 0.5) * size));
            let distance2 = (p.coords - middle).norm_squared();
            if distance2 > reach2 {
                continue;
            }
            let best = out.entry(key(c)).or_insert((distance2, i as u32));
            if distance2 < best.0 {
                *best = (distance2, i as u32);
            }
        }
    }
    out.into_iter().map(|(k, (_, i))| (k, i)).collect()
}

/// Offsets of the cells within `reach` cells along each axis.
fn around(reach: i32) -> impl Iterator<Item = [i32; 3]> {
    let line = -reach..=reach;
    line.clone().flat_map(move |x| (-reach..=reach).flat_map(move |y| (-reach..=reach).map(move |z| [x, y, z])))
}

#[inline(always)]
pub(super) fn cell(p: &Point3<f32>, edge: f32) -> [i32; 3] {
    [(p.x / edge).floor() as i32, (p.y / edge).floor() as i32, (p.z / edge).floor() as i32]
}

/// A cell in one number: 21 bits a coordinate. Clouds of more than a million cells across would meet themselves.
#[inline]
fn key([x, y, z]: [i32; 3]) -> u64 {
    const MASK: u64 = (1 << 21) - 1;
    (x as u64 & MASK) << 42 | (y as u64 & MASK) << 21 | (z as u64 & MASK)
}
