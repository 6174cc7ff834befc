//! Sensor declarations and messages: decoded, with sizes checked before memory is taken.

use super::{geometry, required};
use crate::v1;
use bytes::Bytes;
use percept_formats::images;
use percept_geometry::sensor::{ImuSample, OdometrySample};
use percept_geometry::{
    CameraIntrinsics, DepthImage, Distortion, LaserScan, RgbImage, SensorData, SensorFrame, SensorId, SensorKind,
    SensorSpec, Timestamp,
};
use percept_service::reason;
use percept_service::{Error, IncomingFrame, Limits, OverloadPolicy, Result, SensorDeclaration};

/// A sensor kind that is not UNSPECIFIED.
///
/// # Errors
/// `ENUM_UNKNOWN`.
pub fn kind(value: i32) -> Result<SensorKind> {
    use v1::SensorKind as K;
    Ok(match K::try_from(value) {
        Ok(K::Depth) => SensorKind::Depth,
        Ok(K::Rgbd) => SensorKind::Rgbd,
        Ok(K::Camera) => SensorKind::Camera,
        Ok(K::Lidar3d) => SensorKind::Lidar3d,
        Ok(K::Lidar2d) => SensorKind::Lidar2d,
        Ok(K::Imu) => SensorKind::Imu,
        Ok(K::Odometry) => SensorKind::Odometry,
        _ => return Err(super::unknown_enum("kind", value)),
    })
}

/// A sensor kind as a message.
pub fn kind_to(kind: SensorKind) -> v1::SensorKind {
    match kind {
        SensorKind::Depth => v1::SensorKind::Depth,
        SensorKind::Rgbd => v1::SensorKind::Rgbd,
        SensorKind::Camera => v1::SensorKind::Camera,
        SensorKind::Lidar3d => v1::SensorKind::Lidar3d,
        SensorKind::Lidar2d => v1::SensorKind::Lidar2d,
        SensorKind::Imu => v1::SensorKind::Imu,
        SensorKind::Odometry => v1::SensorKind::Odometry,
    }
}

/// Intrinsics, checked.
///
/// # Errors
/// `OUT_OF_RANGE`, `SIZE_MISMATCH` for a wrong number of coefficients.
pub fn intrinsics(c: &v1::CameraIntrinsics) -> Result<CameraIntrinsics> {
    use v1::DistortionModel as M;
    let k = &c.distortion;
    let mismatch =
        |expected| percept_geometry::GeometryError::ShapeMismatch { field: "distortion", expected, actual: k.len() };
    let distortion = match M::try_from(c.distortion_model) {
        Ok(M::Unspecified) if k.is_empty() => Distortion::None,
        Ok(M::Unspecified) => return Err(mismatch(0).into()),
        Ok(M::PlumbBob) => Distortion::PlumbBob(k.as_slice().try_into().map_err(|_| mismatch(5))?),
        Ok(M::Rational) => Distortion::Rational(k.as_slice().try_into().map_err(|_| mismatch(8))?),
        Ok(M::Fisheye) => Distortion::Fisheye(k.as_slice().try_into().map_err(|_| mismatch(4))?),
        Err(_) => return Err(super::unknown_enum("distortion_model", c.distortion_model)),
    };
    let out = CameraIntrinsics {
        width: c.width_px as usize,
        height: c.height_px as usize,
        fx: c.fx_px,
        fy: c.fy_px,
        cx: c.cx_px,
        cy: c.cy_px,
        distortion,
    };
    out.validate()?;
    Ok(out)
}

/// Intrinsics as a message.
pub fn intrinsics_to(c: &CameraIntrinsics) -> v1::CameraIntrinsics {
    use v1::DistortionModel as M;
    let (model, distortion) = match c.distortion {
        Distortion::None => (M::Unspecified, vec![]),
        Distortion::PlumbBob(k) => (M::PlumbBob, k.to_vec()),
        Distortion::Rational(k) => (M::Rational, k.to_vec()),
        Distortion::Fisheye(k) => (M::Fisheye, k.to_vec()),
    };
    v1::CameraIntrinsics {
        width_px: c.width as u32,
        height_px: c.height as u32,
        fx_px: c.fx,
        fy_px: c.fy,
        cx_px: c.cx,
        cy_px: c.cy,
        distortion_model: model.into(),
        distortion,
    }
}

