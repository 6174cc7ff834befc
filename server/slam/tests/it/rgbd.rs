use crate::room::{Noise, Room, drive};
use percept_geometry::{Pose, Timestamp, se3};
use percept_slam::{Odometry, OdometryEstimate, OdometryKind, OdometryParams};

fn run(threads: usize, frames: usize) -> Vec<OdometryEstimate> {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| {
        let (room, mut noise) = (Room::furnished(), Noise(1));
        let mut odometry = Odometry::new(OdometryKind::Rgbd, OdometryParams::default());
        (0..frames)
            .map(|i| {
                let scan = room.depth(&drive(i, 150), &mut noise);
                odometry.register(Timestamp::from_secs_f64(i as f64 / 15.0), &scan, None)
            })
            .collect()
    })
}

#[test]
fn a_drive_through_the_room_is_followed_to_a_centimetre() {
    let estimates = run(2, 75);
    for (i, e) in estimates.iter().enumerate() {
        let truth: Pose = drive(0, 150).inverse() * drive(i, 150);
        let off = se3::log(&(truth.inverse() * e.t_odom_base));
        assert!(off.fixed_rows::<3>(0).norm() < 0.015 && off.fixed_rows::<3>(3).norm() < 0.01, "frame {i}: {off}");
        assert_eq!(e.state.is_tracking(), i > 0);
        // The covariance is honest: the error is within four of its standard deviations.
        if i > 0 {
            for k in 0..6 {
                assert!(off[k].abs() < 4.0 * e.covariance[(k, k)].sqrt() + 1e-3, "frame {i} axis {k}: {}", off[k]);
            }
        }
    }
}

#[test]
fn the_number_of_threads_changes_not_one_bit() {
    assert_eq!(run(1, 6), run(3, 6));
}

#[test]
fn a_wall_alone_is_reported_open_along_itself_and_the_pose_stays() {
    let mut room = Room::furnished();
    room.boxes.clear();
    room.walls = (nalgebra::Vector3::new(-50.0, -50.0, -50.0), nalgebra::Vector3::new(1.5, 50.0, 50.0));
    let mut noise = Noise(2);
    let mut odometry = Odometry::new(OdometryKind::Rgbd, OdometryParams::default());
    let mut last = None;
    for i in 0..10 {
        let scan = room.depth(&Pose::identity(), &mut noise);
        last = Some(odometry.register(Timestamp::from_secs_f64(i as f64 / 15.0), &scan, None));
    }
    let e = last.unwrap();
    assert!(e.state.is_tracking());
    // y, z of base and the roll about the line of sight.
    assert_eq!(e.degenerate_axes, [false, true, true, true, false, false]);
    assert!(e.t_odom_base.translation.vector.norm() < 0.005);
    assert!(e.covariance[(1, 1)] > 25.0 * e.covariance[(0, 0)]);
}
