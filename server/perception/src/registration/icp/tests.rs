use super::*;
use crate::registration::{RegisterParams, register};
use nalgebra::Vector6;
use percept_geometry::PointCloud;

const METHODS: [IcpMethod; 4] = [IcpMethod::PointToPoint, IcpMethod::PointToPlane, IcpMethod::Gicp, IcpMethod::Vgicp];

/// The faces given of a cube's inside corner, `n x n` points each, 2 m long, with normals and a pattern of colours.
/// They lie in the middle of voxels of 0.25 m, not on their borders.
fn faces(n: usize, axes: &[usize]) -> PointCloud {
    let (mut positions, mut normals, mut colors) = (vec![], vec![], vec![]);
    for &axis in axes {
        for i in 0..n * n {
            let (a, b) = (2.0 * (i % n) as f32 / n as f32 + 0.05, 2.0 * (i / n) as f32 / n as f32 + 0.05);
            let mut p = [a + 0.125, b + 0.125, 0.125];
            p.rotate_right(axis);
            let mut normal = [0.0, 0.0, 1.0];
            normal.rotate_right(axis);
            positions.push(Point3::from(p));
            normals.push(Vector3::from(normal));
            colors.push([(127.0 + 100.0 * (3.0 * a).sin()) as u8, (127.0 + 100.0 * (2.5 * b).cos()) as u8, 90]);
        }
    }
    PointCloud { positions, normals: Some(normals), colors: Some(colors), ..PointCloud::default() }
}

fn moved(cloud: &PointCloud, t_target_source: &Pose) -> PointCloud {
    cloud.transformed(&t_target_source.inverse())
}

fn params(method: IcpMethod, max_distance_m: f64) -> RegisterParams {
    let icp = IcpParams { method, max_distance_m, target_voxel_size_m: 0.25, ..IcpParams::default() };
    RegisterParams { icp, ..RegisterParams::default() }
}

fn off(truth: &Pose, found: &IcpResult) -> f64 {
    se3::log(&(truth.inverse() * found.t_target_source)).norm()
}

#[test]
fn every_method_finds_a_small_motion_back() {
    let target = faces(40, &[0, 1, 2]);
    let truth = se3::exp(&Vector6::new(0.02, -0.01, 0.015, 0.01, -0.02, 0.015));
    let source = moved(&target, &truth);
    for method in METHODS.into_iter().chain([IcpMethod::Colored]) {
        let found = register(&source, &target, &Pose::identity(), &params(method, 0.2)).unwrap();
        // Voxels cut the source elsewhere than the target: their means are millimetres off.
        let tolerance = if method == IcpMethod::Vgicp { 5e-3 } else { 1e-4 };
        assert!(off(&truth, &found) < tolerance, "{method:?}: {} {:?}", off(&truth, &found), found.outcome);
        assert_eq!((found.outcome, found.degenerate_axes), (IcpOutcome::Converged, [false; 6]), "{method:?}");
        assert!(found.inlier_ratio > 0.95 && found.converged());
        assert!((found.covariance - found.covariance.transpose()).norm() < 1e-9 * found.covariance.norm());
    }
}

#[test]
fn normals_are_made_where_the_clouds_have_none() {
    let truth = se3::exp(&Vector6::new(0.02, -0.01, 0.015, 0.01, -0.02, 0.015));
    let target = PointCloud { normals: None, ..faces(30, &[0, 1, 2]) };
    let source = moved(&target, &truth);
    for method in [IcpMethod::PointToPlane, IcpMethod::Gicp] {
        let found = register(&source, &target, &Pose::identity(), &params(method, 0.3)).unwrap();
        assert!(off(&truth, &found) < 2e-3, "{method:?}: {}", off(&truth, &found));
    }
}

