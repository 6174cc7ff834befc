//! Clouds of every format: found by content, there and back, cut at every length.

use nalgebra::{Point3, Vector3};
use percept_formats::{
    CloudFormat, FormatError, Limits, load_cloud, pcd, ply, read_cloud_file, save_cloud, sniff_cloud,
};
use percept_geometry::PointCloud;

const FORMATS: [CloudFormat; 10] = [
    CloudFormat::Ply(ply::Encoding::Ascii),
    CloudFormat::Ply(ply::Encoding::BinaryLittleEndian),
    CloudFormat::Ply(ply::Encoding::BinaryBigEndian),
    CloudFormat::Pcd(pcd::Encoding::Ascii),
    CloudFormat::Pcd(pcd::Encoding::Binary),
    CloudFormat::Pcd(pcd::Encoding::BinaryCompressed),
    CloudFormat::Xyz,
    CloudFormat::KittiBin,
    CloudFormat::Las,
    CloudFormat::Laz,
];

fn name(format: CloudFormat) -> &'static str {
    // Only what has no beginning of its own needs its name.
    if format == CloudFormat::KittiBin { "scan.bin" } else { "upload" }
}

/// A cloud with those channels that the format keeps.
fn cloud(n: usize, format: CloudFormat) -> PointCloud {
    let f = |i: usize, k: usize| ((i * 7 + k * 13) % 1000) as f32 * 0.125 - 40.0;
    let mut cloud = PointCloud {
        positions: (0..n).map(|i| Point3::new(f(i, 0), f(i, 1), f(i, 2))).collect(),
        colors: Some((0..n).map(|i| [i as u8, (i * 3) as u8, 255]).collect()),
        intensities: Some((0..n).map(|i| (i % 300 + 2) as f32).collect()),
        normals: Some((0..n).map(|i| Vector3::new(f(i, 5), 1.0, 2.0).normalize()).collect()),
        time_offsets_s: Some((0..n).map(|i| i as f32 * 1e-4).collect()),
    };
    match format {
        CloudFormat::Ply(_) | CloudFormat::Pcd(_) => return cloud,
        CloudFormat::Xyz => cloud.intensities = None,
        CloudFormat::KittiBin => (cloud.colors, cloud.normals) = (None, None),
        CloudFormat::Las | CloudFormat::Laz => cloud.normals = None,
    }
    cloud.time_offsets_s = None;
    cloud
}

#[test]
fn every_format_is_found_by_its_content_and_comes_back() {
    for format in FORMATS {
        let cloud = cloud(500, format);
        let bytes = save_cloud(&cloud, [0.0; 3], format).unwrap();
        assert_eq!(sniff_cloud(&bytes, name(format)).unwrap(), format);
        let mut back = load_cloud(&bytes, name(format), &Limits::default()).unwrap();
        assert_eq!((back.format, back.origin_m, back.width, back.height), (format, [0.0; 3], 500, 1));
        if matches!(format, CloudFormat::Las | CloudFormat::Laz) {
            for (a, b) in back.cloud.positions.iter_mut().zip(&cloud.positions) {
                assert!((*a - b).norm() < 1e-5);
                *a = *b;
            }
        }
        assert_eq!(back.cloud, cloud, "{format:?}");
    }
}

#[test]
fn a_file_read_piece_by_piece_is_the_file_read_at_once() {
    let dir = tempfile::tempdir().unwrap();
    for format in FORMATS {
        for n in [0, 1, 20_000] {
            let bytes = save_cloud(&cloud(n, format), [0.0; 3], format).unwrap();
            let path = dir.path().join(name(format));
            std::fs::write(&path, &bytes).unwrap();
            if bytes.is_empty() && format == CloudFormat::Xyz {
                continue;
            }
            let at_once = load_cloud(&bytes, name(format), &Limits::default()).unwrap();
            assert_eq!(read_cloud_file(&path, &Limits::default()).unwrap(), at_once, "{format:?} of {n}");
            if n > 0 {
                std::fs::write(&path, &bytes[..bytes.len() - bytes.len() / 3]).unwrap();
                let cut = read_cloud_file(&path, &Limits::default());
                assert!(matches!(format, CloudFormat::Xyz | CloudFormat::KittiBin) || cut.is_err(), "{format:?}");
            }
        }
    }
}

#[test]
fn every_prefix_is_an_error_or_a_shorter_cloud() {
    for format in FORMATS {
        let bytes = save_cloud(&cloud(12, format), [0.0; 3], format).unwrap();
        for end in 0..bytes.len() {
            if let Ok(file) = load_cloud(&bytes[..end], name(format), &Limits::default()) {
                assert!(file.cloud.len() <= 12);
                file.cloud.validate().unwrap();
            }
        }
    }
}

#[test]
fn an_origin_is_kept_or_refused() {
    let utm = [500_000.0, 5_400_000.0, 100.0];
    for format in FORMATS {
        match save_cloud(&cloud(3, format), utm, format) {
            Ok(bytes) => {
                let back = load_cloud(&bytes, "", &Limits::default()).unwrap();
                let y = f64::from(back.cloud.positions[1].y) + back.origin_m[1];
                assert!((y - f64::from(cloud(3, format).positions[1].y) - utm[1]).abs() < 1e-4);
            }
            Err(e) => assert!(matches!(e, FormatError::Unsupported { field: "origin_m", .. })),
        }
    }
}

#[test]
fn what_is_nothing_is_said_to_be() {
    for (bytes, name) in [(&b""[..], ""), (b"\x00\x01\x02", "thing"), (b"\x89PNG\r\n\x1a\n", "a.png")] {
        assert!(matches!(sniff_cloud(bytes, name), Err(FormatError::Malformed { .. })));
    }
}
