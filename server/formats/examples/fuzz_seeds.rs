//! Writes the seeds of the fuzz targets of clouds and images: `cargo run --example fuzz_seeds tests/fuzz/seeds`.

use nalgebra::{Point3, Vector3};
use percept_formats::{CloudFormat, images, pcd, ply, save_cloud};
use percept_geometry::{DepthImage, PointCloud, RgbImage};
use std::error::Error;
use std::path::Path;

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args().nth(1).ok_or("usage: fuzz_seeds FOLDER")?;
    let seed = |target: &str, name: &str, bytes: Vec<u8>| -> std::io::Result<()> {
        let folder = Path::new(&folder).join(target);
        std::fs::create_dir_all(&folder)?;
        std::fs::write(folder.join(name), bytes)
    };
    let full = PointCloud {
        positions: (0..6).map(|i| Point3::new(i as f32, -0.5 * i as f32, 0.25)).collect(),
        colors: Some((0..6).map(|i| [i, 2 * i, 255]).collect()),
        intensities: Some((0..6).map(|i| 40.0 + i as f32).collect()),
        normals: Some(vec![Vector3::z(); 6]),
        time_offsets_s: Some((0..6).map(|i| i as f32 * 1e-3).collect()),
    };
    let plain = PointCloud::from_positions(full.positions.clone());
    for (kind, cloud) in [("full", &full), ("plain", &plain)] {
        for (name, encoding) in [
            ("ascii", ply::Encoding::Ascii),
            ("little", ply::Encoding::BinaryLittleEndian),
            ("big", ply::Encoding::BinaryBigEndian),
        ] {
            seed("ply", &format!("{kind}_{name}.ply"), save_cloud(cloud, [0.0; 3], CloudFormat::Ply(encoding))?)?;
        }
        for (name, encoding) in [
            ("ascii", pcd::Encoding::Ascii),
            ("binary", pcd::Encoding::Binary),
            ("packed", pcd::Encoding::BinaryCompressed),
        ] {
            seed("pcd", &format!("{kind}_{name}.pcd"), save_cloud(cloud, [0.0; 3], CloudFormat::Pcd(encoding))?)?;
        }
        seed("xyz", &format!("{kind}.xyz"), save_cloud(cloud, [0.0; 3], CloudFormat::Xyz)?)?;
        seed("xyz", &format!("{kind}_utm.xyz"), save_cloud(cloud, [5e5, 5.4e6, 100.0], CloudFormat::Xyz)?)?;
        seed("kitti", &format!("{kind}.bin"), save_cloud(cloud, [0.0; 3], CloudFormat::KittiBin)?)?;
        for (name, format) in [("las", CloudFormat::Las), ("laz", CloudFormat::Laz)] {
            seed("las", &format!("{kind}.{name}"), save_cloud(cloud, [5e5, 5.4e6, 100.0], format)?)?;
            seed("cloud", &format!("{kind}.{name}"), save_cloud(cloud, [0.0; 3], format)?)?;
        }
    }
    let units: Vec<u16> = (0..48).map(|i| i * 100).collect();
    let depth = DepthImage::from_u16(8, 6, &units, 1e-3)?;
    let picture = RgbImage::new(8, 6, (0..144).collect())?;
    seed("depth_png", "depth.png", images::encode_depth_png(&depth, 1e-3)?)?;
    seed("depth_png", "gray.png", images::encode_gray_png(&picture.to_gray())?)?;
    seed("color", "colour.png", images::encode_rgb_png(&picture)?)?;
    seed("color", "gray.png", images::encode_gray_png(&picture.to_gray())?)?;
    seed("color", "colour.jpg", images::encode_jpeg(&picture, 80)?)?;
    Ok(())
}
