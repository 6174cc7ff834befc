//! A triangle mesh out: vertices, then faces of three.

use super::header::Encoding;
use super::write::{append_floats, encoding_name, write_properties};
use crate::FormatError;
use percept_geometry::TriangleMesh;
use std::io::Write;

/// Bytes of a PLY file of a mesh; see [`write_mesh`].
///
/// # Errors
/// `Geometry` if the mesh's parts do not fit each other.
pub fn encode_mesh(mesh: &TriangleMesh, encoding: Encoding) -> Result<Vec<u8>, FormatError> {
    let mut out = Vec::with_capacity(512 + mesh.positions.len() * 27 + mesh.triangles.len() * 13);
    write_mesh(&mut out, mesh, encoding)?;
    Ok(out)
}

/// Writes a PLY file of a mesh: float x y z (m), float nx ny nz and uchar red green blue if it has them; faces as
/// `list uchar uint vertex_indices`. A mesh without triangles is a file with no faces.
///
/// Wrap files in a `BufWriter`: each vertex and triangle is a write of its own.
///
/// # Errors
/// `Geometry` if the mesh's parts do not fit each other; `Write` if the writer refuses.
pub fn write_mesh(out: &mut impl Write, mesh: &TriangleMesh, encoding: Encoding) -> Result<(), FormatError> {
    mesh.validate()?;
    write!(out, "ply\nformat {} 1.0\nelement vertex {}\n", encoding_name(encoding), mesh.positions.len())?;
    write_properties(out, "float", &["x", "y", "z"])?;
    if !mesh.normals.is_empty() {
        write_properties(out, "float", &["nx", "ny", "nz"])?;
    }
    if !mesh.colors.is_empty() {
        write_properties(out, "uchar", &["red", "green", "blue"])?;
    }
    let num_faces = mesh.triangles.len();
    write!(out, "element face {num_faces}\nproperty list uchar uint vertex_indices\nend_header\n")?;
    let mut row = Vec::with_capacity(128);
    for (i, position) in mesh.positions.iter().enumerate() {
        row.clear();
        append_floats(&mut row, position.coords.as_slice(), encoding);
        if let Some(normal) = mesh.normals.get(i) {
            append_floats(&mut row, normal.as_slice(), encoding);
        }
        match (mesh.colors.get(i), encoding) {
            (None, _) => {}
            (Some([r, g, b]), Encoding::Ascii) => write!(row, "{r} {g} {b} ")?,
            (Some(color), _) => row.extend(color),
        }
        end_row(&mut row, encoding);
        out.write_all(&row)?;
    }
    for [a, b, c] in &mesh.triangles {
        match encoding {
            Encoding::Ascii => writeln!(out, "3 {a} {b} {c}")?,
            Encoding::BinaryLittleEndian => out.write_all(&face([a, b, c].map(|i| i.to_le_bytes())))?,
            Encoding::BinaryBigEndian => out.write_all(&face([a, b, c].map(|i| i.to_be_bytes())))?,
        }
    }
    Ok(())
}

fn face(indices: [[u8; 4]; 3]) -> [u8; 13] {
    let mut face = [3; 13];
    face[1..].copy_from_slice(indices.as_flattened());
    face
}

/// The last number's space becomes a line end.
fn end_row(row: &mut Vec<u8>, encoding: Encoding) {
    if encoding == Encoding::Ascii {
        row.pop();
        row.push(b'\n');
    }
}
