//! How often global registration is right on recorded clouds, and how often it says so: JSON lines.
//!
//! `registration_quality DATA [submaps] [pair] [captures] [apart TRIES]`: every source is first moved by a random rotation
//! and up to 20 m (indoor 2 m). Right: within 0.1 m at the cloud's centre (indoor 0.02 m) and 0.5 degrees of the truth. `apart` tries clouds of different places: nothing may be found there.

use nalgebra::{Point3, Quaternion, Translation3, UnitQuaternion, Vector3};
use percept_geometry::{PointCloud, Pose};
use percept_perception::registration::{
    GlobalOutcome, GlobalParams, IcpMethod, IcpParams, RegisterParams, register, register_global,
};
use percept_perception::search::KdTree;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::json;
use std::error::Error;
use std::path::Path;
use std::time::Instant;

type Failure = Box<dyn Error>;

struct Pair {
    name: String,
    source: PointCloud,
    target: PointCloud,
    t_target_source: Pose,
    overlap: f64,
}

fn random_pose(rng: &mut ChaCha8Rng, reach_m: f64) -> Pose {
    // A uniform rotation is a uniform direction in four dimensions.
    let q = loop {
        let v = nalgebra::Vector4::from_fn(|_, _| rng.random_range(-1.0..1.0f64));
        if (0.01..1.0).contains(&v.norm_squared()) {
            break UnitQuaternion::from_quaternion(Quaternion::from(v));
        }
    };
    let t = Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0f64)) * reach_m / 3f64.sqrt();
    Pose::from_parts(Translation3::from(t), q)
}

fn overlap(target: &KdTree, source: &PointCloud, t: &Pose, distance_m: f32) -> f64 {
    let sample: Vec<_> = source.positions.iter().step_by(10).collect();
    let near = |p: &&&Point3<f32>| target.nearest_within(&(t * p.cast::<f64>()).cast(), distance_m).is_some();
    sample.iter().filter(near).count() as f64 / sample.len().max(1) as f64
}

fn submaps(folder: &Path, wanted: impl Fn(f64) -> bool) -> Result<Vec<Pair>, Failure> {
    let graph = std::fs::read_to_string(folder.join("graph.txt"))?;
    let mut maps: Vec<(usize, Pose, PointCloud, KdTree)> = Vec::new();
    for line in graph.lines() {
        let words: Vec<&str> = line.split_whitespace().collect();
        let Some(number) = words.first().and_then(|w| w.strip_prefix('v')) else { continue };
        let v: Vec<f64> = words[1..8].iter().map(|w| w.parse()).collect::<Result<_, _>>()?;
        let pose = Pose::from_parts(
            Translation3::new(v[0], v[1], v[2]),
            UnitQuaternion::from_quaternion(Quaternion::new(v[6], v[3], v[4], v[5])),
        );
        let number: usize = number.parse()?;
        let bytes = std::fs::read(folder.join(format!("{number:06}")).join("points.bin"))?;
        let f = |c: &[u8]| f32::from_le_bytes([c[0], c[1], c[2], c[3]]);
        let points: Vec<_> =
            bytes.chunks_exact(12).map(|c| Point3::new(f(&c[0..4]), f(&c[4..8]), f(&c[8..12]))).collect();
        let tree = KdTree::build(&points);
        maps.push((number, pose, PointCloud::from_positions(points), tree));
    }
    let mut out = Vec::new();
    for (i, a, target, tree) in &maps {
        for (j, b, source, _) in &maps {
            let t_target_source = a.inverse() * b;
            let share = if i == j { f64::NAN } else { overlap(tree, source, &t_target_source, 0.5) };
            if wanted(share) {
                let (source, target) = (source.clone(), target.clone());
                out.push(Pair { name: format!("{i}<-{j}"), source, target, t_target_source, overlap: share });
            }
        }
    }
    Ok(out)
}

