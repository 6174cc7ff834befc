//! A triangle mesh in: the vertices as a cloud, then the faces.

use super::FORMAT;
use super::cursor::Cursor;
use super::header::{Element, Encoding, Header, Property};
use crate::text::Lines;
use crate::{FormatError, Limits, Place};
use percept_geometry::TriangleMesh;

/// A mesh from the bytes of a PLY file: vertices as [`super::decode`] reads them, and the faces' `vertex_indices` (or
/// `vertex_index`), whose polygons become fans of triangles about their first vertex.
///
/// Normals of unit length, zero where undefined. Other elements and properties are stepped over, bytes after the faces are not
/// looked at.
///
/// # Errors
/// Those of [`super::decode`]; `Missing` without faces; `Malformed` for a face of fewer than three vertices or an index of
/// none; `TooLarge` beyond `limits.max_points` faces or triangles; `Geometry` for a position that is not finite.
pub fn decode_mesh(bytes: &[u8], limits: &Limits) -> Result<TriangleMesh, FormatError> {
    let header = super::header::parse(bytes)?;
    let is_corners =
        |p: &Property| matches!(p.name.as_str(), "vertex_indices" | "vertex_index") && p.list_length.is_some();
    let face = header.elements.iter().position(|e| e.name == "face" && e.properties.iter().any(is_corners));
    let index = face.ok_or(FormatError::Missing { format: FORMAT, field: "element face with vertex_indices" })?;
    let (before, face) = (&header.elements[..index], &header.elements[index]);
    // Decoded first: it is what the file is compared with, cut ones included.
    let cloud = super::decode(bytes, limits)?;
    let num_faces = limits.faces(face.count)?;
    let available = (bytes.len() - header.body_offset) as u64;
    let needed = face.count.saturating_mul(least_bytes(face, header.encoding));
    if needed > available {
        return Err(FormatError::Truncated { format: FORMAT, field: "faces", needed, available });
    }
    let triangles = Vec::with_capacity(num_faces);
    let mut fans = Fans { num_vertices: cloud.len(), limits, triangles, corners: vec![] };
    match header.encoding {
        Encoding::Ascii => ascii(bytes, &header, before, face, is_corners, &mut fans)?,
        _ => binary(bytes, &header, before, face, is_corners, &mut fans)?,
    }
    let (normals, colors) = (cloud.normals.unwrap_or_default(), cloud.colors.unwrap_or_default());
    Ok(TriangleMesh::new(cloud.positions, normals, colors, fans.triangles)?)
}

/// What a face of three takes at least, bytes.
fn least_bytes(face: &Element, encoding: Encoding) -> u64 {
    let size = |p: &Property| p.list_length.map_or(p.scalar.size(), |length| length.size());
    match encoding {
        // Four numbers of one digit, and what parts them; the last line may have no end.
        Encoding::Ascii => 7,
        _ => face.properties.iter().map(|p| size(p) as u64).sum::<u64>().max(1),
    }
}

/// Grows triangles by faces.
struct Fans<'a> {
    num_vertices: usize,
    limits: &'a Limits,
    triangles: Vec<[u32; 3]>,
    corners: Vec<u32>,
}

impl Fans<'_> {
    /// Adds a corner of the face at hand.
    fn corner(&mut self, index: f64, place: Place) -> Result<(), FormatError> {
        if !(index >= 0.0 && index < self.num_vertices as f64 && index.fract() == 0.0) {
            let found = index.to_string();
            return Err(FormatError::malformed(
                FORMAT,
                place,
                "vertex_indices",
                found.as_bytes(),
                "the index of a vertex",
            ));
        }
        self.corners.push(index as u32);
        Ok(())
    }

    /// Ends the face at hand.
    fn face(&mut self, place: Place) -> Result<(), FormatError> {
        let [first, rest @ ..] = self.corners.as_slice() else { return Err(few_corners(0, place)) };
        if rest.len() < 2 {
            return Err(few_corners(self.corners.len(), place));
        }
        self.limits.faces((self.triangles.len() + rest.len() - 1) as u64)?;
        self.triangles.extend(rest.array_windows().map(|[b, c]| [*first, *b, *c]));
        self.corners.clear();
        Ok(())
    }
}

