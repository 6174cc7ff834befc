//! OctoMap's octrees: `.bt` (occupied or free) and `.ot` (log-odds), in and out.
//!
//! Source: Hornung et al., "OctoMap: An Efficient Probabilistic 3D Mapping Framework Based on Octrees", 2013, and the files
//! that the library (1.9) writes. A header of text says kind of tree, nodes and resolution; nodes follow depth-first, child
//! `x + 2 y + 4 z`. In `.bt` an inner node is two bits a child: 00 unknown, 01 free, 10 occupied, 11 inner (first child in
//! the lowest bits). In `.ot` a node is its log-odds (f32, little-endian) and a mask of its children; an inner node has the
//! largest log-odds of its children.
//! Comes in: bytes. Goes out: an [`OctreeMap`] of leaves as they lie in the file, none expanded. Start with [`decode`].

mod header;
mod map;
mod read;
mod write;

pub use header::{Encoding, encoding};
pub use map::{OctreeLeaf, OctreeMap};
pub use read::decode;
pub use write::{encode, write};

const FORMAT: &str = "OctoMap";

/// Levels below the root; a leaf at this depth is one voxel.
pub const MAX_DEPTH: u8 = 16;

/// The key of the voxel whose lower corner is the origin.
pub const CENTER_KEY: u16 = 32768;

#[cfg(test)]
mod tests;
