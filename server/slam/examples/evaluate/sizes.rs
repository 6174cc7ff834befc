//! Places that a depth camera with colour recognises, by the size of its images: the simulator's worlds, with the truth.

use super::read::Failure;
use percept_geometry::{CameraIntrinsics, Covariance6, KeyframeId, KeyframeScan, Pose, SensorData, Timestamp};
use percept_sim::{DepthCameraParams, SensorSuite, SimParams, Simulation};
use percept_slam::loops::{KeyframePoses, PlaceRecognition, Relocalisation, place_recognition};
use percept_slam::{
    BackEndParams, DepthScan, KeyframeParams, KeyframePolicy, OdometryKind, OdometryParams, Scan, keyframe,
};
use std::sync::Arc;

/// Off by more is a wrong place, metres and degrees.
const WRONG: (f64, f64) = (0.2, 5.0);
/// Views that a lost robot has from its way.
const WAY: usize = 6;

/// What keyframes keep, with the truth.
type Views = Vec<(Pose, Arc<KeyframeScan>)>;

/// `WIDTHxHEIGHT SEED SEED ...`: of each world one lap is the map. What is asked: the same way with other noise, alone and
/// with the way driven; the second half of it in a map of the first; another world; and loops of the second lap.
pub(crate) fn compare(args: &[String]) -> Result<(), Failure> {
    let (width, height) = args[0].split_once('x').ok_or("size is WIDTHxHEIGHT")?;
    let camera = camera(width.parse()?, height.parse()?);
    let mut sums: [Tally; 6] = Default::default();
    for seed in &args[1..] {
        let seed = seed.parse()?;
        let (there, again) = (drive(&camera, seed, 1)?, drive(&camera, seed, 7)?);
        // So far away that every place found is a wrong one.
        let away = Pose::translation(1000.0, 0.0, 0.0);
        let elsewhere: Views = drive(&camera, seed + 100, 7)?.into_iter().map(|(t, s)| (away * t, s)).collect();
        let mut tallies: [Tally; 6] = Default::default();
        let (mut places, poses) = taken_in(&there)?;
        ask(&*places, &poses, &again, &mut tallies[0]);
        ask_driven(&mut *places, &poses, &again, &mut tallies[1]);
        ask(&*places, &poses, &elsewhere, &mut tallies[2]);
        ask_driven(&mut *places, &poses, &elsewhere, &mut tallies[3]);
        let (half, half_poses) = taken_in(&there[..there.len() / 2])?;
        ask(&*half, &half_poses, &again[again.len() / 2..], &mut tallies[4]);
        close(places, poses, &again, &mut tallies[5]);
        print(&format!("{width}x{height} world {seed}"), &mut tallies);
        sums.iter_mut().zip(tallies).for_each(|(sum, t)| sum.add(t));
    }
    print(&format!("{width}x{height} all"), &mut sums);
    Ok(())
}

fn print(what: &str, tallies: &mut [Tally; 6]) {
    let names = ["alone", "driven", "elsewhere", "elsewhere driven", "unknown half", "loops"];
    let all: Vec<String> = names.iter().zip(tallies).map(|(name, t)| format!("{name} {}", t.figures())).collect();
    println!("{what}: {}", all.join("; "));
}

/// The default camera's view in fewer pixels.
fn camera(width: usize, height: usize) -> DepthCameraParams {
    let full = DepthCameraParams::default().intrinsics;
    let f = full.fx * width as f64 / full.width as f64;
    let centre = ((width as f64 - 1.0) / 2.0, (height as f64 - 1.0) / 2.0);
    let intrinsics = CameraIntrinsics::pinhole(width, height, f, f, centre.0, centre.1);
    DepthCameraParams { intrinsics, ..DepthCameraParams::default() }
}