/// A sensor's declaration, checked.
///
/// # Errors
/// Naming the field.
pub fn declaration(s: &v1::SensorSpec) -> Result<SensorDeclaration> {
    percept_service::check_id("sensor_id", &s.sensor_id)?;
    let spec = SensorSpec {
        id: SensorId(s.sensor_id.clone()),
        kind: kind(s.kind)?,
        t_base_sensor: geometry::pose("t_base_sensor", s.t_base_sensor.as_ref())?,
        intrinsics: s.intrinsics.as_ref().map(intrinsics).transpose().map_err(|e| e.within("intrinsics"))?,
        time_offset_s: s.time_offset_s,
        range_max_m: s.range_max_m,
    };
    if matches!(spec.kind, SensorKind::Depth | SensorKind::Rgbd | SensorKind::Camera) {
        required("intrinsics", spec.intrinsics.as_ref())?;
    }
    spec.validate()?;
    Ok(SensorDeclaration { spec, overload: overload(s.overload_policy)? })
}

/// What happens to frames that come too fast.
///
/// # Errors
/// `ENUM_UNKNOWN`.
pub fn overload(value: i32) -> Result<OverloadPolicy> {
    match v1::OverloadPolicy::try_from(value) {
        Ok(v1::OverloadPolicy::Block) => Ok(OverloadPolicy::Block),
        Ok(_) => Ok(OverloadPolicy::DropOldest),
        Err(_) => Err(super::unknown_enum("overload_policy", value)),
    }
}

/// A sensor's declaration as a message.
pub fn declaration_to(d: &SensorDeclaration) -> v1::SensorSpec {
    v1::SensorSpec {
        sensor_id: d.spec.id.0.clone(),
        kind: kind_to(d.spec.kind).into(),
        t_base_sensor: Some(geometry::pose_to(&d.spec.t_base_sensor)),
        intrinsics: d.spec.intrinsics.as_ref().map(intrinsics_to),
        time_offset_s: d.spec.time_offset_s,
        range_max_m: d.spec.range_max_m,
        overload_policy: match d.overload {
            OverloadPolicy::Block => v1::OverloadPolicy::Block,
            OverloadPolicy::DropOldest => v1::OverloadPolicy::DropOldest,
        }
        .into(),
    }
}

/// A sensor message, decoded and checked.
///
/// # Errors
/// Naming field, value and remedy; nothing was changed.
pub fn frame(message: &v1::SensorMessage, limits: &Limits) -> Result<IncomingFrame> {
    use v1::sensor_message::Data;
    percept_service::check_id("session_id", &message.session_id)?;
    percept_service::check_id("sensor_id", &message.sensor_id)?;
    if message.stamp_ns < 0 {
        return Err(Error::invalid(
            reason::STAMP_NEGATIVE,
            "stamp_ns",
            format!("stamp_ns is {}; send nanoseconds since the Unix epoch", message.stamp_ns),
        ));
    }
    let data = match required("data", message.data.as_ref())? {
        Data::Depth(d) => SensorData::Depth(depth(d, limits).map_err(|e| e.within("depth"))?),
        Data::Rgbd(d) => rgbd(d, limits).map_err(|e| e.within("rgbd"))?,
        Data::Colour(c) => SensorData::Camera(color(c, limits).map_err(|e| e.within("colour"))?),
        Data::Cloud(c) => SensorData::Cloud(geometry::cloud(c, limits).map_err(|e| e.within("cloud"))?),
        Data::Scan(s) => SensorData::Scan(scan(s, limits).map_err(|e| e.within("scan"))?),
        Data::Imu(i) => SensorData::Imu(imu(i).map_err(|e| e.within("imu"))?),
        Data::Odometry(o) => SensorData::Odometry(odometry(o).map_err(|e| e.within("odometry"))?),
    };
    Ok(IncomingFrame {
        session: message.session_id.clone(),
        sequence: message.sequence,
        frame: SensorFrame { sensor: SensorId(message.sensor_id.clone()), stamp: Timestamp(message.stamp_ns), data },
    })
}

