//! Logs of BreezySLAM and CoreSLAM: a small robot with a Hokuyo URG-04LX and ticks of two wheels.
//!
//! Source: the log format that BreezySLAM's `mines.py` reads: a row a scan, of 24 fields, 682 ranges and one more field. Field 1
//! is the time, microseconds; 3 and 4 are the left and the right wheel's ticks; 25 to 706 the ranges, millimetres.

use crate::text::{Line, Lines};
use crate::{FormatError, Limits};
use percept_geometry::{LaserScan, Pose, Stamped, Timestamp, se3};

const FORMAT: &str = "BreezySLAM";

/// Fields before the ranges, ranges, and fields in all.
const FIELDS: (usize, usize, usize) = (24, 682, 707);

/// The robot of these logs, by `mines.py`: its wheels' radius and the distance between them, metres, and ticks of a turn.
const WHEELS: (f64, f64, f64) = (0.077, 0.330, 2000.0);
/// The laser is so far ahead of the middle between its wheels, by `mines.py`, metres.
pub const LASER_AHEAD_M: f64 = 0.145;
/// From the first to the last step of a URG-04LX, radians (Hokuyo's data sheet: steps 44 to 725 of 1024 to a turn).
const STEP_RAD: f64 = std::f64::consts::TAU / 1024.0;
/// What it measures, metres (Hokuyo's data sheet). Readings below are codes of errors.
const RANGE_M: (f64, f64) = (0.02, 4.0);

/// A row: what the laser saw, and where the wheels have led.
#[derive(Debug, Clone, PartialEq)]
pub struct BreezyRow {
    /// 682 ranges as written, millimetres, from the right (-120 degrees) to the left.
    pub ranges_mm: Vec<u16>,
    /// By the wheels, from the first row on.
    pub t_odom_base: Pose,
}

impl BreezyRow {
    /// The scan as the rest of the system knows it. What did not come back, and what failed, is 0.
    pub fn laser_scan(&self) -> LaserScan {
        let metres = |&mm: &u16| f32::from(mm) / 1000.0;
        LaserScan {
            angle_min_rad: -0.5 * (FIELDS.1 - 1) as f64 * STEP_RAD,
            angle_increment_rad: STEP_RAD,
            range_min_m: RANGE_M.0,
            range_max_m: RANGE_M.1,
            time_increment_s: 0.0,
            ranges_m: self.ranges_mm.iter().map(metres).collect(),
            intensities: None,
            later_echoes_m: vec![],
        }
    }
}

/// Whether a line looks like a row: 707 whole numbers, but for the few fields between ticks and ranges.
pub fn is_row(line: &[u8]) -> bool {
    let mut fields = 0;
    let is_number = |field: &[u8]| field.iter().all(|b| b.is_ascii_digit() || matches!(b, b'-' | b'.'));
    line.split(|b| b.is_ascii_whitespace()).filter(|field| !field.is_empty()).all(|field| {
        fields += 1;
        fields <= FIELDS.2 && is_number(field)
    }) && fields == FIELDS.2
}

/// Reads a log; a last line that broke off is left out.
///
/// # Errors
/// `Malformed` with the line; `Missing` if there is no row; `TooLarge` for more readings than `max_points`.
pub fn parse(bytes: &[u8], limits: &Limits) -> Result<Vec<Stamped<BreezyRow>>, FormatError> {
    let mut rows: Vec<Stamped<BreezyRow>> = vec![];
    let mut before: Option<(i64, i64)> = None;
    let mut t_odom_base = Pose::identity();
    for line in Lines::new(FORMAT, bytes).contents() {
        let (stamp, ticks, ranges_mm) = match row(&line) {
            Ok(row) => row,
            Err(_) if !line.ended => break,
            Err(error) => return Err(error),
        };
        if let Some(before) = before {
            t_odom_base *= driven(before, ticks);
        }
        before = Some(ticks);
        limits.points(((rows.len() + 1) * ranges_mm.len()) as u64)?;
        rows.push(Stamped { stamp, value: BreezyRow { ranges_mm, t_odom_base } });
    }
    if rows.is_empty() {
        return Err(FormatError::Missing { format: FORMAT, field: "time_us" });
    }
    Ok(rows)
}

