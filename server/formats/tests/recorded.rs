//! Recorded data, read and compared with what is known of it; skipped where it is absent.

#![allow(clippy::unwrap_used, clippy::panic, reason = "all of it is tests")]

use percept_formats::dataset::{OpenOptions, open, open_with};
use percept_formats::{Dataset, DatasetKind, Limits, nav2, pcd, ply, read_file, trajectory};
use percept_geometry::cloud::is_finite;
use percept_geometry::{DepthImage, SensorData, SensorFrame, SensorKind, se3};
use std::path::Path;

percept_recorded::tests! {
    seven_scenes: "rgbd-7scenes-a";
    seven_scenes_poses_fit_the_depth: "rgbd-7scenes-a";
    redwood_folder: "rgbd-open3d-redwood";
    slambook2_folder: "rgbd-slambook2";
    kitti_pcd_with_poses_in_the_lidar_frame: "lidar-kitti-tracking-0000";
    kitti_bin_with_gaps_and_poses_of_the_camera: "lidar-kitti-odometry-00";
    carmen_intel: "lidar2d-intel";
    carmen_csail: "lidar2d-csail";
    carmen_corrected_logs: "lidar2d-corrected";
    breezyslam_logs: "lidar2d-breezyslam";
    labelled_clouds: "cloud-osd-labelled";
    clouds_of_every_version_and_encoding: "cloud-pcl";
    ply_of_a_lidar: "registration-small-gicp";
    maps_of_nav2: "planning-ros-maps";
    trajectories: "trajectory-evo", "rgbd-open3d-redwood/trajectory.log";
    bags_of_ros: "bags";
}

fn frames(dataset: &Dataset) -> Vec<SensorFrame> {
    dataset.frames(None).collect::<Result<_, _>>().unwrap()
}

fn assert_increasing(dataset: &Dataset) {
    assert!(dataset.stamps().windows(2).all(|w| w[0] < w[1]));
}

fn seven_scenes(data: &Path) {
    let path = data.join("rgbd-7scenes-a");
    let dataset = open(&path).unwrap();
    assert_eq!((dataset.kind, dataset.len(), dataset.name.as_str()), (DatasetKind::SevenScenes, 200, "rgbd-7scenes-a"));
    assert_increasing(&dataset);
    assert!((dataset.duration_s() - 398.0 / 30.0).abs() < 1e-8);
    let intrinsics = dataset.sensors[0].intrinsics.unwrap();
    assert_eq!((intrinsics.width, intrinsics.fx, intrinsics.cy), (640, 585.0, 240.0));
    let reference = dataset.reference.as_ref().unwrap();
    assert_eq!(reference.len(), 200);
    let path_m: f64 =
        reference.windows(2).map(|w| (w[1].value.translation.vector - w[0].value.translation.vector).norm()).sum();
    assert!((path_m - 2.89).abs() < 0.02, "{path_m}");
    let chosen: Vec<SensorFrame> = dataset.frames(Some(10..13)).collect::<Result<_, _>>().unwrap();
    assert_eq!(chosen.len(), 3);
    assert_eq!(chosen[0].stamp, dataset.stamps()[10]);
    let SensorData::Rgbd(depth, color) = &chosen[0].data else { panic!("rgbd expected") };
    assert_eq!((depth.width(), color.width(), depth.height()), (640, 640, 480));
    let valid: Vec<f32> = depth.data().iter().copied().filter(|&d| d > 0.0).collect();
    assert!((0.75..0.94).contains(&(valid.len() as f64 / depth.data().len() as f64)));
    assert!(valid.iter().all(|d| (0.8..3.61).contains(d)));
    let options = OpenOptions { depth_only: true, ..OpenOptions::default() };
    let depth_only = open_with(&path, &options).unwrap();
    assert_eq!(depth_only.sensors[0].kind, SensorKind::Depth);
    assert!(matches!(depth_only.frames(Some(0..1)).next().unwrap().unwrap().data, SensorData::Depth(_)));
}

/// The base looks along x: the reference warps frame 0 into frame 20 only in the right convention.
fn seven_scenes_poses_fit_the_depth(data: &Path) {
    let median = warped(&open(&data.join("rgbd-7scenes-a")).unwrap(), 0, 20);
    assert!(median < 0.01, "{median}");
}

