//! How many metres the map's unit is: by wheels, by depth images, or by a second camera at a known distance.
//!
//! Each source gives ratios of metres to the map's unit; their median counts once they agree. From then on the map is in
//! metres; what wheels say between views and what a second camera says of a view's points stays in the adjustment, so that the
//! scale does not drift. A second camera begins a map in metres by itself.

use super::frame::{self, Lens};
use super::known_steps::KnownStep;
use super::knows_way;
use super::map::ViewId;
use super::second::SecondView;
use super::tracker::Tracker;
use crate::motion_prior::MotionPrior;
use crate::scan::{ImageScan, SecondCamera};
use crate::tracking::Scale;
use nalgebra::{Point3, Vector3};
use percept_geometry::{Covariance6, DepthImage, Pose, se3};

/// The median is believed when its relative standard error is below this. ATE with the best scale of `evaluate
/// mono-sim 1 --wheels` as it went on: halved 39, doubled 65 mm (46), of 381, 437 and 366 images that were placed.
const SURE: f64 = 0.04;
/// Steps between views shorter than this tell nothing, metres; nor do those shorter than twice their error.
const MIN_STEP_M: f64 = 0.02;
/// Views' steps that are needed, and metres in all. ATE with the best scale of `evaluate mono-sim 1 --wheels`: the
/// first halved 58, doubled 109 mm (46), of 351, 358 and 366 images that were placed; the second halved as it is.
const MIN_STEPS: usize = 4;
const MIN_WAY_M: f64 = 0.3;
/// Points of one image with depth that are needed. Halved and doubled as it is: `evaluate mono-sim 1 --depth`.
const MIN_DEPTHS: usize = 30;
/// Points that an image of a second camera shows as well, and such images, that are needed. 130 to 340 points of an image say
/// the same as depth at the same points within 1 %, and no two of 30 images differ by more than 2 % (`evaluate mono-sim 2
/// --second 120`, and 3): both numbers are there for what looks alike. They count for maps that began without a second
/// camera; one that it begins is in metres at once.
const MIN_SECOND_POINTS: usize = 30;
const MIN_SECONDS: usize = 6;

/// What is known of the scale.
#[derive(Debug, Clone)]
pub(super) struct Scaling {
    scale: Scale,
    /// Base's motion since the newest view, as long as it was told.
    since_view: Option<(Pose, Covariance6)>,
    /// Ratios by the second camera.
    seconds: Vec<f64>,
}

impl Default for Scaling {
    fn default() -> Self {
        Self { scale: Scale::Unknown, since_view: None, seconds: vec![] }
    }
}

impl Scaling {
    pub(super) fn scale(&self) -> Scale {
        self.scale
    }

    /// The map is left for a while: what moves in the meantime is not seen by it.
    pub(super) fn interrupt(&mut self) {
        self.since_view = None;
    }

    /// What a motion prior says of the camera, t_now_previous, in the map's unit; only how it turned while that is unknown,
    /// or if the prior tells no more.
    pub(super) fn hint(&self, prior: &MotionPrior, t_base_sensor: &Pose, motion: Option<&Pose>) -> Pose {
        let mut hint = in_camera(&prior.t_prev_now, t_base_sensor).inverse();
        if self.scale == Scale::Unknown || !knows_way(prior) {
            hint.translation.vector = motion.map_or_else(Vector3::zeros, |m| m.translation.vector);
        }
        hint
    }

    /// Notes how base moved up to the image that the tracker has just taken in; `newest_before` was the newest view then.
    pub(super) fn moved(
        &mut self,
        prior: Option<&MotionPrior>,
        t_base_sensor: &Pose,
        tracker: &mut Tracker,
        newest_before: Option<ViewId>,
    ) {
        self.since_view = self.since_view.take().zip(prior.filter(|p| knows_way(p))).map(|((t, covariance), p)| {
            (t * p.t_prev_now, se3::compose_covariance(&covariance, &p.t_prev_now, &p.covariance))
        });
        if tracker.newest == newest_before {
            return;
        }
        if let (Some((t, covariance)), Some(a), Some(b)) = (&self.since_view, newest_before, tracker.newest) {
            let variance = covariance.fixed_view::<3, 3>(0, 0).trace() / 3.0;
            let step = KnownStep { t_a_b: in_camera(t, t_base_sensor), variance: variance.max(1e-5) };
            tracker.known.0.insert((a, b), step);
        }
        self.since_view = Some((Pose::identity(), Covariance6::zeros()));
        if self.scale == Scale::Unknown
            && let Some(ratio) = by_steps(tracker)
        {
            self.apply(ratio, Scale::FromOdometry, tracker);
        }
    }

    /// An image that was placed came with depth.
    pub(super) fn see_depth(&mut self, depth: &DepthImage, scan: &ImageScan, tracker: &mut Tracker) {
        let k = &scan.intrinsics;
        if self.scale != Scale::Unknown || (depth.width(), depth.height()) != (k.width, k.height) {
            return;
        }
        let ratio = |p: Point3<f64>| {
            let pixel = k.project(&p)?;
            let (u, v) = (pixel.x.round(), pixel.y.round());
            let inside = u >= 0.0 && v >= 0.0 && u < k.width as f64 && v < k.height as f64;
            let metres = if inside { f64::from(depth.at(u as usize, v as usize)) } else { 0.0 };
            (metres > 0.0).then_some(metres / p.z)
        };
        let mut ratios: Vec<f64> = tracker.points_in_camera().into_iter().filter_map(ratio).collect();
        if let Some(ratio) = agreed(&mut ratios, MIN_DEPTHS) {
            self.apply(ratio, Scale::FromDepth, tracker);
        }
    }

