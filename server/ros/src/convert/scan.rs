//! Planar scans.

use super::ConvertError;
use crate::Message;
use crate::messages::LaserScan;
use percept_geometry::{GeometryError, LaserScan as Scan};

const MESSAGE: &str = LaserScan::TYPE_NAME;

/// The scan of a message, in the frame of its header; ranges stay as REP-117 has them, which is as [`Scan`] has them. Where
/// the greatest range is infinite or 0 nobody knows how far the sensor sees: what it measured counts, and a beam that
/// measured nothing tells nothing.
///
/// # Errors
/// `Geometry` for angles, times or limits that are not finite, a greatest range that is negative, and intensities that are
/// not one a beam.
pub fn scan(message: &LaserScan<'_>) -> Result<Scan, ConvertError> {
    let fail = ConvertError::geometry(MESSAGE);
    let finite = [
        ("angle_min", message.angle_min),
        ("angle_increment", message.angle_increment),
        ("time_increment", message.time_increment),
        ("range_min", message.range_min),
    ];
    if let Some(&(field, value)) = finite.iter().find(|(_, v)| !v.is_finite()) {
        return Err(fail(GeometryError::OutOfRange { field, value: value.into(), requirement: "finite" }));
    }
    if message.range_max < 0.0 || message.range_max.is_nan() {
        let (field, value) = ("range_max", message.range_max.into());
        return Err(fail(GeometryError::OutOfRange { field, value, requirement: "positive; send metres" }));
    }
    let (mut range_max, mut ranges) = (message.range_max, message.ranges.clone());
    if range_max == 0.0 || range_max.is_infinite() {
        let measured = ranges.iter().copied().filter(|r| r.is_finite());
        // What is at the limit counts as free. A scan in which nothing was measured has to have one all the same.
        range_max = measured.fold(message.range_min.max(1.0), f32::max).next_up();
        ranges.iter_mut().filter(|r| r.is_infinite()).for_each(|r| *r = f32::NAN);
    }
    let (expected, actual) = (message.ranges.len(), message.intensities.len());
    if actual != 0 && actual != expected {
        return Err(fail(GeometryError::ShapeMismatch { field: "intensities", expected, actual }));
    }
    Ok(Scan {
        angle_min_rad: message.angle_min.into(),
        angle_increment_rad: message.angle_increment.into(),
        range_min_m: message.range_min.into(),
        range_max_m: range_max.into(),
        time_increment_s: message.time_increment.into(),
        ranges_m: ranges,
        intensities: (actual > 0).then(|| message.intensities.clone()),
        later_echoes_m: vec![],
    })
}
