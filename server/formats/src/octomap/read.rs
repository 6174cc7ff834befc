//! The nodes: depth-first into leaves.

use super::header::{Encoding, Header};
use super::map::{OctreeLeaf, OctreeMap};
use super::{FORMAT, MAX_DEPTH};
use crate::{FormatError, Limits, Place};

/// OctoMap's clamping thresholds, which it gives to the leaves of a `.bt`: probabilities 0.1192 and 0.971.
pub(super) const FREE_LOG_ODDS: f32 = -2.000_028;
/// See [`FREE_LOG_ODDS`].
pub(super) const OCCUPIED_LOG_ODDS: f32 = 3.511_030_7;

/// A map from the bytes of a `.bt` or `.ot` file, told apart by their first line.
///
/// A leaf above the finest depth stays one. Leaves of a `.bt` come with OctoMap's clamping thresholds as log-odds (-2.0 and
/// 3.5). Of inner nodes only the children count, of coloured trees only the log-odds. Bytes after the nodes are not looked
/// at.
///
/// # Errors
/// `Malformed` for a line or node that OctoMap cannot have written, more or fewer nodes than declared included; `Missing`;
/// `Unsupported` for other kinds of trees, with their id; `Truncated`; `TooLarge` beyond `limits.max_points` nodes.
pub fn decode(bytes: &[u8], limits: &Limits) -> Result<OctreeMap, FormatError> {
    let header = super::header::parse(bytes)?;
    let num_nodes = limits.nodes(header.num_nodes)?;
    let body = &bytes[header.body_offset..];
    // A node is `4 + colour + 1` bytes, or two bits in the two bytes of its parent, the root's being all its own.
    let node_bytes = 5 + header.color_bytes as u64;
    let needed = match header.encoding {
        Encoding::Binary if num_nodes == 0 => 0,
        Encoding::Binary => 2 * (header.num_nodes - 1).div_ceil(8).max(1),
        Encoding::Full => node_bytes * header.num_nodes,
    };
    let available = body.len() as u64;
    if needed > available {
        return Err(FormatError::Truncated { format: FORMAT, field: "nodes", needed, available });
    }
    let mut nodes = Nodes { bytes, at: header.body_offset, header: &header, num_nodes: 0, leaves: vec![] };
    if num_nodes > 0 {
        nodes.leaves.reserve_exact(num_nodes);
        let root = Cube { key: [0; 3], depth: 0 };
        match header.encoding {
            Encoding::Binary => nodes.binary(root)?,
            Encoding::Full => nodes.full(root)?,
        }
        if nodes.num_nodes != header.num_nodes {
            let found = header.num_nodes.to_string();
            let expected = "the number of nodes that follow";
            return Err(FormatError::malformed(
                FORMAT,
                Place::Byte(nodes.at as u64),
                "size",
                found.as_bytes(),
                expected,
            ));
        }
    }
    nodes.leaves.shrink_to_fit();
    Ok(OctreeMap::in_order(header.resolution_m, nodes.leaves))
}

/// A node's place.
#[derive(Debug, Clone, Copy)]
struct Cube {
    key: [u16; 3],
    depth: u8,
}

impl Cube {
    /// Child `i`; the caller has seen that there is a level below.
    fn child(self, i: u8) -> Self {
        let mut key = self.key;
        for (axis, k) in key.iter_mut().enumerate() {
            *k |= u16::from(i >> axis & 1) << (15 - self.depth);
        }
        Self { key, depth: self.depth + 1 }
    }

    fn leaf(self, log_odds: f32) -> OctreeLeaf {
        OctreeLeaf { key: self.key, depth: self.depth, log_odds }
    }
}

struct Nodes<'a> {
    bytes: &'a [u8],
    at: usize,
    header: &'a Header,
    num_nodes: u64,
    leaves: Vec<OctreeLeaf>,
}

impl Nodes<'_> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N], FormatError> {
        let rest = &self.bytes[self.at..];
        let Some(&taken) = rest.first_chunk::<N>() else {
            let start = self.header.body_offset;
            let (needed, available) = ((self.at - start + N) as u64, (self.bytes.len() - start) as u64);
            return Err(FormatError::Truncated { format: FORMAT, field: "nodes", needed, available });
        };
        self.at += N;
        Ok(taken)
    }

    /// Counts a node before it takes memory: the declared number is what was checked.
    fn count(&mut self) -> Result<(), FormatError> {
        self.num_nodes += 1;
        if self.num_nodes > self.header.num_nodes {
            let found = self.header.num_nodes.to_string();
            return Err(self.wrong("size", &found, "the number of nodes that follow"));
        }
        Ok(())
    }

    fn wrong(&self, field: &str, found: &str, expected: &'static str) -> FormatError {
        FormatError::malformed(FORMAT, Place::Byte(self.at as u64), field, found.as_bytes(), expected)
    }

    /// An inner node of a `.bt`. Nests no deeper than the tree.
    fn binary(&mut self, cube: Cube) -> Result<(), FormatError> {
        self.count()?;
        if cube.depth == MAX_DEPTH {
            return Err(self.wrong("depth of a node", "17", "at most 16"));
        }
        let children = u16::from_le_bytes(self.take()?);
        if children == 0 {
            // A root alone is how OctoMap writes and reads a space that is all occupied.
            if cube.depth == 0 {
                self.leaves.push(cube.leaf(OCCUPIED_LOG_ODDS));
                return Ok(());
            }
            return Err(self.wrong("children of an inner node", "none", "one or more"));
        }
        for i in 0..8 {
            let log_odds = match children >> (2 * i) & 3 {
                0 => continue,
                3 => {
                    self.binary(cube.child(i))?;
                    continue;
                }
                1 => FREE_LOG_ODDS,
                _ => OCCUPIED_LOG_ODDS,
            };
            self.count()?;
            self.leaves.push(cube.child(i).leaf(log_odds));
        }
        Ok(())
    }

    /// A node of an `.ot`. Nests no deeper than the tree.
    fn full(&mut self, cube: Cube) -> Result<(), FormatError> {
        self.count()?;
        let log_odds = f32::from_le_bytes(self.take()?);
        if self.header.color_bytes > 0 {
            self.take::<3>()?;
        }
        let [children] = self.take()?;
        if children == 0 {
            if !log_odds.is_finite() {
                return Err(self.wrong("log-odds", &log_odds.to_string(), "a finite number"));
            }
            self.leaves.push(cube.leaf(log_odds));
            return Ok(());
        }
        if cube.depth == MAX_DEPTH {
            return Err(self.wrong("depth of a node", "17", "at most 16"));
        }
        (0..8).filter(|i| children >> i & 1 != 0).try_for_each(|i| self.full(cube.child(i)))
    }
}