#[test]
fn coarse_levels_bridge_what_the_finest_cannot() {
    let target = faces(60, &[0, 1, 2]);
    let truth = se3::exp(&Vector6::new(0.15, -0.1, 0.12, 0.05, -0.08, 0.06));
    let source = moved(&target, &truth);
    let fine = RegisterParams { voxel_sizes_m: vec![0.05], ..params(IcpMethod::PointToPlane, 0.1) };
    let levels = RegisterParams { voxel_sizes_m: vec![0.2, 0.1, 0.05], ..fine };
    let found = register(&source, &target, &Pose::identity(), &levels).unwrap();
    assert!(off(&truth, &found) < 0.01 && found.converged(), "{} {:?}", off(&truth, &found), found.outcome);
}

#[test]
fn robust_kernels_ignore_what_only_one_cloud_holds() {
    let target = faces(40, &[0, 1, 2]);
    let truth = se3::exp(&Vector6::new(0.01, -0.01, 0.01, 0.005, -0.005, 0.004));
    let mut source = moved(&target, &truth);
    // A sheet of points 8 cm above one face.
    source.normals = None;
    source.colors = None;
    source.positions.extend((0..1600).map(|i| Point3::new((i % 40) as f32 * 0.04, (i / 40) as f32 * 0.04, 0.205)));
    let run = |kernel| {
        let mut p = params(IcpMethod::PointToPlane, 0.3);
        p.icp.kernel = kernel;
        off(&truth, &register(&source, &target, &Pose::identity(), &p).unwrap())
    };
    let plain = run(RobustKernel::None);
    for kernel in [
        RobustKernel::Huber(0.002),
        RobustKernel::Cauchy(0.002),
        RobustKernel::Tukey(0.04),
        RobustKernel::GemanMcClure(0.01),
    ] {
        assert!(run(kernel) < 0.3 * plain, "{kernel:?}: {} beside {plain}", run(kernel));
    }
}

#[test]
fn a_wall_alone_is_reported_open_along_itself() {
    let target = faces(40, &[0]);
    let source = moved(&target, &se3::exp(&Vector6::new(0.0, 0.0, 0.02, 0.0, 0.0, 0.0)));
    let mut p = params(IcpMethod::PointToPlane, 0.2);
    for tangent_weight in [0.0, 0.1] {
        p.icp.tangent_weight = tangent_weight;
        let found = register(&source, &target, &Pose::identity(), &p).unwrap();
        assert_eq!(found.degenerate_axes, [true, true, false, false, false, true]);
        assert_eq!(found.outcome, IcpOutcome::Degenerate);
        assert!((found.t_target_source.translation.z - 0.02).abs() < 1e-5);
        assert!(found.covariance[(0, 0)] > 1e5 && found.covariance[(2, 2)] < 1e-3, "{}", found.covariance);
    }
    // Coloured, the same wall is fixed by its pattern.
    let truth = se3::exp(&Vector6::new(0.01, -0.008, 0.02, 0.0, 0.0, 0.005));
    let mut p = params(IcpMethod::Colored, 0.2);
    p.icp.degeneracy_threshold = 0.0;
    let found = register(&moved(&target, &truth), &target, &Pose::identity(), &p).unwrap();
    assert!(off(&truth, &found) < 2e-3, "{}", off(&truth, &found));
}

#[test]
fn a_corridor_is_reported_open_along_its_length() {
    // Floor and two walls, 5 m long.
    let mut positions = vec![];
    for i in 0..50 {
        for j in 0..20 {
            let (x, s) = (i as f32 * 0.1 - 2.5, j as f32 * 0.1);
            positions.extend([[x, s - 1.0, 0.0], [x, -1.0, s], [x, 1.0, s]].map(Point3::from));
        }
    }
    let target = PointCloud::from_positions(positions);
    let source = moved(&target, &se3::exp(&Vector6::new(0.0, 0.03, 0.02, 0.0, 0.0, 0.002)));
    for method in [IcpMethod::PointToPlane, IcpMethod::Gicp] {
        let mut p = params(method, 0.3);
        p.icp.degeneracy_threshold = 0.01;
        let found = register(&source, &target, &Pose::identity(), &p).unwrap();
        assert_eq!(found.degenerate_axes, [true, false, false, false, false, false], "{method:?}");
        assert_eq!(found.outcome, IcpOutcome::Degenerate);
        assert!((found.t_target_source.translation.y - 0.03).abs() < 2e-3);
    }
}

