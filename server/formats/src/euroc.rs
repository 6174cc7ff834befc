//! The files of a EuRoC MAV recording (ASL's layout): `sensor.yaml` and `data.csv` of cameras, inertial sensors and truth.
//!
//! Source: Burri et al., "The EuRoC micro aerial vehicle datasets", 2016. Stamps are nanoseconds; `T_BS` takes coordinates of
//! the sensor to the body, row after row. Rows of a `data.csv` rise in time: one that does not is damage, for all sensors share
//! one clock.

use crate::text::{Line, Lines, parse};
use crate::{FormatError, Limits, trajectory};
use nalgebra::{Matrix4, Vector3};
use percept_geometry::camera::Distortion;
use percept_geometry::sensor::ImuSample;
use percept_geometry::{CameraIntrinsics, Pose, Stamped, Timestamp, se3};

const YAML: &str = "sensor.yaml";
const CSV: &str = "EuRoC";

/// A camera as its `sensor.yaml` describes it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EurocCamera {
    /// Optical frame to body.
    pub t_body_camera: Pose,
    /// Size, pinhole and distortion.
    pub intrinsics: CameraIntrinsics,
}

/// Reads a camera's `sensor.yaml`.
///
/// # Errors
/// `Missing` for a key; `Malformed` with the line; `Unsupported` for another camera than a pinhole, or a distortion that is not
/// known; `Geometry` for a camera that cannot be.
pub fn parse_camera(bytes: &[u8]) -> Result<EurocCamera, FormatError> {
    let t_body_camera = parse_extrinsics(bytes)?;
    let model = required(bytes, "camera_model")?;
    if model.bytes != b"pinhole" {
        return Err(unsupported("camera_model", &model, "pinhole"));
    }
    let resolution = required(bytes, "resolution")?;
    let [width, height] = resolution.numbers::<2>("resolution", "[columns, rows]")?;
    let side = |v: f64| (v.fract() == 0.0 && (1.0..=16384.0).contains(&v)).then_some(v as usize);
    let (Some(width), Some(height)) = (side(width), side(height)) else {
        return Err(resolution.malformed("resolution", "pixels, 1 to 16384"));
    };
    let [fx, fy, cx, cy] = required(bytes, "intrinsics")?.numbers("intrinsics", "[fu, fv, cu, cv]")?;
    let pinhole = CameraIntrinsics::pinhole(width, height, fx, fy, cx, cy);
    let intrinsics = CameraIntrinsics { distortion: distortion(bytes)?, ..pinhole };
    intrinsics.validate()?;
    Ok(EurocCamera { t_body_camera, intrinsics })
}

fn distortion(bytes: &[u8]) -> Result<Distortion, FormatError> {
    let model = required(bytes, "distortion_model")?;
    let (key, coefficients) = ("distortion_coefficients", || required(bytes, "distortion_coefficients"));
    match model.bytes.as_slice() {
        b"none" => Ok(Distortion::None),
        b"radial-tangential" | b"radtan" | b"plumb_bob" => {
            let k = coefficients()?;
            match *k.list(key)?.as_slice() {
                [k1, k2, p1, p2] => Ok(Distortion::PlumbBob([k1, k2, p1, p2, 0.0])),
                [k1, k2, p1, p2, k3] => Ok(Distortion::PlumbBob([k1, k2, p1, p2, k3])),
                [k1, k2, p1, p2, k3, k4, k5, k6] => Ok(Distortion::Rational([k1, k2, p1, p2, k3, k4, k5, k6])),
                _ => Err(k.malformed(key, "[k1, k2, p1, p2], with k3 or k3 to k6 behind them")),
            }
        }
        b"equidistant" => Ok(Distortion::Fisheye(coefficients()?.numbers(key, "[k1, k2, k3, k4]")?)),
        _ => Err(unsupported("distortion_model", &model, "none, radial-tangential or equidistant")),
    }
}

/// Reads where a sensor sits on the body, `T_BS` of any `sensor.yaml`.
///
/// # Errors
/// `Missing` if it is not there; `Malformed` with the line for what is no rigid transform.
pub fn parse_extrinsics(bytes: &[u8]) -> Result<Pose, FormatError> {
    let matrix = value(bytes, &["T_BS", "data"]).ok_or(FormatError::Missing { format: YAML, field: "T_BS: data" })?;
    let numbers = matrix.numbers::<16>("T_BS", "16 numbers, row after row")?;
    if numbers[12..] != [0.0, 0.0, 0.0, 1.0] {
        return Err(matrix.malformed("T_BS", "row after row, the last 0, 0, 0, 1"));
    }
    let pose = se3::pose_from_matrix("T_BS", &Matrix4::from_row_slice(&numbers));
    pose.map_err(|_| matrix.malformed("T_BS", "a rotation and a translation"))
}