/// The median difference of depth, metres, of one frame seen from another by the reference.
fn warped(dataset: &Dataset, from: usize, to: usize) -> f64 {
    let intrinsics = dataset.sensors[0].intrinsics.unwrap();
    let t_world_camera = |i: usize| dataset.reference.as_ref().unwrap()[i].value * dataset.sensors[0].t_base_sensor;
    let t_to_from = t_world_camera(to).inverse() * t_world_camera(from);
    let (from, to) = (depth(dataset, from), depth(dataset, to));
    let mut differences = vec![];
    for v in (0..480).step_by(8) {
        for u in (0..640).step_by(8).filter(|&u| from.at(u, v) > 0.0) {
            let p = t_to_from * (intrinsics.ray(u as f64, v as f64) * f64::from(from.at(u, v)));
            let Some(q) = intrinsics.project(&p) else { continue };
            if (0.0..639.0).contains(&q.x) && (0.0..479.0).contains(&q.y) {
                let there = f64::from(to.at(q.x.round() as usize, q.y.round() as usize));
                if there > 0.0 {
                    differences.push((there - p.z).abs());
                }
            }
        }
    }
    assert!(differences.len() > 1000, "{}", differences.len());
    differences.sort_by(f64::total_cmp);
    differences[differences.len() / 2]
}

fn depth(dataset: &Dataset, index: usize) -> DepthImage {
    match dataset.frames(Some(index..index + 1)).next().unwrap().unwrap().data {
        SensorData::Rgbd(depth, color) => {
            assert_eq!((depth.width(), depth.height(), color.width(), color.height()), (640, 480, 640, 480));
            depth
        }
        other => panic!("{:?}", other.kind()),
    }
}

/// The share of pixels that are measured, and the nearest and farthest depth, metres.
fn measured(depth: &DepthImage) -> (f64, f32, f32) {
    let valid: Vec<f32> = depth.data().iter().copied().filter(|&d| d > 0.0).collect();
    let (nearest, farthest) =
        (valid.iter().copied().fold(f32::MAX, f32::min), valid.iter().copied().fold(0.0, f32::max));
    (valid.len() as f64 / depth.data().len() as f64, nearest, farthest)
}

fn redwood_folder(data: &Path) {
    let dataset = open(&data.join("rgbd-open3d-redwood")).unwrap();
    assert_eq!((dataset.kind, dataset.len(), dataset.is_timed), (DatasetKind::RgbdFolders, 5, false));
    let i = dataset.sensors[0].intrinsics.unwrap();
    assert_eq!((i.width, i.height, i.fx, i.fy, i.cx, i.cy), (640, 480, 525.0, 525.0, 319.5, 239.5));
    assert_eq!(dataset.reference_source.as_deref(), Some("trajectory.log"));
    assert!(dataset.notes.iter().any(|n| n.starts_with("odometry.log is left")), "{:?}", dataset.notes);
    for index in 0..5 {
        let (share, nearest, farthest) = measured(&depth(&dataset, index));
        assert!((share - 0.87).abs() < 0.01 && nearest > 0.95 && farthest < 2.75, "{share} {nearest} {farthest}");
    }
    assert!((depth(&dataset, 4).at(320, 240) - 2.195).abs() < 1e-4);
    let median = warped(&dataset, 0, 4);
    assert!(median < 0.01, "{median}");
}

fn slambook2_folder(data: &Path) {
    let dataset = open(&data.join("rgbd-slambook2")).unwrap();
    assert_eq!((dataset.kind, dataset.len(), dataset.is_timed), (DatasetKind::RgbdFolders, 5, false));
    let i = dataset.sensors[0].intrinsics.unwrap();
    assert_eq!((i.width, i.height, i.fx, i.fy, i.cx, i.cy), (640, 480, 518.0, 519.0, 325.5, 253.5));
    assert_eq!(dataset.reference_source.as_deref(), Some("pose.txt"));
    for index in 0..5 {
        let (share, nearest, farthest) = measured(&depth(&dataset, index));
        assert!((0.68..0.73).contains(&share) && nearest > 0.7 && farthest < 9.85, "{share} {nearest} {farthest}");
    }
    // As another decoder reads them.
    for (index, expected) in [(0, 2.799), (3, 3.042)] {
        assert!((depth(&dataset, index).at(320, 240) - expected).abs() < 1e-4);
    }
    for index in 0..4 {
        // The poses are coarse; taken the wrong way round, they are off by half a metre and more.
        let median = warped(&dataset, index, index + 1);
        assert!(median < 0.15, "{index} {median}");
    }
}

