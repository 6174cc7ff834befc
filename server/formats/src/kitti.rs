//! KITTI's velodyne files: float32 x y z intensity, little-endian, without a header.
//!
//! Source: Geiger, Lenz, Stiller, Urtasun, "Vision meets robotics: the KITTI dataset", 2013. Poses of the
//! odometry benchmark are in [`crate::trajectory`].

use crate::{FormatError, Limits};
use nalgebra::{Matrix4, Point3};
use percept_geometry::{PointCloud, Pose, se3};
use std::io::Write;

const FORMAT: &str = "KITTI";

/// A cloud with intensities (0..1) from 16 bytes a point, in the lidar frame, metres.
///
/// # Errors
/// `Truncated` if the length is not a multiple of 16; `TooLarge`.
pub fn decode_bin(bytes: &[u8], limits: &Limits) -> Result<PointCloud, FormatError> {
    let (rows, rest) = bytes.as_chunks::<16>();
    if !rest.is_empty() {
        let (needed, available) = (16 * (rows.len() as u64 + 1), bytes.len() as u64);
        return Err(FormatError::Truncated { format: FORMAT, field: "last point", needed, available });
    }
    limits.points(rows.len() as u64)?;
    let value = |row: &[u8; 16], i: usize| f32::from_le_bytes([row[i], row[i + 1], row[i + 2], row[i + 3]]);
    Ok(PointCloud {
        positions: rows.iter().map(|r| Point3::new(value(r, 0), value(r, 4), value(r, 8))).collect(),
        intensities: Some(rows.iter().map(|r| value(r, 12)).collect()),
        ..PointCloud::default()
    })
}

/// Writes a cloud as KITTI's velodyne files hold it; intensities that it lacks are 0.
///
/// # Errors
/// `Geometry` if a channel has another length than the positions; `Write` if the writer refuses.
pub fn write_bin(out: &mut impl Write, cloud: &PointCloud) -> Result<(), FormatError> {
    cloud.validate()?;
    for (i, p) in cloud.positions.iter().enumerate() {
        let intensity = cloud.intensities.as_ref().map_or(0.0, |v| v[i]);
        let mut row = [0; 16];
        for (at, v) in row.chunks_exact_mut(4).zip([p.x, p.y, p.z, intensity]) {
            at.copy_from_slice(&v.to_le_bytes());
        }
        out.write_all(&row)?;
    }
    Ok(())
}

/// The transform of the line `Tr:` of an odometry calibration: t_cam0_lidar. None if there is no such line.
///
/// The tracking and object benchmarks name theirs otherwise (`Tr_velo_to_cam`); it is not taken for this.
///
/// # Errors
/// `Malformed` if the line does not hold 12 finite numbers; `Geometry` if they are no rigid transform.
pub fn parse_calibration(bytes: &[u8]) -> Result<Option<Pose>, FormatError> {
    for line in crate::text::Lines::new(FORMAT, bytes).contents() {
        let mut fields = line.fields();
        if fields.token() == Some(b"Tr:") {
            let mut m = Matrix4::identity();
            for i in 0..12 {
                m[(i / 4, i % 4)] = fields.finite("Tr")?;
            }
            fields.end()?;
            return Ok(Some(se3::pose_from_matrix("Tr", &m)?));
        }
    }
    Ok(None)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_round_trip_and_a_cut_file_is_an_error() {
        let mut cloud = PointCloud::from_positions(vec![Point3::new(1.5, -2.0, 0.25), Point3::new(40.0, 3.0, -1.7)]);
        cloud.intensities = Some(vec![0.5, 0.0]);
        let mut bytes = vec![];
        write_bin(&mut bytes, &cloud).unwrap();
        assert_eq!(decode_bin(&bytes, &Limits::default()).unwrap(), cloud);
        for end in (0..bytes.len()).filter(|n| n % 16 != 0) {
            assert!(decode_bin(&bytes[..end], &Limits::default()).is_err());
        }
        let tight = Limits { max_points: 1, ..Limits::default() };
        assert!(matches!(decode_bin(&bytes, &tight), Err(FormatError::TooLarge { value: 2, limit: 1, .. })));
    }

    #[test]
    fn only_the_odometry_calibration_counts() {
        let text = b"P0: 1 2 3\nTr_velo_to_cam: 1 0 0 0 0 1 0 0 0 0 1 0\nTr: 1 0 0 0.5 0 1 0 0 0 0 1 -1\n";
        assert_eq!(parse_calibration(text).unwrap(), Some(Pose::translation(0.5, 0.0, -1.0)));
        assert_eq!(parse_calibration(b"Tr_velo_to_cam: 1 0 0 0 0 1 0 0 0 0 1 0\n").unwrap(), None);
        assert!(parse_calibration(b"Tr: 1 0 0\n").is_err());
    }
}
