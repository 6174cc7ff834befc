//! PCD point clouds: ascii, binary and binary_compressed in (versions .5 to .7) and out.
//!
//! Source: the Point Cloud Library's documentation of the PCD file format, version 0.7. Bytes after the
//! declared points are padding and not looked at; the viewpoint is told, not applied.

mod header;
mod lzf;
mod read;
mod write;

pub use header::Encoding;
pub use read::{Pcd, decode};
pub(crate) use read::{encoding, rows};
pub use write::{encode, encode_as, write};

const FORMAT: &str = "PCD";

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{FormatError, Limits};
    use nalgebra::{Point3, Vector3};
    use percept_geometry::PointCloud;
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

    /// label (u16), x y z (f64), two bytes of padding, rgba: as ascii, binary or compressed (literals only).
    fn labelled(n: usize, encoding: &str) -> Vec<u8> {
        let header = format!(
            "# .PCD v.7\nVERSION .7\nFIELDS label x y z _ rgba\nSIZE 2 8 8 8 1 4\nTYPE U F F F U U\nCOUNT 1 1 1 1 2 1\n\
             WIDTH {n}\nHEIGHT 1\nVIEWPOINT 1 2 3 1 0 0 0\nPOINTS {n}\nDATA {encoding}\n"
        );
        let mut out = header.into_bytes();
        let columns: [fn(usize) -> Vec<u8>; 6] = [
            |i| (i as u16 * 10).to_le_bytes().to_vec(),
            |i| (i as f64).to_le_bytes().to_vec(),
            |i| (i as f64 + 0.5).to_le_bytes().to_vec(),
            |i| (-(i as f64)).to_le_bytes().to_vec(),
            |_| vec![9, 9],
            |i| (0xff01_0200 + i as u32).to_le_bytes().to_vec(),
        ];
        match encoding {
            "ascii" => {
                for i in 0..n {
                    let rgba = 0xff01_0200 + i as u32;
                    out.extend(format!("{} {i} {}.5 -{i} 9 9 {rgba}\n", i * 10, i).bytes());
                }
            }
            "binary" => (0..n).for_each(|i| columns.iter().for_each(|c| out.extend(c(i)))),
            _ => {
                let data: Vec<u8> = columns.iter().flat_map(|c| (0..n).flat_map(c)).collect();
                let packed: Vec<u8> =
                    data.chunks(32).flat_map(|c| std::iter::once(c.len() as u8 - 1).chain(c.iter().copied())).collect();
                out.extend((packed.len() as u32).to_le_bytes());
                out.extend((data.len() as u32).to_le_bytes());
                out.extend(packed);
            }
        }
        out
    }

    #[test]
    fn all_encodings_say_the_same() {
        for encoding in ["ascii", "binary", "binary_compressed"] {
            let mut bytes = labelled(7, encoding);
            for end in 0..bytes.len() - 12 {
                assert!(decode(&bytes[..end], &Limits::default()).is_err(), "{encoding} cut at {end}");
            }
            if encoding != "ascii" {
                bytes.extend([0; 100]);
            }
            let pcd = decode(&bytes, &Limits::default()).unwrap();
            assert_eq!((pcd.width, pcd.height), (7, 1));
            assert_eq!(pcd.t_cloud_viewpoint, percept_geometry::Pose::translation(1.0, 2.0, 3.0));
            assert_eq!(pcd.labels.unwrap(), [0, 10, 20, 30, 40, 50, 60]);
            assert_eq!(pcd.cloud.positions[3], Point3::new(3.0, 3.5, -3.0));
            assert_eq!(pcd.cloud.colors.unwrap()[3], [1, 2, 3]);
            assert!(pcd.cloud.intensities.is_none() && pcd.cloud.normals.is_none());
        }
    }

    #[test]
    fn lying_headers_take_no_memory() {
        let text = |width: u64, data: &str| {
            let header = format!("FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH {width}\nHEIGHT 1\nDATA {data}\n");
            let mut bytes = header.into_bytes();
            bytes.extend([4, 0, 0, 0, 255, 255, 255, 255, 0, 0, 0, 0]);
            decode(&bytes, &Limits::default()).unwrap_err()
        };
        assert!(matches!(text(u64::MAX, "binary"), FormatError::TooLarge { field: "num_points", .. }));
        for data in ["ascii", "binary", "binary_compressed"] {
            assert!(matches!(text(10_000_000, data), FormatError::Truncated { .. } | FormatError::Malformed { .. }));
        }
        let odd = b"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 18446744073709551615\nWIDTH 5\nDATA binary\n";
        assert!(matches!(decode(odd, &Limits::default()), Err(FormatError::Truncated { .. })));
        let odd = b"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 0\nWIDTH 5\nDATA binary\n";
        assert!(decode(odd, &Limits::default()).is_err());
    }

    proptest! {
        #[test]
        fn what_is_written_reads_back(n in 0usize..40, seed in 0u32..1000, channels in 0u8..16, encoding in 0usize..3) {
            let mut cloud = cloud(n, seed);
            if channels & 1 == 0 { cloud.colors = None; }
            if channels & 2 == 0 { cloud.intensities = None; }
            if channels & 4 == 0 { cloud.normals = None; }
            if channels & 8 == 0 { cloud.time_offsets_s = None; }
            let encoding = [Encoding::Ascii, Encoding::Binary, Encoding::BinaryCompressed][encoding];
            let bytes = encode_as(&cloud, encoding).unwrap();
            prop_assert_eq!(decode(&bytes, &Limits::default()).unwrap().cloud, cloud);
        }

        #[test]
        fn damaged_bytes_never_panic(
            kind in 0usize..3, hits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6)
        ) {
            let mut bytes = labelled(5, ["ascii", "binary", "binary_compressed"][kind]);
            for (at, value) in hits {
                let at = at.index(bytes.len());
                bytes[at] = value;
            }
            let _ = decode(&bytes, &Limits { max_points: 1000, ..Limits::default() });
        }
    }
}
