//! Trajectories as text: TUM, EuRoC, KITTI, Redwood, and single 4x4 matrices.
//!
//! Poses are those of the file, mostly sensor to world; stamps keep every nanosecond that the file gives.

use crate::FormatError;
use crate::euroc::Cells;
use crate::text::{Line, Lines};
use nalgebra::Matrix4;
use percept_geometry::{Pose, Stamped, se3};
use std::io::Write;

/// TUM: rows `stamp x y z qx qy qz qw` (s, m), comments with `#`.
///
/// Quaternions are rounded in many files: a norm within 5 % of 1 is brought to 1.
///
/// # Errors
/// `Malformed` with the line, for a row that does not hold these eight numbers.
pub fn parse_tum(bytes: &[u8]) -> Result<Vec<Stamped<Pose>>, FormatError> {
    Lines::new("TUM", bytes).contents().map(|line| tum_row(&line)).collect()
}

fn tum_row(line: &Line<'_>) -> Result<Stamped<Pose>, FormatError> {
    let mut fields = line.fields();
    let stamp = fields.stamp("stamp")?;
    let mut v = [0.0; 7];
    for (value, name) in v.iter_mut().zip(["x", "y", "z", "qx", "qy", "qz", "qw"]) {
        *value = fields.finite(name)?;
    }
    fields.end()?;
    Ok(Stamped { stamp, value: rounded_pose(line, &v)? })
}

/// A pose from x y z qx qy qz qw, the quaternion as rounded as files have it.
fn rounded_pose(line: &Line<'_>, v: &[f64; 7]) -> Result<Pose, FormatError> {
    let norm = v[3..].iter().map(|q| q * q).sum::<f64>().sqrt();
    if (norm - 1.0).abs() > 0.05 {
        return Err(line.malformed("quaternion norm", norm.to_string().as_bytes(), "1"));
    }
    // Left alone if it is unit to f64's precision, so that poses survive a round trip.
    let scale = if (norm - 1.0).abs() < 1e-12 { 1.0 } else { norm };
    Ok(se3::pose_from_parts("pose", [v[0], v[1], v[2]], [3, 4, 5, 6].map(|i| v[i] / scale))?)
}

/// Poses in the order of frames, as slambook2 has them: rows `x y z qx qy qz qw` (m), a quaternion's norm as in [`parse_tum`].
///
/// # Errors
/// `Malformed` with the line, for a row that does not hold these seven numbers.
pub fn parse_pose_rows(bytes: &[u8]) -> Result<Vec<Pose>, FormatError> {
    let row = |line: Line<'_>| rounded_pose(&line, &line.numbers::<7>("x y z qx qy qz qw")?);
    Lines::new("poses", bytes).contents().map(row).collect()
}

/// EuRoC's ground truth: rows `stamp,x,y,z,qw,qx,qy,qz` (ns, m) and more columns, which are left out.
///
/// Source: Burri et al., "The EuRoC micro aerial vehicle datasets", 2016.
///
/// # Errors
/// `Malformed` with the line, for a row that does not begin with these eight numbers.
pub fn parse_euroc(bytes: &[u8]) -> Result<Vec<Stamped<Pose>>, FormatError> {
    Lines::new("EuRoC", bytes).contents().map(|line| euroc_row(&line)).collect()
}

pub(crate) fn euroc_row(line: &Line<'_>) -> Result<Stamped<Pose>, FormatError> {
    const NAMES: [&str; 7] = ["x", "y", "z", "qw", "qx", "qy", "qz"];
    let mut cells = Cells::new(line);
    let stamp = cells.stamp()?;
    let mut v = [0.0; 7];
    // The file has qw first.
    for (slot, name) in [0, 1, 2, 6, 3, 4, 5].into_iter().zip(NAMES) {
        v[slot] = cells.finite(name)?;
    }
    Ok(Stamped { stamp, value: rounded_pose(line, &v)? })
}

/// Writes TUM rows with nine decimals.
///
/// # Errors
/// `Write` if the writer refuses.
pub fn write_tum(out: &mut impl Write, trajectory: &[Stamped<Pose>]) -> Result<(), FormatError> {
    trajectory.iter().try_for_each(|pose| write_tum_row(out, pose, true))
}

/// Writes one TUM row with nine decimals; a pose that is but a guess as a comment, so that no reader takes it for a measured
/// one.
///
/// # Errors
/// `Write` if the writer refuses.
pub fn write_tum_row(
    out: &mut impl Write,
    Stamped { stamp, value }: &Stamped<Pose>,
    is_measured: bool,
) -> Result<(), FormatError> {
    let mark = if is_measured { "" } else { "# guessed: " };
    let t = value.translation.vector;
    let [x, y, z, w] = se3::quaternion_xyzw(value);
    writeln!(out, "{mark}{stamp} {:.9} {:.9} {:.9} {x:.9} {y:.9} {z:.9} {w:.9}", t.x, t.y, t.z)?;
    Ok(())
}

