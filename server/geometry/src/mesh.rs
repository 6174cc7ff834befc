//! Triangle meshes: vertices with optional normals and colours, and triangles between them.

use crate::cloud::is_finite;
use crate::{GeometryError, Pose};
use nalgebra::{Point3, Vector3};

/// `V` vertices and `T` triangles in one frame.
///
/// The fields are open; [`TriangleMesh::validate`] says whether they fit each other.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TriangleMesh {
    /// V x 3, metres, finite.
    pub positions: Vec<Point3<f32>>,
    /// V x 3, unit length, all zero where undefined; or empty.
    pub normals: Vec<Vector3<f32>>,
    /// V x 3 RGB8 (sRGB, as cameras give it); or empty.
    pub colors: Vec<[u8; 3]>,
    /// T x 3 indices of vertices, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

impl TriangleMesh {
    /// A mesh whose parts fit each other; `normals` and `colors` may be empty.
    ///
    /// # Errors
    /// Those of [`TriangleMesh::validate`].
    pub fn new(
        positions: Vec<Point3<f32>>,
        normals: Vec<Vector3<f32>>,
        colors: Vec<[u8; 3]>,
        triangles: Vec<[u32; 3]>,
    ) -> Result<Self, GeometryError> {
        let mesh = Self { positions, normals, colors, triangles };
        mesh.validate()?;
        Ok(mesh)
    }

    /// Checks the lengths of normals and colours, that numbers are finite and that every index has its vertex.
    ///
    /// # Errors
    /// `ShapeMismatch` for normals or colours that are neither none nor one a vertex; `OutOfRange` for a coordinate or
    /// normal that is not finite, and for the index of no vertex.
    pub fn validate(&self) -> Result<(), GeometryError> {
        let expected = self.positions.len();
        for (field, actual) in [("normals", self.normals.len()), ("colors", self.colors.len())] {
            if actual != 0 && actual != expected {
                return Err(GeometryError::ShapeMismatch { field, expected, actual });
            }
        }
        let out_of_range = |field, value, requirement| Err(GeometryError::OutOfRange { field, value, requirement });
        let not_finite = |v: &[f32]| f64::from(v.iter().copied().find(|x| !x.is_finite()).unwrap_or(f32::NAN));
        if let Some(p) = self.positions.iter().find(|p| !is_finite(p)) {
            return out_of_range("positions", not_finite(p.coords.as_slice()), "finite");
        }
        if let Some(n) = self.normals.iter().find(|n| n.iter().any(|x| !x.is_finite())) {
            return out_of_range("normals", not_finite(n.as_slice()), "finite");
        }
        match self.triangles.iter().flatten().find(|&&i| i as usize >= expected) {
            Some(&i) => out_of_range("triangles", f64::from(i), "the index of a vertex"),
            None => Ok(()),
        }
    }

    /// Number of vertices.
    pub fn num_vertices(&self) -> usize {
        self.positions.len()
    }

    /// Whether it has no surface: there is no triangle.
    pub fn is_empty(&self) -> bool {
        self.triangles.is_empty()
    }

    /// A normal for each vertex: that of its triangles, weighted by their areas; zero where it has none or they cancel.
    ///
    /// Panics if an index has no vertex; see [`TriangleMesh::validate`].
    pub fn vertex_normals(&self) -> Vec<Vector3<f32>> {
        let mut sums = vec![Vector3::<f64>::zeros(); self.positions.len()];
        for triangle in &self.triangles {
            let [a, b, c] = triangle.map(|i| self.positions[i as usize].cast::<f64>());
            // Twice the area long.
            let normal = (b - a).cross(&(c - a));
            triangle.iter().for_each(|&i| sums[i as usize] += normal);
        }
        sums.iter().map(|n| n.try_normalize(1e-30).unwrap_or_default().cast()).collect()
    }

    /// The mesh with coordinates in frame a, from coordinates in b. Normals turn along.
    pub fn transformed(&self, t_a_b: &Pose) -> Self {
        let r = t_a_b.rotation.to_rotation_matrix();
        let t = t_a_b.translation.vector;
        let moved = |p: &Point3<f32>| Point3::from((r * p.coords.cast::<f64>() + t).cast::<f32>());
        Self {
            positions: self.positions.iter().map(moved).collect(),
            normals: self.normals.iter().map(|n| (r * n.cast::<f64>()).cast()).collect(),
            colors: self.colors.clone(),
            triangles: self.triangles.clone(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tetrahedron() -> TriangleMesh {
        let positions = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(Point3::from);
        let triangles = vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
        TriangleMesh::new(positions.to_vec(), vec![], vec![], triangles).unwrap()
    }

    #[test]
    fn parts_that_do_not_fit_are_named() {
        let mesh = tetrahedron();
        let error = |mesh: TriangleMesh| mesh.validate().unwrap_err().to_string();
        let normals = vec![Vector3::z(); 3];
        assert_eq!(error(TriangleMesh { normals, ..mesh.clone() }), "normals: expected 4 elements, got 3");
        let colors = vec![[0; 3]; 5];
        assert_eq!(error(TriangleMesh { colors, ..mesh.clone() }), "colors: expected 4 elements, got 5");
        let triangles = vec![[0, 1, 4]];
        assert_eq!(error(TriangleMesh { triangles, ..mesh.clone() }), "triangles: 4 is not the index of a vertex");
        let positions = vec![Point3::new(0.0, f32::INFINITY, 0.0); 4];
        assert_eq!(error(TriangleMesh { positions, ..mesh.clone() }), "positions: inf is not finite");
        let normals = vec![Vector3::new(0.0, 0.0, f32::NAN); 4];
        assert_eq!(error(TriangleMesh { normals, ..mesh }), "normals: NaN is not finite");
        assert_eq!(TriangleMesh::default().validate(), Ok(()));
    }

    #[test]
    fn normals_point_out_of_a_counter_clockwise_surface_and_turn_with_it() {
        let mut mesh = tetrahedron();
        mesh.positions.push(Point3::new(9.0, 9.0, 9.0));
        let normals = mesh.vertex_normals();
        let diagonal = Vector3::new(1.0, 1.0, 1.0).normalize();
        assert!((normals[0] + diagonal).norm() < 1e-6);
        assert!(normals[1].x > 0.0 && normals[2].y > 0.0 && normals[3].z > 0.0);
        assert_eq!(normals[4], Vector3::zeros());
        mesh.normals = normals;
        let t_a_b = Pose::new(Vector3::new(5.0, -3.0, 1.0), Vector3::new(0.3, -0.4, 1.1));
        let moved = mesh.transformed(&t_a_b);
        for (turned, computed) in moved.normals.iter().zip(moved.vertex_normals()) {
            assert!((turned - computed).norm() < 1e-5);
        }
    }
}
