//! Features and depth operations on recorded images, judged by known warps and by plain references; skipped where the
//! data are absent (`PERCEPT_DATA`, or `shared/data` beside the repository).

#![allow(clippy::unwrap_used, clippy::panic, reason = "all of it is tests")]

use nalgebra::{Matrix3, Vector2, Vector3};
use percept_formats::images::decode_gray16;
use percept_formats::{Limits, decode_color, read_file};
use percept_geometry::{CameraIntrinsics, DepthImage, GrayImage};
use percept_perception::depth::{
    BilateralParams, MedianParams, NormalMap, NormalMapParams, RayTable, UnprojectParams, bilateral, median_units,
    unproject_units,
};
use percept_perception::features2d::{
    FeatureMatch, Features, MatchParams, Orb, OrbParams, Sift, SiftParams, match_features,
};
use std::path::Path;

const W: usize = 640;
const H: usize = 480;

/// Least repeatability, share of right matches, and matches. OpenCV 5.0's `ORB_create(1000)` has 0.876, 0.948 and 491 on
/// the same images and warp, its `SIFT_create(1000)` 0.530, 0.878 and 329; ours 0.863, 0.944, 485 and 0.519, 0.875, 329.
const ORB: (f64, f64, f64) = (0.85, 0.93, 450.0);
const SIFT: (f64, f64, f64) = (0.505, 0.865, 310.0);
/// Largest median and ninth decile of the angle between normals and fitted planes, degrees: what the sensor's noise
/// leaves after smoothing, over 5 pixels in one and 7 by 7 in the other.
const NORMALS: (f64, f64) = (3.0, 9.0);

percept_recorded::tests! {
    orb_finds_again_what_it_found: "rgbd-7scenes-a";
    sift_finds_again_what_it_found: "rgbd-7scenes-a";
    points_of_recorded_depth_are_those_of_the_pinhole: "rgbd-7scenes-a";
    medians_of_recorded_depth_are_those_of_sorted_windows: "rgbd-7scenes-a";
    bilateral_of_recorded_depth_is_the_weighted_mean: "rgbd-7scenes-a";
    normals_of_smoothed_recorded_depth_are_those_of_planes_fitted: "rgbd-7scenes-a";
}

/// A file of the recorded frames.
fn recorded(data: &Path, frame: usize, end: &str) -> Vec<u8> {
    let path = data.join("rgbd-7scenes-a").join(format!("frame-{frame:06}.{end}"));
    read_file(&path, &Limits::default()).unwrap()
}

/// Pixels of the first image to pixels of the second: a turn by 25 degrees and a shrink to 0.8 about the centre.
fn warp(p: Vector2<f64>) -> Vector2<f64> {
    let centre = Vector2::new(319.5, 239.5);
    centre + nalgebra::Rotation2::new(25f64.to_radians()) * (p - centre) * 0.8
}

/// The image after the warp, a little darker, black where nothing is seen.
fn warped(image: &GrayImage) -> GrayImage {
    let centre = Vector2::new(319.5, 239.5);
    let back = nalgebra::Rotation2::new(-25f64.to_radians());
    let grey = |u: f64, v: f64| {
        let at = |x: f64, y: f64| {
            let inside = (0.0..W as f64).contains(&x) && (0.0..H as f64).contains(&y);
            if inside { f64::from(image.data()[y as usize * W + x as usize]) } else { 0.0 }
        };
        let (x, y, fx, fy) = (u.floor(), v.floor(), u - u.floor(), v - v.floor());
        (at(x, y) * (1.0 - fx) + at(x + 1.0, y) * fx) * (1.0 - fy)
            + (at(x, y + 1.0) * (1.0 - fx) + at(x + 1.0, y + 1.0) * fx) * fy
    };
    let pixel = |i: usize| {
        let p = centre + back * (Vector2::new((i % W) as f64, (i / W) as f64) - centre) / 0.8;
        (0.8 * grey(p.x, p.y).round() + 10.0).round() as u8
    };
    GrayImage::new(W, H, (0..W * H).map(pixel).collect()).unwrap()
}

