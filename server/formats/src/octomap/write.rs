//! A map out, pruned.

use super::header::Encoding;
use super::map::{OctreeLeaf, OctreeMap};
use super::read::{FREE_LOG_ODDS, OCCUPIED_LOG_ODDS};
use crate::FormatError;
use std::io::Write;

/// Bytes of a `.bt` or `.ot` file; see [`write()`].
pub fn encode(map: &OctreeMap, encoding: Encoding) -> Vec<u8> {
    let map = match encoding {
        Encoding::Binary => most_likely(map),
        Encoding::Full => map.pruned(),
    };
    let mut out = format!(
        "{}\n# (feel free to add / change comments, but leave the first line as it is!)\n#\nid OcTree\nsize {}\nres {}\ndata\n",
        encoding.magic(),
        map.num_nodes(),
        map.resolution_m(),
    )
    .into_bytes();
    match (encoding, map.leaves()) {
        (_, []) => {}
        // The root alone: see `most_likely`.
        (Encoding::Binary, [leaf]) if leaf.depth == 0 => out.extend([0, 0]),
        (Encoding::Binary, leaves) => binary(leaves, 0, &mut out),
        (Encoding::Full, leaves) => {
            full(leaves, 0, &mut out);
        }
    }
    out
}

/// Writes a `.bt` or `.ot` file of an `OcTree`, with eight equal children made one leaf as OctoMap's own writer does.
///
/// A `.bt` keeps occupied (log-odds of 0 and more) and free. An empty map has no nodes; OctoMap itself writes the same, and
/// reads it back from `.bt` alone.
///
/// # Errors
/// `Write` if the writer refuses.
pub fn write(out: &mut impl Write, map: &OctreeMap, encoding: Encoding) -> Result<(), FormatError> {
    Ok(out.write_all(&encode(map, encoding))?)
}

/// Leaves with one of two values, pruned. A space all free stays eight leaves: the root alone means occupied.
fn most_likely(map: &OctreeMap) -> OctreeMap {
    let pruned = map.map_log_odds(|l| if l.is_occupied() { OCCUPIED_LOG_ODDS } else { FREE_LOG_ODDS }).pruned();
    match pruned.leaves() {
        [leaf] if leaf.depth == 0 && !leaf.is_occupied() => {
            let key = |i: u16| [0, 1, 2].map(|axis| (i >> axis & 1) << 15);
            let leaves = (0..8).map(|i| OctreeLeaf { key: key(i), depth: 1, ..*leaf }).collect();
            OctreeMap::in_order(map.resolution_m(), leaves)
        }
        _ => pruned,
    }
}

/// The leaves of each child of the node at `depth` that holds `leaves`, with the child's number.
fn children(leaves: &[OctreeLeaf], depth: u8) -> impl Iterator<Item = (u8, &[OctreeLeaf])> {
    leaves.chunk_by(move |a, b| a.child(depth) == b.child(depth)).map(move |c| (c[0].child(depth), c))
}

/// Whether the child below `depth` that holds `leaves` is a leaf.
fn is_leaf(leaves: &[OctreeLeaf], depth: u8) -> bool {
    leaves[0].depth == depth + 1
}

fn binary(leaves: &[OctreeLeaf], depth: u8, out: &mut Vec<u8>) {
    let kind = |child: &[OctreeLeaf]| match (is_leaf(child, depth), child[0].is_occupied()) {
        (false, _) => 3u16,
        (true, true) => 2,
        (true, false) => 1,
    };
    let bits = children(leaves, depth).fold(0, |bits, (i, child)| bits | kind(child) << (2 * i));
    out.extend(bits.to_le_bytes());
    for (_, child) in children(leaves, depth).filter(|(_, child)| !is_leaf(child, depth)) {
        binary(child, depth + 1, out);
    }
}

/// Writes the node at `depth` that holds `leaves`; its log-odds, which come last, are put in place when they are known.
fn full(leaves: &[OctreeLeaf], depth: u8, out: &mut Vec<u8>) -> f32 {
    if leaves[0].depth == depth {
        out.extend(leaves[0].log_odds.to_le_bytes());
        out.push(0);
        return leaves[0].log_odds;
    }
    let at = out.len();
    let mask = children(leaves, depth).fold(0, |mask, (i, _)| mask | 1u8 << i);
    out.extend([0, 0, 0, 0, mask]);
    let largest = children(leaves, depth).map(|(_, c)| full(c, depth + 1, out)).fold(f32::MIN, f32::max);
    out[at..at + 4].copy_from_slice(&largest.to_le_bytes());
    largest
}
