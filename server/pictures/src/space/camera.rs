//! From where something is looked at: parallel projection, so that a metre is as long everywhere in the picture.

use crate::PictureError;
use nalgebra::{Point3, Vector2, Vector3};

/// From where a map is looked at.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ViewFrom {
    /// Straight from above: x to the right, y up.
    Above,
    /// From a direction in the map frame.
    Oblique {
        /// Where the viewer stands, as seen from the map, counter-clockwise from x, radians: -3/4 pi is the south-west, if y is north.
        azimuth_rad: f64,
        /// How high above the horizon the viewer stands, radians, from 0 (level) to pi / 2 (above).
        elevation_rad: f64,
    },
}

/// How something in space is shown.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// From where.
    pub from: ViewFrom,
    /// What lies above this height of the map frame is cut away, metres; none: nothing is.
    pub cut_above_m: Option<f64>,
    /// Pixels along the drawing's longer edge, 300 to 3300.
    pub edge_px: usize,
}

impl Default for View {
    /// From the south-west, 35 degrees up, nothing cut away, 1100 pixels.
    fn default() -> Self {
        let from = ViewFrom::Oblique { azimuth_rad: -0.75 * std::f64::consts::PI, elevation_rad: 35f64.to_radians() };
        Self { from, cut_above_m: None, edge_px: 1100 }
    }
}

impl View {
    /// From above, ceilings cut away above 2.2 m, 1100 pixels.
    pub fn above() -> Self {
        Self { from: ViewFrom::Above, cut_above_m: Some(2.2), ..Self::default() }
    }

    pub(super) fn camera(&self) -> Result<Camera, PictureError> {
        let out_of_range = |field, value, requirement| Err(PictureError::OutOfRange { field, value, requirement });
        if !(300..=crate::sheet::MAX_PLOT).contains(&self.edge_px) {
            return out_of_range("edge_px", self.edge_px as f64, "between 300 and 3300");
        }
        if let Some(cut) = self.cut_above_m.filter(|cut| cut.is_nan()) {
            return out_of_range("cut_above_m", cut, "a number");
        }
        let (azimuth, elevation) = match self.from {
            ViewFrom::Above => (-std::f64::consts::FRAC_PI_2, std::f64::consts::FRAC_PI_2),
            ViewFrom::Oblique { azimuth_rad, elevation_rad } => (azimuth_rad, elevation_rad),
        };
        if !azimuth.is_finite() {
            return out_of_range("azimuth_rad", azimuth, "finite");
        }
        if !(0.0..=std::f64::consts::FRAC_PI_2 + 1e-9).contains(&elevation) {
            return out_of_range("elevation_rad", elevation, "between 0 and pi / 2");
        }
        let cut = self.cut_above_m.unwrap_or(f64::INFINITY) as f32;
        Ok(Camera::new(azimuth, elevation, cut, self.from == ViewFrom::Above))
    }
}

/// Axes of the picture in the map frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct Camera {
    right: Vector3<f64>,
    up: Vector3<f64>,
    /// Away from the viewer.
    pub(super) ahead: Vector3<f64>,
    /// What is higher is not drawn, metres.
    pub(super) cut: f32,
    pub(super) is_above: bool,
}

impl Camera {
    fn new(azimuth: f64, elevation: f64, cut: f32, is_above: bool) -> Self {
        let (sin, cos) = azimuth.sin_cos();
        let (up, level) = elevation.sin_cos();
        let ahead = -Vector3::new(level * cos, level * sin, up);
        let right = Vector3::new(-sin, cos, 0.0);
        Self { right, up: right.cross(&ahead), ahead, cut, is_above }
    }

    /// Metres to the right, up and away from the viewer.
    pub(super) fn project(&self, p: &Point3<f64>) -> Vector3<f64> {
        Vector3::new(self.right.dot(&p.coords), self.up.dot(&p.coords), self.ahead.dot(&p.coords))
    }

    /// Whether a point is drawn at all: it has numbers that make sense, and lies below the cut.
    pub(super) fn shows(&self, p: &Point3<f32>) -> bool {
        p.z <= self.cut && is_somewhere(p)
    }

    /// The axes of the map frame as they lie in the picture, up positive.
    pub(super) fn axes(&self) -> [(&'static str, Vector2<f64>); 3] {
        let axis = |v: Vector3<f64>| Vector2::new(self.right.dot(&v), self.up.dot(&v));
        [("x", axis(Vector3::x())), ("y", axis(Vector3::y())), ("z", axis(Vector3::z()))]
    }

    /// From where in words.
    pub(super) fn words(&self) -> String {
        if self.is_above {
            return "from above".to_owned();
        }
        let azimuth = (-self.ahead.y).atan2(-self.ahead.x).to_degrees();
        let elevation = (-self.ahead.z).clamp(-1.0, 1.0).asin().to_degrees();
        format!("from azimuth {azimuth:.0}\u{b0}, {elevation:.0}\u{b0} up")
    }
}

/// Whether a point has numbers that make sense: within ten thousand kilometres.
pub(super) fn is_somewhere(p: &Point3<f32>) -> bool {
    p.coords.iter().all(|v| v.abs() <= 1e7)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn from_above_x_is_right_and_y_is_up() {
        let camera = View::above().camera().unwrap();
        let p = camera.project(&Point3::new(2.0, 3.0, 4.0));
        assert!((p - Vector3::new(2.0, 3.0, -4.0)).norm() < 1e-12);
    }

    #[test]
    fn from_the_south_west_x_goes_right_and_down_into_the_picture() {
        let camera = View::default().camera().unwrap();
        let [x, y, z] = camera.axes().map(|a| a.1);
        assert!(x.x > 0.5 && y.x < -0.5 && x.y > 0.3 && y.y > 0.3 && z.x.abs() < 1e-12 && z.y > 0.8);
        assert_eq!(camera.words(), "from azimuth -135\u{b0}, 35\u{b0} up");
    }

    #[test]
    fn what_cannot_be_looked_from_is_refused() {
        let view = |azimuth_rad, elevation_rad| View {
            from: ViewFrom::Oblique { azimuth_rad, elevation_rad },
            ..View::default()
        };
        assert!(view(f64::NAN, 0.5).camera().is_err());
        assert!(view(0.0, -0.5).camera().is_err());
        assert!(View { edge_px: 1 << 40, ..View::default() }.camera().is_err());
        assert!(View { cut_above_m: Some(f64::NAN), ..View::default() }.camera().is_err());
    }
}
