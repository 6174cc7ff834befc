//! Prints what decoding costs: `times FOLDER`, the folder of the recorded data.

use percept_formats::dataset::{OpenOptions, open, open_with};
use std::path::Path;
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = std::env::args().nth(1).ok_or("usage: times FOLDER")?;
    let data = Path::new(&folder);
    for (name, range) in [("rgbd-7scenes-a", 0..50), ("lidar-kitti-tracking-0000", 0..24), ("cloud-pcl", 2..7)] {
        for depth_only in [false, true] {
            let options = OpenOptions { depth_only, ..OpenOptions::default() };
            let dataset = open_with(&data.join(name), &options)?;
            let start = Instant::now();
            for frame in dataset.frames(Some(range.clone())) {
                frame?;
            }
            let each_ms = start.elapsed().as_secs_f64() * 1e3 / range.len() as f64;
            println!("{name}: {each_ms:.2} ms a frame, depth_only {depth_only}");
        }
    }
    let start = Instant::now();
    let dataset = open(&data.join("lidar2d-intel"))?;
    let poses = dataset.reference.map_or(0, |r| r.len());
    println!("lidar2d-intel: opened in {:?}, reference {poses}", start.elapsed());
    Ok(())
}