fn few_corners(found: usize, place: Place) -> FormatError {
    FormatError::malformed(FORMAT, place, "vertices of a face", found.to_string().as_bytes(), "three or more")
}

fn binary(
    bytes: &[u8],
    header: &Header,
    before: &[Element],
    face: &Element,
    is_corners: impl Fn(&Property) -> bool,
    fans: &mut Fans<'_>,
) -> Result<(), FormatError> {
    let big_endian = header.encoding == Encoding::BinaryBigEndian;
    let mut cursor = Cursor { bytes, offset: header.body_offset, big_endian };
    before.iter().try_for_each(|element| cursor.skip(element))?;
    for _ in 0..face.count {
        let place = Place::Byte(cursor.offset as u64);
        for property in &face.properties {
            let Some(length) = property.list_length else {
                cursor.take(property.scalar.size() as u64, "property")?;
                continue;
            };
            let items = cursor.list(property, length)?;
            if is_corners(property) {
                for item in items.chunks_exact(property.scalar.size()) {
                    fans.corner(property.scalar.read(item, big_endian), place)?;
                }
                fans.face(place)?;
            }
        }
    }
    Ok(())
}

fn ascii(
    bytes: &[u8],
    header: &Header,
    before: &[Element],
    face: &Element,
    is_corners: impl Fn(&Property) -> bool,
    fans: &mut Fans<'_>,
) -> Result<(), FormatError> {
    let mut lines = Lines::resume(FORMAT, bytes, header.body_offset, header.num_lines).contents();
    let available = (bytes.len() - header.body_offset) as u64;
    let cut = || FormatError::Truncated { format: FORMAT, field: "faces", needed: available + 1, available };
    for element in before.iter().filter(|e| !e.properties.is_empty()) {
        for _ in 0..element.count {
            lines.next().ok_or_else(cut)?;
        }
    }
    for _ in 0..face.count {
        let line = lines.next().ok_or_else(cut)?;
        let mut fields = line.fields();
        for property in &face.properties {
            if property.list_length.is_none() {
                fields.required(&property.name)?;
                continue;
            }
            for _ in 0..fields.number::<u32>(&property.name)? {
                if is_corners(property) {
                    fans.corner(fields.number(&property.name)?, line.place())?;
                } else {
                    fields.required(&property.name)?;
                }
            }
            if is_corners(property) {
                fans.face(line.place())?;
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ply::encode_mesh;
    use nalgebra::{Point3, Vector3};
    use proptest::prelude::*;

    const ENCODINGS: [Encoding; 3] = [Encoding::Ascii, Encoding::BinaryLittleEndian, Encoding::BinaryBigEndian];

    /// A sheet of `n` by `n` vertices.
    fn sheet(n: u32, channels: u8) -> TriangleMesh {
        let vertices = || (0..n * n).map(|i| (i % n, i / n));
        let positions: Vec<_> = vertices().map(|(x, y)| Point3::new(x as f32 * 0.1, y as f32, 0.3)).collect();
        let normals = if channels & 1 != 0 { vec![Vector3::z(); positions.len()] } else { vec![] };
        let colors = if channels & 2 != 0 { vertices().map(|(x, y)| [x as u8, y as u8, 9]).collect() } else { vec![] };
        let corners = vertices().filter(|&(x, y)| x + 1 < n && y + 1 < n).map(|(x, y)| y * n + x);
        let triangles = corners.flat_map(|k| [[k, k + 1, k + n], [k + 1, k + n + 1, k + n]]).collect();
        TriangleMesh::new(positions, normals, colors, triangles).unwrap()
    }

    fn text(faces: &str, count: u64) -> Vec<u8> {
        let vertices = "property float x\nproperty float y\nproperty float z\n";
        let face = "property uchar flag\nproperty list uchar int vertex_index\nproperty list uchar float texcoord\n";
        let head = format!("ply\nformat ascii 1.0\nelement vertex 5\n{vertices}element edge 1\nproperty int a\n");
        format!("{head}element face {count}\n{face}end_header\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n-1 0 0\n7\n{faces}")
            .into_bytes()
    }

    #[test]
    fn polygons_become_fans_and_other_properties_are_stepped_over() {
        let mesh = decode_mesh(&text("0 4 0 1 2 3 2 0.5 0.5\n1 5 0 1 2 3 4 0\n", 2), &Limits::default()).unwrap();
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3], [0, 1, 2], [0, 2, 3], [0, 3, 4]]);
    }

    #[test]
    fn faces_that_are_none_are_named() {
        let error = |faces: &str, count| decode_mesh(&text(faces, count), &Limits::default()).unwrap_err().to_string();
        assert!(error("0 2 0 1 0\n", 1).contains("line 20: vertices of a face is '2'"));
        assert!(error("0 3 0 1 5 0\n", 1).contains("vertex_indices is '5'"));
        assert!(error("0 3 0 1 -1 0\n", 1).contains("vertex_indices is '-1'"));
        assert!(error("0 3 0 1 2 0\n", 2).contains("faces needs"));
        assert!(error("0 3 0 1 2 0\n", u64::MAX).contains("num_faces"));
        assert!(error("0 3 0 1 2 0\n", 19_000_000).contains("faces needs"));
        let cloud = percept_geometry::PointCloud::from_positions(vec![Point3::origin()]);
        let cloud = crate::ply::encode(&cloud, Encoding::Ascii).unwrap();
        assert!(matches!(decode_mesh(&cloud, &Limits::default()), Err(FormatError::Missing { .. })));
        let few = Limits { max_points: 5, ..Limits::default() };
        let error = decode_mesh(&text("0 5 0 1 2 3 4 0\n0 5 0 1 2 3 4 0\n", 2), &few).unwrap_err();
        assert_eq!(error, FormatError::TooLarge { field: "num_faces", value: 6, limit: 5 });
    }

    #[test]
    fn a_mesh_cut_anywhere_is_an_error() {
        for encoding in ENCODINGS {
            let bytes = encode_mesh(&sheet(4, 3), encoding).unwrap();
            // The last index of a text may lose its line end or a digit and still be one.
            let spare = if encoding == Encoding::Ascii { 2 } else { 0 };
            for end in 0..bytes.len() - spare {
                assert!(decode_mesh(&bytes[..end], &Limits::default()).is_err(), "{encoding:?} cut at {end}");
            }
        }
    }

    proptest! {
        #[test]
        fn a_mesh_that_is_written_reads_back(n in 1u32..12, channels in 0u8..4, encoding in 0usize..3) {
            let mesh = sheet(n, channels);
            let bytes = encode_mesh(&mesh, ENCODINGS[encoding]).unwrap();
            prop_assert_eq!(decode_mesh(&bytes, &Limits::default()).unwrap(), mesh);
        }

        #[test]
        fn damaged_meshes_never_panic(
            encoding in 0usize..4, hits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6)
        ) {
            let mut bytes = match encoding {
                3 => text("0 4 0 1 2 3 2 0.5 0.5\n1 5 0 1 2 3 4 0\n", 2),
                i => encode_mesh(&sheet(3, 3), ENCODINGS[i]).unwrap(),
            };
            for (at, value) in hits {
                let at = at.index(bytes.len());
                bytes[at] = value;
            }
            if let Ok(mesh) = decode_mesh(&bytes, &Limits { max_points: 1000, ..Limits::default() }) {
                prop_assert_eq!(mesh.validate(), Ok(()));
            }
        }
    }
}