fn small_gicp(folder: &Path) -> Result<Pair, Failure> {
    let limits = percept_formats::Limits::default();
    let read = |name: &str| -> Result<PointCloud, Failure> {
        Ok(percept_formats::read_cloud_file(&folder.join(name), &limits)?.cloud)
    };
    let text = std::fs::read_to_string(folder.join("T_target_source.txt"))?;
    let v: Vec<f64> = text.split_whitespace().map(str::parse).collect::<Result<_, _>>()?;
    let r = nalgebra::Matrix3::new(v[0], v[1], v[2], v[4], v[5], v[6], v[8], v[9], v[10]);
    let pose = Pose::from_parts(Translation3::new(v[3], v[7], v[11]), UnitQuaternion::from_matrix(&r));
    let (source, target) = (read("source.ply")?, read("target.ply")?);
    Ok(Pair { name: "target<-source".into(), source, target, t_target_source: pose, overlap: 0.9 })
}

/// Neighbouring captures of a room, either way. No truth is given: it is what GICP makes of the greatest overlap from
/// several starts, the sensor not having moved and what global registration says among them.
fn captures(data: &Path) -> Result<Vec<Pair>, Failure> {
    let limits = percept_formats::Limits::default();
    let read = |k: usize| -> Result<PointCloud, Failure> {
        let file = data.join(format!("cloud-pcl/capture000{k}.pcd"));
        let cloud = percept_formats::read_cloud_file(&file, &limits)?.cloud;
        let finite = cloud.positions.iter().copied().filter(|p| p.iter().all(|v| v.is_finite())).collect();
        Ok(PointCloud::from_positions(finite))
    };
    let clouds: Vec<PointCloud> = (1..=5).map(read).collect::<Result<_, _>>()?;
    let mut out = Vec::new();
    for (k, at) in clouds.windows(2).enumerate() {
        let [target, source] = at else { continue };
        let tree = KdTree::build(&target.positions);
        let mut best = (0.0, Pose::identity());
        let mut starts = vec![Pose::identity()];
        for voxel_size_m in [0.03, 0.05, 0.08] {
            let params = GlobalParams { voxel_size_m, ..GlobalParams::default() };
            starts.push(register_global(source, target, &params)?.t_target_source);
        }
        for start in starts {
            let mut t = start;
            for max_distance_m in [0.1, 0.03] {
                let icp = IcpParams {
                    max_distance_m,
                    max_iterations: 50,
                    num_neighbours: 20,
                    ..IcpParams::lidar(IcpMethod::Gicp)
                };
                let fine = RegisterParams { voxel_sizes_m: vec![0.01], icp };
                t = register(source, target, &t, &fine)?.t_target_source;
            }
            let share = overlap(&tree, source, &t, 0.02);
            if share > best.0 {
                best = (share, t);
            }
        }
        let names = [format!("{}<-{}", k + 1, k + 2), format!("{}<-{}", k + 2, k + 1)];
        let [forth, back] = names;
        let (a, b) = (source.clone(), target.clone());
        out.push(Pair { name: forth, source: a, target: b, t_target_source: best.1, overlap: best.0 });
        let (a, b) = (target.clone(), source.clone());
        out.push(Pair { name: back, source: a, target: b, t_target_source: best.1.inverse(), overlap: best.0 });
    }
    Ok(out)
}

/// Every cloud with every cloud of another recording.
fn apart(data: &Path) -> Result<Vec<Pair>, Failure> {
    let limits = percept_formats::Limits::default();
    let mut clouds: Vec<(&str, PointCloud)> = Vec::new();
    for pair in submaps(&data.join("lidar-kitti-07-submaps"), |share| share >= 0.8)? {
        clouds.push(("07", pair.target));
    }
    clouds.push(("small_gicp", small_gicp(&data.join("registration-small-gicp"))?.target));
    for (recording, folder) in
        [("00", "lidar-kitti-odometry-00/velodyne"), ("tracking", "lidar-kitti-tracking-0000/velodyne")]
    {
        let mut files: Vec<_> = std::fs::read_dir(data.join(folder))?.filter_map(|e| Some(e.ok()?.path())).collect();
        files.sort();
        for file in files.iter().step_by((files.len() / 5).max(1)) {
            clouds.push((recording, percept_formats::read_cloud_file(file, &limits)?.cloud));
        }
    }
    let mut out = Vec::new();
    for (a, target) in &clouds {
        for (b, source) in clouds.iter().filter(|(b, _)| b != a) {
            let (source, target) = (source.clone(), target.clone());
            out.push(Pair {
                name: format!("{a}<-{b}"),
                source,
                target,
                t_target_source: Pose::identity(),
                overlap: 0.0,
            });
        }
    }
    Ok(out)
}