fn rgbd(d: &v1::RgbdImage, limits: &Limits) -> Result<SensorData> {
    let depth = depth(&required("depth", d.depth.clone())?, limits).map_err(|e| e.within("depth"))?;
    let color = color(&required("colour", d.colour.clone())?, limits).map_err(|e| e.within("colour"))?;
    if (depth.width(), depth.height()) != (color.width(), color.height()) {
        return Err(Error::invalid(
            reason::COLOUR_SIZE_MISMATCH,
            "colour",
            format!(
                "colour is {}x{} but depth is {}x{}; register them to one size",
                color.width(),
                color.height(),
                depth.width(),
                depth.height()
            ),
        ));
    }
    Ok(SensorData::Rgbd(depth, color))
}

/// Checks the declared size: not empty, no overflow, within the limit. Returns width, height.
fn image_size(width: u32, height: u32, limits: &Limits) -> Result<(usize, usize)> {
    let (w, h) = (width as usize, height as usize);
    let pixels = w.checked_mul(h).filter(|&n| n > 0).ok_or_else(|| {
        Error::invalid(
            reason::IMAGE_EMPTY,
            "width_px",
            format!("image is {width}x{height}; both sizes must be positive"),
        )
    })?;
    if pixels > limits.max_image_pixels {
        let limit = limits.max_image_pixels;
        return Err(Error::exhausted(
            reason::IMAGE_TOO_LARGE,
            "width_px",
            format!("image of {width}x{height} has {pixels} pixels, the limit is {limit}; send it smaller"),
        ));
    }
    Ok((w, h))
}

/// The packed rows of an image whose rows may be padded.
fn rows(data: &Bytes, row_bytes: usize, height: usize, stride: Option<u32>) -> Result<Bytes> {
    let stride = stride.map_or(row_bytes, |s| s as usize);
    if stride < row_bytes {
        return Err(Error::invalid(
            reason::STRIDE_TOO_SMALL,
            "row_stride_bytes",
            format!("row_stride_bytes is {stride} but a row holds {row_bytes} bytes; send at least that"),
        ));
    }
    // The last row may come without its padding.
    let shortest = stride.checked_mul(height - 1).and_then(|n| n.checked_add(row_bytes));
    let longest = stride.checked_mul(height);
    if shortest.is_none_or(|n| data.len() < n) || longest.is_none_or(|n| data.len() > n) {
        return Err(Error::invalid(
            reason::SIZE_MISMATCH,
            "data",
            format!(
                "data holds {} bytes but {height} rows of {stride} bytes were declared; send exactly that many",
                data.len()
            ),
        ));
    }
    if stride == row_bytes {
        return Ok(data.clone());
    }
    let mut out = Vec::with_capacity(row_bytes * height);
    for row in 0..height {
        out.extend_from_slice(&data[row * stride..row * stride + row_bytes]);
    }
    Ok(out.into())
}

fn decoded_size(decoded: (usize, usize), declared: (usize, usize)) -> Result<()> {
    if decoded == declared {
        return Ok(());
    }
    Err(Error::invalid(
        reason::IMAGE_SIZE_MISMATCH,
        "width_px",
        format!(
            "the file is {}x{} but {}x{} was declared; declare its true size",
            decoded.0, decoded.1, declared.0, declared.1
        ),
    ))
}

/// A depth image.
///
/// # Errors
/// Sizes that lie, a missing or unusable scale, files that do not decode.
pub fn depth(d: &v1::DepthImage, limits: &Limits) -> Result<DepthImage> {
    use v1::DepthEncoding as E;
    let (w, h) = image_size(d.width_px, d.height_px, limits)?;
    let scale = || required("metres_per_unit", d.metres_per_unit);
    match E::try_from(d.encoding) {
        Ok(E::U16) => {
            let data = rows(&d.data, w * 2, h, d.row_stride_bytes)?;
            let units: Vec<u16> = data.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]])).collect();
            Ok(DepthImage::from_u16(w, h, &units, scale()?)?)
        }
        Ok(E::F32) => {
            let data = rows(&d.data, w * 4, h, d.row_stride_bytes)?;
            let metres = data.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
            Ok(DepthImage::new(w, h, metres)?)
        }
        Ok(E::Png16) => {
            let image = images::decode_depth_png(&d.data, scale()?, &super::format_limits(limits))
                .map_err(super::format_error)?;
            decoded_size((image.width(), image.height()), (w, h))?;
            Ok(image)
        }
        _ => Err(super::unknown_enum("encoding", d.encoding)),
    }
}

