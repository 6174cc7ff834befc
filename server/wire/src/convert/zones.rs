//! Zones of questions and of sessions, and masks.

use super::{geometry, required};
use crate::v1;
use nalgebra::Point2;
use percept_planning::{Zone, ZoneKind};
use percept_service::{Error, MaskMeaning, Result, SessionMask, SessionZone, SpeedUnit, reason};

/// Zones of a request, corners of a zone.
const MAX_ZONES: usize = 1000;
const MAX_ZONE_CORNERS: usize = 1000;

/// Zones of a question.
///
/// # Errors
/// Naming the field below `options`.
pub(super) fn zones(asked: &[v1::Zone]) -> Result<Vec<Zone>> {
    if asked.len() > MAX_ZONES {
        let message = format!("there are {} zones, at most {MAX_ZONES} are allowed; merge some", asked.len());
        return Err(Error::invalid(reason::OUT_OF_RANGE, "options.zones", message));
    }
    let numbered = |(i, z)| zone(z).map_err(|e| e.within(&format!("options.zones[{i}]")));
    asked.iter().enumerate().map(numbered).collect()
}

/// Corners of an area, at most so many.
///
/// # Errors
/// `OUT_OF_RANGE`.
pub(super) fn corners(field: &'static str, points: &[v1::Vector2], most: usize) -> Result<Vec<Point2<f64>>> {
    if points.len() > most {
        let message = format!("{field} has {} corners, at most {most} are allowed; simplify it", points.len());
        return Err(Error::invalid(reason::OUT_OF_RANGE, field, message));
    }
    points.iter().map(|p| geometry::point2(field, p)).collect()
}

/// An area of the map.
///
/// # Errors
/// `FIELD_MISSING`, `OUT_OF_RANGE`.
pub(super) fn zone(zone: &v1::Zone) -> Result<Zone> {
    let polygon = corners("polygon", &zone.polygon, MAX_ZONE_CORNERS)?;
    let kind = match required("kind", zone.kind)? {
        v1::zone::Kind::KeepOut(true) => ZoneKind::KeepOut,
        v1::zone::Kind::KeepOut(false) => {
            let message = "keep_out is false; set it, or give a speed_share";
            return Err(Error::invalid(reason::OUT_OF_RANGE, "keep_out", message));
        }
        v1::zone::Kind::SpeedShare(share) => ZoneKind::SpeedLimit { share },
    };
    Ok(Zone { polygon, kind })
}

/// A zone of a session as a message.
pub(super) fn zone_to(z: &SessionZone) -> v1::Zone {
    let kind = match z.zone.kind {
        ZoneKind::KeepOut => v1::zone::Kind::KeepOut(true),
        ZoneKind::SpeedLimit { share } => v1::zone::Kind::SpeedShare(share),
    };
    let polygon = z.zone.polygon.iter().map(|p| v1::Vector2 { x: p.x, y: p.y }).collect();
    v1::Zone { polygon, kind: Some(kind), name: z.name.clone() }
}

/// What the values of a mask mean, if that is said.
///
/// # Errors
/// `OUT_OF_RANGE`, `ENUM_UNKNOWN`.
pub(super) fn mask_meaning(kind: Option<&v1::zone_mask::Kind>) -> Result<Option<MaskMeaning>> {
    match kind {
        None => Ok(None),
        Some(v1::zone_mask::Kind::KeepOut(true)) => Ok(Some(MaskMeaning::KeepOut)),
        Some(v1::zone_mask::Kind::KeepOut(false)) => {
            let message = "keep_out is false; set it, or give speed";
            Err(Error::invalid(reason::OUT_OF_RANGE, "keep_out", message))
        }
        Some(v1::zone_mask::Kind::Speed(speed)) => {
            let unit = match v1::SpeedUnit::try_from(speed.unit) {
                Ok(v1::SpeedUnit::Unspecified | v1::SpeedUnit::Percent) => SpeedUnit::Percent,
                Ok(v1::SpeedUnit::MetresPerSecond) => SpeedUnit::MetresPerSecond,
                Err(_) => return Err(super::unknown_enum("speed.unit", speed.unit)),
            };
            Ok(Some(MaskMeaning::Speed { base: speed.base, multiplier: speed.multiplier.unwrap_or(1.0), unit }))
        }
    }
}

/// A mask of a session as a message, without its cells.
pub(super) fn mask_to(mask: &SessionMask) -> v1::ZoneMask {
    let kind = match mask.meaning {
        MaskMeaning::KeepOut => v1::zone_mask::Kind::KeepOut(true),
        MaskMeaning::Speed { base, multiplier, unit } => {
            let unit = match unit {
                SpeedUnit::Percent => v1::SpeedUnit::Percent,
                SpeedUnit::MetresPerSecond => v1::SpeedUnit::MetresPerSecond,
            };
            v1::zone_mask::Kind::Speed(v1::SpeedMask { unit: unit.into(), base, multiplier: Some(multiplier) })
        }
    };
    let grid = &mask.cells.grid;
    let geometry = v1::GridGeometry {
        resolution_m: grid.geometry.resolution_m,
        origin: Some(v1::Vector2 { x: grid.geometry.origin.x, y: grid.geometry.origin.y }),
        width: grid.width as u32,
        height: grid.height as u32,
    };
    v1::ZoneMask { name: mask.name.clone(), map: None, kind: Some(kind), geometry: Some(geometry) }
}
