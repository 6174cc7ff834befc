//! CARMEN logs of planar laser robots, and the relations files that go with some of them.
//!
//! Source: the CARMEN toolkit's log format (`FLASER num_readings [ranges] x y theta odom_x odom_y odom_theta
//! ipc_timestamp ipc_hostname logger_timestamp`, `ODOM x y theta tv rv accel …`, and the newer `ROBOTLASER1`).
//! Rows stay in the order of the file, and so do their stamps, which need not rise.

use crate::text::{Fields, Line, Lines};
use crate::{FormatError, Limits};
use percept_geometry::{LaserScan, Pose, Stamped, Timestamp, se3};
use std::collections::BTreeMap;

const FORMAT: &str = "CARMEN";

/// Readings below this are none, metres: the scanners of these logs write 0 for a failed one.
const RANGE_MIN_M: f64 = 0.05;

/// One scan with the poses that its row gives.
#[derive(Debug, Clone, PartialEq)]
pub struct CarmenScan {
    /// Angle of beam 0, radians.
    pub angle_min_rad: f64,
    /// Angle between beams, radians.
    pub angle_increment_rad: f64,
    /// B ranges as written, metres.
    pub ranges_m: Vec<f32>,
    /// The laser's pose; in a corrected log the corrected one.
    pub t_world_laser: Pose,
    /// The robot's pose by its odometry; in a corrected log again the corrected one.
    pub t_odom_base: Pose,
}

/// A row that matters.
#[derive(Debug, Clone, PartialEq)]
pub enum CarmenRow {
    /// `FLASER` or `ROBOTLASER1`.
    Scan(CarmenScan),
    /// `ODOM`: t_odom_base.
    Odometry(Pose),
}

/// A log in the order of its rows.
#[derive(Debug, Clone, PartialEq)]
pub struct CarmenLog {
    /// Scans and odometry.
    pub rows: Vec<Stamped<CarmenRow>>,
    /// Whether poses are corrected ones: GMapping leaves `NEFF` rows.
    pub corrected: bool,
    /// The front laser's place ahead of the robot's centre, metres (`PARAM robot_frontlaser_offset`).
    pub front_laser_offset_m: f64,
    /// Readings at or beyond this are 'no return', metres.
    pub range_max_m: f64,
}

impl CarmenLog {
    /// The scans with their row numbers, in order.
    pub fn scans(&self) -> impl Iterator<Item = (usize, &CarmenScan)> {
        self.rows.iter().enumerate().filter_map(|(i, row)| match &row.value {
            CarmenRow::Scan(scan) => Some((i, scan)),
            CarmenRow::Odometry(_) => None,
        })
    }

    /// A scan as the rest of the system knows it: beyond the maximum is +inf.
    pub fn laser_scan(&self, scan: &CarmenScan) -> LaserScan {
        let range = |&r: &f32| if f64::from(r) >= self.range_max_m { f32::INFINITY } else { r };
        LaserScan {
            angle_min_rad: scan.angle_min_rad,
            angle_increment_rad: scan.angle_increment_rad,
            range_min_m: RANGE_MIN_M,
            range_max_m: self.range_max_m,
            time_increment_s: 0.0,
            ranges_m: scan.ranges_m.iter().map(range).collect(),
            intensities: None,
            later_echoes_m: vec![],
        }
    }
}

/// Reads a log; rows of other messages are stepped over, and so is a last line that broke off.
///
/// # Errors
/// `Malformed` with the line; `Missing` if there is no scan; `TooLarge` for more readings than `max_points`.
pub fn parse(bytes: &[u8], limits: &Limits) -> Result<CarmenLog, FormatError> {
    let mut log = CarmenLog { rows: vec![], corrected: false, front_laser_offset_m: 0.0, range_max_m: f64::INFINITY };
    let mut num_readings = 0;
    for line in Lines::new(FORMAT, bytes).contents() {
        match parse_row(&line, &mut log) {
            Ok(Some(row)) => {
                if let CarmenRow::Scan(scan) = &row.value {
                    num_readings += scan.ranges_m.len() as u64;
                    limits.points(num_readings)?;
                }
                log.rows.push(row);
            }
            Ok(None) => {}
            Err(_) if !line.ended => {}
            Err(error) => return Err(error),
        }
    }
    if num_readings == 0 {
        return Err(FormatError::Missing { format: FORMAT, field: "FLASER" });
    }
    log.range_max_m = range_max(&log);
    Ok(log)
}

fn parse_row(line: &Line<'_>, log: &mut CarmenLog) -> Result<Option<Stamped<CarmenRow>>, FormatError> {
    let mut fields = line.fields();
    match fields.token() {
        Some(b"FLASER") => front_laser(line, &mut fields).map(Some),
        Some(b"ROBOTLASER1") => robot_laser(line, &mut fields).map(Some),
        Some(b"ODOM") => {
            let value = CarmenRow::Odometry(planar(&mut fields, "odometry")?);
            for name in ["tv", "rv", "accel"] {
                fields.finite(name)?;
            }
            Ok(Some(Stamped { stamp: fields.stamp("ipc_timestamp")?, value }))
        }
        Some(b"NEFF") => {
            log.corrected = true;
            Ok(None)
        }
        Some(b"PARAM") => {
            if fields.token() == Some(b"robot_frontlaser_offset") {
                log.front_laser_offset_m = fields.finite("robot_frontlaser_offset")?;
            }
            Ok(None)
        }
        _ => Ok(None),
    }
}