fn required<'a>(bytes: &'a [u8], key: &'static str) -> Result<Entry<'a>, FormatError> {
    let found = value(bytes, &[key]).filter(|entry| !entry.bytes.is_empty());
    found.ok_or(FormatError::Missing { format: YAML, field: key })
}

fn unsupported(field: &'static str, entry: &Entry<'_>, supported: &'static str) -> FormatError {
    let value = String::from_utf8_lossy(&entry.bytes).chars().take(40).collect();
    FormatError::Unsupported { format: YAML, field, value, supported }
}

/// What stands behind a key.
struct Entry<'a> {
    line: Line<'a>,
    /// Without spaces around it and comments; a list in full, though it goes over several lines.
    bytes: Vec<u8>,
}

impl Entry<'_> {
    fn malformed(&self, field: &str, expected: &'static str) -> FormatError {
        self.line.malformed(field, &self.bytes, expected)
    }

    /// The numbers of a list.
    fn list(&self, field: &str) -> Result<Vec<f64>, FormatError> {
        let inner = self.bytes.strip_prefix(b"[").and_then(|v| v.strip_suffix(b"]"));
        let inner = inner.ok_or_else(|| self.malformed(field, "a list, [a, b, ...]"))?;
        let number = |token: &[u8]| {
            let token = token.trim_ascii();
            let number = parse::<f64>(token).filter(|v| v.is_finite());
            number.ok_or_else(|| self.line.malformed(field, token, "a finite number"))
        };
        // No list here is longer.
        inner.split(|&b| b == b',').take(17).map(number).collect()
    }

    fn numbers<const N: usize>(&self, field: &str, expected: &'static str) -> Result<[f64; N], FormatError> {
        self.list(field)?.try_into().map_err(|_| self.malformed(field, expected))
    }
}

/// Finds a key, or one that is indented below another.
fn value<'a>(bytes: &'a [u8], path: &[&str]) -> Option<Entry<'a>> {
    let mut lines = Lines::new(YAML, bytes).contents();
    let mut sought = path;
    while let Some(line) = lines.next() {
        let is_below = line.bytes.first().is_some_and(u8::is_ascii_whitespace);
        if is_below != (sought.len() < path.len()) {
            if is_below {
                continue;
            }
            return None;
        }
        let text = without_comment(line.bytes);
        let Some(colon) = text.iter().position(|&b| b == b':') else { continue };
        let (first, rest) = sought.split_first()?;
        if text[..colon].trim_ascii() != first.as_bytes() {
            continue;
        }
        if !rest.is_empty() {
            sought = rest;
            continue;
        }
        let mut value = text[colon + 1..].trim_ascii().to_vec();
        while value.first() == Some(&b'[') && value.last() != Some(&b']') {
            let Some(next) = lines.next() else { break };
            value.extend_from_slice(without_comment(next.bytes).trim_ascii());
        }
        return Some(Entry { line, bytes: value });
    }
    None
}

fn without_comment(bytes: &[u8]) -> &[u8] {
    &bytes[..bytes.iter().position(|&b| b == b'#').unwrap_or(bytes.len())]
}

/// A camera's `data.csv`: rows `stamp,file`. A file is named, without a folder: it lies in `data` beside the list.
///
/// # Errors
/// `Malformed` with the line; `TooLarge` for more rows than `limits.max_points`.
pub fn parse_images(bytes: &[u8], limits: &Limits) -> Result<Vec<Stamped<String>>, FormatError> {
    rising(bytes, limits, |line| {
        let mut cells = Cells::new(line);
        let stamp = cells.stamp()?;
        let file = cells.next("file")?;
        cells.end()?;
        let is_plain = |name: &&str| !name.is_empty() && *name != ".." && !name.contains(['/', '\\', '\0']);
        let name = std::str::from_utf8(file).ok().filter(is_plain);
        let name = name.ok_or_else(|| line.malformed("file", file, "the name of a file in data"))?;
        Ok(Stamped { stamp, value: name.to_owned() })
    })
}

