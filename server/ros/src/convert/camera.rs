//! Calibration of cameras.

use super::ConvertError;
use crate::Message;
use crate::messages::CameraInfo;
use percept_geometry::{CameraIntrinsics, Distortion};

const MESSAGE: &str = CameraInfo::TYPE_NAME;

/// Intrinsics of the raw image, with its distortion (K and D); what binning and region leave of the full image.
///
/// # Errors
/// `Missing` if the camera is not calibrated (K is zero), `Invalid` for a model that is not known or has another number of
/// coefficients, `Geometry` for values that are not usable.
pub fn intrinsics(info: &CameraInfo<'_>) -> Result<CameraIntrinsics, ConvertError> {
    let [fx, _, cx, _, fy, cy, ..] = info.k;
    made(info, [fx, fy, cx, cy], distortion(info)?)
}

/// Intrinsics of the rectified image (P), which has no distortion.
///
/// # Errors
/// As [`intrinsics`].
pub fn rectified_intrinsics(info: &CameraInfo<'_>) -> Result<CameraIntrinsics, ConvertError> {
    let [fx, _, cx, _, _, fy, cy, ..] = info.p;
    made(info, [fx, fy, cx, cy], Distortion::None)
}

fn made(info: &CameraInfo<'_>, full: [f64; 4], distortion: Distortion) -> Result<CameraIntrinsics, ConvertError> {
    if full == [0.0; 4] {
        let remedy = "calibrate the camera, or declare its intrinsics";
        return Err(ConvertError::Missing { message: MESSAGE, field: "k, p", remedy });
    }
    let [fx, fy, cx, cy] = full;
    let roi = info.roi;
    let side = |part: u32, whole: u32| if part == 0 { whole } else { part };
    let (bin_x, bin_y) = (info.binning_x.max(1), info.binning_y.max(1));
    let (x, y) = (f64::from(bin_x), f64::from(bin_y));
    let intrinsics = CameraIntrinsics {
        width: (side(roi.width, info.width) / bin_x) as usize,
        height: (side(roi.height, info.height) / bin_y) as usize,
        fx: fx / x,
        fy: fy / y,
        // As image_geometry's PinholeCameraModel has it.
        cx: (cx - f64::from(roi.x_offset)) / x,
        cy: (cy - f64::from(roi.y_offset)) / y,
        distortion,
    };
    intrinsics.validate().map_err(ConvertError::geometry(MESSAGE))?;
    Ok(intrinsics)
}

fn distortion(info: &CameraInfo<'_>) -> Result<Distortion, ConvertError> {
    if info.d.iter().all(|&c| c == 0.0) {
        return Ok(Distortion::None);
    }
    let wrong = |expected| {
        let found = format!("{} with {} coefficients", info.distortion_model, info.d.len());
        Err(ConvertError::invalid(MESSAGE, "distortion_model, d", found, expected))
    };
    match (info.distortion_model, &info.d[..]) {
        ("plumb_bob" | "", &[k1, k2, p1, p2]) => Ok(Distortion::PlumbBob([k1, k2, p1, p2, 0.0])),
        ("plumb_bob" | "", &[k1, k2, p1, p2, k3]) => Ok(Distortion::PlumbBob([k1, k2, p1, p2, k3])),
        // What OpenCV appends for thin prisms and tilted sensors has to be zero.
        ("rational_polynomial" | "plumb_bob", &[k1, k2, p1, p2, k3, k4, k5, k6, ref rest @ ..])
            if rest.iter().all(|&c| c == 0.0) =>
        {
            Ok(Distortion::Rational([k1, k2, p1, p2, k3, k4, k5, k6]))
        }
        ("rational_polynomial", &[k1, k2, p1, p2, k3]) => Ok(Distortion::PlumbBob([k1, k2, p1, p2, k3])),
        ("equidistant" | "fisheye", &[k1, k2, k3, k4]) => Ok(Distortion::Fisheye([k1, k2, k3, k4])),
        ("plumb_bob" | "", _) => wrong("4 or 5"),
        ("rational_polynomial", _) => wrong("8, those behind them zero"),
        ("equidistant" | "fisheye", _) => wrong("4"),
        _ => wrong("plumb_bob, rational_polynomial or equidistant"),
    }
}