/// Means over five frames: share of keypoints found again within 3 pixels, share of matches that are right within 3.
fn quality(data: &Path, extract: impl Fn(&GrayImage) -> Features) -> (f64, f64, f64) {
    let mut sums = Vector3::zeros();
    for frame in [0, 100, 200, 300, 398] {
        let image = decode_color(&recorded(data, frame, "color.jpg"), &Limits::default()).unwrap().to_gray();
        let (a, b) = (extract(&image), extract(&warped(&image)));
        let at = |f: &Features, i: usize| Vector2::new(f64::from(f.keypoints[i].u), f64::from(f.keypoints[i].v));
        let moved: Vec<Vector2<f64>> = (0..a.keypoints.len()).map(|i| warp(at(&a, i))).collect();
        let seen = |p: &&Vector2<f64>| (40.0..600.0).contains(&p.x) && (40.0..440.0).contains(&p.y);
        let again = |p: &&Vector2<f64>| (0..b.keypoints.len()).any(|j| (at(&b, j) - **p).norm() < 3.0);
        let inside: Vec<&Vector2<f64>> = moved.iter().filter(seen).collect();
        let repeated = inside.iter().copied().filter(again).count() as f64 / inside.len() as f64;
        let params = MatchParams { ratio: 0.8, ..MatchParams::default() };
        let matches = match_features(&a.descriptors, &b.descriptors, &params).unwrap();
        let right = |m: &&FeatureMatch| (moved[m.query_index as usize] - at(&b, m.train_index as usize)).norm() < 3.0;
        let inliers = matches.iter().filter(right).count() as f64 / matches.len() as f64;
        sums += Vector3::new(repeated, inliers, matches.len() as f64) / 5.0;
    }
    (sums.x, sums.y, sums.z)
}

fn orb_finds_again_what_it_found(data: &Path) {
    let orb = Orb::new(OrbParams::default()).unwrap();
    let (repeated, inliers, matches) = quality(data, |image| orb.extract(image).unwrap());
    eprintln!("ORB: repeatability {repeated:.3}, inlier ratio {inliers:.3}, {matches:.0} matches");
    assert!(repeated > ORB.0 && inliers > ORB.1 && matches > ORB.2, "{repeated} {inliers} {matches}");
}

fn sift_finds_again_what_it_found(data: &Path) {
    let extract = |image: &GrayImage| {
        let params = SiftParams { max_features: 1000, ..SiftParams::default() };
        Sift::new(params).unwrap().extract(image).unwrap()
    };
    let (repeated, inliers, matches) = quality(data, extract);
    eprintln!("SIFT: repeatability {repeated:.3}, inlier ratio {inliers:.3}, {matches:.0} matches");
    assert!(repeated > SIFT.0 && inliers > SIFT.1 && matches > SIFT.2, "{repeated} {inliers} {matches}");
}

/// Millimetres of two frames.
fn depths(data: &Path) -> [Vec<u16>; 2] {
    [0, 200].map(|frame| decode_gray16(&recorded(data, frame, "depth.png"), &Limits::default()).unwrap().data)
}

fn camera() -> CameraIntrinsics {
    CameraIntrinsics::pinhole(W, H, 585.0, 585.0, 320.0, 240.0)
}

fn points_of_recorded_depth_are_those_of_the_pinhole(data: &Path) {
    for units in depths(data) {
        let params = UnprojectParams { min_depth_m: 0.0, max_depth_m: 2.5, ..UnprojectParams::default() };
        let cloud = unproject_units(&units, 0.001, None, &RayTable::new(&camera()).unwrap(), &params).unwrap();
        // 65535 is far beyond the bound.
        let pixels: Vec<usize> = (0..W * H).filter(|&i| (1..=2500).contains(&units[i])).collect();
        assert_eq!(cloud.len(), pixels.len());
        for (p, i) in cloud.positions.iter().zip(pixels) {
            let z = f64::from(units[i]) * 0.001;
            let q = Vector3::new(((i % W) as f64 - 320.0) / 585.0 * z, ((i / W) as f64 - 240.0) / 585.0 * z, z);
            assert!((p.coords.cast::<f64>() - q).norm() < 1e-6, "{p} {q}");
        }
    }
}

