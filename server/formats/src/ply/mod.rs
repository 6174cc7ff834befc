//! PLY point clouds and triangle meshes: ascii and binary of both byte orders, in and out.
//!
//! Source: Turk, "The PLY polygon file format", 1994. Read are the vertices with `x y z`, colour
//! (`red green blue`), intensity and normals; other properties and elements, lists included, are stepped over.

mod cursor;
mod faces;
mod header;
mod mesh;
mod read;
mod write;

pub use faces::decode_mesh;
pub use header::Encoding;
pub use mesh::{encode_mesh, write_mesh};
pub use read::decode;
pub(crate) use read::{encoding, rows};
pub use write::{encode, write};

const FORMAT: &str = "PLY";

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Limits;
    use nalgebra::{Point3, Vector3};
    use percept_geometry::{PointCloud, TriangleMesh};
    use proptest::prelude::*;

    fn cloud(n: usize, seed: u32) -> PointCloud {
        let f = |i: usize, k: u32| ((i as u32 * 7 + k * 13 + seed) % 1000) as f32 * 0.137 - 40.0;
        PointCloud {
            positions: (0..n).map(|i| Point3::new(f(i, 0), f(i, 1), f(i, 2))).collect(),
            colors: Some((0..n).map(|i| [i as u8, (i * 3) as u8, (i * 7) as u8]).collect()),
            intensities: Some((0..n).map(|i| f(i, 4)).collect()),
            normals: Some((0..n).map(|i| Vector3::new(f(i, 5), 1.0, 2.0).normalize()).collect()),
            time_offsets_s: Some((0..n).map(|i| f(i, 8)).collect()),
        }
    }

    /// The same cloud in any encoding, with a property and an element that nobody knows, lists included.
    fn foreign(cloud: &PointCloud, encoding: Encoding) -> Vec<u8> {
        let name = match encoding {
            Encoding::Ascii => "ascii",
            Encoding::BinaryLittleEndian => "binary_little_endian",
            Encoding::BinaryBigEndian => "binary_big_endian",
        };
        let mut out = format!(
            "ply\r\nformat {name} 1.0\r\ncomment by someone\r\nelement camera 2\r\nproperty short id\r\n\
             property list uchar ushort pixels\r\nelement vertex {}\r\nproperty double x\r\nproperty list uint8 int32 seen\r\n\
             property float64 y\r\nproperty float32 z\r\nproperty uchar red\r\nproperty uchar green\r\nproperty uchar blue\r\n\
             element face 1\r\nproperty list uchar int vertex_indices\r\nend_header\r\n",
            cloud.len()
        )
        .into_bytes();
        let value = |out: &mut Vec<u8>, v: f64, size: usize, float: bool| {
            let big = match (float, size) {
                (true, 8) => v.to_be_bytes().to_vec(),
                (true, _) => (v as f32).to_be_bytes().to_vec(),
                (false, n) => (v as i64).to_be_bytes()[8 - n..].to_vec(),
            };
            match encoding {
                Encoding::Ascii => out.extend(format!("{v} ").bytes()),
                Encoding::BinaryBigEndian => out.extend(big),
                Encoding::BinaryLittleEndian => out.extend(big.iter().rev()),
            }
        };
        let end = |out: &mut Vec<u8>| {
            if encoding == Encoding::Ascii {
                out.push(b'\n');
            }
        };
        for i in 0..2 {
            value(&mut out, f64::from(i), 2, false);
            value(&mut out, f64::from(i), 1, false);
            (0..i).for_each(|k| value(&mut out, f64::from(k), 2, false));
            end(&mut out);
        }
        for i in 0..cloud.len() {
            let p = cloud.positions[i];
            value(&mut out, f64::from(p.x), 8, true);
            value(&mut out, (i % 3) as f64, 1, false);
            (0..i % 3).for_each(|k| value(&mut out, k as f64, 4, false));
            value(&mut out, f64::from(p.y), 8, true);
            value(&mut out, f64::from(p.z), 4, true);
            cloud.colors.as_ref().unwrap()[i].iter().for_each(|&c| value(&mut out, f64::from(c), 1, false));
            end(&mut out);
        }
        out
    }

    #[test]
    fn foreign_properties_and_elements_are_stepped_over() {
        let known = PointCloud { intensities: None, normals: None, time_offsets_s: None, ..cloud(11, 3) };
        for encoding in [Encoding::Ascii, Encoding::BinaryLittleEndian, Encoding::BinaryBigEndian] {
            let bytes = foreign(&known, encoding);
            assert_eq!(decode(&bytes, &Limits::default()).unwrap(), known, "{encoding:?}");
            for end in 0..bytes.len() - 10 {
                assert!(decode(&bytes[..end], &Limits::default()).is_err(), "{encoding:?} cut at {end}");
            }
        }
    }

    #[test]
    fn a_file_cut_anywhere_is_an_error() {
        for encoding in [Encoding::Ascii, Encoding::BinaryLittleEndian, Encoding::BinaryBigEndian] {
            let bytes = encode(&cloud(5, 1), encoding).unwrap();
            // A text's last number may lose its line end or digits and still be a number.
            let spare = if encoding == Encoding::Ascii { 12 } else { 0 };
            for end in 0..bytes.len() - spare {
                assert!(decode(&bytes[..end], &Limits::default()).is_err(), "{encoding:?} cut at {end}");
            }
        }
    }

    #[test]
    fn a_lying_count_takes_no_memory() {
        let text = |n: u64| {
            format!(
                "ply\nformat binary_little_endian 1.0\nelement vertex {n}\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
            )
        };
        let error = decode(text(19_000_000).as_bytes(), &Limits::default()).unwrap_err();
        assert!(matches!(error, crate::FormatError::Truncated { needed: 228_000_000, available: 0, .. }), "{error}");
        let error = decode(text(u64::MAX).as_bytes(), &Limits::default()).unwrap_err();
        assert!(matches!(error, crate::FormatError::TooLarge { field: "num_points", .. }), "{error}");
    }

    fn tetrahedron() -> TriangleMesh {
        let positions =
            [[0.0, 0.0, 0.0], [1.5, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1e-9]].map(Point3::from).to_vec();
        let (normals, colors) = (vec![Vector3::z(); 4], vec![[1, 2, 3], [4, 5, 6], [7, 8, 9], [255, 0, 10]]);
        TriangleMesh::new(positions, normals, colors, vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]).unwrap()
    }

    #[test]
    fn a_mesh_is_its_vertices_and_then_its_faces() {
        let mesh = tetrahedron();
        for encoding in [Encoding::Ascii, Encoding::BinaryLittleEndian, Encoding::BinaryBigEndian] {
            let bytes = encode_mesh(&mesh, encoding).unwrap();
            let cloud = decode(&bytes, &Limits::default()).unwrap();
            assert_eq!(cloud.positions, mesh.positions);
            assert_eq!((cloud.normals, cloud.colors), (Some(mesh.normals.clone()), Some(mesh.colors.clone())));
            let last: &[u8] = match encoding {
                Encoding::Ascii => b"\n3 1 2 3\n",
                Encoding::BinaryLittleEndian => &[3, 1, 0, 0, 0, 2, 0, 0, 0, 3, 0, 0, 0],
                Encoding::BinaryBigEndian => &[3, 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0, 3],
            };
            assert!(bytes.ends_with(last), "{encoding:?}");
        }
        let bare = TriangleMesh { normals: vec![], colors: vec![], ..mesh.clone() };
        let text = String::from_utf8(encode_mesh(&bare, Encoding::Ascii).unwrap()).unwrap();
        assert!(
            text.ends_with("end_header\n0 0 0\n1.5 0 0\n0 1 0\n0 0 -0.000000001\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n")
        );
        let empty = encode_mesh(&TriangleMesh::default(), Encoding::Ascii).unwrap();
        assert!(String::from_utf8(empty).unwrap().contains("element vertex 0\n"));
        assert!(encode_mesh(&TriangleMesh { triangles: vec![[4; 3]], ..mesh }, Encoding::Ascii).is_err());
    }

    #[test]
    fn an_empty_cloud_and_a_cloud_without_channels_survive() {
        for encoding in [Encoding::Ascii, Encoding::BinaryLittleEndian, Encoding::BinaryBigEndian] {
            for positions in [vec![], vec![Point3::new(1.0, -2.5, 1e-20)]] {
                let cloud = PointCloud::from_positions(positions);
                let bytes = encode(&cloud, encoding).unwrap();
                assert_eq!(decode(&bytes, &Limits::default()).unwrap(), cloud);
            }
        }
    }

    #[test]
    fn a_bad_number_is_found_by_its_line() {
        let text = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nend_header\n1 2 3\n1 zwei 3\n";
        let error = decode(text.as_bytes(), &Limits::default()).unwrap_err();
        assert_eq!(error.to_string(), "PLY, line 9: y is 'zwei', expected a number");
    }

    proptest! {
        #[test]
        fn what_is_written_reads_back(n in 0usize..40, seed in any::<u32>(), encoding in 0usize..3) {
            let cloud = cloud(n, seed % 1000);
            let encoding = [Encoding::Ascii, Encoding::BinaryLittleEndian, Encoding::BinaryBigEndian][encoding];
            let back = decode(&encode(&cloud, encoding).unwrap(), &Limits::default()).unwrap();
            prop_assert_eq!(back, cloud);
        }

        #[test]
        fn damaged_bytes_never_panic(
            seed in 0u32..1000, kind in 0usize..4, hits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6)
        ) {
            let cloud = cloud(4, seed);
            let mut bytes = match kind {
                0 => encode(&cloud, Encoding::Ascii).unwrap(),
                1 => encode(&cloud, Encoding::BinaryLittleEndian).unwrap(),
                2 => foreign(&cloud, Encoding::BinaryBigEndian),
                _ => foreign(&cloud, Encoding::Ascii),
            };
            for (at, value) in hits {
                let at = at.index(bytes.len());
                bytes[at] = value;
            }
            let _ = decode(&bytes, &Limits { max_points: 1000, ..Limits::default() });
        }
    }
}
