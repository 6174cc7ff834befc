//! How often global registration is right, and how often it says so: JSON lines, then a summary of each set.
//!
//! `registration_quality DATA SET ...`, where a set is one of
//! `submaps`, `pair`, `captures`: recorded clouds as they are;
//! `apart TRIES`: clouds of different places, `mirrored TRIES`: a place and its mirror image: nothing may be found;
//! `cuts PAIRS`: recorded submaps cut until 0.1 to 0.5 of the smaller overlaps;
//! `streets PAIRS`: two stretches of a simulated street between parallel walls, with the same overlaps.
//! `--seed N` draws others; `--only N` tries one of `cuts` or `streets` alone, as it comes among all.
//!
//! Every source is first moved by a random rotation and up to 20 m (indoor 2 m). Right: within 0.1 m at the cloud's centre
//! (indoor 0.02 m) and 0.5 degrees of the truth. Wrong and said to be found: off by more than a voxel or 2 degrees. Of
//! what is found, the error at the centre along the direction with the largest variance is given in standard deviations.

mod cuts;
mod recorded;
mod streets;

use nalgebra::{Matrix3x6, Point3, Quaternion, SymmetricEigen, Translation3, UnitQuaternion, Vector3};
use percept_geometry::{PointCloud, Pose, se3};
use percept_perception::registration::{GlobalOutcome, GlobalParams, GlobalResult, register_global};
use percept_perception::search::KdTree;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::json;
use std::collections::BTreeMap;
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