fn kitti_pcd_with_poses_in_the_lidar_frame(data: &Path) {
    let path = data.join("lidar-kitti-tracking-0000");
    let dataset = open(&path).unwrap();
    assert_eq!((dataset.kind, dataset.len()), (DatasetKind::Kitti, 24));
    assert!((dataset.duration_s() - 2.3).abs() < 1e-9);
    for frame in dataset.frames(None) {
        let SensorData::Cloud(cloud) = frame.unwrap().data else { panic!("cloud expected") };
        assert!((122_000..125_000).contains(&cloud.len()) && cloud.intensities.is_some());
    }
    let reference = dataset.reference.unwrap();
    let end = reference[23].value.translation.vector;
    assert!((end.norm() - 7.43).abs() < 0.1 && end.x > 7.0, "{end}");
}

fn kitti_bin_with_gaps_and_poses_of_the_camera(data: &Path) {
    let path = data.join("lidar-kitti-odometry-00");
    let dataset = open(&path).unwrap();
    let clouds: Vec<usize> = frames(&dataset)
        .into_iter()
        .map(|f| match f.data {
            SensorData::Cloud(cloud) => cloud.len(),
            _ => 0,
        })
        .collect();
    assert_eq!(&clouds[..3], [124_668, 124_605, 124_478]);
    let reference = dataset.reference.as_ref().unwrap();
    assert_eq!(reference.len(), 5);
    let t_94_95 = reference[3].value.inverse() * reference[4].value;
    assert!((t_94_95.translation.vector.norm() - 0.475).abs() < 0.002, "{t_94_95}");
    assert!(t_94_95.translation.vector.x > 0.47);
    assert!((dataset.stamps()[1].as_secs_f64() - 0.1037359).abs() < 1e-12);
    assert!((9.0..10.5).contains(&dataset.stamps()[4].as_secs_f64()));
}

fn carmen_intel(data: &Path) {
    let path = data.join("lidar2d-intel");
    let dataset = open(&path).unwrap();
    assert_eq!((dataset.kind, dataset.len()), (DatasetKind::Carmen, 13_631));
    assert_eq!(dataset.num_odometry_samples(), 13_631 + 26_915);
    assert_increasing(&dataset);
    assert!((dataset.duration_s() - 2691.0).abs() < 20.0, "{}", dataset.duration_s());
    let (mut path_m, mut last, mut stamp) = (0.0, None, None);
    for frame in dataset.frames(None) {
        let frame = frame.unwrap();
        assert!(stamp.is_none_or(|s| s <= frame.stamp));
        stamp = Some(frame.stamp);
        match frame.data {
            SensorData::Odometry(sample) => {
                let p = sample.t_odom_base.translation.vector;
                path_m += last.map_or(0.0, |q: nalgebra::Vector3<f64>| (p - q).norm());
                last = Some(p);
            }
            SensorData::Scan(scan) => {
                assert_eq!(scan.ranges_m.len(), 180);
                assert!((scan.range_max_m - 81.83).abs() < 0.001, "{}", scan.range_max_m);
            }
            other => panic!("{:?}", other.kind()),
        }
    }
    assert!((path_m - 509.1).abs() < 1.0, "{path_m}");
    let relations = dataset.relations.as_ref().unwrap();
    assert_eq!(relations.len(), 2984);
    // The scan-matched poses agree with the checked relations where both are known: mean 0.12 m.
    let reference = dataset.reference.as_ref().unwrap();
    assert!(reference.len() > 850, "{}", reference.len());
    let at = |stamp| reference.binary_search_by_key(&stamp, |p| p.stamp).ok().map(|i| reference[i].value);
    let errors: Vec<f64> = relations
        .iter()
        .filter_map(|r| {
            let t_1_2 = at(r.stamp_1)?.inverse() * at(r.stamp_2)?;
            Some(se3::log(&(r.t_1_2.inverse() * t_1_2)).fixed_rows::<3>(0).norm())
        })
        .collect();
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    assert!(errors.len() > 50 && mean < 0.15, "{} {mean}", errors.len());
}