    /// The last image came with one of a second camera: it begins a map, or tells the scale, or holds it. Whether a map began.
    pub(super) fn see_second(
        &mut self,
        second: &SecondCamera,
        lens: &Lens,
        tracker: &mut Tracker,
        max_features: usize,
    ) -> bool {
        let baseline = second.t_sensor_second.translation.vector.norm();
        let is_known = self.scale != Scale::Unknown || !tracker.has_map();
        if !(baseline > 0.0 && baseline.is_finite()) || (is_known && tracker.wants_depths().is_none()) {
            return false;
        }
        let second_lens = Lens::of(&second.intrinsics);
        let Ok(frame) = frame::extract(&second.image, &second.intrinsics, &second_lens, max_features) else {
            return false;
        };
        let second = SecondView::new(frame, second_lens, &second.t_sensor_second);
        if !is_known {
            self.note_ratio(&second, lens, tracker);
            return false;
        }
        let Some(depths) = tracker.wants_depths().map(|frame| second.depths(frame, lens)) else { return false };
        if tracker.has_map() {
            tracker.see_depths(depths, lens);
            return false;
        }
        let began = tracker.begin_in_metres(depths, lens);
        if began {
            self.scale = Scale::FromBaseline;
        }
        began
    }

    fn note_ratio(&mut self, second: &SecondView, lens: &Lens, tracker: &mut Tracker) {
        let told = second.units_per_metre(&tracker.features_in_camera(), lens, MIN_SECOND_POINTS);
        let Some((units, _)) = told.filter(|(_, error)| *error < SURE) else { return };
        self.seconds.push(1.0 / units);
        if let Some(ratio) = agreed(&mut self.seconds.clone(), MIN_SECONDS) {
            self.apply(ratio, Scale::FromBaseline, tracker);
        } else if self.seconds.len() >= 64 {
            self.seconds.remove(0);
        }
    }

    fn apply(&mut self, ratio: f64, scale: Scale, tracker: &mut Tracker) {
        tracker.rescale(ratio);
        tracker.is_metric = true;
        self.scale = scale;
    }
}

/// Base's motion as the camera's.
fn in_camera(t_base: &Pose, t_base_sensor: &Pose) -> Pose {
    t_base_sensor.inverse() * t_base * t_base_sensor
}

/// Metres by the map's unit from the steps between views.
fn by_steps(tracker: &Tracker) -> Option<f64> {
    let (mut ratios, mut way) = (vec![], 0.0);
    for ((a, b), step) in &tracker.known.0 {
        let (Some(a), Some(b)) = (tracker.map.views.get(a), tracker.map.views.get(b)) else { continue };
        let seen = (a.t_camera_map * b.t_camera_map.inverse()).translation.vector;
        let told = step.t_a_b.translation.vector;
        let length = told.norm();
        if length < MIN_STEP_M.max(2.0 * step.variance.sqrt()) || seen.norm() < 1e-9 {
            continue;
        }
        way += length;
        ratios.push(length / seen.norm());
    }
    if way < MIN_WAY_M { None } else { agreed(&mut ratios, MIN_STEPS) }
}

/// The median, if there are enough and their spread is small.
fn agreed(ratios: &mut [f64], needed: usize) -> Option<f64> {
    if ratios.len() < needed {
        return None;
    }
    ratios.sort_by(f64::total_cmp);
    let median = ratios[ratios.len() / 2];
    let mut off: Vec<f64> = ratios.iter().map(|r| (r / median - 1.0).abs()).collect();
    off.sort_by(f64::total_cmp);
    // 1.4826 makes the median deviation a standard deviation, 1.25 is the median's loss against the mean.
    let error = 1.25 * 1.4826 * off[off.len() / 2] / (ratios.len() as f64).sqrt();
    (median.is_finite() && median > 0.0 && error < SURE).then_some(median)
}

#[cfg(test)]
mod tests {
    use super::super::known_steps::KnownSteps;
    use super::*;
    use std::collections::BTreeMap;

    #[test]
    fn a_median_counts_only_when_the_ratios_agree() {
        assert_eq!(agreed(&mut [2.0, 2.01, 1.99, 9.0], 4), Some(2.01));
        assert_eq!(agreed(&mut [2.0, 2.01, 1.99], 4), None);
        assert_eq!(agreed(&mut [1.0, 2.0, 3.0, 4.0], 4), None);
    }

    #[test]
    fn steps_to_and_from_a_view_that_goes_become_one() {
        let step = |x| KnownStep { t_a_b: se3::from_xy_yaw(x, 0.0, 0.0), variance: 0.01 };
        let [a, b, c] = [0, 1, 2].map(ViewId);
        let mut steps = KnownSteps(BTreeMap::from([((a, b), step(1.0)), ((b, c), step(2.0))]));
        steps.bridge(b);
        let all: Vec<_> = steps.0.into_iter().collect();
        assert_eq!(all.len(), 1);
        assert_eq!(all[0].0, (a, c));
        assert!((all[0].1.t_a_b.translation.x - 3.0).abs() < 1e-12 && (all[0].1.variance - 0.02).abs() < 1e-12);
    }
}
