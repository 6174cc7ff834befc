//! Pieces of a mesh, and how they are joined where they meet.

use super::mesh_data::MeshData;
use rustc_hash::FxHashMap;

/// The edge of the voxels' grid that a vertex lies on: the voxel at its lower end, and its axis.
pub(super) type GridEdge = ([i32; 3], u8);

/// A piece of a mesh. Where two meet, both have the vertices of what they share, equal to the bit.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Piece {
    pub(super) mesh: MeshData,
    /// Vertices that other pieces may have as well.
    pub(super) rim: Vec<(GridEdge, u32)>,
}

impl Piece {
    /// What it takes, bytes.
    pub(super) fn memory_bytes(&self) -> usize {
        self.mesh.memory_bytes() + size_of_val(&self.rim[..])
    }
}

/// Pieces in one, in order, each vertex once. Those of its rim stay in it of which other pieces may have them as well.
pub(super) fn weld<'a>(pieces: impl Iterator<Item = &'a Piece> + Clone, is_rim: impl Fn(&GridEdge) -> bool) -> Piece {
    let sum = |count: fn(&Piece) -> usize| pieces.clone().map(count).sum::<usize>();
    let (num_vertices, num_triangles) = (sum(|p| p.mesh.positions.len()), sum(|p| p.mesh.triangles.len()));
    let mut out = Piece { mesh: MeshData::with_capacity(num_vertices, num_triangles), rim: vec![] };
    let mut known: FxHashMap<GridEdge, u32> = FxHashMap::default();
    known.reserve(sum(|p| p.rim.len()));
    let mut numbers: Vec<u32> = vec![];
    for piece in pieces {
        let mut rim = piece.rim.iter().peekable();
        numbers.clear();
        for vertex in 0..piece.mesh.positions.len() {
            let next = out.mesh.positions.len() as u32;
            let number = match rim.next_if(|r| r.1 as usize == vertex) {
                None => next,
                Some((edge, _)) => *known.entry(*edge).or_insert_with(|| {
                    if is_rim(edge) {
                        out.rim.push((*edge, next));
                    }
                    next
                }),
            };
            if number == next {
                out.mesh.positions.push(piece.mesh.positions[vertex]);
                out.mesh.normals.push(piece.mesh.normals[vertex]);
                out.mesh.colors.push(piece.mesh.colors[vertex]);
            }
            numbers.push(number);
        }
        out.mesh.triangles.extend(piece.mesh.triangles.iter().map(|t| t.map(|v| numbers[v as usize])));
    }
    out
}