#[derive(Default)]
struct Score {
    runs: usize,
    right: usize,
    found: usize,
    wrong_called_good: usize,
    ms: Vec<f64>,
}

/// What differs between kinds of sensor.
struct Kind {
    voxel_m: f64,
    moved_m: f64,
    right_m: f64,
}

const LIDAR: Kind = Kind { voxel_m: 0.5, moved_m: 20.0, right_m: 0.1 };
const INDOOR: Kind = Kind { voxel_m: 0.05, moved_m: 2.0, right_m: 0.02 };

fn try_pair(pair: &Pair, kind: &Kind, rng: &mut ChaCha8Rng, score: &mut Score, truth: bool) -> Result<(), Failure> {
    let voxel_m = kind.voxel_m;
    let moved_by = random_pose(rng, kind.moved_m);
    let source = pair.source.transformed(&moved_by);
    let params = GlobalParams { voxel_size_m: voxel_m, ..GlobalParams::default() };
    let start = Instant::now();
    let found = register_global(&source, &pair.target, &params)?;
    let ms = start.elapsed().as_secs_f64() * 1e3;
    let n = pair.source.len().max(1) as f64;
    let center = Point3::from(pair.source.positions.iter().map(|p| p.coords.cast::<f64>()).sum::<Vector3<f64>>() / n);
    let error = |t: &Pose| {
        let d = t * moved_by;
        let off = (d * center - pair.t_target_source * center).norm();
        (off, d.rotation.angle_to(&pair.t_target_source.rotation).to_degrees())
    };
    let (off_m, off_deg) = error(&found.t_target_source);
    let right = truth && off_m < kind.right_m && off_deg < 0.5;
    let good = found.outcome == GlobalOutcome::Found;
    score.runs += 1;
    score.right += usize::from(right);
    score.found += usize::from(good);
    score.wrong_called_good += usize::from(good && !(truth && off_m < kind.voxel_m && off_deg < 2.0));
    score.ms.push(ms);
    println!(
        "{}",
        json!({"pair": pair.name, "true_overlap": pair.overlap, "outcome": format!("{:?}", found.outcome), "right": right,
            "off_m": off_m, "off_deg": off_deg,
            "overlap": found.overlap, "rival": found.rival_overlap, "pairs": found.num_pairs,
            "agreeing": found.num_agreeing, "ms": ms})
    );
    Ok(())
}

fn report(set: &str, mut score: Score) {
    score.ms.sort_by(f64::total_cmp);
    println!(
        "{}",
        json!({"set": set, "runs": score.runs, "right": score.right, "found": score.found,
            "wrong_called_good": score.wrong_called_good, "median_ms": score.ms[score.ms.len() / 2]})
    );
}

fn main() -> Result<(), Failure> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [data, sets @ ..] = &words[..] else { return Err("usage: registration_quality DATA SET ...".into()) };
    let data = Path::new(data);
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let folder = data.join("lidar-kitti-07-submaps");
    if sets.iter().any(|s| s == "submaps") {
        let mut score = Score::default();
        for pair in submaps(&folder, |share| share >= 0.3)? {
            try_pair(&pair, &LIDAR, &mut rng, &mut score, true)?;
        }
        report("submaps", score);
    }
    if sets.iter().any(|s| s == "pair") {
        let pair = small_gicp(&data.join("registration-small-gicp"))?;
        let mut score = Score::default();
        for _ in 0..50 {
            try_pair(&pair, &LIDAR, &mut rng, &mut score, true)?;
        }
        report("pair", score);
    }
    if sets.iter().any(|s| s == "captures") {
        let mut score = Score::default();
        for _ in 0..5 {
            for pair in &captures(data)? {
                try_pair(pair, &INDOOR, &mut rng, &mut score, true)?;
            }
        }
        report("captures", score);
    }
    if let Some(at) = sets.iter().position(|s| s == "apart") {
        let tries: usize = sets.get(at + 1).map_or(Ok(100), |n| n.parse())?;
        let pairs = apart(data)?;
        let mut score = Score::default();
        for k in 0..tries {
            try_pair(&pairs[k % pairs.len()], &LIDAR, &mut rng, &mut score, false)?;
        }
        report("apart", score);
    }
    Ok(())
}
