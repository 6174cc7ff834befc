//! The whole of an object of which one side is seen.

use super::rectangle::face;
use super::traits::Shape;
use nalgebra::{Point3, Vector3};
use percept_geometry::{ObjectClass, OrientedBox3};
use std::f64::consts::FRAC_PI_2;

/// Usual length, width and height, metres. Cars, people and cyclists: means of KITTI's labels as Yan et al. ("SECOND",
/// 2018) and Lang et al. ("PointPillars", 2019) use them; vans and trucks: Geiger et al.'s benchmark (2012); buses and
/// motorcycles: means of nuScenes (Caesar et al. 2020) as Yin et al. ("CenterPoint", 2021) use them.
pub fn usual_size(class: ObjectClass) -> Option<[f64; 3]> {
    match class {
        ObjectClass::Car => Some([3.9, 1.6, 1.56]),
        ObjectClass::Van => Some([5.06, 1.9, 2.2]),
        ObjectClass::Truck => Some([8.5, 2.55, 3.1]),
        ObjectClass::Bus => Some([10.5, 2.94, 3.47]),
        ObjectClass::Cyclist => Some([1.76, 0.6, 1.73]),
        ObjectClass::Motorcycle => Some([2.11, 0.77, 1.47]),
        ObjectClass::Person => Some([0.8, 0.6, 1.73]),
        _ => None,
    }
}

/// A side is not the short one if it is so much longer than that usually is, metres.
const LONGER_M: f64 = 0.5;

/// The box on the ground around what is seen, its x along the length, grown to the usual size of its class: away from
/// the sensor, since what faces it would have been seen.
pub(super) fn whole_box(shape: &Shape, class: ObjectClass) -> OrientedBox3 {
    let f = &shape.footprint;
    let longer = usize::from(f.extent(1) > f.extent(0));
    let usual = usual_size(class).unwrap_or([0.1; 3]);
    let is_vehicle = usual[1] > 1.0;
    // Of a vehicle of which no side is longer than it is wide, one end is seen, and that is the wider of the two.
    let long = if is_vehicle && f.extent(longer) < usual[1] + LONGER_M { 1 - longer } else { longer };
    let (mut low, mut high) = (f.low, f.high);
    for axis in 0..2 {
        let missing = usual[usize::from(axis != long)] - f.extent(axis);
        if missing <= 0.0 {
            continue;
        }
        // Of people all is seen but for the swing of limbs, on either side.
        let seen = face(f.low[axis], f.high[axis]).filter(|_| class != ObjectClass::Person);
        match seen {
            Some(at) if at == f.low[axis] => high[axis] += missing,
            Some(_) => low[axis] -= missing,
            None => {
                low[axis] -= 0.5 * missing;
                high[axis] += 0.5 * missing;
            }
        }
    }
    let (sin, cos) = f.yaw.sin_cos();
    let middle = [0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1])];
    let center = Point3::new(
        middle[0] * cos - middle[1] * sin,
        middle[0] * sin + middle[1] * cos,
        shape.ground + 0.5 * shape.top,
    );
    let size = Vector3::new(high[long] - low[long], high[1 - long] - low[1 - long], shape.top);
    OrientedBox3::upright(center, size, f.yaw + FRAC_PI_2 * long as f64)
}