#[test]
fn what_cannot_be_aligned_is_named() {
    let target = faces(10, &[0, 1, 2]);
    let identity = Pose::identity();
    let empty = PointCloud::default();
    for method in METHODS {
        let p = params(method, 0.02);
        assert!(matches!(
            register(&empty, &target, &identity, &p),
            Err(RegistrationError::TooFewPoints { field: "source", .. })
        ));
        assert!(matches!(
            register(&target, &empty, &identity, &p),
            Err(RegistrationError::TooFewPoints { field: "target", .. })
        ));
        // Far apart: no correspondence, an answer and no panic.
        let far = Pose::translation(100.0, 0.0, 0.0);
        let found = register(&target, &target, &far, &p).unwrap();
        assert_eq!((found.outcome, found.inlier_ratio), (IcpOutcome::TooFewPairs, 0.0));
        for degenerate in [
            vec![Point3::new(1.0, 1.0, 1.0); 50],
            (0..50).map(|i| Point3::new(i as f32 * 0.1, 0.0, 0.0)).collect(),
            vec![Point3::new(1e7, 1e7, 1e7); 50],
        ] {
            let same = PointCloud::from_positions(degenerate);
            let found = register(&same, &same, &identity, &p).unwrap();
            assert_ne!(found.outcome, IcpOutcome::Converged, "{method:?}");
            assert!(off(&identity, &found) < 1e-3, "{method:?} {}", found.t_target_source);
        }
    }
    let bad = params(IcpMethod::Gicp, f64::NAN);
    let error = register(&target, &target, &identity, &bad).unwrap_err();
    assert!(error.to_string().starts_with("max_distance_m"));
    let plain = PointCloud::from_positions(target.positions.clone());
    let missing = register(&plain, &target, &identity, &params(IcpMethod::Colored, 0.1));
    assert_eq!(missing, Err(RegistrationError::Missing { cloud: "source", channel: "colours" }));
}

#[test]
fn prepared_for_another_method_is_refused() {
    let cloud = faces(10, &[0, 1, 2]);
    let icp = |method| IcpParams { method, ..IcpParams::default() };
    let source = PreparedCloud::source(&cloud, &icp(IcpMethod::PointToPoint)).unwrap();
    let target = PreparedCloud::target(&cloud, &icp(IcpMethod::PointToPoint)).unwrap();
    for method in [IcpMethod::PointToPlane, IcpMethod::Vgicp, IcpMethod::Colored] {
        let refused = align(&source, &target, &Pose::identity(), &icp(method));
        assert!(matches!(refused, Err(RegistrationError::Missing { .. })), "{method:?}");
    }
}

#[test]
fn threads_change_nothing() {
    let target = faces(60, &[0, 1, 2]);
    let source = moved(&target, &se3::exp(&Vector6::new(0.02, -0.01, 0.015, 0.01, -0.02, 0.015)));
    for method in METHODS {
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| register(&source, &target, &Pose::identity(), &params(method, 0.2)).unwrap())
        };
        assert_eq!(run(1), run(3));
    }
}

#[test]
fn far_from_the_origin_the_motion_is_found_as_near_it() {
    let target = faces(40, &[0, 1, 2]);
    let away = Pose::translation(4096.0, -2048.0, 512.0);
    let truth = Pose::translation(0.02, -0.01, 0.015);
    let source = target.transformed(&(away * truth.inverse()));
    let p = params(IcpMethod::PointToPlane, 0.2);
    let found = register(&source, &target.transformed(&away), &Pose::identity(), &p).unwrap();
    // Floats at 4 km resolve half a millimetre.
    let center = away * Point3::new(1.0, 1.0, 1.0);
    assert!((found.t_target_source * center - truth * center).norm() < 1e-3);
}