/// An inertial sensor's `data.csv`: rows `stamp,wx,wy,wz,ax,ay,az` (ns, rad/s, m/s^2).
///
/// # Errors
/// `Malformed` with the line; `TooLarge` for more rows than `limits.max_points`.
pub fn parse_imu(bytes: &[u8], limits: &Limits) -> Result<Vec<Stamped<ImuSample>>, FormatError> {
    rising(bytes, limits, |line| {
        let mut cells = Cells::new(line);
        let stamp = cells.stamp()?;
        let mut v = [0.0; 6];
        for (value, name) in v.iter_mut().zip(["w_x", "w_y", "w_z", "a_x", "a_y", "a_z"]) {
            *value = cells.finite(name)?;
        }
        cells.end()?;
        let [wx, wy, wz, ax, ay, az] = v;
        let angular_velocity = Vector3::new(wx, wy, wz);
        let value = ImuSample { angular_velocity, linear_acceleration: Vector3::new(ax, ay, az) };
        let expected = "at most 100 rad/s and 5000 m/s^2 in each axis";
        value.validate().map_err(|_| line.malformed("row", line.bytes, expected))?;
        Ok(Stamped { stamp, value })
    })
}

/// The truth's `data.csv`, as [`trajectory::parse_euroc`] reads it, in order.
///
/// # Errors
/// `Malformed` with the line; `TooLarge` for more rows than `limits.max_points`.
pub fn parse_poses(bytes: &[u8], limits: &Limits) -> Result<Vec<Stamped<Pose>>, FormatError> {
    rising(bytes, limits, trajectory::euroc_row)
}

/// Rows whose stamps rise; counted before memory is taken.
fn rising<'a, T>(
    bytes: &'a [u8],
    limits: &Limits,
    row: impl Fn(&Line<'a>) -> Result<Stamped<T>, FormatError>,
) -> Result<Vec<Stamped<T>>, FormatError> {
    let num_rows = Lines::new(CSV, bytes).contents().count();
    limits.rows(num_rows as u64)?;
    let mut out: Vec<Stamped<T>> = Vec::with_capacity(num_rows);
    for line in Lines::new(CSV, bytes).contents() {
        let row = row(&line)?;
        if out.last().is_some_and(|last| last.stamp >= row.stamp) {
            let found = row.stamp.0.to_string();
            return Err(line.malformed("stamp", found.as_bytes(), "later than that of the row before"));
        }
        out.push(row);
    }
    Ok(out)
}

/// The cells of a row, parted by commas.
pub(crate) struct Cells<'a> {
    line: Line<'a>,
    rest: Option<&'a [u8]>,
}

impl<'a> Cells<'a> {
    pub(crate) fn new(line: &Line<'a>) -> Self {
        Self { line: *line, rest: Some(line.bytes) }
    }

