//! An octree as its leaves, in depth-first order.

use super::{CENTER_KEY, FORMAT, MAX_DEPTH};
use crate::{FormatError, Place};
use nalgebra::Point3;
use percept_geometry::{GeometryError, Voxel};

/// One leaf: a cube of `2^(16 - depth)` voxels an edge that have the same log-odds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OctreeLeaf {
    /// Keys along x, y, z of the lowest voxel, [`CENTER_KEY`] at the origin; multiples of the edge in voxels.
    pub key: [u16; 3],
    /// Levels below the root: 16 is one voxel, 0 all of space.
    pub depth: u8,
    /// Log-odds of being occupied; from 0 on it counts as occupied, as in OctoMap.
    pub log_odds: f32,
}

impl OctreeLeaf {
    /// The leaf of one voxel; none beyond the 32768 voxels about the origin that keys reach.
    pub fn of_voxel(voxel: Voxel, log_odds: f32) -> Option<Self> {
        let key = |i: i32| u16::try_from(i.checked_add(i32::from(CENTER_KEY))?).ok();
        Some(Self { key: [key(voxel.x)?, key(voxel.y)?, key(voxel.z)?], depth: MAX_DEPTH, log_odds })
    }

    /// The lowest voxel along x, y and z.
    pub fn lowest_voxel(&self) -> Voxel {
        let [x, y, z] = self.key.map(|k| i32::from(k) - i32::from(CENTER_KEY));
        Voxel::new(x, y, z)
    }

    /// Voxels along an edge.
    pub fn edge_voxels(&self) -> u32 {
        1 << MAX_DEPTH.saturating_sub(self.depth)
    }

    /// Whether it is as likely occupied as free, or more.
    pub fn is_occupied(&self) -> bool {
        self.log_odds >= 0.0
    }

    /// Place in the depth-first order: the bits of z, y and x interleaved, z first.
    pub(super) fn order(&self) -> u64 {
        self.key.iter().enumerate().fold(0, |sum, (axis, &k)| sum | spread(k) << axis)
    }

    /// Voxels in it, which are as many places in that order.
    pub(super) fn num_voxels(&self) -> u64 {
        u64::from(self.edge_voxels()).pow(3)
    }

    /// Which of the eight children of its ancestor at `depth` it lies in.
    pub(super) fn child(&self, depth: u8) -> u8 {
        self.key.iter().enumerate().fold(0, |sum, (axis, &k)| sum | (((k >> (15 - depth)) & 1) as u8) << axis)
    }
}

/// Each bit of `k` moved to three times its place.
fn spread(k: u16) -> u64 {
    let k = u64::from(k);
    let k = (k | k << 16) & 0x0000_ff00_00ff;
    let k = (k | k << 8) & 0x00f0_0f00_f00f;
    let k = (k | k << 4) & 0x0c30_c30c_30c3;
    (k | k << 2) & 0x2492_4924_9249
}

/// An occupancy octree in its map frame: leaves that do not overlap; where there is none, space is unknown.
#[derive(Debug, Clone, PartialEq)]
pub struct OctreeMap {
    resolution_m: f64,
    leaves: Vec<OctreeLeaf>,
}

impl OctreeMap {
    /// A map of `leaves` in any order, whose voxels have an edge of `resolution_m`.
    ///
    /// # Errors
    /// `Geometry` for a resolution that is not positive and finite, or log-odds that are not finite; `Malformed` for a
    /// depth beyond 16, a key that is no multiple of the leaf's edge, and leaves that overlap, with the leaf's number.
    pub fn new(resolution_m: f64, mut leaves: Vec<OctreeLeaf>) -> Result<Self, FormatError> {
        let out_of_range = |field, value, requirement| GeometryError::OutOfRange { field, value, requirement };
        if !(resolution_m.is_finite() && resolution_m > 0.0) {
            return Err(out_of_range("resolution_m", resolution_m, "positive and finite").into());
        }
        if let Some(leaf) = leaves.iter().find(|leaf| !leaf.log_odds.is_finite()) {
            return Err(out_of_range("log_odds", f64::from(leaf.log_odds), "finite").into());
        }
        for (i, leaf) in leaves.iter().enumerate() {
            if leaf.depth > MAX_DEPTH {
                return Err(wrong_leaf(i, "depth", leaf.depth.to_string(), "at most 16"));
            }
            if leaf.key.iter().any(|&k| u32::from(k) % leaf.edge_voxels() != 0) {
                return Err(wrong_leaf(i, "key", format!("{:?}", leaf.key), "multiples of the leaf's edge in voxels"));
            }
        }
        leaves.sort_unstable_by_key(|leaf| (leaf.order(), leaf.depth));
        let overlap = leaves.array_windows().position(|[a, b]| b.order() < a.order() + a.num_voxels());
        if let Some(i) = overlap {
            return Err(wrong_leaf(i + 1, "key", format!("{:?}", leaves[i + 1].key), "outside of all other leaves"));
        }
        Ok(Self { resolution_m, leaves })
    }

