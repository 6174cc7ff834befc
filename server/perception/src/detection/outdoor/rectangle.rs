//! The footprint of what is seen from one side.

use nalgebra::Point2;

/// Angles tried: a quarter turn in steps of 2 degrees, as wide as corners are rounded.
const NUM_ANGLES: usize = 45;
/// Points nearer to a face than this are on it, metres: noise of the range and bulges of a body.
const FACE_M: f64 = 0.05;
/// So many points tell the angle, spread evenly over those that there are.
const MAX_POINTS: usize = 120;

/// An upright rectangle around points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Footprint {
    /// Direction of its first axis, radians, 0 to a quarter turn.
    pub(super) yaw: f64,
    /// Lower ends along the first and the second axis, metres from the frame's origin.
    pub(super) low: [f64; 2],
    /// Upper ends.
    pub(super) high: [f64; 2],
    /// Mean closeness of the points to the faces that the sensor sees, 0 to 1: 1 if all are within 5 cm.
    pub(super) closeness: f64,
}

impl Footprint {
    /// The rectangle whose faces towards the sensor, at the origin, are closest to the points. None without points.
    ///
    /// Source: Zhang et al., "Efficient L-shape fitting for vehicle detection using laser scanners", 2017, algorithm 3
    /// (closeness). There the nearest of opposite faces counts for each point; here only a face that the sensor can
    /// see, because the others are where points happen to end.
    pub(super) fn of(points: &[Point2<f64>]) -> Option<Self> {
        let step = points.len().div_ceil(MAX_POINTS).max(1);
        let few: Vec<Point2<f64>> = points.iter().step_by(step).copied().collect();
        let mut best: Option<(f64, f64)> = None;
        for i in 0..NUM_ANGLES {
            let yaw = std::f64::consts::FRAC_PI_2 * i as f64 / NUM_ANGLES as f64;
            let closeness = Self::along(&few, yaw)?.closeness;
            if best.is_none_or(|(most, _)| closeness > most) {
                best = Some((closeness, yaw));
            }
        }
        Self::along(points, best?.1)
    }

    /// The rectangle along `yaw`.
    pub(super) fn along(points: &[Point2<f64>], yaw: f64) -> Option<Self> {
        let (sin, cos) = yaw.sin_cos();
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        let turn = |p: &Point2<f64>| [p.x * cos + p.y * sin, p.y * cos - p.x * sin];
        for p in points {
            for (axis, v) in turn(p).into_iter().enumerate() {
                (low[axis], high[axis]) = (low[axis].min(v), high[axis].max(v));
            }
        }
        let seen: Vec<(usize, f64)> = (0..2).filter_map(|axis| Some((axis, face(low[axis], high[axis])?))).collect();
        let close = |p: &Point2<f64>| {
            let p = turn(p);
            let off = seen.iter().map(|&(axis, at)| (p[axis] - at).abs()).fold(f64::INFINITY, f64::min);
            FACE_M / off.max(FACE_M)
        };
        let closeness = points.iter().map(close).sum::<f64>() / points.len() as f64;
        (!points.is_empty()).then_some(Self { yaw, low, high, closeness })
    }

    /// Length along an axis, metres.
    pub(super) fn extent(&self, axis: usize) -> f64 {
        self.high[axis] - self.low[axis]
    }
}

/// Where the face towards the origin is; none if the origin is between the two.
pub(super) fn face(low: f64, high: f64) -> Option<f64> {
    if low > 0.0 {
        Some(low)
    } else if high < 0.0 {
        Some(high)
    } else {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points on the two faces towards the origin of a rectangle of 4 x 1.7 m.
    fn corner(yaw: f64, center: (f64, f64)) -> Vec<Point2<f64>> {
        let (sin, cos) = yaw.sin_cos();
        let local = [(center.0 * cos + center.1 * sin), (center.1 * cos - center.0 * sin)];
        let near = [2.0 * -local[0].signum(), 0.85 * -local[1].signum()];
        let long = (0..40).map(|i| [-2.0 + 0.1 * f64::from(i), near[1]]);
        let short = (0..17).map(|i| [near[0], -0.85 + 0.1 * f64::from(i)]);
        let place = |q: [f64; 2]| Point2::new(center.0 + q[0] * cos - q[1] * sin, center.1 + q[0] * sin + q[1] * cos);
        long.chain(short).map(place).collect()
    }

    #[test]
    fn the_corner_of_a_car_tells_its_direction() {
        for (yaw, center) in [(0.1, (10.0, 4.0)), (0.9, (-8.0, 6.0)), (1.3, (5.0, -12.0)), (0.5, (-7.0, -3.0))] {
            let found = Footprint::of(&corner(yaw, center)).unwrap();
            assert!((found.yaw - yaw).abs() < 0.036, "{found:?} for {yaw}");
            assert!(found.extent(0) > 3.7 && found.extent(1) > 1.5, "{found:?}");
            // Of a face that is seen edge on the points do not count as close.
            assert!(found.closeness > 0.7, "{found:?}");
        }
    }

    #[test]
    fn few_points_have_a_footprint_and_none_have_none() {
        assert_eq!(Footprint::of(&[]), None);
        let found = Footprint::of(&[Point2::new(3.0, 1.0); 4]).unwrap();
        assert_eq!((found.extent(0), found.extent(1)), (0.0, 0.0));
    }
}
