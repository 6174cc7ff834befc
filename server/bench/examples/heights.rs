//! What a keyframe takes in the height layer, and what that holds: `heights PATH [FRAMES]`, a recording of a lidar in space.
//!
//! Each frame is a keyframe of all of its points, taken from where the one before was: so that the layer holds as much as it can around a
//! robot. Times are medians, milliseconds of the processor on one thread. Each layer finds the ground for itself; what the occupancy
//! grid takes for such a keyframe stands beside it.

use nalgebra::Point2;
use percept_formats::dataset;
use percept_geometry::{GridGeometry, KeyframeScan, Pose, SensorData};
use percept_mapping::height::HeightUpdate;
use percept_mapping::occupancy::ScanUpdate;
use percept_mapping::{HeightGrid, HeightParams, KeyframeView, OccupancyGrid, OccupancyParams};
use std::path::Path;

type Failure = Box<dyn std::error::Error + Send + Sync>;

/// Height of the lidar above the road, metres: KITTI's.
const LIDAR_M: f64 = 1.73;

fn main() -> Result<(), Failure> {
    let path = std::env::args().nth(1).ok_or("usage: heights PATH [FRAMES]")?;
    let most = std::env::args().nth(2).map_or(Ok(40), |n| n.parse())?;
    rayon::ThreadPoolBuilder::new().num_threads(1).build()?.install(|| measure(Path::new(&path), most))
}

fn measure(path: &Path, most: usize) -> Result<(), Failure> {
    let recording = dataset::open(path)?;
    let heights = HeightParams { enabled: true, ..HeightParams::default() };
    let occupancy = OccupancyParams::default();
    let geometry = GridGeometry::new(occupancy.resolution_m, Point2::origin());
    let (mut grid, mut cells) = (HeightGrid::new(heights)?, OccupancyGrid::new(occupancy)?);
    let (mut prepare, mut add, mut other, mut points) = (vec![], vec![], vec![], vec![]);
    for frame in recording.frames(None).take(most) {
        let frame = frame?;
        let SensorData::Cloud(cloud) = frame.data else { continue };
        let scan = KeyframeScan {
            stamp: frame.stamp,
            sensor: frame.sensor,
            t_base_sensor: Pose::identity(),
            hits: cloud,
            misses: vec![],
            base_height_m: LIDAR_M,
            planar: false,
            features: None,
        };
        points.push(scan.hits.len() as f64);
        let start = cpu_ms();
        let update = HeightUpdate::new(&heights, &KeyframeView::new(&Pose::identity(), &scan));
        let made = cpu_ms();
        // A reader holds the grid as it was.
        let held = grid.clone();
        grid.apply(&update);
        prepare.push(made - start);
        add.push(cpu_ms() - made);
        drop(held);
        let start = cpu_ms();
        cells.apply(&ScanUpdate::new(&occupancy, &geometry, &KeyframeView::new(&Pose::identity(), &scan)));
        other.push(cpu_ms() - start);
    }
    println!("{} keyframes of {:.0} points", points.len(), median(points));
    println!(
        "heights: prepared in {:.1} ms, added in {:.1}; occupancy: {:.1}",
        median(prepare),
        median(add),
        median(other)
    );
    println!("{} cells of ground, {} kB", grid.num_ground(), grid.memory_bytes() / 1024);
    Ok(())
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

/// Time that this thread has computed, milliseconds.
fn cpu_ms() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    time.tv_sec as f64 * 1e3 + time.tv_nsec as f64 / 1e6
}