fn medians_of_recorded_depth_are_those_of_sorted_windows(data: &Path) {
    for units in depths(data) {
        let found = median_units(&units, W, H, &MedianParams::default()).unwrap();
        for i in (0..W * H).step_by(7) {
            let near = |x: usize, k: usize, n: usize| (x + k).saturating_sub(2).min(n - 1);
            let mut window: Vec<u16> =
                (0..25).map(|k| units[near(i / W, k / 5, H) * W + near(i % W, k % 5, W)]).collect();
            window.sort_unstable();
            assert_eq!(found[i], window[12], "pixel {i}");
        }
    }
}

fn bilateral_of_recorded_depth_is_the_weighted_mean(data: &Path) {
    for units in depths(data) {
        let depth = DepthImage::from_u16(W, H, &units, 0.001).unwrap();
        let found = bilateral(&depth, &BilateralParams::default()).unwrap();
        for i in (0..W * H).step_by(5) {
            let (u, v, d) = ((i % W) as isize, (i / W) as isize, f64::from(depth.data()[i]));
            let (mut sum, mut weight) = (0.0, 0.0);
            for (dx, dy) in (-2..=2).flat_map(|y| (-2..=2).map(move |x| (x, y))).filter(|(x, y)| x * x + y * y <= 4) {
                if (0..W as isize).contains(&(u + dx)) && (0..H as isize).contains(&(v + dy)) {
                    let e = f64::from(depth.at((u + dx) as usize, (v + dy) as usize));
                    let far = (dx * dx + dy * dy) as f64 / 25.0 + ((e - d) / 0.03).powi(2);
                    let w = if e > 0.0 { (-0.5 * far).exp() } else { 0.0 };
                    (sum, weight) = (sum + w * e, weight + w);
                }
            }
            let expected = if d > 0.0 { sum / weight } else { 0.0 };
            assert!((f64::from(found.data()[i]) - expected).abs() < 1e-5, "pixel {i}: {} {expected}", found.data()[i]);
        }
    }
}

/// The plane through the returns of a window of 7 by 7 pixels on one surface: the eigenvector of least variance.
fn plane_normal(points: &dyn Fn(usize, usize) -> Option<Vector3<f64>>, u: usize, v: usize) -> Option<Vector3<f64>> {
    let centre = points(u, v)?;
    let window: Vec<Vector3<f64>> = (0..49)
        .filter_map(|k| points(u + k % 7 - 3, v + k / 7 - 3))
        .filter(|p| (p.z - centre.z).abs() < 0.03 * centre.z)
        .collect();
    let mean = window.iter().sum::<Vector3<f64>>() / window.len() as f64;
    let scatter = window.iter().fold(Matrix3::zeros(), |s, p| s + (p - mean) * (p - mean).transpose());
    let eigen = scatter.symmetric_eigen();
    let n = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
    (window.len() >= 40).then(|| if n.dot(&centre) > 0.0 { -n } else { n })
}

fn normals_of_smoothed_recorded_depth_are_those_of_planes_fitted(data: &Path) {
    for units in depths(data) {
        let depth = DepthImage::from_u16(W, H, &units, 0.001).unwrap();
        let depth = bilateral(&depth, &BilateralParams { radius_px: 5, ..BilateralParams::default() }).unwrap();
        let map = NormalMap::of_depth(&depth, &RayTable::new(&camera()).unwrap(), &NormalMapParams::default()).unwrap();
        let points = |u: usize, v: usize| {
            let d = f64::from(depth.at(u, v));
            (d > 0.0).then(|| camera().ray(u as f64, v as f64).coords * d)
        };
        let mut angles = vec![];
        for (u, v) in (3..H - 3).step_by(9).flat_map(|v| (3..W - 3).step_by(9).map(move |u| (u, v))) {
            if let (Some(n), Some(m)) = (map.at(u, v), plane_normal(&points, u, v)) {
                let n = n.cast::<f64>();
                assert!((n.norm() - 1.0).abs() < 2e-6 && n.dot(&points(u, v).unwrap()) < 0.0);
                angles.push(n.angle(&m).to_degrees());
            }
        }
        angles.sort_by(f64::total_cmp);
        let (median, late) = (angles[angles.len() / 2], angles[angles.len() * 9 / 10]);
        eprintln!("normals: {} angles, median {median:.2}, nine tenths below {late:.2} degrees", angles.len());
        assert!(angles.len() > 2000 && median < NORMALS.0 && late < NORMALS.1, "{median} {late}");
    }
}
