//! The ground of a lidar scan, uneven as it may be.

use super::patches::{NUM_PATCHES, Patches, ring_of};
use crate::cloud::{Scatter, at_least, positive, sums_within, symmetric_eigen3};
use nalgebra::{Point3, Vector3};
use percept_geometry::{GeometryError, Plane};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Rings near the sensor where a patch is compared with the others of its ring: farther out too little ground is seen.
const NEAR_RINGS: usize = 4;
/// Rings in which points under the ground (mirrored beams) and vertical things at its foot are looked for.
const INNER_RINGS: usize = 2;
/// Patches longer than this many times their width are a line of beams, whose flatness says nothing.
const MAX_STRETCH: f64 = 8.0;

/// How [`segment_ground`] fits and judges patches.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GroundParams {
    /// Height of the sensor above the ground under it, metres.
    pub sensor_height_m: f64,
    /// Nearer points are not ground (the vehicle itself), metres in the plane.
    pub min_range_m: f64,
    /// Farther points are not ground, metres in the plane.
    pub max_range_m: f64,
    /// Points so far above the fitted plane are still ground, metres.
    pub distance_m: f64,
    /// The first fit takes points up to this height above the lowest ones, metres.
    pub seed_height_m: f64,
    /// How many lowest points tell the height to start from.
    pub num_lowest: usize,
    /// Patches with fewer points have no ground.
    pub min_points: usize,
    /// Fits a patch.
    pub num_fits: usize,
    /// Steepest ground, radians.
    pub max_slope_rad: f64,
    /// Points so far below the fitted plane are mirrored beams, not ground, metres.
    pub max_below_m: f64,
}

impl Default for GroundParams {
    fn default() -> Self {
        Self {
            sensor_height_m: 1.73,
            min_range_m: 2.7,
            max_range_m: 80.0,
            distance_m: 0.125,
            seed_height_m: 0.125,
            num_lowest: 20,
            min_points: 10,
            num_fits: 3,
            max_slope_rad: 0.785,
            max_below_m: 0.8,
        }
    }
}

impl GroundParams {
    /// Checks the bounds.
    ///
    /// # Errors
    /// `OutOfRange` naming the field.
    pub fn validate(&self) -> Result<(), GeometryError> {
        positive("sensor_height_m", self.sensor_height_m)?;
        positive("min_range_m", self.min_range_m)?;
        positive("max_range_m", self.max_range_m)?;
        positive("distance_m", self.distance_m)?;
        positive("seed_height_m", self.seed_height_m)?;
        positive("max_slope_rad", self.max_slope_rad)?;
        positive("max_below_m", self.max_below_m)?;
        at_least("num_lowest", self.num_lowest, 1, "at least 1")?;
        at_least("min_points", self.min_points, 3, "at least 3")?;
        at_least("num_fits", self.num_fits, 1, "at least 1")?;
        if self.max_range_m <= self.min_range_m {
            let requirement = "greater than min_range_m";
            return Err(GeometryError::OutOfRange { field: "max_range_m", value: self.max_range_m, requirement });
        }
        Ok(())
    }
}

/// A piece of ground.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GroundPatch {
    /// Its plane, the normal upward.
    pub plane: Plane,
    /// Mean of its points, metres.
    pub center: Point3<f64>,
    /// Number of its points.
    pub num_points: usize,
}

/// What of a scan is ground.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Ground {
    /// N, whether each point is ground.
    pub is_ground: Vec<bool>,
    /// The pieces of ground, from the sensor outward.
    pub patches: Vec<GroundPatch>,
}

