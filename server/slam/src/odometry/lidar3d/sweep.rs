//! The points of a sweep, each where base was at its own time, in groups of nearly equal time.

use crate::inertial::Curve;
use nalgebra::{Matrix3, Point3, Vector3, Vector6};
use percept_geometry::{Pose, se3};

/// Groups of a sweep: of 100 ms each lasts 1.6 ms, in which a hand turns by 3 mrad at 2 rad/s.
const NUM_GROUPS: usize = 64;
/// And where an IMU felt the motion, quick turns included: 0.4 ms, 1 mrad at 3 rad/s.
const NUM_FELT_GROUPS: usize = 256;

/// Rotation and translation of a rigid motion, ready to be applied to many points.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Motion {
    pub(crate) rotation: Matrix3<f64>,
    pub(crate) translation: Vector3<f64>,
}

impl Motion {
    pub(crate) fn of(t: &Pose) -> Self {
        Self { rotation: *t.rotation.to_rotation_matrix().matrix(), translation: t.translation.vector }
    }

    #[inline]
    pub(crate) fn apply(&self, p: &Point3<f32>) -> Point3<f64> {
        Point3::from(self.rotation * p.coords.cast::<f64>() + self.translation)
    }
}

/// When the points of a sweep were taken: so many instants, seconds from the stamp.
#[derive(Debug, Clone, Default)]
pub(crate) struct Instants {
    first: f32,
    step: f32,
    times: Vec<f64>,
    /// Base at each of them, seen from base at the stamp, where an IMU felt it.
    felt: Option<Vec<Pose>>,
}

impl Instants {
    /// Of these offsets from the stamp; where there are none, all groups are at the stamp.
    pub(crate) fn new(offsets: Option<&[f32]>) -> Self {
        Self::of(offsets, NUM_GROUPS)
    }

    /// The same with the motion that an IMU felt, if it did.
    pub(crate) fn felt(offsets: Option<&[f32]>, curve: Option<&Curve>) -> Self {
        let Some(curve) = curve else { return Self::new(offsets) };
        let instants = Self::of(offsets, NUM_FELT_GROUPS);
        let felt = instants.times.iter().map(|&t| curve.at(t)).collect();
        Self { felt: Some(felt), ..instants }
    }

    fn of(offsets: Option<&[f32]>, num: usize) -> Self {
        let range = offsets
            .map(|o| o.iter().filter(|t| t.is_finite()).fold((f32::MAX, f32::MIN), |(a, b), &t| (a.min(t), b.max(t))));
        match range {
            Some((first, last)) if last > first => {
                let step = (last - first) / (num - 1) as f32;
                let times = (0..num).map(|i| f64::from(first + step * i as f32)).collect();
                Self { first, step, times, felt: None }
            }
            // All at one time, which need not be the stamp.
            Some((first, last)) if last == first => {
                Self { first, step: 1.0, times: vec![f64::from(first); num], felt: None }
            }
            _ => Self { first: 0.0, step: 1.0, times: vec![0.0; num], felt: None },
        }
    }

    /// The group of a point; the first one for a time that is no number.
    #[inline]
    fn group(&self, offset: f32) -> usize {
        // A cast of what is negative or no number gives 0.
        (((offset - self.first) / self.step).round() as usize).min(self.times.len() - 1)
    }

    pub(crate) fn times(&self) -> &[f64] {
        &self.times
    }

    /// Seconds from the first point to the last; 0 where times are not known.
    pub(crate) fn duration(&self) -> f64 {
        match (self.times.first(), self.times.last()) {
            (Some(a), Some(b)) => b - a,
            _ => 0.0,
        }
    }

    /// The middle between the first point and the last, seconds from the stamp.
    pub(crate) fn middle(&self) -> f64 {
        self.times.first().zip(self.times.last()).map_or(0.0, |(a, b)| 0.5 * (a + b))
    }

    /// What brings points to base at the stamp, group by group, if base moves at constant `velocity`, on top of what an IMU
    /// felt if it did.
    pub(crate) fn motions(&self, velocity: &Vector6<f64>) -> Vec<Motion> {
        let at = |t: f64| se3::exp(&(velocity * t));
        match &self.felt {
            Some(felt) => self.times.iter().zip(felt).map(|(&t, felt)| Motion::of(&(at(t) * felt))).collect(),
            None => self.times.iter().map(|&t| Motion::of(&at(t))).collect(),
        }
    }

