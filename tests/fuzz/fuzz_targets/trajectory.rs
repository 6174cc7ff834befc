//! Trajectories: TUM, KITTI, Redwood, EuRoC, slambook2, single matrices.
#![no_main]
use percept_formats::trajectory;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    if let Ok(poses) = trajectory::parse_tum(bytes) {
        let mut again = Vec::new();
        assert!(trajectory::write_tum(&mut again, &poses).is_ok());
        assert_eq!(trajectory::parse_tum(&again).map(|p| p.len()), Ok(poses.len()));
    }
    let _ = trajectory::parse_kitti(bytes);
    let _ = trajectory::parse_redwood(bytes);
    let _ = trajectory::parse_matrix(bytes);
    let _ = trajectory::parse_euroc(bytes);
    let _ = trajectory::parse_pose_rows(bytes);
});