fn planar(fields: &mut Fields<'_>, name: &str) -> Result<Pose, FormatError> {
    Ok(se3::from_xy_yaw(fields.finite(name)?, fields.finite(name)?, fields.finite(name)?))
}

fn readings(line: &Line<'_>, fields: &mut Fields<'_>) -> Result<Vec<f32>, FormatError> {
    let n: usize = fields.number("num_readings")?;
    // A reading takes a digit and a space.
    if n == 0 || n > line.bytes.len() / 2 {
        return Err(line.malformed("num_readings", n.to_string().as_bytes(), "the number of readings in the row"));
    }
    (0..n).map(|_| fields.number("range")).collect()
}

fn front_laser(line: &Line<'_>, fields: &mut Fields<'_>) -> Result<Stamped<CarmenRow>, FormatError> {
    let ranges_m = readings(line, fields)?;
    let (t_world_laser, t_odom_base) = (planar(fields, "laser pose")?, planar(fields, "odometry pose")?);
    let stamp = fields.stamp("ipc_timestamp")?;
    // An odd number of beams has one at each end of the half-circle; an even one stops short of the left end.
    let n = ranges_m.len();
    let steps = if n % 2 == 1 { (n - 1).max(1) } else { n };
    let angle_increment_rad = std::f64::consts::PI / steps as f64;
    let angle_min_rad = -std::f64::consts::FRAC_PI_2;
    let scan = CarmenScan { angle_min_rad, angle_increment_rad, ranges_m, t_world_laser, t_odom_base };
    Ok(Stamped { stamp, value: CarmenRow::Scan(scan) })
}

/// `ROBOTLASER1 type start_angle field_of_view resolution maximum_range accuracy remission_mode n [ranges]
/// m [remissions] laser(x y theta) robot(x y theta) tv rv forward_safety side_safety turn_axis ipc_timestamp …`.
fn robot_laser(line: &Line<'_>, fields: &mut Fields<'_>) -> Result<Stamped<CarmenRow>, FormatError> {
    fields.required("laser_type")?;
    let angle_min_rad = fields.finite("start_angle")?;
    fields.finite("field_of_view")?;
    let angle_increment_rad = fields.finite("angular_resolution")?;
    for name in ["maximum_range", "accuracy", "remission_mode"] {
        fields.finite(name)?;
    }
    let ranges_m = readings(line, fields)?;
    for _ in 0..fields.number::<usize>("num_remissions")? {
        fields.required("remission")?;
    }
    let (t_world_laser, t_odom_base) = (planar(fields, "laser pose")?, planar(fields, "robot pose")?);
    for name in ["tv", "rv", "forward_safety_dist", "side_safety_dist", "turn_axis"] {
        fields.finite(name)?;
    }
    let stamp = fields.stamp("ipc_timestamp")?;
    let scan = CarmenScan { angle_min_rad, angle_increment_rad, ranges_m, t_world_laser, t_odom_base };
    Ok(Stamped { stamp, value: CarmenRow::Scan(scan) })
}

/// The least of the readings that mean 'no return': the maximum, if it comes up again and again, and other
/// repeated values close under it (SICK's error codes). Otherwise just beyond the largest.
fn range_max(log: &CarmenLog) -> f64 {
    const REPEATED: usize = 3;
    const CLOSE: f64 = 0.975;
    let mut counts: BTreeMap<i64, usize> = BTreeMap::new();
    for (_, scan) in log.scans() {
        for &r in scan.ranges_m.iter().filter(|r| r.is_finite()) {
            *counts.entry((f64::from(r) * 1000.0).round() as i64).or_default() += 1;
        }
    }
    let Some((&largest, &count)) = counts.last_key_value() else {
        return f64::INFINITY;
    };
    let close = (largest as f64 * CLOSE) as i64;
    let codes = counts.range(close..).find(|&(_, &n)| n >= REPEATED);
    match codes {
        // Half a millimetre of room for the rounding of f32.
        Some((&code, _)) if count >= REPEATED => (code as f64 - 0.5) / 1000.0,
        _ => (largest as f64 + 1.0) / 1000.0,
    }
}

/// A relative pose that somebody checked.
#[derive(Debug, Clone, PartialEq)]
pub struct Relation {
    /// First time; may be the later one.
    pub stamp_1: Timestamp,
    /// Second time.
    pub stamp_2: Timestamp,
    /// The robot at the second time, seen from the first.
    pub t_1_2: Pose,
}