/// KITTI: 12 numbers a row, the upper 3x4 of the matrix, row-major.
///
/// # Errors
/// `Malformed` with the line, for a row that does not hold these numbers or whose 3x3 is no rotation.
pub fn parse_kitti(bytes: &[u8]) -> Result<Vec<Pose>, FormatError> {
    let row = |line: Line<'_>| {
        let v = line.numbers::<12>("pose")?;
        let mut m = Matrix4::identity();
        for (i, v) in v.into_iter().enumerate() {
            m[(i / 4, i % 4)] = v;
        }
        rigid(&line, &m)
    };
    Lines::new("KITTI poses", bytes).contents().map(row).collect()
}

/// Writes KITTI rows with nine decimals.
///
/// # Errors
/// `Write` if the writer refuses.
pub fn write_kitti(out: &mut impl Write, poses: &[Pose]) -> Result<(), FormatError> {
    for pose in poses {
        let m = pose.to_homogeneous();
        let row: Vec<String> = (0..12).map(|i| format!("{:.9}", m[(i / 4, i % 4)])).collect();
        writeln!(out, "{}", row.join(" "))?;
    }
    Ok(())
}

/// Redwood's `.log`: three integers, of which the first names the frame, then four rows of a 4x4 matrix, again
/// and again.
///
/// # Errors
/// `Malformed` with the line; `Truncated` if the last matrix lacks rows.
pub fn parse_redwood(bytes: &[u8]) -> Result<Vec<(u64, Pose)>, FormatError> {
    let mut lines = Lines::new("Redwood log", bytes).contents();
    let mut out = vec![];
    while let Some(line) = lines.next() {
        let mut fields = line.fields();
        let frame = fields.number("frame")?;
        fields.number::<i64>("frame")?;
        fields.number::<i64>("frame")?;
        fields.end()?;
        out.push((frame, matrix(&mut lines, "Redwood log")?));
    }
    Ok(out)
}

/// A file with one 4x4 matrix (7-Scenes' `pose.txt`). None if a number is not finite, which some sets
/// write for 'not known'.
///
/// # Errors
/// `Malformed` with the line; `Truncated` if rows are missing.
pub fn parse_matrix(bytes: &[u8]) -> Result<Option<Pose>, FormatError> {
    const FORMAT: &str = "4x4 pose";
    let text = Lines::new(FORMAT, bytes);
    for line in text.clone().contents() {
        let mut fields = line.fields();
        for _ in 0..4 {
            if !fields.number::<f64>("pose")?.is_finite() {
                return Ok(None);
            }
        }
    }
    matrix(&mut text.contents(), FORMAT).map(Some)
}

fn matrix<'a>(lines: &mut impl Iterator<Item = Line<'a>>, format: &'static str) -> Result<Pose, FormatError> {
    let mut m = Matrix4::zeros();
    let mut last = None;
    for row in 0..4 {
        let available = row as u64 * 8;
        let line = lines.next().ok_or(FormatError::Truncated { format, field: "matrix", needed: 32, available })?;
        for (column, v) in line.numbers::<4>("matrix")?.into_iter().enumerate() {
            m[(row, column)] = v;
        }
        last = Some(line);
    }
    last.map_or(Err(FormatError::Missing { format, field: "matrix" }), |line| rigid(&line, &m))
}

