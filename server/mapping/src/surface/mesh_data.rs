//! A mesh: triangles with shared vertices.

use nalgebra::{Point3, Vector3};
use percept_geometry::Aabb3;

/// Colour given to vertices without one.
pub(super) const NO_COLOR: [u8; 3] = [128; 3];

/// Triangles with shared vertices, in one frame. Order: by tile, block and voxel, always the same.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MeshData {
    /// V x 3, metres.
    pub positions: Vec<Point3<f32>>,
    /// V x 3, unit length, towards where the surface was seen from; zero where undefined.
    pub normals: Vec<Vector3<f32>>,
    /// V x 3 RGB8; grey where the surface has no colour.
    pub colors: Vec<[u8; 3]>,
    /// T x 3 numbers of vertices, counter-clockwise as seen from where the surface was seen.
    pub triangles: Vec<[u32; 3]>,
}

impl MeshData {
    pub(super) fn with_capacity(num_vertices: usize, num_triangles: usize) -> Self {
        Self {
            positions: Vec::with_capacity(num_vertices),
            normals: Vec::with_capacity(num_vertices),
            colors: Vec::with_capacity(num_vertices),
            triangles: Vec::with_capacity(num_triangles),
        }
    }

    /// What it takes, bytes.
    pub fn memory_bytes(&self) -> usize {
        let vertices = size_of_val(&self.positions[..]) + size_of_val(&self.normals[..]);
        vertices + size_of_val(&self.colors[..]) + size_of_val(&self.triangles[..])
    }

    /// The triangles of which a corner lies in a box, with their vertices.
    pub(super) fn within(&self, region: &Aabb3) -> Self {
        let is_in: Vec<bool> = self.positions.iter().map(|p| region.contains(&p.cast())).collect();
        let mut numbers = vec![u32::MAX; self.positions.len()];
        let mut out = Self::default();
        for triangle in self.triangles.iter().filter(|t| t.iter().any(|v| is_in[*v as usize])) {
            out.triangles.push(triangle.map(|v| {
                let (number, v) = (&mut numbers[v as usize], v as usize);
                if *number == u32::MAX {
                    *number = out.positions.len() as u32;
                    out.positions.push(self.positions[v]);
                    out.normals.push(self.normals[v]);
                    out.colors.push(self.colors[v]);
                }
                *number
            }));
        }
        out
    }
}