    /// A map of leaves that a decoder has found in depth-first order.
    pub(super) fn in_order(resolution_m: f64, leaves: Vec<OctreeLeaf>) -> Self {
        Self { resolution_m, leaves }
    }

    /// Edge of a voxel, metres.
    pub fn resolution_m(&self) -> f64 {
        self.resolution_m
    }

    /// The leaves, depth-first: by z, y and x, one bit of each after the other.
    pub fn leaves(&self) -> &[OctreeLeaf] {
        &self.leaves
    }

    /// Centre of a leaf, metres.
    pub fn center(&self, leaf: &OctreeLeaf) -> Point3<f64> {
        let half = f64::from(leaf.edge_voxels()) / 2.0;
        let v = leaf.lowest_voxel();
        Point3::new(f64::from(v.x) + half, f64::from(v.y) + half, f64::from(v.z) + half) * self.resolution_m
    }

    /// Edge of a leaf, metres.
    pub fn edge_m(&self, leaf: &OctreeLeaf) -> f64 {
        f64::from(leaf.edge_voxels()) * self.resolution_m
    }

    /// Log-odds of the leaf that holds a voxel; none where space is unknown. Takes log(leaves) steps.
    pub fn log_odds(&self, voxel: Voxel) -> Option<f32> {
        let place = OctreeLeaf::of_voxel(voxel, 0.0)?.order();
        let behind = self.leaves.partition_point(|leaf| leaf.order() <= place);
        let leaf = &self.leaves[behind.checked_sub(1)?];
        (place < leaf.order() + leaf.num_voxels()).then_some(leaf.log_odds)
    }

    /// Voxels that are known, at the finest depth.
    pub fn num_voxels(&self) -> u64 {
        self.leaves.iter().map(OctreeLeaf::num_voxels).sum()
    }

    /// Nodes of the tree, inner ones and the root included; 0 for an empty map.
    pub fn num_nodes(&self) -> u64 {
        let Some(first) = self.leaves.first() else { return 0 };
        // The leaves behind share the ancestors that the leaf before them has below the root.
        let inner = self.leaves.array_windows().map(|[a, b]| {
            let shared = (a.order() ^ b.order()).leading_zeros() - 16;
            u64::from(b.depth) - 1 - u64::from(shared / 3)
        });
        self.leaves.len() as u64 + u64::from(first.depth) + inner.sum::<u64>()
    }

    /// Hands every known voxel at the finest depth and its log-odds to `visit`, leaf by leaf; within one x runs fastest.
    ///
    /// # Errors
    /// `TooLarge` before the first if there are more than `limit`: one leaf near the root is millions.
    pub fn for_each_voxel(&self, limit: u64, mut visit: impl FnMut(Voxel, f32)) -> Result<(), FormatError> {
        let value = self.num_voxels();
        if value > limit {
            return Err(FormatError::TooLarge { field: "num_voxels", value, limit });
        }
        for leaf in &self.leaves {
            let (lowest, n) = (leaf.lowest_voxel(), leaf.edge_voxels() as i32);
            for (z, y) in (0..n).flat_map(|z| (0..n).map(move |y| (z, y))) {
                (0..n).for_each(|x| visit(Voxel::new(lowest.x + x, lowest.y + y, lowest.z + z), leaf.log_odds));
            }
        }
        Ok(())
    }

    /// The map with eight children of equal log-odds made one leaf, from the finest depth up, as OctoMap's `prune()` does.
    pub fn pruned(&self) -> Self {
        let mut leaves: Vec<OctreeLeaf> = Vec::with_capacity(self.leaves.len());
        for leaf in &self.leaves {
            leaves.push(*leaf);
            while let Some(parent) = parent(&leaves) {
                leaves.truncate(leaves.len() - 8);
                leaves.push(parent);
            }
        }
        Self { resolution_m: self.resolution_m, leaves }
    }

    /// The map with other log-odds.
    pub(super) fn map_log_odds(&self, log_odds: impl Fn(&OctreeLeaf) -> f32) -> Self {
        let leaves = self.leaves.iter().map(|leaf| OctreeLeaf { log_odds: log_odds(leaf), ..*leaf }).collect();
        Self { resolution_m: self.resolution_m, leaves }
    }
}

/// The leaf that the last eight make, if they are all the children of one node and have the same log-odds.
fn parent(leaves: &[OctreeLeaf]) -> Option<OctreeLeaf> {
    let eight = leaves.last_chunk::<8>()?;
    let first = eight[0];
    let is_alike = |(i, leaf): (usize, &OctreeLeaf)| {
        leaf.depth == first.depth
            && leaf.log_odds == first.log_odds
            && leaf.order() == first.order() + i as u64 * first.num_voxels()
    };
    let is_first_child = first.depth > 0 && first.child(first.depth - 1) == 0;
    (is_first_child && eight.iter().enumerate().all(is_alike)).then(|| OctreeLeaf { depth: first.depth - 1, ..first })
}

fn wrong_leaf(index: usize, field: &str, found: String, expected: &'static str) -> FormatError {
    let field = format!("{field} of leaf {index}");
    FormatError::malformed(FORMAT, Place::Byte(0), field, found.as_bytes(), expected)
}