/// The ground of a scan given in the sensor's frame, z up: rings about the sensor are cut into patches, in each a plane
/// is fitted to its low points, and the patches that are upright and, near the sensor, not above the others of their
/// ring or else as flat as they, are ground.
///
/// Source: Lim et al., "Patchwork", 2021, and Lee, Lim and Myung, "Patchwork++: fast and robust ground segmentation
/// solving partial under-segmentation using 3D point cloud", 2022. Where they learn how high and flat ground is from
/// the scans before, the other patches of the same ring tell here: the answer depends on the one scan alone.
///
/// # Errors
/// `OutOfRange` naming the parameter.
pub fn segment_ground(points: &[Point3<f32>], params: &GroundParams) -> Result<Ground, GeometryError> {
    params.validate()?;
    let patches = Patches::new(points, params.min_range_m as f32, params.max_range_m as f32);
    let fits: Vec<Option<Fit>> =
        (0..NUM_PATCHES).into_par_iter().with_min_len(16).map(|patch| Fit::of(&patches, patch, params)).collect();
    let rings: Vec<Ring> = (0..NEAR_RINGS).map(|ring| Ring::of(&fits, ring)).collect();
    let mut out = Ground { is_ground: vec![false; points.len()], patches: Vec::new() };
    for (patch, fit) in fits.iter().enumerate() {
        let Some(fit) = fit else { continue };
        if fit.is_upright && rings.get(ring_of(patch)).is_none_or(|ring| ring.accepts(fit)) {
            fit.ground.iter().for_each(|&i| out.is_ground[i as usize] = true);
            out.patches.push(GroundPatch { plane: fit.plane, center: fit.center, num_points: fit.ground.len() });
        }
    }
    Ok(out)
}

/// The plane in a patch and what can be said about it.
struct Fit {
    plane: Plane,
    center: Point3<f64>,
    ground: Vec<u32>,
    is_upright: bool,
    /// Variance across the plane, square metres.
    flatness: f64,
    /// Largest over middle variance.
    stretch: f64,
}

impl Fit {
    fn of(patches: &Patches, patch: usize, params: &GroundParams) -> Option<Self> {
        let mut region = Region::new(patches, patch);
        if region.len() < params.min_points {
            return None;
        }
        let inner = ring_of(patch) < INNER_RINGS;
        // Mirrored beams under the ground do not tell its height.
        let floor = if inner { -1.2 * params.sensor_height_m } else { f64::NEG_INFINITY };
        if inner {
            region.drop_verticals(floor, params);
        }
        let seeds = region.seeds(region.lowest(floor, params.num_lowest)? + params.seed_height_m);
        let mut plane = Flat::fit(&seeds)?;
        let mut moments = seeds;
        for _ in 0..params.num_fits {
            moments = region.between(&plane, -params.max_below_m, params.distance_m);
            plane = Flat::fit(&moments)?;
        }
        let ground = region.list(&plane, -params.max_below_m, params.distance_m);
        let [l3, l2, l1] = plane.variances;
        (ground.len() >= 3).then(|| Self {
            plane: Plane::through(&moments.mean(), nalgebra::Unit::new_normalize(plane.normal)),
            center: moments.mean(),
            ground,
            is_upright: plane.normal.z >= params.max_slope_rad.cos(),
            flatness: l3.max(0.0),
            stretch: if l2 > 0.0 { l1 / l2 } else { f64::INFINITY },
        })
    }
}

/// A plane of least squares.
struct Flat {
    normal: Vector3<f64>,
    offset: f64,
    variances: [f64; 3],
}

impl Flat {
    fn fit(moments: &Scatter) -> Option<Self> {
        if moments.num_points() < 3 {
            return None;
        }
        let eigen = symmetric_eigen3(&moments.covariance());
        let normal = if eigen.vectors[0].z < 0.0 { -eigen.vectors[0] } else { eigen.vectors[0] };
        Some(Self { normal, offset: -normal.dot(&moments.mean().coords), variances: eigen.values })
    }

    fn coefficients(&self) -> [f32; 4] {
        [self.normal.x as f32, self.normal.y as f32, self.normal.z as f32, self.offset as f32]
    }
}