struct Submap {
    number: usize,
    t_map_submap: Pose,
    cloud: PointCloud,
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

/// Share of the cloud with fewer points that has the other within half a metre; both in one frame.
fn overlap_of_smaller(a: &[Point3<f32>], b: &[Point3<f32>]) -> f64 {
    let (less, more) = if a.len() < b.len() { (a, b) } else { (b, a) };
    overlap(&KdTree::build(more), &PointCloud::from_positions(less.to_vec()), &Pose::identity(), 0.5)
}

#[derive(Default)]
struct Score {
    runs: usize,
    right: usize,
    found: usize,
    wrong_called_good: usize,
    ms: Vec<f64>,
    /// By tenths of the true overlap: runs, found and right.
    by_overlap: BTreeMap<usize, [usize; 2]>,
    /// Errors of what was rightly found, along the direction with the largest variance, standard deviations.
    sigmas: Vec<f64>,
}

/// What differs between kinds of sensor.
struct Kind {
    voxel_m: f64,
    moved_m: f64,
    right_m: f64,
}

const LIDAR: Kind = Kind { voxel_m: 0.5, moved_m: 20.0, right_m: 0.1 };
const INDOOR: Kind = Kind { voxel_m: 0.05, moved_m: 2.0, right_m: 0.02 };

/// Standard deviation of where the source's `center` comes to lie, along the direction in which it is largest, and the
/// error there; metres.
fn weakest(found: &GlobalResult, t_true: &Pose, center: &Point3<f64>) -> (f64, f64) {
    let mut of_center = Matrix3x6::zeros();
    of_center.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
    of_center.fixed_view_mut::<3, 3>(0, 3).copy_from(&-se3::skew(&center.coords));
    let eigen = SymmetricEigen::new(of_center * found.covariance * of_center.transpose());
    let k = eigen.eigenvalues.imax();
    let off = found.t_target_source.inverse() * (t_true * center) - center;
    (eigen.eigenvalues[k].max(0.0).sqrt(), eigen.eigenvectors.column(k).dot(&off))
}

fn try_pair(pair: &Pair, kind: &Kind, rng: &mut ChaCha8Rng, score: &mut Score, truth: bool) -> Result<(), Failure> {
    let voxel_m = kind.voxel_m;
    let moved_by = random_pose(rng, kind.moved_m);
    let source = pair.source.transformed(&moved_by);
    let params = GlobalParams { voxel_size_m: voxel_m, ..GlobalParams::default() };
    let start = Instant::now();
    let found = register_global(&source, &pair.target, &params)?;
    let ms = start.elapsed().as_secs_f64() * 1e3;
    let n = source.len().max(1) as f64;
    let center = Point3::from(source.positions.iter().map(|p| p.coords.cast::<f64>()).sum::<Vector3<f64>>() / n);
    let t_true = pair.t_target_source * moved_by.inverse();
    let off_m = (found.t_target_source * center - t_true * center).norm();
    let off_deg = found.t_target_source.rotation.angle_to(&t_true.rotation).to_degrees();
    let right = truth && off_m < kind.right_m && off_deg < 0.5;
    let good = found.outcome == GlobalOutcome::Found;
    let wrong = !(truth && off_m < kind.voxel_m && off_deg < 2.0);
    let (sigma_m, along_m) = weakest(&found, &t_true, &center);
    score.runs += 1;
    score.right += usize::from(right);
    score.found += usize::from(good);
    score.wrong_called_good += usize::from(good && wrong);
    score.ms.push(ms);
    let bin = score.by_overlap.entry((pair.overlap * 10.0) as usize).or_default();
    bin[0] += 1;
    bin[1] += usize::from(good && !wrong);
    if good && !wrong {
        score.sigmas.push((along_m / sigma_m.max(1e-9)).abs());
    }
    println!(
        "{}",
        json!({"pair": pair.name, "true_overlap": pair.overlap, "outcome": format!("{:?}", found.outcome), "right": right,
            "wrong": wrong, "off_m": off_m, "off_deg": off_deg, "sigma_m": sigma_m, "along_m": along_m,
            "open": found.degenerate_axes, "overlap": found.overlap, "rival": found.rival_overlap,
            "evidence": found.evidence, "rival_evidence": found.rival_evidence,
            "pairs": found.num_pairs, "agreeing": found.num_agreeing, "ms": ms})
    );
    Ok(())
}

fn report(set: &str, mut score: Score) {
    score.ms.sort_by(f64::total_cmp);
    score.sigmas.sort_by(f64::total_cmp);
    let quantile = |q: f64| score.sigmas.get((q * score.sigmas.len() as f64) as usize);
    let recall: BTreeMap<String, String> = score
        .by_overlap
        .iter()
        .map(|(bin, [runs, found])| (format!("{:.1}", *bin as f64 / 10.0), format!("{found} of {runs}")))
        .collect();
    println!(
        "{}",
        json!({"set": set, "runs": score.runs, "right": score.right, "found": score.found,
            "wrong_called_good": score.wrong_called_good, "median_ms": score.ms.get(score.ms.len() / 2),
            "found_by_overlap": recall, "sigmas_median": quantile(0.5), "sigmas_95": quantile(0.95),
            "sigmas_99": quantile(0.99)})
    );
}

/// The number behind a word, if the word is there.
fn number_after(words: &[String], word: &str) -> Result<Option<u64>, Failure> {
    let Some(at) = words.iter().position(|w| w == word) else { return Ok(None) };
    let number = words.get(at + 1).ok_or_else(|| format!("{word} needs a number behind it"))?;
    Ok(Some(number.parse()?))
}

fn main() -> Result<(), Failure> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [data, sets @ ..] = &words[..] else { return Err("usage: registration_quality DATA SET ...".into()) };
    let data = Path::new(data);
    let seed = number_after(sets, "--seed")?.unwrap_or(0);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let only = number_after(sets, "--only")?;
    // Those that are left out draw their motion all the same.
    let chosen = |pairs: u64, rng: &mut ChaCha8Rng| match only {
        Some(only) => {
            (0..only).for_each(|_| {
                random_pose(rng, LIDAR.moved_m);
            });
            only as usize..only as usize + 1
        }
        None => 0..pairs as usize,
    };
    let folder = data.join("lidar-kitti-07-submaps");
    if sets.iter().any(|s| s == "submaps") {
        let mut score = Score::default();
        for pair in recorded::submaps(&recorded::read_submaps(&folder)?, |share| share >= 0.3) {
            try_pair(&pair, &LIDAR, &mut rng, &mut score, true)?;
        }
        report("submaps", score);
    }
    if sets.iter().any(|s| s == "pair") {
        let pair = recorded::small_gicp(&data.join("registration-small-gicp"))?;
        let mut score = Score::default();
        for _ in 0..50 {
            try_pair(&pair, &LIDAR, &mut rng, &mut score, true)?;
        }
        report("pair", score);
    }
    if sets.iter().any(|s| s == "captures") {
        let mut score = Score::default();
        for _ in 0..5 {
            for pair in &recorded::captures(data)? {
                try_pair(pair, &INDOOR, &mut rng, &mut score, true)?;
            }
        }
        report("captures", score);
    }
    if let Some(tries) = number_after(sets, "apart")? {
        let pairs = recorded::apart(data)?;
        let mut score = Score::default();
        for pair in pairs.iter().cycle().take(tries as usize) {
            try_pair(pair, &LIDAR, &mut rng, &mut score, false)?;
        }
        report("apart", score);
    }
    if let Some(tries) = number_after(sets, "mirrored")? {
        let pairs = recorded::mirrored(data)?;
        let mut score = Score::default();
        for pair in pairs.iter().cycle().take(tries as usize) {
            try_pair(pair, &LIDAR, &mut rng, &mut score, false)?;
        }
        report("mirrored", score);
    }
    if let Some(pairs) = number_after(sets, "cuts")? {
        let maps = recorded::read_submaps(&folder)?;
        let mut score = Score::default();
        for index in chosen(pairs, &mut rng) {
            try_pair(&cuts::pair(&maps, seed, index)?, &LIDAR, &mut rng, &mut score, true)?;
        }
        report("cuts", score);
    }
    if let Some(pairs) = number_after(sets, "streets")? {
        let mut score = Score::default();
        for index in chosen(pairs, &mut rng) {
            try_pair(&streets::pair(seed, index)?, &LIDAR, &mut rng, &mut score, true)?;
        }
        report("streets", score);
    }
    Ok(())
}