/// A colour image.
///
/// # Errors
/// Sizes that lie, files that do not decode.
pub fn color(c: &v1::ColourImage, limits: &Limits) -> Result<RgbImage> {
    use v1::ColourEncoding as E;
    let (w, h) = image_size(c.width_px, c.height_px, limits)?;
    match E::try_from(c.encoding) {
        Ok(E::Rgb8) => Ok(RgbImage::new(w, h, rows(&c.data, w * 3, h, c.row_stride_bytes)?.to_vec())?),
        Ok(E::Grey8) => {
            let gray = rows(&c.data, w, h, c.row_stride_bytes)?;
            Ok(RgbImage::new(w, h, gray.iter().flat_map(|&g| [g; 3]).collect())?)
        }
        Ok(E::Jpeg | E::Png) => {
            let image = images::decode_color(&c.data, &super::format_limits(limits)).map_err(super::format_error)?;
            decoded_size((image.width(), image.height()), (w, h))?;
            Ok(image)
        }
        _ => Err(super::unknown_enum("encoding", c.encoding)),
    }
}

fn scan(s: &v1::LaserScan, limits: &Limits) -> Result<LaserScan> {
    let beams = s.ranges_m.len() / 4;
    if beams == 0 || !s.ranges_m.len().is_multiple_of(4) {
        return Err(Error::invalid(
            reason::SCAN_EMPTY,
            "ranges_m",
            format!("ranges_m holds {} bytes; send one float32 a beam, at least one", s.ranges_m.len()),
        ));
    }
    if beams > limits.max_cloud_points {
        let limit = limits.max_cloud_points;
        return Err(Error::exhausted(
            reason::SCAN_TOO_LARGE,
            "ranges_m",
            format!("{beams} beams, the limit is {limit}"),
        ));
    }
    let numbers = [
        ("angle_min_rad", s.angle_min_rad),
        ("angle_increment_rad", s.angle_increment_rad),
        ("range_min_m", s.range_min_m),
        ("range_max_m", s.range_max_m),
        ("time_increment_s", s.time_increment_s),
    ];
    let out_of = |field, value, requirement| percept_geometry::GeometryError::OutOfRange { field, value, requirement };
    if let Some((field, value)) = numbers.into_iter().find(|(_, v)| !v.is_finite()) {
        return Err(out_of(field, value, "finite").into());
    }
    if s.angle_increment_rad == 0.0 && beams > 1 {
        return Err(out_of("angle_increment_rad", 0.0, "other than 0").into());
    }
    if s.range_max_m <= s.range_min_m || s.range_min_m < 0.0 {
        return Err(out_of("range_max_m", s.range_max_m, "greater than range_min_m, which is not negative").into());
    }
    let values =
        |data: &Bytes| data.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect::<Vec<_>>();
    let intensities = match &s.intensities {
        Some(d) if d.len() != beams * 4 => {
            let actual = d.len() / 4;
            let mismatch =
                percept_geometry::GeometryError::ShapeMismatch { field: "intensities", expected: beams, actual };
            return Err(mismatch.into());
        }
        other => other.as_ref().map(values),
    };
    let later = s.later_echoes_m.as_ref().map_or(&[][..], |d| d);
    if !later.len().is_multiple_of(beams * 4) {
        let (expected, actual) = (beams, later.len() / 4);
        return Err(percept_geometry::GeometryError::ShapeMismatch { field: "later_echoes_m", expected, actual }.into());
    }
    if later.len() / 4 > limits.max_cloud_points {
        let (echoes, limit) = (later.len() / 4, limits.max_cloud_points);
        let message = format!("later_echoes_m has {echoes} echoes, the limit is {limit}");
        return Err(Error::exhausted(reason::SCAN_TOO_LARGE, "later_echoes_m", message));
    }
    Ok(LaserScan {
        angle_min_rad: s.angle_min_rad,
        angle_increment_rad: s.angle_increment_rad,
        range_min_m: s.range_min_m,
        range_max_m: s.range_max_m,
        time_increment_s: s.time_increment_s,
        ranges_m: values(&s.ranges_m),
        intensities,
        later_echoes_m: s.later_echoes_m.as_ref().map(values).unwrap_or_default(),
    })
}