/// The points of a patch, of which some may be dropped.
struct Region<'a> {
    xs: std::borrow::Cow<'a, [f32]>,
    ys: std::borrow::Cow<'a, [f32]>,
    zs: std::borrow::Cow<'a, [f32]>,
    indices: std::borrow::Cow<'a, [u32]>,
}

impl<'a> Region<'a> {
    fn new(patches: &'a Patches, patch: usize) -> Self {
        let places = patches.places(patch);
        Self {
            xs: (&patches.xs[places.clone()]).into(),
            ys: (&patches.ys[places.clone()]).into(),
            zs: (&patches.zs[places.clone()]).into(),
            indices: (&patches.indices[places]).into(),
        }
    }

    fn len(&self) -> usize {
        self.xs.len()
    }

    /// Mean height of the lowest points above `floor`; none if there is none.
    fn lowest(&self, floor: f64, num: usize) -> Option<f64> {
        let mut heights: Vec<f32> = self.zs.iter().copied().filter(|&z| f64::from(z) >= floor).collect();
        if heights.len() > num {
            heights.select_nth_unstable_by(num - 1, f32::total_cmp);
            heights.truncate(num);
        }
        (!heights.is_empty()).then(|| heights.iter().map(|&z| f64::from(z)).sum::<f64>() / heights.len() as f64)
    }

    fn seeds(&self, below: f64) -> Scatter {
        let sums = sums_within(&self.xs, &self.ys, &self.zs, &[0.0, 0.0, 1.0, 0.0], f32::NEG_INFINITY, below as f32);
        Scatter::from_sums(Point3::origin(), &sums)
    }

    fn between(&self, plane: &Flat, low: f64, high: f64) -> Scatter {
        let sums = sums_within(&self.xs, &self.ys, &self.zs, &plane.coefficients(), low as f32, high as f32);
        Scatter::from_sums(Point3::origin(), &sums)
    }

    fn heights(&self, plane: &Flat) -> impl Iterator<Item = f32> {
        let [a, b, c, d] = plane.coefficients();
        self.xs.iter().zip(&*self.ys).zip(&*self.zs).map(move |((x, y), z)| a * x + b * y + c * z + d)
    }

    fn list(&self, plane: &Flat, low: f64, high: f64) -> Vec<u32> {
        let (low, high) = (low as f32, high as f32);
        let near = self.heights(plane).zip(&*self.indices).filter(|(h, _)| (low..=high).contains(h));
        near.map(|(_, &i)| i).collect()
    }

    /// While the low points stand on a wall or a wheel rather than lie, these are dropped (R-VPF of Patchwork++).
    fn drop_verticals(&mut self, floor: f64, params: &GroundParams) {
        for _ in 0..params.num_fits {
            let Some(lowest) = self.lowest(floor, params.num_lowest) else { return };
            let Some(plane) = Flat::fit(&self.seeds(lowest + 2.0 * params.seed_height_m)) else { return };
            if plane.normal.z >= params.max_slope_rad.cos() {
                return;
            }
            let keep: Vec<usize> =
                (0..).zip(self.heights(&plane)).filter(|(_, h)| h.abs() >= 0.1).map(|k| k.0).collect();
            let pick = |v: &[f32]| keep.iter().map(|&i| v[i]).collect::<Vec<f32>>();
            let indices: Vec<u32> = keep.iter().map(|&i| self.indices[i]).collect();
            (self.xs, self.ys, self.zs) = (pick(&self.xs).into(), pick(&self.ys).into(), pick(&self.zs).into());
            self.indices = indices.into();
        }
    }
}

/// What is usual in a ring near the sensor.
struct Ring {
    max_elevation: f64,
    max_flatness: f64,
}