/// The keyframes of a lap.
fn drive(camera: &DepthCameraParams, world: u64, noise: u64) -> Result<Views, Failure> {
    let (intrinsics, t_base_sensor) = (camera.intrinsics, camera.t_base_sensor());
    let mut params = SimParams { seed: noise, ..SimParams::default() };
    (params.world.seed, params.world.person) = (world, false);
    params.sensors = SensorSuite {
        // Keyframes of different laps are not taken at the same places.
        depth_camera: Some(DepthCameraParams { rate_hz: if noise == 1 { 2.0 } else { 1.3 }, ..camera.clone() }),
        lidar3d: None,
        lidar2d: None,
        odometry: None,
        imu: None,
    };
    let kept = KeyframeParams::default();
    let mut policy = KeyframePolicy::new(kept.clone());
    let mut views = vec![];
    for f in Simulation::new(params)?.frames() {
        let SensorData::Rgbd(depth, color) = f.frame.data else { continue };
        if policy.consider(&f.t_world_base) {
            let (depth, color) = (Arc::new(depth), Some(Arc::new(color)));
            let scan = Scan::Depth(DepthScan { depth, color, intrinsics, t_base_sensor });
            let zero = nalgebra::Vector6::zeros();
            let scan = keyframe::keyframe_scan(&kept, Timestamp(0), &"camera".into(), &scan, &zero);
            views.push((f.t_world_base, Arc::new(scan)));
        }
    }
    Ok(views)
}

fn taken_in(views: &[(Pose, Arc<KeyframeScan>)]) -> Result<(Box<dyn PlaceRecognition>, KeyframePoses), Failure> {
    let mut places =
        place_recognition(OdometryKind::Rgbd, &OdometryParams::default(), BackEndParams::default().place_limits())
            .ok_or("no place recognition")?;
    let mut poses = KeyframePoses::new();
    for (k, (t, scan)) in views.iter().enumerate() {
        poses.insert(KeyframeId(k as u64), *t);
        places.insert(KeyframeId(k as u64), &scan.into(), &Covariance6::identity(), &poses);
    }
    Ok((places, poses))
}

fn ask(places: &dyn PlaceRecognition, poses: &KeyframePoses, asked: &[(Pose, Arc<KeyframeScan>)], tally: &mut Tally) {
    for (truth, scan) in asked {
        tally.asked += 1;
        tally.relocalised(places.relocalise(scan, poses).as_ref(), truth, poses);
    }
}

fn ask_driven(
    places: &mut dyn PlaceRecognition,
    poses: &KeyframePoses,
    asked: &[(Pose, Arc<KeyframeScan>)],
    tally: &mut Tally,
) {
    for views in asked.windows(WAY).step_by(3) {
        let (now, scan) = &views[WAY - 1];
        let before: Views = views[..WAY - 1].iter().map(|(t, s)| (now.inv_mul(t), Arc::clone(s))).collect();
        tally.asked += 1;
        tally.relocalised(places.relocalise_driven(&before, scan, poses).as_ref(), now, poses);
    }
}

fn close(mut places: Box<dyn PlaceRecognition>, mut poses: KeyframePoses, again: &Views, tally: &mut Tally) {
    for (truth, scan) in again {
        let id = KeyframeId(poses.len() as u64);
        poses.insert(id, *truth);
        tally.asked += 1;
        for l in places.insert(id, &scan.into(), &Covariance6::identity(), &poses) {
            tally.add_off(&(poses[&l.from].inv_mul(truth).inv_mul(&l.t_from_to)));
        }
    }
}

#[derive(Default)]
struct Tally {
    asked: usize,
    metres: Vec<f64>,
    degrees: Vec<f64>,
}

impl Tally {
    fn relocalised(&mut self, found: Option<&Relocalisation>, truth: &Pose, poses: &KeyframePoses) {
        if let Some(r) = found {
            self.add_off(&truth.inv_mul(&(poses[&r.keyframe] * r.t_keyframe_base)));
        }
    }

    fn add_off(&mut self, off: &Pose) {
        self.metres.push(off.translation.vector.norm());
        self.degrees.push(off.rotation.angle().to_degrees());
    }

    fn add(&mut self, other: Tally) {
        self.asked += other.asked;
        self.metres.extend(other.metres);
        self.degrees.extend(other.degrees);
    }

    fn figures(&mut self) -> String {
        let wrong = self.metres.iter().zip(&self.degrees).filter(|(m, d)| **m > WRONG.0 || **d > WRONG.1).count();
        self.metres.sort_by(f64::total_cmp);
        let at = |q: f64| 1e3 * self.metres.get((self.metres.len() as f64 * q) as usize).copied().unwrap_or(0.0);
        format!("{}/{} wrong {wrong} p50 {:.0} p95 {:.0} mm", self.metres.len(), self.asked, at(0.5), at(0.95))
    }
}
