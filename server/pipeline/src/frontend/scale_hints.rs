//! What else a session sees that tells a camera its scale: depth of what the camera sees, and a second camera's images.
//!
//! They come before or after the image that they belong to; both are met.

use percept_geometry::{DepthImage, Pose, Timestamp};
use percept_slam::{DepthScan, ImageScan, Scan, SecondCamera};
use std::sync::Arc;

/// Depth taken so near to an image in time shows the same, but for a few centimetres, seconds.
const DEPTH_S: f64 = 0.035;
/// Two cameras tell their distance only if both are exposed at once, seconds.
const SECOND_S: f64 = 0.005;

/// The newest image of the camera that moves the pose, and the newest of what tells its scale.
#[derive(Debug, Clone, Default)]
pub(crate) struct ScaleHints {
    image: Option<(Timestamp, ImageScan)>,
    other: Option<(Timestamp, Scan)>,
}

impl ScaleHints {
    /// An image of the camera that moves the pose: what came before and belongs to it is added.
    pub(crate) fn see_image(&mut self, stamp: Timestamp, scan: &mut Scan) {
        let Scan::Image(image) = scan else { return };
        self.image = Some((stamp, image.clone()));
        if let Some(hint) = self.other.as_ref().and_then(|(at, other)| told(stamp, image, *at, other)) {
            *image = hint;
        }
    }

    /// A frame of another sensor: the image before with what belongs to it, if it does.
    pub(crate) fn see_other(&mut self, stamp: Timestamp, scan: &Scan) -> Option<ImageScan> {
        if !matches!(scan, Scan::Depth(_) | Scan::Image(_)) {
            return None;
        }
        self.other = Some((stamp, scan.clone()));
        let (at, image) = self.image.as_ref()?;
        told(*at, image, stamp, scan)
    }
}

/// The image with the other sensor's frame, if both were taken at one time.
fn told(stamp: Timestamp, image: &ImageScan, at: Timestamp, other: &Scan) -> Option<ImageScan> {
    let apart = stamp.seconds_since(at).abs();
    let mut image = image.clone();
    match other {
        Scan::Depth(depth) if apart <= DEPTH_S => image.depth = in_view(depth, &image).map(Arc::new),
        Scan::Image(second) if apart <= SECOND_S => {
            image.second = Some(SecondCamera {
                image: Arc::clone(&second.image),
                intrinsics: second.intrinsics,
                t_sensor_second: image.t_base_sensor.inv_mul(&second.t_base_sensor),
            });
        }
        _ => return None,
    }
    Some(image)
}

/// Depth as the camera would see it from where it is mounted, its lens included; nearer surfaces hide farther ones, and
/// pixels between those that are met have none.
fn in_view(scan: &DepthScan, image: &ImageScan) -> Option<DepthImage> {
    let k = &image.intrinsics;
    let t_camera_depth: Pose = image.t_base_sensor.inv_mul(&scan.t_base_sensor);
    let mut out = vec![0.0f32; k.width * k.height];
    for v in 0..scan.depth.height() {
        for u in 0..scan.depth.width() {
            let z = f64::from(scan.depth.at(u, v));
            if z <= 0.0 {
                continue;
            }
            let p = t_camera_depth * (scan.intrinsics.ray(u as f64, v as f64) * z);
            let Some(pixel) = k.project(&p).filter(|_| p.z > 0.0) else { continue };
            let (x, y) = (pixel.x.round(), pixel.y.round());
            if x >= 0.0 && y >= 0.0 && x < k.width as f64 && y < k.height as f64 {
                let held = &mut out[y as usize * k.width + x as usize];
                if *held == 0.0 || p.z < f64::from(*held) {
                    *held = p.z as f32;
                }
            }
        }
    }
    DepthImage::new(k.width, k.height, out).ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_geometry::{CameraIntrinsics, RgbImage};

    fn image() -> ImageScan {
        let image = Arc::new(RgbImage::new(40, 30, vec![0; 3600]).unwrap());
        let intrinsics = CameraIntrinsics::pinhole(40, 30, 30.0, 30.0, 19.5, 14.5);
        ImageScan { image, depth: None, second: None, intrinsics, t_base_sensor: Pose::identity() }
    }

    fn wall(at: f32) -> Scan {
        Scan::Depth(DepthScan {
            depth: Arc::new(DepthImage::new(80, 60, vec![at; 4800]).unwrap()),
            color: None,
            intrinsics: CameraIntrinsics::pinhole(80, 60, 60.0, 60.0, 39.5, 29.5),
            // Half a metre behind the camera.
            t_base_sensor: Pose::translation(0.0, 0.0, -0.5),
        })
    }

    #[test]
    fn depth_is_seen_from_where_the_camera_is_whichever_comes_first() {
        let (t0, t1) = (Timestamp::from_secs_f64(1.0), Timestamp::from_secs_f64(1.02));
        let mut before = ScaleHints::default();
        assert!(before.see_other(t0, &wall(3.0)).is_none());
        let mut scan = Scan::Image(image());
        before.see_image(t1, &mut scan);
        let Scan::Image(told) = scan else { panic!() };
        let mut after = ScaleHints::default();
        after.see_image(t0, &mut Scan::Image(image()));
        let late = after.see_other(t1, &wall(3.0)).unwrap();
        for depth in [told.depth.unwrap(), late.depth.unwrap()] {
            assert!((depth.at(20, 15) - 2.5).abs() < 1e-5, "{}", depth.at(20, 15));
        }
    }

    #[test]
    fn what_was_taken_at_another_time_tells_nothing() {
        let mut hints = ScaleHints::default();
        hints.see_image(Timestamp::from_secs_f64(1.0), &mut Scan::Image(image()));
        assert!(hints.see_other(Timestamp::from_secs_f64(1.1), &wall(3.0)).is_none());
        assert!(hints.see_other(Timestamp::from_secs_f64(1.01), &Scan::Image(image())).is_none());
        assert!(hints.see_other(Timestamp::from_secs_f64(1.0), &Scan::Image(image())).is_some());
    }
}
