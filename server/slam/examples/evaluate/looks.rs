//! What features of each method tell apart: matches, and places found, in recorded depth images beside the truth.

use super::{Run, read, read::Failure};
use nalgebra::Vector6;
use percept_geometry::{
    CameraIntrinsics, Covariance6, FeatureMethod, GrayImage, KeyframeFeatures, KeyframeId, KeyframeScan, Pose,
    Timestamp,
};
use percept_perception::features2d::{
    Descriptors, MatchParams, Orb, OrbParams, Sift, SiftParams, binary_sift, match_features,
};
use percept_slam::keyframe::keyframe_scan;
use percept_slam::loops::{KeyframePoses, place_recognition};
use percept_slam::{BackEndParams, DepthScan, KeyframeParams, OdometryKind, OdometryParams, Scan};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

const METHODS: [FeatureMethod; 2] = [FeatureMethod::Orb, FeatureMethod::Sift];
/// What is compared: bits of both methods, and what SIFT's were made from.
const KINDS: [&str; 3] = ["orb", "sift", "sift, 128 numbers"];
/// Every so many frames are looked at.
const STEP: usize = 5;
/// A place is right within so many metres and radians: the truth itself is good to 1 to 3 cm.
const RIGHT: (f64, f64) = (0.1, 0.05);

struct View {
    t_world_camera: Pose,
    kept: [Arc<KeyframeScan>; 2],
    numbers: Descriptors,
}

impl View {
    fn features(&self, kind: usize) -> Option<(Descriptors, &KeyframeFeatures)> {
        let features = self.kept[kind.min(1)].features.as_deref()?;
        let bits = || Descriptors::Binary(features.features.iter().map(|f| f.descriptor).collect());
        Some((if kind == 2 { self.numbers.clone() } else { bits() }, features))
    }
}

/// Right and wrong matches, and places, of all kinds.
pub(crate) fn compare(dir: &Path) -> Result<(), Failure> {
    let views = views(dir)?;
    for (low, high) in [(0.0, 10.0), (10.0, 20.0), (20.0, 35.0), (35.0, 60.0)] {
        for ratio in [0.75, 0.85] {
            for (kind, name) in KINDS.iter().enumerate() {
                let (mut pairs, mut right, mut wrong) = (0.0, 0.0, 0.0);
                for (i, a) in views.iter().enumerate() {
                    for b in views[i + 1..].iter().filter(|b| (low..high).contains(&apart(a, b))) {
                        let Some((r, w)) = matches(a, b, kind, ratio) else { continue };
                        (pairs, right, wrong) = (pairs + 1.0, right + r as f64, wrong + w as f64);
                    }
                }
                println!(
                    "{low} to {high} apart, ratio {ratio}, {name}: of {pairs} pairs each {:.1} right, {:.1} wrong matches",
                    right / pairs,
                    wrong / pairs
                );
            }
        }
    }
    for (m, name) in KINDS.iter().enumerate().take(METHODS.len()) {
        let views: Vec<_> = views.iter().map(|v| (v.t_world_camera, Arc::clone(&v.kept[m]))).collect();
        found(&views, name);
    }
    Ok(())
}

/// Places alone, of views whose colour camera is believed to be where the depth camera is: two seconds, for sweeps.
pub(crate) fn places(dir: &Path) -> Result<(), Failure> {
    let recording = Recording::open(dir)?;
    let keep = |name: &String| -> Result<_, Failure> {
        let (scan, _) = recording.scan(name)?;
        let kept = keyframe_scan(&KeyframeParams::default(), Timestamp(0), &"camera".into(), &scan, &Vector6::zeros());
        Ok((recording.t_world_camera(name)?, Arc::new(kept)))
    };
    let views = recording.names.iter().step_by(STEP).map(keep).collect::<Result<Vec<_>, Failure>>()?;
    found(&views, KINDS[0]);
    Ok(())
}

/// A folder of images with depth and truth.
struct Recording<'a> {
    dir: &'a Path,
    k: Vec<f64>,
    names: Vec<String>,
}