fn imu(i: &v1::ImuSample) -> Result<ImuSample> {
    Ok(ImuSample {
        angular_velocity: geometry::vector(
            "angular_velocity_radps",
            &required("angular_velocity_radps", i.angular_velocity_radps)?,
        )?,
        linear_acceleration: geometry::vector(
            "linear_acceleration_mps2",
            &required("linear_acceleration_mps2", i.linear_acceleration_mps2)?,
        )?,
    })
}

fn odometry(o: &v1::OdometrySample) -> Result<OdometrySample> {
    required("t_odom_base", o.t_odom_base.as_ref())?;
    Ok(OdometrySample {
        t_odom_base: geometry::pose("t_odom_base", o.t_odom_base.as_ref())?,
        covariance: o.covariance.as_ref().map(|c| geometry::covariance("covariance", c)).transpose()?,
    })
}

/// A frame as a message; depth travels as float32 metres, so that nothing is lost.
pub fn frame_to(session: &str, sequence: u64, frame: &SensorFrame) -> v1::SensorMessage {
    use v1::sensor_message::Data;
    let floats = |values: &[f32]| -> Bytes { values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>().into() };
    let depth = |d: &DepthImage| v1::DepthImage {
        width_px: d.width() as u32,
        height_px: d.height() as u32,
        encoding: v1::DepthEncoding::F32.into(),
        metres_per_unit: None,
        row_stride_bytes: None,
        data: floats(d.data()),
    };
    let color = |c: &RgbImage| v1::ColourImage {
        width_px: c.width() as u32,
        height_px: c.height() as u32,
        encoding: v1::ColourEncoding::Rgb8.into(),
        row_stride_bytes: None,
        data: c.data().to_vec().into(),
    };
    let data = match &frame.data {
        SensorData::Depth(d) => Data::Depth(depth(d)),
        SensorData::Rgbd(d, c) => Data::Rgbd(v1::RgbdImage { depth: Some(depth(d)), colour: Some(color(c)) }),
        SensorData::Camera(c) => Data::Colour(color(c)),
        SensorData::Cloud(c) => Data::Cloud(geometry::cloud_to(c)),
        SensorData::Scan(s) => Data::Scan(v1::LaserScan {
            angle_min_rad: s.angle_min_rad,
            angle_increment_rad: s.angle_increment_rad,
            range_min_m: s.range_min_m,
            range_max_m: s.range_max_m,
            time_increment_s: s.time_increment_s,
            ranges_m: floats(&s.ranges_m),
            intensities: s.intensities.as_deref().map(floats),
            later_echoes_m: (!s.later_echoes_m.is_empty()).then(|| floats(&s.later_echoes_m)),
        }),
        SensorData::Imu(i) => Data::Imu(v1::ImuSample {
            angular_velocity_radps: Some(geometry::vector_to(&i.angular_velocity)),
            linear_acceleration_mps2: Some(geometry::vector_to(&i.linear_acceleration)),
        }),
        SensorData::Odometry(o) => Data::Odometry(v1::OdometrySample {
            t_odom_base: Some(geometry::pose_to(&o.t_odom_base)),
            covariance: o.covariance.as_ref().map(geometry::covariance_to),
        }),
    };
    v1::SensorMessage {
        session_id: session.to_owned(),
        sensor_id: frame.sensor.0.clone(),
        sequence,
        stamp_ns: frame.stamp.nanos(),
        data: Some(data),
    }
}