/// How a robot on two wheels has moved between two readings of its ticks, along an arc.
fn driven(before: (i64, i64), now: (i64, i64)) -> Pose {
    let (radius, apart, turn) = WHEELS;
    // Counters run over; what they say then is nonsense, and is not let grow.
    let metres = |a: i64, b: i64| radius * std::f64::consts::TAU * b.wrapping_sub(a) as f64 / turn;
    let (left, right) = (metres(before.0, now.0), metres(before.1, now.1));
    let (way, yaw) = (0.5 * (left + right), (right - left) / apart);
    se3::from_xy_yaw(way * (0.5 * yaw).cos(), way * (0.5 * yaw).sin(), yaw)
}

/// A row's time, its ticks, its ranges.
type Row = (Timestamp, (i64, i64), Vec<u16>);

fn row(line: &Line<'_>) -> Result<Row, FormatError> {
    let mut fields = line.fields();
    let microseconds: i64 = fields.number("time_us")?;
    let stamp = Timestamp(microseconds.checked_mul(1000).ok_or_else(|| {
        line.malformed("time_us", microseconds.to_string().as_bytes(), "microseconds within 292 years")
    })?);
    fields.required("field 2")?;
    let ticks = (fields.number("left_ticks")?, fields.number("right_ticks")?);
    for _ in 4..FIELDS.0 {
        fields.required("a field before the ranges")?;
    }
    let ranges_mm: Result<Vec<u16>, FormatError> = (0..FIELDS.1).map(|_| fields.number("range_mm")).collect();
    let ranges_mm = ranges_mm?;
    fields.required("field 707")?;
    Ok((stamp, ticks, ranges_mm))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(us: i64, left: i64, right: i64, mm: u16) -> String {
        let mut fields = vec![us.to_string(), "0".to_owned(), left.to_string(), right.to_string()];
        fields.extend((4..24).map(|_| "7.5".to_owned()));
        fields.extend((0..682).map(|_| mm.to_string()));
        fields.push("0".to_owned());
        fields.join(" ") + " \n"
    }

    #[test]
    fn wheels_lead_straight_on_and_on_the_spot() {
        // A turn of both wheels is their girth; a quarter to the left takes a quarter of the circle between them.
        let girth = std::f64::consts::TAU * 0.077;
        let quarter = (0.25 * std::f64::consts::PI * 0.330 / girth * 2000.0).round() as i64;
        let text =
            line(0, 5, 9, 1000) + &line(100_000, 2005, 2009, 1000) + &line(200_000, 2005 - quarter, 2009 + quarter, 1);
        let rows = parse(text.as_bytes(), &Limits::default()).unwrap();
        let at = |i: usize| (rows[i].value.t_odom_base.translation.vector, se3::yaw(&rows[i].value.t_odom_base));
        assert!((at(1).0.x - girth).abs() < 1e-9 && at(1).1.abs() < 1e-9, "{:?}", at(1));
        assert!(
            (at(2).0 - at(1).0).norm() < 1e-9 && (at(2).1 - std::f64::consts::FRAC_PI_2).abs() < 2e-3,
            "{:?}",
            at(2)
        );
        assert_eq!(rows[2].stamp, Timestamp(200_000_000));
        let scan = rows[0].value.laser_scan();
        assert!(
            (scan.angle(681) - 119.7f64.to_radians()).abs() < 2e-3 && (scan.angle(0) + scan.angle(681)).abs() < 1e-12
        );
        assert_eq!((scan.ranges_m.len(), scan.ranges_m[5]), (682, 1.0));
    }

    #[test]
    fn what_is_no_row_is_refused_where_it_stands_and_a_broken_end_is_left_out() {
        let good = line(0, 0, 0, 1000);
        assert!(is_row(good.trim_end().as_bytes()) && !is_row(b"1 2 3") && !is_row("x ".repeat(707).as_bytes()));
        let cut = good.clone() + &line(1, 0, 0, 1000)[..900];
        assert_eq!(parse(cut.as_bytes(), &Limits::default()).unwrap().len(), 1);
        for bad in ["70000", "-1", "x"] {
            let text = good.clone() + &line(1, 0, 0, 1234).replacen("1234", bad, 1) + &good;
            let error = parse(text.as_bytes(), &Limits::default()).unwrap_err().to_string();
            assert!(error.contains("line 2") && error.contains("range_mm"), "{error}");
        }
        let far = line(0, i64::MIN, i64::MAX, 1) + &line(1, i64::MAX, i64::MIN, 1);
        assert!(parse(far.as_bytes(), &Limits::default()).is_ok());
        assert!(parse(line(i64::MAX, 0, 0, 1).as_bytes(), &Limits::default()).is_err());
        assert!(parse(b"", &Limits::default()).is_err());
    }
}
