//! Floor, walls, ceiling and tables.

use super::local::Local;
use super::{PlaneParams, PlaneSegment, at_least};
use nalgebra::{Point3, Unit, Vector3};
use percept_geometry::GeometryError;
use serde::{Deserialize, Serialize};
use std::f64::consts::FRAC_PI_2;

/// What a plane is, by its direction and height.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PlaneKind {
    /// The lowest horizontal plane.
    Floor,
    /// Vertical.
    Wall,
    /// The highest horizontal plane, if at least a room's height above the floor.
    Ceiling,
    /// Horizontal, at the height of tables, desks and seats.
    Table,
    /// None of these.
    Other,
}

/// A plane with its kind.
#[derive(Debug, Clone, PartialEq)]
pub struct TypedPlane {
    /// What it is.
    pub kind: PlaneKind,
    /// The plane and its points.
    pub segment: PlaneSegment,
    /// Height of its points' mean along `up`, metres.
    pub height_m: f64,
    /// Angle between its normal and `up`, radians, from 0 (level) to a quarter turn (upright).
    pub tilt_rad: f64,
}

/// How [`segment_planes`] searches and names.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PlanesParams {
    /// How each plane is searched; `min_points` ends the search.
    pub plane: PlaneParams,
    /// Most planes taken.
    pub max_planes: usize,
    /// Planes within this of horizontal or vertical count as such, radians.
    pub max_tilt_rad: f64,
    /// Least height of a ceiling above the floor, metres.
    pub min_ceiling_m: f64,
    /// Lowest and highest table top above the floor, metres.
    pub table_band_m: [f64; 2],
}

impl Default for PlanesParams {
    fn default() -> Self {
        Self {
            plane: PlaneParams { min_points: 200, ..PlaneParams::default() },
            max_planes: 12,
            max_tilt_rad: 0.15,
            min_ceiling_m: 1.8,
            table_band_m: [0.3, 1.3],
        }
    }
}

/// The largest planes of a cloud one after another, each without the points of those before, largest first
/// as a rule; `up` is against gravity in the cloud's frame.
///
/// # Errors
/// `OutOfRange` naming the parameter.
pub fn segment_planes(
    points: &[Point3<f32>],
    up: &Unit<Vector3<f64>>,
    params: &PlanesParams,
) -> Result<Vec<TypedPlane>, GeometryError> {
    params.plane.validate()?;
    at_least("max_planes", params.max_planes, 1, "at least 1")?;
    let mut out: Vec<TypedPlane> = Vec::new();
    let Some(mut left) = Local::new(points, 0..points.len() as u32) else { return Ok(out) };
    while out.len() < params.max_planes {
        let Some((segment, places)) = left.find_plane(&params.plane, &|_| true) else { break };
        left.remove(&places);
        let heights = segment.inliers.iter().map(|&i| up.dot(&points[i].coords.cast()));
        let height_m = heights.sum::<f64>() / segment.inliers.len() as f64;
        let tilt_rad = segment.plane.normal.dot(up).abs().min(1.0).acos();
        out.push(TypedPlane { kind: PlaneKind::Other, segment, height_m, tilt_rad });
    }
    name(&mut out, params);
    Ok(out)
}

fn name(planes: &mut [TypedPlane], params: &PlanesParams) {
    let horizontal = |p: &TypedPlane| p.tilt_rad <= params.max_tilt_rad;
    let heights = || planes.iter().filter(|p| horizontal(p)).map(|p| p.height_m);
    let floor = heights().fold(f64::INFINITY, f64::min);
    let top = heights().fold(f64::NEG_INFINITY, f64::max);
    for plane in planes {
        let above = plane.height_m - floor;
        plane.kind = if horizontal(plane) {
            let [low, high] = params.table_band_m;
            match above {
                // Steps and carpets lie on the floor, not above it.
                _ if above <= 0.05 => PlaneKind::Floor,
                _ if plane.height_m == top && above >= params.min_ceiling_m => PlaneKind::Ceiling,
                _ if (low..=high).contains(&above) => PlaneKind::Table,
                _ => PlaneKind::Other,
            }
        } else if plane.tilt_rad >= FRAC_PI_2 - params.max_tilt_rad {
            PlaneKind::Wall
        } else {
            PlaneKind::Other
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sheet(origin: [f32; 3], u: [f32; 3], v: [f32; 3], n: usize, out: &mut Vec<Point3<f32>>) {
        let (o, u, v) = (Vector3::from(origin), Vector3::from(u), Vector3::from(v));
        for i in 0..n * n {
            let (a, b) = ((i % n) as f32 / n as f32, (i / n) as f32 / n as f32);
            out.push(Point3::from(o + u * a + v * b));
        }
    }

    #[test]
    fn a_room_has_floor_walls_ceiling_and_table() {
        let mut points = Vec::new();
        sheet([0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 3.0, 0.0], 60, &mut points);
        sheet([0.0, 0.0, 2.5], [4.0, 0.0, 0.0], [0.0, 3.0, 0.0], 50, &mut points);
        sheet([0.0, 0.0, 0.1], [4.0, 0.0, 0.0], [0.0, 0.0, 2.3], 45, &mut points);
        sheet([0.0, 0.0, 0.1], [0.0, 3.0, 0.0], [0.0, 0.0, 2.3], 40, &mut points);
        sheet([1.0, 1.0, 0.74], [1.2, 0.0, 0.0], [0.0, 0.8, 0.0], 30, &mut points);
        let planes = segment_planes(&points, &Vector3::z_axis(), &PlanesParams::default()).unwrap();
        let kinds: Vec<PlaneKind> = planes.iter().map(|p| p.kind).collect();
        use PlaneKind::*;
        let tilts = planes.iter().map(|p| (p.kind, p.tilt_rad));
        assert!(tilts.filter(|(kind, _)| *kind == Floor).all(|(_, tilt)| tilt < 0.02));
        assert_eq!(kinds, [Floor, Ceiling, Wall, Wall, Table]);
        assert!((planes[4].height_m - 0.74).abs() < 0.01);
    }

    #[test]
    fn an_empty_cloud_has_no_planes() {
        assert!(segment_planes(&[], &Vector3::z_axis(), &PlanesParams::default()).unwrap().is_empty());
    }
}