    /// The next cell without spaces around it.
    pub(crate) fn next(&mut self, field: &str) -> Result<&'a [u8], FormatError> {
        let rest = self.rest.ok_or_else(|| self.line.malformed(field, b"end of line", "a value"))?;
        let end = rest.iter().position(|&b| b == b',');
        self.rest = end.map(|end| &rest[end + 1..]);
        Ok(rest[..end.unwrap_or(rest.len())].trim_ascii())
    }

    pub(crate) fn stamp(&mut self) -> Result<Timestamp, FormatError> {
        let token = self.next("stamp")?;
        parse(token).map(Timestamp).ok_or_else(|| self.line.malformed("stamp", token, "nanoseconds"))
    }

    pub(crate) fn finite(&mut self, field: &str) -> Result<f64, FormatError> {
        let token = self.next(field)?;
        let number = parse::<f64>(token).filter(|v| v.is_finite());
        number.ok_or_else(|| self.line.malformed(field, token, "a finite number"))
    }

    /// Nothing may follow.
    fn end(&self) -> Result<(), FormatError> {
        match self.rest {
            None => Ok(()),
            Some(rest) => Err(self.line.malformed("row", rest, "end of line")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// `cam0/sensor.yaml` as the data set has it.
    const CAMERA: &str = "# General sensor definitions.
sensor_type: camera
comment: VI-Sensor cam0 (MT9M034)

# Sensor extrinsics wrt. the body-frame.
T_BS:
  cols: 4
  rows: 4
  data: [0.0148655429818, -0.999880929698, 0.00414029679422, -0.0216401454975,
         0.999557249008, 0.0149672133247, 0.025715529948, -0.064676986768,
        -0.0257744366974, 0.00375618835797, 0.999660727178, 0.00981073058949,
         0.0, 0.0, 0.0, 1.0]

# Camera specific definitions.
rate_hz: 20
resolution: [752, 480]
camera_model: pinhole
intrinsics: [458.654, 457.296, 367.215, 248.375] #fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]
";

    fn with(from: &str, to: &str) -> Result<EurocCamera, FormatError> {
        assert!(CAMERA.contains(from));
        parse_camera(CAMERA.replace(from, to).as_bytes())
    }

    #[test]
    fn a_camera_is_read_as_it_is_published() {
        let EurocCamera { t_body_camera, intrinsics: i } = parse_camera(CAMERA.as_bytes()).unwrap();
        assert_eq!((i.width, i.height, i.fx, i.fy, i.cx, i.cy), (752, 480, 458.654, 457.296, 367.215, 248.375));
        assert_eq!(
            i.distortion,
            Distortion::PlumbBob([-0.283_408_11, 0.073_959_07, 0.000_193_59, 1.761_871_14e-5, 0.0])
        );
        assert_eq!(t_body_camera.translation.vector.as_slice(), [-0.0216401454975, -0.064676986768, 0.00981073058949]);
        // Right in the image is the body's y.
        assert!((t_body_camera.rotation * Vector3::x() - Vector3::y()).norm() < 0.03);
        let windows = CAMERA.replace('\n', "\r\n").replace("T_BS:", "%YAML:1.0\r\nT_BS: !!opencv-matrix");
        assert_eq!(parse_camera(windows.as_bytes()).unwrap().intrinsics, i);
    }

    #[test]
    fn lenses_are_those_of_the_camera_model() {
        let of = |model: &str, k: &str| {
            let text = CAMERA
                .replace("radial-tangential", model)
                .replace("-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05", k);
            parse_camera(text.as_bytes()).map(|c| c.intrinsics.distortion)
        };
        assert_eq!(of("equidistant", "1, 2, 3, 4"), Ok(Distortion::Fisheye([1.0, 2.0, 3.0, 4.0])));
        assert_eq!(of("radtan", "1, 2, 3, 4, 5"), Ok(Distortion::PlumbBob([1.0, 2.0, 3.0, 4.0, 5.0])));
        let rational = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0];
        assert_eq!(of("radial-tangential", "1,2,3,4,5,6,7,8"), Ok(Distortion::Rational(rational)));
        assert_eq!(of("none", ""), Ok(Distortion::None));
        let words = |model, k| of(model, k).unwrap_err().to_string();
        assert_eq!(
            words("fov", "0.9"),
            "sensor.yaml: distortion_model 'fov' is not supported, only none, radial-tangential or equidistant"
        );
        assert!(words("radtan", "1, 2, 3").starts_with("sensor.yaml, line 20: distortion_coefficients is '[1, 2, 3]'"));
        assert!(words("equidistant", "1, 2, 3, nan").contains("is 'nan', expected a finite number"));
    }

    #[test]
    fn what_a_camera_lacks_is_named() {
        let words = |from: &str, to: &str| with(from, to).unwrap_err().to_string();
        assert_eq!(words("T_BS:", "T_SB:"), "sensor.yaml: T_BS: data is missing");
        assert_eq!(words("resolution", "size"), "sensor.yaml: resolution is missing");
        assert_eq!(
            words("[752, 480]", "[752.5, 480]"),
            "sensor.yaml, line 16: resolution is '[752.5, 480]', expected pixels, 1 to 16384"
        );
        assert!(words("[752, 480]", "[4000000000, 4000000000]").contains("expected pixels, 1 to 16384"));
        assert!(words("[752, 480]", "[752]").contains("expected [columns, rows]"));
        assert!(words("[752, 480]", "752").contains("expected a list"));
        assert!(words("458.654", "-458.654").contains("fx"));
        assert_eq!(words("pinhole", "omni"), "sensor.yaml: camera_model 'omni' is not supported, only pinhole");
        assert!(words("0.0, 0.0, 0.0, 1.0]", "0.0, 0.0, 0.0, 1.0").contains("line 9: T_BS is"), "it is closed nowhere");
        assert!(words("0.0, 0.0, 0.0, 1.0]", "0.0, 0.0, 1.0]").contains("16 numbers"));
        assert!(words("0.0, 0.0, 0.0, 1.0]", "1.0, 0.0, 0.0, 1.0]").contains("the last 0, 0, 0, 1"));
        assert!(words("[0.0148655429818,", "[7,").contains("a rotation and a translation"));
    }

    #[test]
    fn rows_are_complete_finite_and_in_order() {
        let limits = Limits::default();
        let images = parse_images(
            b"#timestamp [ns],filename\r\n1403636579763555584, a.png\r\n1403636579813555456,b.png\r\n",
            &limits,
        );
        let images = images.unwrap();
        assert_eq!((images[0].stamp, images[1].value.as_str()), (Timestamp(1_403_636_579_763_555_584), "b.png"));
        let refused = |text: &[u8]| parse_images(text, &limits).unwrap_err().to_string();
        assert_eq!(
            refused(b"1,a\n3,b\n2,c\n"),
            "EuRoC, line 3: stamp is '2', expected later than that of the row before"
        );
        assert_eq!(refused(b"1,a\n2\n"), "EuRoC, line 2: file is 'end of line', expected a value");
        assert_eq!(refused(b"1,a,b\n"), "EuRoC, line 1: row is 'b', expected end of line");
        for name in ["../a.png", "/etc/passwd", "..", "", "a\\b"] {
            assert!(refused(format!("1,{name}\n").as_bytes()).contains("the name of a file in data"), "{name}");
        }

        let imu = parse_imu(b"# ns\n5,-0.1,0.2,0.3,9.8,0.1,-0.2\n6,0,0,0,0,0,0\n", &limits).unwrap();
        assert_eq!(imu[0].value.angular_velocity, Vector3::new(-0.1, 0.2, 0.3));
        assert_eq!((imu[0].value.linear_acceleration, imu.len()), (Vector3::new(9.8, 0.1, -0.2), 2));
        let refused = |text: &[u8]| parse_imu(text, &limits).unwrap_err().to_string();
        assert_eq!(refused(b"5,0,0,0,0,0\n"), "EuRoC, line 1: a_z is 'end of line', expected a value");
        assert_eq!(refused(b"5,0,nan,0,0,0,0\n"), "EuRoC, line 1: w_y is 'nan', expected a finite number");
        assert_eq!(refused(b"5,0,0,0,0,0,0,7\n"), "EuRoC, line 1: row is '7', expected end of line");
        assert!(refused(b"5,0,0,0,0,0,0\n5,0,0,0,0,0,0\n").contains("line 2: stamp is '5'"));
        assert!(refused(b"5,0,0,200,0,0,0\n").contains("at most 100 rad/s"));
        assert!(refused(b"99999999999999999999,0,0,0,0,0,0\n").contains("expected nanoseconds"));

        let poses = parse_poses(b"1,0,0,0,1,0,0,0,9\n2,1,0,0,1,0,0,0\n", &limits).unwrap();
        assert_eq!((poses.len(), poses[1].value), (2, Pose::translation(1.0, 0.0, 0.0)));
        assert!(parse_poses(b"1,0,0,0,1,0,0,0,9\n0,1,0,0,1,0,0,0\n", &limits).is_err());
        let tight = Limits { max_points: 1, ..limits };
        let error = parse_images(b"1,a\n2,b\n", &tight).unwrap_err();
        assert_eq!(error.to_string(), "num_rows: 2 exceeds the limit of 1");
        assert!(parse_images(b"1,a\n", &tight).is_ok());
    }

    proptest! {
        #[test]
        fn damaged_descriptions_never_panic(hits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..9)) {
            let mut bytes = CAMERA.as_bytes().to_vec();
            for (at, value) in hits {
                let at = at.index(bytes.len());
                bytes[at] = value;
            }
            let _ = parse_camera(&bytes);
        }

        #[test]
        fn damaged_text_never_panics(text in "([0-9 ,.:#e\\[\\]\n-]|nan|T_BS:|data:){0,200}") {
            let (bytes, limits) = (text.as_bytes(), Limits::default());
            let _ = (parse_camera(bytes), parse_extrinsics(bytes), parse_images(bytes, &limits));
            let _ = (parse_imu(bytes, &limits), parse_poses(bytes, &limits));
        }

        #[test]
        fn samples_read_back(rows in prop::collection::vec((1..1_000_000i64, prop::array::uniform6(-99.0..99.0f64)), 0..20)) {
            let (mut stamp, mut text) = (0, String::from("#timestamp [ns],w,w,w,a,a,a\n"));
            for (step, v) in &rows {
                stamp += step;
                let cells: Vec<String> = v.iter().map(ToString::to_string).collect();
                text += &format!("{stamp},{}\n", cells.join(","));
            }
            let samples = parse_imu(text.as_bytes(), &Limits::default()).unwrap();
            prop_assert_eq!(samples.len(), rows.len());
            for (sample, (_, v)) in samples.iter().zip(&rows) {
                prop_assert_eq!(sample.value.angular_velocity.as_slice(), &v[..3]);
                prop_assert_eq!(sample.value.linear_acceleration.as_slice(), &v[3..]);
            }
        }
    }
}