fn carmen_csail(data: &Path) {
    let path = data.join("lidar2d-csail");
    let dataset = open(&path).unwrap();
    assert_eq!((dataset.len(), dataset.num_odometry_samples()), (1988, 1988));
    assert_increasing(&dataset);
    assert!((dataset.duration_s() - 424.0).abs() < 1.0, "{}", dataset.duration_s());
    let SensorData::Scan(scan) = dataset.frames(Some(0..1)).nth(1).unwrap().unwrap().data else { panic!() };
    assert_eq!(scan.ranges_m.len(), 361);
    assert!((scan.angle(360) - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
    assert!(dataset.reference.as_ref().unwrap().len() > 350, "{:?}", dataset.reference.map(|r| r.len()));
}

fn carmen_corrected_logs(data: &Path) {
    let path = data.join("lidar2d-corrected");
    for (file, len, beams) in [("freiburg-101-corrected.log", 292, 360), ("orebro-corrected.log", 237, 181)] {
        let dataset = open(&path.join(file)).unwrap();
        assert_eq!((dataset.len(), dataset.num_odometry_samples(), dataset.sensors.len()), (len, 0, 1));
        assert_increasing(&dataset);
        assert_eq!(dataset.reference.as_ref().unwrap().len(), len);
        let mut num_free = 0;
        for frame in dataset.frames(None) {
            let SensorData::Scan(scan) = frame.unwrap().data else { panic!() };
            assert_eq!(scan.ranges_m.len(), beams);
            num_free += scan.ranges_m.iter().filter(|r| r.is_infinite()).count();
            assert!(scan.ranges_m.iter().all(|&r| r.is_infinite() || r < 81.0));
        }
        assert!(num_free > 400, "{file} {num_free}");
    }
}

fn breezyslam_logs(data: &Path) {
    let path = data.join("lidar2d-breezyslam");
    for (file, len) in [("exp1.dat", 756), ("exp2.dat", 641)] {
        let dataset = open(&path.join(file)).unwrap();
        assert_eq!((dataset.kind.name(), dataset.len(), dataset.num_odometry_samples()), ("breezyslam", len, len));
        assert_increasing(&dataset);
        let mut free = 0;
        for frame in dataset.frames(Some(0..1)).filter_map(|f| f.ok()) {
            let SensorData::Scan(scan) = frame.data else { continue };
            free += scan.ranges_m.iter().filter(|r| **r > 0.1 && **r < 4.0).count();
        }
        assert!(free > 200, "{file} {free}");
    }
    assert_eq!(open(&path).unwrap().len(), 756);
}

fn labelled_clouds(data: &Path) {
    let path = data.join("cloud-osd-labelled");
    for file in ["learn0.pcd", "learn40.pcd"] {
        let pcd = pcd::decode(&read_file(&path.join(file), &Limits::default()).unwrap(), &Limits::default()).unwrap();
        assert_eq!((pcd.width, pcd.height, pcd.cloud.len()), (640, 480, 307_200));
        let labels = pcd.labels.unwrap();
        let valid = pcd.cloud.positions.iter().filter(|p| is_finite(p)).count();
        assert!((172_000..=209_500).contains(&valid), "{file} {valid}");
        for (p, &label) in pcd.cloud.positions.iter().zip(&labels) {
            assert_eq!(is_finite(p), label != 0);
        }
        let mut objects: Vec<u32> = labels.iter().filter(|&&l| l >= 20).map(|l| l / 10).collect();
        objects.sort_unstable();
        objects.dedup();
        assert_eq!(objects.len(), if file == "learn40.pcd" { 3 } else { 2 });
        assert!(pcd.cloud.colors.unwrap().iter().any(|c| c[0] != c[2]));
    }
    let dataset = open(&path).unwrap();
    assert_eq!((dataset.kind, dataset.len()), (DatasetKind::Clouds, 6));
}

fn clouds_of_every_version_and_encoding(data: &Path) {
    let path = data.join("cloud-pcl");
    for (file, points) in [("bun0.pcd", 397), ("bun4.pcd", 361), ("cturtle.pcd", 167_198), ("milk.pcd", 12_575)] {
        let bytes = read_file(&path.join(file), &Limits::default()).unwrap();
        let pcd = pcd::decode(&bytes, &Limits::default()).unwrap();
        assert_eq!(pcd.cloud.len(), points, "{file}");
        assert_eq!(pcd.cloud.normals.is_some(), file == "bun0.pcd");
        assert_eq!(pcd.cloud.intensities.is_some(), file == "cturtle.pcd");
        assert_eq!(pcd.cloud.colors.is_some(), file == "milk.pcd");
        for end in [0, 1, 100, bytes.len() / 2] {
            assert!(pcd::decode(&bytes[..end], &Limits::default()).is_err(), "{file} cut at {end}");
        }
    }
    let dataset = open(&path).unwrap();
    assert_eq!(dataset.len(), 17);
    for frame in dataset.frames(None) {
        let SensorData::Cloud(cloud) = frame.unwrap().data else { panic!() };
        assert!(cloud.len() > 300 && cloud.positions.iter().all(is_finite));
        cloud.validate().unwrap();
    }
}

fn ply_of_a_lidar(data: &Path) {
    let path = data.join("registration-small-gicp");
    for (file, points) in [("source.ply", 69_792), ("target.ply", 69_088)] {
        let cloud = ply::decode(&read_file(&path.join(file), &Limits::default()).unwrap(), &Limits::default()).unwrap();
        assert_eq!(cloud.len(), points);
        assert!(cloud.intensities.is_some() && cloud.positions.iter().all(is_finite));
    }
    assert_eq!(open(&path).unwrap().len(), 2);
}

fn maps_of_nav2(data: &Path) {
    let path = data.join("planning-ros-maps");
    for file in ["depot.yaml", "depot_keepout.yaml", "tb3_sandbox.yaml"] {
        let map = nav2::read(&path.join(file), &Limits::default()).unwrap();
        assert_eq!(map.cells.len(), map.width * map.height);
        for value in [0, 100] {
            assert!(map.cells.iter().filter(|&&c| c == value).count() > 100, "{file} {value}");
        }
        assert_eq!(map.geometry.resolution_m, 0.05);
    }
}

fn trajectories(data: &Path) {
    let path = data.join("trajectory-evo");
    let read = |file: &str| trajectory::parse_tum(&read_file(&path.join(file), &Limits::default()).unwrap()).unwrap();
    for file in ["V102.txt", "fr2_desk_ORB.txt", "fr2_desk_groundtruth.txt", "freiburg1_xyz-groundtruth.txt"] {
        assert!(read(file).len() > 100, "{file}");
    }
    assert_eq!(read("V102.txt")[0].stamp.0, 1_403_715_529_112_143_517);
    let path = data.join("rgbd-open3d-redwood/trajectory.log");
    assert_eq!(trajectory::parse_redwood(&read_file(&path, &Limits::default()).unwrap()).unwrap().len(), 5);
}

fn bags_of_ros(data: &Path) {
    let folder = data.join("bags");
    // Its index is damaged: all 278 scans are there, and nothing tells where the laser sits.
    let scans = open(&folder.join("scan_tools_demo.bag")).unwrap();
    assert_eq!((scans.kind, scans.len(), scans.sensors[0].kind), (DatasetKind::Ros, 278, SensorKind::Lidar2d));
    assert!((scans.duration_s() - 27.6).abs() < 0.2, "{}", scans.duration_s());
    let SensorData::Scan(first) = frames(&scans).swap_remove(0).data else { panic!() };
    assert_eq!((first.ranges_m.len(), first.range_max_m as f32), (681, 5.6));
    assert!((first.angle_increment_rad.to_degrees() - 0.35).abs() < 0.01);
    // Poses, wheels and transforms alone: refused, with what is there.
    for (name, topic) in
        [("nav2_turtlebot.mcap", "/odom"), ("ROS_example.bag", "groundtruth"), ("tf_example.db3", "tf")]
    {
        let words = open(&folder.join(name)).unwrap_err().to_string();
        assert!(words.contains("no topic that poses are found by") && words.contains(topic), "{name}: {words}");
    }
}
