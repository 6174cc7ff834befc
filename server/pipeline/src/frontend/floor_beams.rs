//! Beams of a tilted planar lidar that meet the floor: they are no walls.

use nalgebra::Vector3;
use percept_geometry::{LaserScan, Pose};
use std::borrow::Cow;

/// What is this near to the floor is floor, metres, and more for each metre of range: floors are rough, and mounts are declared to a
/// degree.
const NEAR_FLOOR: (f64, f64) = (0.05, 0.02);
/// Beams that fall by less, as a share of the way (2 degrees), are level: they meet walls first in rooms.
const LEVEL: f64 = 0.035;

/// A scan without the returns that come from the floor, by its mount (sensor to base; base stands on the floor at z = 0). One whose
/// plane is level, or whose sensor is mounted too low to tell, is left as it is. Beams that meet the floor say nothing.
pub(super) fn off_the_floor<'a>(scan: &'a LaserScan, t_base_sensor: &Pose) -> Cow<'a, LaserScan> {
    let height = t_base_sensor.translation.z;
    if height < 2.0 * NEAR_FLOOR.0 || (t_base_sensor.rotation * Vector3::z()).xy().norm() <= LEVEL {
        return Cow::Borrowed(scan);
    }
    let falls: Vec<f64> = (0..scan.ranges_m.len())
        .map(|i| {
            let angle = scan.angle_min_rad + i as f64 * scan.angle_increment_rad;
            -(t_base_sensor.rotation * Vector3::new(angle.cos(), angle.sin(), 0.0)).z
        })
        .collect();
    let meets_floor = |fall: f64, range: f32| {
        let range = f64::from(range);
        range.is_finite() && fall > LEVEL && height - range * fall < NEAR_FLOOR.0 + NEAR_FLOOR.1 * range
    };
    let mut out = scan.clone();
    let LaserScan { ranges_m, later_echoes_m, .. } = &mut out;
    for echo in std::iter::once(&mut ranges_m[..]).chain(later_echoes_m.chunks_mut(falls.len().max(1))) {
        let beams = echo.iter_mut().zip(&falls);
        beams.filter(|(range, fall)| meets_floor(**fall, **range)).for_each(|(range, _)| *range = f32::NAN);
    }
    Cow::Owned(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Isometry3, Translation3, UnitQuaternion};
    use percept_geometry::cloud::Beam;

    /// Half a turn at 0.6 m in the middle of a round hall of 8 m, pitched down by so much.
    fn scan(pitch: f64) -> (LaserScan, Pose, Vec<bool>) {
        let turn = UnitQuaternion::from_euler_angles(0.0, pitch, 0.0);
        let t_base_sensor: Pose = Isometry3::from_parts(Translation3::new(0.0, 0.0, 0.6), turn);
        let (mut ranges_m, mut is_floor) = (vec![], vec![]);
        for i in 0..181 {
            let angle = f64::from(i - 90).to_radians();
            let d = turn * Vector3::new(angle.cos(), angle.sin(), 0.0);
            let (wall, floor) = (8.0 / d.xy().norm(), if d.z < 0.0 { -0.6 / d.z } else { f64::INFINITY });
            ranges_m.push(wall.min(floor) as f32);
            is_floor.push(floor < wall);
        }
        let scan = LaserScan {
            angle_min_rad: -std::f64::consts::FRAC_PI_2,
            angle_increment_rad: 1f64.to_radians(),
            range_min_m: 0.1,
            range_max_m: 20.0,
            time_increment_s: 0.0,
            intensities: None,
            later_echoes_m: ranges_m.clone(),
            ranges_m,
        };
        (scan, t_base_sensor, is_floor)
    }

    #[test]
    fn what_a_tilted_plane_meets_of_the_floor_is_left_out_and_walls_stay() {
        for pitch in [5f64, 8.0, 12.0, 30.0] {
            let (scan, mount, is_floor) = scan(pitch.to_radians());
            // Declared half a degree wrong, and 1 cm too low.
            let turn = UnitQuaternion::from_euler_angles(0.0, 0.5f64.to_radians(), 0.0);
            let near = Isometry3::from_parts(Translation3::new(0.0, 0.0, 0.59), turn * mount.rotation);
            for declared in [mount, near] {
                let seen = off_the_floor(&scan, &declared);
                let is_left = |i: usize| matches!(seen.beam(i), Beam::Hit(_));
                assert!((0..181).all(|i| !(is_floor[i] && is_left(i))), "{pitch}");
                let walls = (0..181).filter(|i| !is_floor[*i]);
                let (all, left) = (walls.clone().count(), walls.filter(|i| is_left(*i)).count());
                // Those that meet the wall's foot are lost, too: floor and wall cannot be told apart there.
                assert!(2 * left >= all, "{pitch}: {left} of {all}");
                assert!(seen.later_echoes_m.iter().zip(&seen.ranges_m).all(|(a, b)| a.is_nan() == b.is_nan()));
            }
        }
    }

    #[test]
    fn a_level_plane_is_left_as_it_is_also_near_the_floor_and_hung_upside_down() {
        let (scan, ..) = scan(0.0);
        for (z, roll, pitch) in [(0.6, 0.0, 0.0), (0.05, 0.0, 0.0), (0.0, 0.0, 0.3), (0.6, std::f64::consts::PI, 0.01)]
        {
            let mount = Isometry3::from_parts(
                Translation3::new(0.0, 0.0, z),
                UnitQuaternion::from_euler_angles(roll, pitch, 0.0),
            );
            assert!(matches!(off_the_floor(&scan, &mount), Cow::Borrowed(_)));
        }
    }
}
