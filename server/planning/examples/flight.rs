//! Times paths in space: `flight [EDGE] [QUERIES] [SEED]`.
//!
//! The box is EDGE x EDGE x EDGE / 8 voxels of 0.2 m (400) with a floor, pillars of random height and slabs between storeys
//! with holes; the ball has a radius of 0.3 m. Prints the processor's time of whole calls (voxels and ends in, path out) over
//! voxels and at any angle, and by how much the latter are shorter.

#![allow(clippy::unwrap_used, reason = "a tool: it fails loudly")]

use nalgebra::Point3;
use percept_geometry::Voxel;
use percept_planning::flight::{DenseVoxels, FlightOutcome, FlightParams, FlightPlanner, FlightRequest, plan_flight};

fn main() {
    let mut arguments = std::env::args().skip(1).map(|a| a.parse::<u64>().unwrap());
    let edge = arguments.next().unwrap_or(400) as usize;
    let queries = arguments.next().unwrap_or(20) as usize;
    let mut random = Random(arguments.next().unwrap_or(1));
    let voxels = building(edge, &mut random);
    let params = FlightParams::default();
    let (mut over_voxels, mut any_angle, mut ratios) = (vec![], vec![], vec![]);
    while ratios.len() < queries {
        let mut place = || {
            let [x, y, z] = voxels.size.map(|side| random.below(side) as i32);
            Voxel::new(x, y, z).center(voxels.voxel_size_m)
        };
        let (start, goal): (Point3<f64>, Point3<f64>) = (place(), place());
        let timed = |planner: FlightPlanner, times: &mut Vec<f64>| {
            let begin = processor_ms();
            let request = FlightRequest { planner, ..FlightRequest::new(start, goal, &params) };
            let outcome = plan_flight(&voxels, &request).unwrap();
            let FlightOutcome::Path(path) = outcome else { return None };
            times.push(processor_ms() - begin);
            Some(path)
        };
        if let Some(way) = timed(FlightPlanner::Lattice, &mut over_voxels) {
            ratios.push(timed(FlightPlanner::AnyAngle, &mut any_angle).unwrap().length_m / way.length_m);
        }
    }
    println!("{:?} voxels, {queries} queries with a path", voxels.size);
    for (name, mut times) in [("over voxels", over_voxels), ("at any angle", any_angle)] {
        times.sort_by(f64::total_cmp);
        println!("{name:12} median {:8.1} ms  most {:8.1} ms", times[times.len() / 2], times[times.len() - 1]);
    }
    println!("length at any angle over that over voxels: mean {:.3}", ratios.iter().sum::<f64>() / ratios.len() as f64);
}

fn building(edge: usize, random: &mut Random) -> DenseVoxels {
    let size = [edge, edge, (edge / 8).max(8)];
    let mut percent = vec![0i8; size.iter().product()];
    let mut fill = |x: std::ops::Range<usize>, y: std::ops::Range<usize>, z: std::ops::Range<usize>, value: i8| {
        for z in z.start..z.end.min(size[2]) {
            for y in y.start..y.end.min(edge) {
                (x.start..x.end.min(edge)).for_each(|x| percent[(z * edge + y) * edge + x] = value);
            }
        }
    };
    for floor in (0..size[2]).step_by(16) {
        fill(0..edge, 0..edge, floor..floor + 1, 100);
        for _ in 0..if floor == 0 { 0 } else { edge * edge / 2000 } {
            let (x, y) = (random.below(edge), random.below(edge));
            fill(x..x + 8, y..y + 8, floor..floor + 1, 0);
        }
    }
    for _ in 0..edge * edge / 150 {
        let (x, y, z, height) =
            (random.below(edge), random.below(edge), random.below(size[2]), 4 + random.below(size[2]));
        fill(x..x + 2, y..y + 2, z..z + height, 100);
    }
    DenseVoxels::new(0.2, Voxel::new(0, 0, 0), size, percent).unwrap()
}

/// Time that this thread was on a processor, milliseconds: what others run does not count.
fn processor_ms() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap();
    text.split_whitespace().next().unwrap().parse::<f64>().unwrap() / 1e6
}

/// Small generator (Knuth's MMIX constants): the same box everywhere.
struct Random(u64);

impl Random {
    fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (self.0 >> 33) as usize % n
    }
}
