//! The 2D grid of a planar log whose poses are given: `planar_grid LOG [RESOLUTION_M] [MAX_RANGE_M]`.
//!
//! LOG is a CARMEN log whose `FLASER` rows hold corrected poses, as `intel.gfs.log` has them: 180 beams over a half turn less one step.
//! Every scan enters, returns beyond the largest range (30 m) are left out, cells are of 0.05 m: what other libraries were timed on.
//! Times are those of this thread's processor for all scans, milliseconds: from ranges to a packed grid of one submap (a dense
//! window is what others fill), the same without the ends of beams, and with all that a [`Map`] does beside it: submaps and the tiles of
//! what is read. Medians of eleven rounds after one that is not counted, and the least. The robot's own way is not marked, as others do not.

use nalgebra::{Point2, Point3};
use percept_geometry::{GridGeometry, KeyframeId, KeyframeScan, PointCloud, Pose, SensorId, Timestamp, se3};
use percept_mapping::occupancy::ScanUpdate;
use percept_mapping::{KeyframeView, Map, MapEntry, MapParams, Occupancy, OccupancyGrid, OccupancyParams};
use std::f64::consts::PI;
use std::sync::Arc;

type Failure = Box<dyn std::error::Error + Send + Sync>;

const ROUNDS: usize = 11;

struct Row {
    ranges: Vec<f64>,
    t_map_base: Pose,
}

fn main() -> Result<(), Failure> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let path = args.first().ok_or("usage: planar_grid LOG [RESOLUTION_M] [MAX_RANGE_M]")?;
    let number = |i: usize, usual: f64| args.get(i).map_or(Ok(usual), |v| v.parse::<f64>());
    let (resolution_m, range_max_m) = (number(1, 0.05)?, number(2, 30.0)?);
    let params = OccupancyParams {
        resolution_m,
        range_max_m: Some(range_max_m),
        footprint_radius_m: 0.0,
        ..OccupancyParams::default()
    };
    let rows = rows(&std::fs::read_to_string(path)?)?;
    rayon::ThreadPoolBuilder::new().num_threads(1).build()?.install(|| measure(&params, &rows))
}

/// Of the `FLASER` rows: count, ranges, x, y and yaw.
fn rows(text: &str) -> Result<Vec<Row>, Failure> {
    let mut out = vec![];
    for line in text.lines().filter(|l| l.starts_with("FLASER")) {
        let words: Vec<f64> = line.split_whitespace().skip(1).map_while(|w| w.parse().ok()).collect();
        let num = words.first().copied().unwrap_or(0.0) as usize;
        let [x, y, yaw] = words.get(num + 1..num + 4).ok_or("a FLASER row is too short")?[..] else { continue };
        out.push(Row { ranges: words[1..=num].to_vec(), t_map_base: se3::from_xy_yaw(x, y, yaw) });
    }
    Ok(out)
}

fn measure(params: &OccupancyParams, rows: &[Row]) -> Result<(), Failure> {
    let num_beams = rows.first().ok_or("no FLASER rows")?.ranges.len();
    let beam = |i: usize| -0.5 * PI * (num_beams - 1) as f64 / num_beams as f64 + PI * i as f64 / num_beams as f64;
    let directions: Vec<(f64, f64)> = (0..num_beams).map(|i| beam(i).sin_cos()).collect();
    let scan = |row: &Row| {
        let ends = row.ranges.iter().zip(&directions).filter(|(r, _)| **r > 0.0 && **r < params.range_max());
        let ends = ends.map(|(r, (sin, cos))| Point3::new((r * cos) as f32, (r * sin) as f32, 0.0));
        KeyframeScan {
            stamp: Timestamp(0),
            sensor: SensorId::from("scan"),
            t_base_sensor: Pose::identity(),
            hits: PointCloud::from_positions(ends.collect()),
            misses: vec![],
            base_height_m: 0.0,
            planar: true,
            features: None,
        }
    };
    let geometry = GridGeometry::new(params.resolution_m, Point2::origin());
    let scans: Vec<Arc<KeyframeScan>> = rows.iter().map(|row| Arc::new(scan(row))).collect();
    let mut filled = OccupancyGrid::new(*params)?;
    let from_ranges = rounds(|| {
        filled = OccupancyGrid::new(*params)?;
        for row in rows {
            let scan = scan(row);
            filled.apply(&ScanUpdate::new(params, &geometry, &KeyframeView::new(&row.t_map_base, &scan)));
        }
        Ok(())
    })?;
    let from_ends = rounds(|| {
        let mut grid = OccupancyGrid::new(*params)?;
        for (row, scan) in rows.iter().zip(&scans) {
            grid.apply(&ScanUpdate::new(params, &geometry, &KeyframeView::new(&row.t_map_base, scan)));
        }
        Ok(())
    })?;
    let mut map_params = MapParams { occupancy: *params, ..MapParams::default() };
    // As far as the cloud's voxels go; it takes its time, too.
    map_params.cloud.range_max_m = Some(params.range_max());
    let with_map = rounds(|| {
        let mut map = Map::new(map_params)?;
        for (i, (row, scan)) in rows.iter().zip(&scans).enumerate() {
            map.insert(KeyframeId(i as u64), &MapEntry::at(row.t_map_base), Arc::clone(scan))?;
        }
        map.layers().occupancy.dense(100_000_000)?;
        Ok(())
    })?;
    let grid = filled.dense(100_000_000)?;
    let count = |is: fn(i8) -> bool| grid.cells.iter().filter(|v| is(**v)).count();
    println!(
        "{} scans of {num_beams} beams; {} cells occupied, {} free",
        rows.len(),
        count(|v| v > 50),
        count(|v| (0..50).contains(&v))
    );
    println!("  grid from ranges: {from_ranges} ms");
    println!("  grid from ends of beams: {from_ends} ms");
    println!("  map with grid and cloud, read once: {with_map} ms");
    Ok(())
}

/// Median and least of the rounds, as text.
fn rounds(mut work: impl FnMut() -> Result<(), Failure>) -> Result<String, Failure> {
    let mut ms = vec![];
    for _ in 0..=ROUNDS {
        let before = cpu_ms();
        work()?;
        ms.push(cpu_ms() - before);
    }
    ms.remove(0);
    ms.sort_by(f64::total_cmp);
    Ok(format!("{:.1} (least {:.1})", ms[ROUNDS / 2], ms[0]))
}

/// Time that this thread has computed, milliseconds.
fn cpu_ms() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    time.tv_sec as f64 * 1e3 + time.tv_nsec as f64 / 1e6
}
