//! LAS 1.0 to 1.4 and LAZ point clouds: positions, colours, intensities in and out.
//!
//! Source: ASPRS, LAS Specification 1.4-R15; the packed points are those of Isenburg's LASzip, by the library `laz`.
//! Our own header reader compares every size with the bytes before the library sees them. Coordinates are integers with
//! scale and offset; positions come relative to an origin in f64, so that map coordinates keep their millimetres.

mod header;
mod packed;
mod read;
mod write;

pub(crate) use header::is_compressed;
pub use read::decode;
pub use write::encode;

const FORMAT: &str = "LAS";

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{FormatError, Limits};
    use nalgebra::Point3;
    use percept_geometry::PointCloud;
    use proptest::prelude::*;

    fn cloud(n: usize, channels: u8) -> PointCloud {
        let f = |i: usize, k: usize| ((i * 7 + k * 13) % 1000) as f32 * 0.125 - 40.0;
        PointCloud {
            positions: (0..n).map(|i| Point3::new(f(i, 0), f(i, 1), f(i, 2))).collect(),
            colors: (channels & 1 != 0).then(|| (0..n).map(|i| [i as u8, (i * 3) as u8, 255]).collect()),
            intensities: (channels & 2 != 0).then(|| (0..n).map(|i| (i * 31 % 5000 + 2) as f32).collect()),
            ..PointCloud::default()
        }
    }

    #[test]
    fn a_file_cut_anywhere_is_an_error() {
        for packed in [false, true] {
            let bytes = encode(&cloud(40, 3), [0.0; 3], packed).unwrap();
            // What follows the packed points is the table of chunks, which only seeking needs.
            let spare = if packed { 24 } else { 0 };
            for end in 0..bytes.len() - spare {
                assert!(
                    decode(&bytes[..end], &Limits::default()).is_err(),
                    "packed {packed}, cut at {end} of {}",
                    bytes.len()
                );
            }
        }
    }

    #[test]
    fn what_unpacks_to_more_than_a_file_may_have_is_refused_before_it_is_unpacked() {
        let bytes = encode(&cloud(4000, 0), [0.0; 3], true).unwrap();
        let unpacked = 4000 * u64::from(u16::from_le_bytes([bytes[105], bytes[106]]));
        assert!(unpacked > bytes.len() as u64);
        let limits = |max_bytes| Limits { max_bytes, ..Limits::default() };
        assert!(decode(&bytes, &limits(unpacked)).is_ok());
        let error = decode(&bytes, &limits(unpacked - 1)).unwrap_err();
        assert!(matches!(error, FormatError::TooLarge { field: "num_bytes", .. }), "{error}");
    }

    #[test]
    fn a_wrong_count_is_named() {
        for count in [0u32, 39, 41, 1_000_000, u32::MAX] {
            let mut bytes = encode(&cloud(40, 0), [0.0; 3], false).unwrap();
            bytes[107..111].copy_from_slice(&count.to_le_bytes());
            let error = decode(&bytes, &Limits::default()).unwrap_err();
            match error {
                FormatError::Malformed { field, .. } => assert!(count < 40 && field == "number of points"),
                FormatError::Truncated { .. } => assert!(count > 40 && count < u32::MAX),
                FormatError::TooLarge { .. } => assert_eq!(count, u32::MAX),
                other => unreachable!("{other}"),
            }
        }
    }

    #[test]
    fn map_coordinates_lose_nothing() {
        let utm = [500_000.0, 5_400_000.0, 100.0];
        for packed in [false, true] {
            let bytes = encode(&cloud(40, 0), utm, packed).unwrap();
            let (back, origin) = decode(&bytes, &Limits::default()).unwrap();
            for (a, b) in cloud(40, 0).positions.iter().zip(&back.positions) {
                for k in 0..3 {
                    let error = f64::from(a[k]) + utm[k] - f64::from(b[k]) - origin[k];
                    assert!(error.abs() < 1e-4, "{error}");
                }
            }
        }
    }

    proptest! {
        #[test]
        fn what_is_written_reads_back(n in 0usize..200, channels in 0u8..4, packed in any::<bool>()) {
            let cloud = cloud(n, channels);
            let (back, origin) = decode(&encode(&cloud, [0.0; 3], packed).unwrap(), &Limits::default()).unwrap();
            prop_assert_eq!(origin, [0.0; 3]);
            prop_assert_eq!(back.colors, cloud.colors);
            if n > 0 { prop_assert_eq!(back.intensities, cloud.intensities); }
            for (a, b) in cloud.positions.iter().zip(&back.positions) {
                prop_assert!((a - b).norm() < 1e-4);
            }
        }

        #[test]
        fn damaged_bytes_never_panic(
            packed in any::<bool>(), hits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6)
        ) {
            let mut bytes = encode(&cloud(30, 3), [0.0; 3], packed).unwrap();
            for (at, value) in hits {
                let at = at.index(bytes.len());
                bytes[at] = value;
            }
            let _ = decode(&bytes, &Limits { max_points: 1000, ..Limits::default() });
        }
    }
}