/// Reads a `.relations` file: rows `t1 t2 x y z roll pitch yaw` (s, m, rad).
///
/// Source: Kuemmerle et al., "On measuring the accuracy of SLAM algorithms", 2009.
///
/// # Errors
/// `Malformed` with the line.
pub fn parse_relations(bytes: &[u8]) -> Result<Vec<Relation>, FormatError> {
    let row = |line: Line<'_>| {
        let mut fields = line.fields();
        let (stamp_1, stamp_2) = (fields.stamp("t1")?, fields.stamp("t2")?);
        let mut v = [0.0; 6];
        for (value, name) in v.iter_mut().zip(["x", "y", "z", "roll", "pitch", "yaw"]) {
            *value = fields.finite(name)?;
        }
        let rotation = nalgebra::UnitQuaternion::from_euler_angles(v[3], v[4], v[5]);
        let t_1_2 = Pose::from_parts(nalgebra::Translation3::new(v[0], v[1], v[2]), rotation);
        Ok(Relation { stamp_1, stamp_2, t_1_2 })
    };
    Lines::new("relations", bytes).contents().map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::f64::consts::{FRAC_PI_2, PI};

    const LOG: &str = "# FLASER num_readings [range_readings] …\nPARAM robot_frontlaser_offset 0.25 nohost 0\n\
        ODOM 1 2 0.5 0 0 0 10.5 nohost 0.5\n\
        FLASER 4 1.00 81.83 81.91 0.0 1.25 2 0.5 1 2 0.5 11.25 nohost 1.25\n\
        FLASER 4 2.00 81.83 81.91 3.0 1.25 2 0.5 1 2 0.5 12 nohost\n\
        FLASER 4 2.00 81.83 81.91 3.0 1.25 2 0.5 1 2 0.5 11 nohost 1\n";

    #[test]
    fn rows_become_scans_and_odometry() {
        let log = parse(LOG.as_bytes(), &Limits::default()).unwrap();
        assert_eq!(log.rows.len(), 4);
        assert_eq!(log.rows[0].value, CarmenRow::Odometry(se3::from_xy_yaw(1.0, 2.0, 0.5)));
        assert_eq!(
            log.rows.iter().map(|r| r.stamp.0 / 1_000_000).collect::<Vec<_>>(),
            [10_500, 11_250, 12_000, 11_000]
        );
        let (_, first) = log.scans().next().unwrap();
        let scan = log.laser_scan(first);
        assert_eq!(scan.ranges_m, [1.0, f32::INFINITY, f32::INFINITY, 0.0]);
        assert_eq!(scan.angle_min_rad, -FRAC_PI_2);
        assert_eq!(scan.angle_increment_rad, PI / 4.0);
        assert_eq!((log.corrected, log.front_laser_offset_m), (false, 0.25));
        assert_eq!(scan.hits().len(), 1);
    }

    #[test]
    fn an_odd_number_of_beams_reaches_both_ends() {
        let text = "NEFF 12\nFLASER 3 1 2 3 0 0 0 0 0 0 1.5 pippo 1.5\n";
        let log = parse(text.as_bytes(), &Limits::default()).unwrap();
        let (_, scan) = log.scans().next().unwrap();
        assert!((log.laser_scan(scan).angle(2) - FRAC_PI_2).abs() < 1e-12);
        // Nothing is repeated: all three are hits.
        assert_eq!(log.laser_scan(scan).hits().len(), 3);
        assert!(log.corrected);
    }

    #[test]
    fn the_newer_message_is_read() {
        let text = "ROBOTLASER1 0 -1.0 2.0 1.0 80 0.01 0 3 1.5 2.5 3.5 1 7 1 2 0 0.8 2 0 0 0 0.5 0.5 0 99.5 host 1.0\n";
        let log = parse(text.as_bytes(), &Limits::default()).unwrap();
        let (_, scan) = log.scans().next().unwrap();
        assert_eq!((scan.angle_min_rad, scan.angle_increment_rad), (-1.0, 1.0));
        assert_eq!(scan.ranges_m, [1.5, 2.5, 3.5]);
        assert_eq!(scan.t_odom_base, se3::from_xy_yaw(0.8, 2.0, 0.0));
        assert_eq!(log.rows[0].stamp, Timestamp(99_500_000_000));
    }

    #[test]
    fn bad_rows_are_named_and_a_broken_end_is_dropped() {
        let error = |text: &str| parse(text.as_bytes(), &Limits::default()).unwrap_err().to_string();
        assert_eq!(error("\nFLASER 2 1 x 0 0 0 0 0 0 1 h 1\n"), "CARMEN, line 2: range is 'x', expected a number");
        assert!(error("FLASER 99999999999 1 2\n").contains("num_readings"));
        assert_eq!(error("ODOM 0 0 0 0 0 0 1 h 1\n"), "CARMEN: FLASER is missing");
        for end in 0..LOG.len() {
            match parse(&LOG.as_bytes()[..end], &Limits::default()) {
                Ok(log) => assert!(log.rows.len() <= 4),
                Err(error) => assert!(matches!(error, FormatError::Missing { .. }), "{error}"),
            }
        }
    }

    proptest! {
        #[test]
        fn damaged_bytes_never_panic(hits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6)) {
            let mut bytes = LOG.as_bytes().to_vec();
            for (at, value) in hits {
                let at = at.index(bytes.len());
                bytes[at] = value;
            }
            let _ = (parse(&bytes, &Limits::default()), parse_relations(&bytes));
        }
    }
}