fn rigid(line: &Line<'_>, m: &Matrix4<f64>) -> Result<Pose, FormatError> {
    se3::pose_from_matrix("pose", m).map_err(|e| line.malformed("pose", e.to_string().as_bytes(), "a rigid transform"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector6;
    use percept_geometry::Timestamp;
    use proptest::prelude::*;

    fn poses() -> impl Strategy<Value = Vec<Stamped<Pose>>> {
        let pose = (any::<u32>(), prop::array::uniform6(-3.0..3.0f64)).prop_map(|(stamp, v)| Stamped {
            stamp: Timestamp(1_305_031_102_000_000_000 + i64::from(stamp)),
            value: se3::exp(&Vector6::from(v)),
        });
        prop::collection::vec(pose, 0..20)
    }

    proptest! {
        #[test]
        fn trajectories_read_back(trajectory in poses()) {
            let mut bytes = vec![];
            write_tum(&mut bytes, &trajectory).unwrap();
            let back = parse_tum(&bytes).unwrap();
            prop_assert_eq!(back.len(), trajectory.len());
            for (a, b) in trajectory.iter().zip(&back) {
                prop_assert_eq!(a.stamp, b.stamp);
                prop_assert!(se3::log(&(a.value.inverse() * b.value)).norm() < 1e-7);
            }
            let poses: Vec<Pose> = trajectory.into_iter().map(|s| s.value).collect();
            let mut bytes = vec![];
            write_kitti(&mut bytes, &poses).unwrap();
            for (a, b) in poses.iter().zip(parse_kitti(&bytes).unwrap()) {
                prop_assert!(se3::log(&(a.inverse() * b)).norm() < 1e-7);
            }
        }

        #[test]
        fn damaged_text_never_panics(bytes in "([0-9 ,.e#\n-]|nan){0,200}") {
            let _ = (parse_tum(bytes.as_bytes()), parse_kitti(bytes.as_bytes()), parse_euroc(bytes.as_bytes()));
            let _ = (parse_redwood(bytes.as_bytes()), parse_matrix(bytes.as_bytes()), parse_pose_rows(bytes.as_bytes()));
        }
    }

    #[test]
    fn errors_name_the_line() {
        let message = |r: Result<Vec<Stamped<Pose>>, FormatError>| r.unwrap_err().to_string();
        assert_eq!(
            message(parse_tum(b"# x\n1 0 0 0 0 0 0 1\n2 0 0 0 0 0 1\n")),
            "TUM, line 3: qw is 'end of line', expected a value"
        );
        assert_eq!(message(parse_tum(b"1 0 nan 0 0 0 0 1\n")), "TUM, line 1: y is 'nan', expected a finite number");
        assert_eq!(message(parse_tum(b"1 0 0 0 0 0 0 2\n")), "TUM, line 1: quaternion norm is '2', expected 1");
        assert!(parse_kitti(b"1 0 0 0 0 1 0 0 0 0 1\n").is_err());
        assert!(parse_kitti(b"9 0 0 0 0 9 0 0 0 0 9 0\n").is_err());
    }

    #[test]
    fn euroc_rows_have_the_real_part_first_and_more_than_a_pose() {
        let text = b"#timestamp [ns],p_x\n1403715529662142976,1,2,3,0.6, 0.8,0,0,9,9\n";
        let pose = &parse_euroc(text).unwrap()[0];
        assert_eq!(pose.stamp, Timestamp(1_403_715_529_662_142_976));
        assert_eq!(pose.value.translation.vector.as_slice(), [1.0, 2.0, 3.0]);
        assert_eq!(se3::quaternion_xyzw(&pose.value), [0.8, 0.0, 0.0, 0.6]);
        let refused = |text: &[u8]| parse_euroc(text).unwrap_err().to_string();
        assert_eq!(refused(b"1,2,3,4,1,0,0\n"), "EuRoC, line 1: qz is 'end of line', expected a value");
        assert_eq!(refused(b"1,2,3,4,,0,0,1\n"), "EuRoC, line 1: qw is '', expected a finite number");
        assert_eq!(refused(b"1.5,2,3,4,1,0,0,0\n"), "EuRoC, line 1: stamp is '1.5', expected nanoseconds");
    }

    #[test]
    fn pose_rows_have_no_stamp_and_the_real_part_last() {
        let poses = parse_pose_rows(b"1 2 3 0 0 0.6 0.8\n-1 0 0 0 0 0 1").unwrap();
        assert_eq!(poses[0].translation.vector.as_slice(), [1.0, 2.0, 3.0]);
        assert_eq!((poses.len(), se3::quaternion_xyzw(&poses[0])), (2, [0.0, 0.0, 0.6, 0.8]));
        let refused = |text: &[u8]| parse_pose_rows(text).unwrap_err().to_string();
        assert!(
            refused(b"0 0 0 0 0 0 1\n1 2 3 0 0 0\n").starts_with("poses, line 2: x y z qx qy qz qw is 'end of line'")
        );
        assert!(refused(b"1 2 3 0 0 0 1 9\n").contains("row is '9', expected end of line"));
        assert!(refused(b"1 2 inf 0 0 0 1\n").contains("'inf', expected a finite number"));
        assert!(refused(b"1 2 3 0 0 0 0\n").contains("quaternion norm is '0'"));
    }

    #[test]
    fn matrices_and_redwood_logs() {
        let text = "0 0 1\n1 0 0 1\n0 1 0 2\n0 0 1 3\n0 0 0 1\n1 1 2\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n";
        let log = parse_redwood(text.as_bytes()).unwrap();
        assert_eq!(log, [(0, Pose::translation(1.0, 2.0, 3.0)), (1, Pose::identity())]);
        assert!(parse_redwood(&text.as_bytes()[..text.len() - 10]).is_err());
        assert_eq!(
            parse_matrix(b"1 0 0 1\n0 1 0 0\n0 0 1 0\n0 0 0 1\n").unwrap(),
            Some(Pose::translation(1.0, 0.0, 0.0))
        );
        assert_eq!(parse_matrix(b"nan nan nan nan\n").unwrap(), None);
        assert!(parse_matrix(b"1 0 0 1\n0 1 0 0\n").is_err());
    }
}
