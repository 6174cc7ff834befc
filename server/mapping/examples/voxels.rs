//! Times voxels on scans, and writes what was found: `voxels LIST VOXEL_M RANGE_M [OUT]`.
//!
//! Each line of LIST is `FILE X Y Z`: points in the map frame as little-endian f32 triples, and where their beams start, metres. OUT gets
//! a line `x y z occupied` a known voxel, by its indices. One thread.

// A tool for developers may fail loudly.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::Point3;
use percept_geometry::{Aabb3, KeyframeScan, PointCloud, Pose, SensorId, Timestamp};
use percept_mapping::{KeyframeView, MapEntry, MapParams, VoxelGrid, VoxelParams, voxels::VoxelUpdate};
use std::io::Write;
use std::sync::Arc;
use std::time::Instant;

fn main() {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [list, voxel, range, ..] = &args[..] else { panic!("voxels LIST VOXEL_M RANGE_M [OUT]") };
    let params = VoxelParams {
        enabled: true,
        voxel_size_m: voxel.parse().expect("VOXEL_M is a number"),
        range_max_m: Some(range.parse().expect("RANGE_M is a number")),
        range_min_m: 0.0,
        ..Default::default()
    };
    rayon::ThreadPoolBuilder::new().num_threads(1).build_global().unwrap();
    let scans: Vec<KeyframeScan> = std::fs::read_to_string(list).unwrap().lines().map(read).collect();
    let (mut prepare, mut add) = (vec![], vec![]);
    for _ in 0..5 {
        let mut grid = VoxelGrid::new(params).unwrap();
        for scan in &scans {
            let begun = Instant::now();
            let update = VoxelUpdate::new(&params, &KeyframeView::new(&Pose::identity(), scan));
            prepare.push(begun.elapsed().as_secs_f64() * 1e3);
            let begun = Instant::now();
            grid.apply(&update);
            add.push(begun.elapsed().as_secs_f64() * 1e3);
        }
    }
    let median = |mut v: Vec<f64>| {
        v.sort_by(f64::total_cmp);
        v[v.len() / 2]
    };
    println!("{} scans: {:.1} ms to follow the beams, {:.1} ms to add", scans.len(), median(prepare), median(add));
    if let Some(out) = args.get(3) {
        let mut map = percept_mapping::Map::new(MapParams { voxels: params, ..Default::default() }).unwrap();
        for (i, scan) in scans.into_iter().enumerate() {
            let entry = MapEntry::at(Pose::identity());
            map.insert(percept_geometry::KeyframeId(i as u64), &entry, Arc::new(scan)).unwrap();
        }
        let all = Aabb3 { min: Point3::from([-1e4; 3]), max: Point3::from([1e4; 3]) };
        let mut file = std::io::BufWriter::new(std::fs::File::create(out).unwrap());
        for (v, log_odds) in map.layers().voxels.within(&all, usize::MAX).unwrap() {
            writeln!(file, "{} {} {} {}", v.x, v.y, v.z, u8::from(log_odds > 0.0)).unwrap();
        }
    }
}

fn read(line: &str) -> KeyframeScan {
    let words: Vec<&str> = line.split_whitespace().collect();
    let bytes = std::fs::read(words[0]).unwrap();
    let number = |b: &[u8]| f32::from_le_bytes(b.try_into().unwrap());
    let point = |b: &[u8]| Point3::new(number(&b[..4]), number(&b[4..8]), number(&b[8..12]));
    let mut t_base_sensor = Pose::identity();
    (0..3).for_each(|i| t_base_sensor.translation.vector[i] = words[1 + i].parse().unwrap());
    KeyframeScan {
        stamp: Timestamp(0),
        sensor: SensorId::from("lidar"),
        t_base_sensor,
        base_height_m: 0.0,
        hits: PointCloud::from_positions(bytes.chunks_exact(12).map(point).collect()),
        misses: vec![],
        planar: false,
        features: None,
    }
}