    /// Base's mean velocity from the first point to the last, in its axes at the first, m/s and rad/s.
    pub(crate) fn mean_velocity(&self, velocity: &Vector6<f64>) -> Vector6<f64> {
        let (Some(felt), true) = (&self.felt, self.duration() > 0.0) else { return *velocity };
        let at = |k: usize| se3::exp(&(velocity * self.times[k])) * felt[k];
        se3::log(&at(0).inv_mul(&at(felt.len() - 1))) / self.duration()
    }
}

/// Points with their groups, ordered by group.
#[derive(Debug, Clone, Default)]
pub(crate) struct Sweep {
    instants: Instants,
    /// In base at the point's own time, metres.
    points: Vec<Point3<f32>>,
    /// Where each group begins, and the end.
    starts: Vec<u32>,
}

impl Sweep {
    /// Points `indices` of a cloud in the sensor frame.
    pub(crate) fn new(
        positions: &[Point3<f32>],
        offsets: Option<&[f32]>,
        t_base_sensor: &Pose,
        instants: &Instants,
        indices: &[u32],
    ) -> Self {
        let motion = Motion::of(t_base_sensor);
        // Groups are work for threads, too: without times they are equal shares.
        let share = |k: usize| k * instants.times.len() / indices.len();
        let group = |k: usize, i: u32| offsets.map_or_else(|| share(k), |o| instants.group(o[i as usize]));
        let mut starts = vec![0u32; instants.times.len() + 1];
        for (k, &i) in indices.iter().enumerate() {
            starts[group(k, i) + 1] += 1;
        }
        for k in 1..starts.len() {
            starts[k] += starts[k - 1];
        }
        let mut next = starts.clone();
        let mut points = vec![Point3::origin(); indices.len()];
        for (k, &i) in indices.iter().enumerate() {
            let slot = &mut next[group(k, i)];
            points[*slot as usize] = motion.apply(&positions[i as usize]).cast();
            *slot += 1;
        }
        Self { instants: instants.clone(), points, starts }
    }

    pub(crate) fn instants(&self) -> &Instants {
        &self.instants
    }

    pub(crate) fn len(&self) -> usize {
        self.points.len()
    }

    /// The points of a group, and the number of the first.
    pub(crate) fn group(&self, group: usize) -> (usize, &[Point3<f32>]) {
        let (a, b) = (self.starts[group] as usize, self.starts[group + 1] as usize);
        (a, &self.points[a..b])
    }

    /// All points in base at the stamp, if base moves at constant `velocity`.
    pub(crate) fn at_stamp(&self, velocity: &Vector6<f64>) -> Vec<Point3<f32>> {
        let motions = self.instants.motions(velocity);
        let moved = |(g, m): (usize, &Motion)| {
            let m = *m;
            self.group(g).1.iter().map(move |p| m.apply(p).cast())
        };
        motions.iter().enumerate().flat_map(moved).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_seen_on_the_way_comes_back_to_where_it_was() {
        let velocity = Vector6::new(1.0, 0.5, 0.0, 0.0, 0.3, 2.0);
        let fixed = Point3::new(4.0, -2.0, 1.0);
        let offsets = [0.1f32, 0.0, 0.05, f32::NAN];
        let positions: Vec<Point3<f32>> = offsets
            .iter()
            .map(|&t| (se3::exp(&(velocity * f64::from(if t.is_finite() { t } else { 0.0 }))).inverse() * fixed).cast())
            .collect();
        let instants = Instants::new(Some(&offsets));
        let sweep = Sweep::new(&positions, Some(&offsets), &Pose::identity(), &instants, &[0, 1, 2, 3]);
        for p in sweep.at_stamp(&velocity) {
            // Half a group at 2 rad/s over 4.6 m.
            assert!((p.cast::<f64>() - fixed).norm() < 0.01, "{p}");
        }
        assert_eq!(sweep.group(0).1.len(), 2);
        assert!((instants.duration() - 0.1).abs() < 1e-6);
    }

    #[test]
    fn points_without_times_are_all_at_the_stamp() {
        let instants = Instants::new(None);
        assert_eq!((instants.times(), instants.duration()), (&[0.0; NUM_GROUPS][..], 0.0));
        let sweep = Sweep::new(&[Point3::new(1.0, 0.0, 0.0)], None, &Pose::identity(), &instants, &[0]);
        assert_eq!(sweep.at_stamp(&Vector6::repeat(5.0)), [Point3::new(1.0, 0.0, 0.0)]);
    }
}