impl Ring {
    fn of(fits: &[Option<Fit>], ring: usize) -> Self {
        let near = |patch: &usize| ring_of(*patch) == ring;
        let upright: Vec<&Fit> =
            (0..fits.len()).filter(near).filter_map(|patch| fits[patch].as_ref()).filter(|f| f.is_upright).collect();
        let limit = |value: fn(&Fit) -> f64, deviations: f64, least: f64| {
            let values: Vec<f64> = upright.iter().map(|f| value(f)).collect();
            let middle = median(values.clone());
            // 1.4826: deviation of a normal distribution from its median absolute one.
            let spread = 1.4826 * median(values.iter().map(|v| (v - middle).abs()).collect());
            middle + (deviations * spread).max(least)
        };
        Self { max_elevation: limit(|f| f.center.z, 3.0, 0.15), max_flatness: limit(|f| f.flatness, 2.0, 1e-4) }
    }

    fn accepts(&self, fit: &Fit) -> bool {
        // Seen from above: the sensor is on the side that the normal shows to.
        let faces_sensor = fit.plane.offset > 0.0;
        let is_flat = fit.flatness <= self.max_flatness && fit.stretch <= MAX_STRETCH;
        faces_sensor && (fit.center.z <= self.max_elevation || is_flat)
    }
}

fn median(mut values: Vec<f64>) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Beams of a lidar 1.73 m over ground that rises by a tenth of x, with a wall 10 m to the left.
    fn scan() -> (Vec<Point3<f32>>, Vec<bool>) {
        let (mut points, mut truth) = (Vec::new(), Vec::new());
        for ring in 0..48 {
            let down = (-2.0 - 0.5 * f64::from(ring)).to_radians();
            for step in 0..900 {
                let (sin, cos) = (f64::from(step) * 0.4).to_radians().sin_cos();
                let d = Vector3::new(cos * down.cos(), sin * down.cos(), down.sin());
                // z = 0.1 x - 1.73, y = 10.
                let to_ground = if d.z < 0.1 * d.x { -1.73 / (d.z - 0.1 * d.x) } else { f64::INFINITY };
                let to_wall = if d.y > 0.0 { 10.0 / d.y } else { f64::INFINITY };
                let range = to_ground.min(to_wall);
                if range < 75.0 {
                    points.push(Point3::from((d * range).cast::<f32>()));
                    truth.push(to_ground <= to_wall);
                }
            }
        }
        (points, truth)
    }

    #[test]
    fn a_slope_is_ground_and_a_wall_is_not() {
        let (points, truth) = scan();
        let found = segment_ground(&points, &GroundParams::default()).unwrap();
        let (mut right, mut of) = ([0.0, 0.0], [0.0, 0.0]);
        for ((p, &is), &said) in points.iter().zip(&truth).zip(&found.is_ground) {
            if p.coords.xy().norm() > 3.0 {
                of[usize::from(is)] += 1.0;
                right[usize::from(is)] += f64::from(u8::from(is == said));
            }
        }
        assert!(right[1] > 0.88 * of[1], "{right:?} of {of:?}");
        // The foot of the wall is within the thickness of the ground.
        assert!(right[0] > 0.85 * of[0], "{right:?} of {of:?}");
        assert!(found.patches.iter().all(|p| p.plane.normal.z > 0.9));
    }

    #[test]
    fn degenerate_scans_have_no_ground() {
        let none = |points: &[Point3<f32>]| {
            segment_ground(points, &GroundParams::default()).unwrap().is_ground.iter().all(|g| !g)
        };
        assert!(none(&[]));
        assert!(none(&[Point3::origin(); 100]));
        assert!(none(&[Point3::from([f32::NAN; 3]); 100]));
        assert!(none(&[Point3::new(f32::INFINITY, 0.0, f32::NAN); 100]));
        assert!(none(&[Point3::new(1e7, 1e7, 0.0); 100]));
        assert!(none(&(0..100).map(|i| Point3::new(5.0, 0.0, i as f32 * 0.1)).collect::<Vec<_>>()));
        let params = GroundParams { max_range_m: 1.0, ..GroundParams::default() };
        assert!(segment_ground(&[], &params).unwrap_err().to_string().starts_with("max_range_m"));
    }
}
