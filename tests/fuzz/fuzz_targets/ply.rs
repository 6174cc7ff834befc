//! PLY clouds and meshes.
#![no_main]
use percept_formats::{Limits, ply};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    if let Ok(cloud) = ply::decode(bytes, &Limits::default()) {
        assert!(cloud.positions.len() <= bytes.len());
        for encoding in [ply::Encoding::Ascii, ply::Encoding::BinaryLittleEndian, ply::Encoding::BinaryBigEndian] {
            let again = ply::encode(&cloud, encoding).unwrap();
            assert_eq!(ply::decode(&again, &Limits::default()).unwrap().len(), cloud.len());
        }
    }
    let limits = Limits { max_points: 1 << 20, ..Limits::default() };
    if let Ok(mesh) = ply::decode_mesh(bytes, &limits) {
        assert!(mesh.triangles.len() <= bytes.len());
        let again = ply::encode_mesh(&mesh, ply::Encoding::BinaryLittleEndian).unwrap();
        let again = ply::decode_mesh(&again, &limits).unwrap();
        assert_eq!((again.positions, again.triangles), (mesh.positions, mesh.triangles));
    }
});
