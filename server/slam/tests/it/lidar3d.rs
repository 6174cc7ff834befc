use crate::room::{Noise, Room, drive, velocity};
use percept_geometry::{Pose, Timestamp, se3};
use percept_slam::{Odometry, OdometryEstimate, OdometryKind, OdometryParams};

fn run(threads: usize, frames: usize, rings: usize) -> Vec<OdometryEstimate> {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| {
        let (room, mut noise) = (Room::furnished(), Noise(3));
        let mut odometry = Odometry::new(OdometryKind::Lidar3d, OdometryParams::default());
        (0..frames)
            .map(|i| {
                let scan = room.cloud(&drive(i, 200), rings, &velocity(i, 200), &mut noise);
                odometry.register(Timestamp::from_secs_f64(i as f64 * 0.1), &scan, None)
            })
            .collect()
    })
}

fn check(estimates: &[OdometryEstimate], metres: f64) {
    for (i, e) in estimates.iter().enumerate() {
        let truth: Pose = drive(0, 200).inverse() * drive(i, 200);
        let off = se3::log(&(truth.inverse() * e.t_odom_base));
        assert!(off.fixed_rows::<3>(0).norm() < metres && off.fixed_rows::<3>(3).norm() < 0.01, "frame {i}: {off}");
        assert_eq!(e.state.is_tracking(), i > 0);
    }
}

#[test]
fn thirty_two_rings_in_a_room_are_followed_to_two_centimetres() {
    check(&run(2, 100, 32), 0.02);
}

#[test]
fn sixteen_sparse_rings_are_followed_too() {
    check(&run(2, 100, 16), 0.03);
}

#[test]
fn the_number_of_threads_changes_not_one_bit() {
    assert_eq!(run(1, 6, 16), run(3, 6, 16));
}