impl<'a> Recording<'a> {
    fn open(dir: &'a Path) -> Result<Self, Failure> {
        let k = read::numbers(&dir.join("camera-intrinsics.txt"))?;
        let mut names: Vec<_> = std::fs::read_dir(dir)?
            .filter_map(|e| e.ok()?.file_name().into_string().ok()?.strip_suffix(".pose.txt").map(String::from))
            .collect();
        names.sort();
        Ok(Self { dir, k, names })
    }

    /// With the image in grey.
    fn scan(&self, name: &str) -> Result<(Scan, GrayImage), Failure> {
        let depth = Arc::new(read::depth_png(&self.dir.join(format!("{name}.depth.png")), 0.001)?);
        let color = Arc::new(read::color(&self.dir.join(format!("{name}.color.jpg")))?);
        let (gray, t_base_sensor) = (color.to_gray(), Pose::identity());
        let k = &self.k;
        let intrinsics = CameraIntrinsics::pinhole(depth.width(), depth.height(), k[0], k[4], k[2], k[5]);
        Ok((Scan::Depth(DepthScan { depth, color: Some(color), intrinsics, t_base_sensor }), gray))
    }

    fn t_world_camera(&self, name: &str) -> Result<Pose, Failure> {
        read::pose_3x4(&read::numbers(&self.dir.join(format!("{name}.pose.txt")))?)
    }
}

fn views(dir: &Path) -> Result<Vec<View>, Failure> {
    let recording = Recording::open(dir)?;
    let mut runs = METHODS.map(|features| {
        let mut params = OdometryParams::default();
        params.keyframe.features = features;
        Run::with(OdometryKind::Rgbd, params)
    });
    // Where the colour camera is, is found on the way.
    for (i, name) in recording.names.iter().enumerate() {
        let (scan, _) = recording.scan(name)?;
        runs.iter_mut().for_each(|r| r.step(Timestamp::from_secs_f64(i as f64 / 15.0), &scan, None));
    }
    let (mut views, mut ms) = (vec![], [0.0; 2]);
    for name in recording.names.iter().step_by(STEP) {
        let (scan, gray) = recording.scan(name)?;
        let mut keep = |i: usize| {
            let start = Instant::now();
            let kept = runs[i].odometry.keyframe_scan(Timestamp(0), &"camera".into(), &scan);
            ms[i] += start.elapsed().as_secs_f64() * 1e3;
            Arc::new(kept)
        };
        let max_features = KeyframeFeatures::LIMIT;
        views.push(View {
            t_world_camera: recording.t_world_camera(name)?,
            kept: [keep(0), keep(1)],
            numbers: Sift::new(SiftParams { max_features, ..SiftParams::default() })?.extract(&gray)?.descriptors,
        });
    }
    let n = views.len() as f64;
    println!("{n} images, ms a keyframe: orb {:.1}, sift {:.1}", ms[0] / n, ms[1] / n);
    Ok(views)
}

/// Degrees of turning, a metre as 20.
fn apart(a: &View, b: &View) -> f64 {
    let off = a.t_world_camera.inv_mul(&b.t_world_camera);
    off.rotation.angle().to_degrees() + 20.0 * off.translation.vector.norm()
}

/// How many are right and wrong, of those whose points are known.
fn matches(a: &View, b: &View, kind: usize, ratio: f64) -> Option<(usize, usize)> {
    let ((da, fa), (db, fb)) = (a.features(kind)?, b.features(kind)?);
    let params = MatchParams { ratio, mutual: true, max_distance: None };
    let t_a_b = a.t_world_camera.inv_mul(&b.t_world_camera);
    let (mut right, mut wrong) = (0, 0);
    for m in match_features(&da, &db, &params).ok()? {
        let (p, q) = (fa.features[m.query_index as usize].p_base, fb.features[m.train_index as usize].p_base);
        if p.x.is_finite() && q.x.is_finite() {
            // The truth, a few pixels across, and depth.
            let tolerance = 0.03 + 0.02 * f64::from(p.coords.norm());
            let is_right = (t_a_b * q.cast::<f64>() - p.cast::<f64>()).norm() < tolerance;
            if is_right { right += 1 } else { wrong += 1 }
        }
    }
    Some((right, wrong))
}

/// Places: every second view is in the map, the others ask where they are; and loops, each view after those before.
fn found(views: &[(Pose, Arc<KeyframeScan>)], name: &str) {
    for every in [2, 4, 8] {
        let Some(mut places) =
            place_recognition(OdometryKind::Rgbd, &OdometryParams::default(), BackEndParams::default().place_limits())
        else {
            return;
        };
        let mut poses = KeyframePoses::new();
        for (i, (t_world_camera, kept)) in views.iter().enumerate().step_by(every) {
            poses.insert(KeyframeId(i as u64), *t_world_camera);
            places.insert(KeyframeId(i as u64), &kept.into(), &Covariance6::identity(), &poses);
        }
        let (mut asked, mut right, mut wrong) = (0, 0, 0);
        for (_, (t_world_camera, kept)) in views.iter().enumerate().filter(|(i, _)| i % every != 0) {
            asked += 1;
            if let Some(r) = places.relocalise(kept, &poses) {
                let off = t_world_camera.inv_mul(&(poses[&r.keyframe] * r.t_keyframe_base));
                if is_right(&off) { right += 1 } else { wrong += 1 }
            }
        }
        println!("{name}: map of every {every}th view: {asked} asked, {right} found, {wrong} wrong");
    }
    let Some(mut places) =
        place_recognition(OdometryKind::Rgbd, &OdometryParams::default(), BackEndParams::default().place_limits())
    else {
        return;
    };
    let mut poses = KeyframePoses::new();
    let (mut right, mut wrong) = (0, 0);
    for (i, (t_world_camera, kept)) in views.iter().enumerate() {
        let id = KeyframeId(i as u64);
        poses.insert(id, *t_world_camera);
        for l in places.insert(id, &kept.into(), &Covariance6::identity(), &poses) {
            if is_right(&t_world_camera.inv_mul(&(poses[&l.from] * l.t_from_to))) { right += 1 } else { wrong += 1 }
        }
    }
    println!("{name}: {right} loops, {wrong} wrong");
}

fn is_right(off: &Pose) -> bool {
    off.translation.vector.norm() < RIGHT.0 && off.rotation.angle() < RIGHT.1
}

/// By how many bits features of images of different places differ; five images of each folder.
pub(crate) fn unrelated(folders: &[String]) -> Result<(), Failure> {
    for (m, method) in METHODS.into_iter().enumerate() {
        let sets: Vec<Vec<[u64; 4]>> =
            folders.iter().map(|f| bits_of(Path::new(f), method)).collect::<Result<_, _>>()?;
        let mut counts = vec![0u64; 257];
        for (i, a) in sets.iter().enumerate() {
            for (d, e) in sets[i + 1..].iter().flatten().flat_map(|e| a.iter().map(move |d| (d, e))) {
                counts[(0..4).map(|k| (d[k] ^ e[k]).count_ones() as usize).sum::<usize>()] += 1;
            }
        }
        let total: u64 = counts.iter().sum();
        for most in 40..=70 {
            let share = counts[..=most].iter().sum::<u64>() as f64 / total as f64;
            println!("{}: at most {most} bits: {:.3} % of {total}", KINDS[m], 100.0 * share);
        }
    }
    Ok(())
}

fn bits_of(folder: &Path, method: FeatureMethod) -> Result<Vec<[u64; 4]>, Failure> {
    let is_color = |p: &PathBuf| {
        let name = p.to_string_lossy();
        (name.ends_with(".png") || name.ends_with(".jpg")) && !name.contains("depth")
    };
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)?.flatten().map(|e| e.path()).filter(is_color).collect();
    files.sort();
    let max_features = KeyframeFeatures::LIMIT;
    let mut out = vec![];
    for file in files.iter().step_by(files.len().div_ceil(5).max(1)) {
        let gray = read::color(file)?.to_gray();
        let found = match method {
            FeatureMethod::Orb => Orb::new(OrbParams { max_features, ..OrbParams::default() })?.extract(&gray)?,
            FeatureMethod::Sift => Sift::new(SiftParams { max_features, ..SiftParams::default() })?.extract(&gray)?,
        };
        match found.descriptors {
            Descriptors::Binary(bits) => out.extend(bits),
            Descriptors::Bytes(numbers) => out.extend(numbers.iter().map(binary_sift)),
        }
    }
    Ok(out)
}
