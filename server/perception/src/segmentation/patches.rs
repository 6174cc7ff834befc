//! The ground around a lidar in patches: rings about the sensor, cut into sectors.

use nalgebra::Point3;
use percept_geometry::by_processor;
use rayon::prelude::*;

/// Zones from the inside out; in each all patches have the same depth and the same angle.
pub(super) const RINGS: [usize; 4] = [2, 4, 4, 4];
const SECTORS: [usize; 4] = [16, 32, 54, 32];
/// Points numbered by one task.
const CHUNK: usize = 8192;

/// Patches in all.
pub(super) const NUM_PATCHES: usize = 2 * 16 + 4 * 32 + 4 * 54 + 4 * 32;
/// What is in no patch.
const NONE: u32 = NUM_PATCHES as u32;

/// Points sorted by patch, coordinates side by side.
pub(super) struct Patches {
    pub(super) xs: Vec<f32>,
    pub(super) ys: Vec<f32>,
    pub(super) zs: Vec<f32>,
    /// Index of each in the cloud; ascending in a patch.
    pub(super) indices: Vec<u32>,
    /// First point of each patch, and the end.
    starts: Vec<usize>,
}

impl Patches {
    /// Points nearer than `min_range` or farther than `max_range` (metres, in the plane) are in no patch, nor are
    /// non-finite ones.
    ///
    /// Source: Lim et al., "Patchwork: concentric zone-based region-wise ground segmentation", 2021, section III-B.
    pub(super) fn new(points: &[Point3<f32>], min_range: f32, max_range: f32) -> Self {
        let mut patch_of = vec![0u32; points.len()];
        let borders = zone_borders(min_range, max_range);
        let chunks = patch_of.par_chunks_mut(CHUNK).zip(points.par_chunks(CHUNK));
        chunks.for_each(|(out, points)| number(points, &borders, out));
        let mut starts = vec![0usize; NUM_PATCHES + 2];
        patch_of.iter().for_each(|&patch| starts[patch as usize + 1] += 1);
        for i in 1..starts.len() {
            starts[i] += starts[i - 1];
        }
        let n = starts[NUM_PATCHES];
        let mut out = Self { xs: vec![0.0; n], ys: vec![0.0; n], zs: vec![0.0; n], indices: vec![0; n], starts };
        let mut next = out.starts.clone();
        for ((&patch, p), i) in patch_of.iter().zip(points).zip(0u32..) {
            if patch != NONE {
                let place = &mut next[patch as usize];
                out.xs[*place] = p.x;
                out.ys[*place] = p.y;
                out.zs[*place] = p.z;
                out.indices[*place] = i;
                *place += 1;
            }
        }
        out
    }

    /// Places of a patch's points.
    pub(super) fn places(&self, patch: usize) -> std::ops::Range<usize> {
        self.starts[patch]..self.starts[patch + 1]
    }
}

/// Which ring a patch is of, counted from the sensor.
pub(super) fn ring_of(patch: usize) -> usize {
    let (mut first, mut ring) = (0, 0);
    for (rings, sectors) in RINGS.iter().zip(SECTORS) {
        if patch < first + rings * sectors {
            return ring + (patch - first) / sectors;
        }
        first += rings * sectors;
        ring += rings;
    }
    ring
}

/// Inner borders of the zones, and the outer one of the last.
fn zone_borders(min: f32, max: f32) -> [f32; 5] {
    [min, (7.0 * min + max) / 8.0, (3.0 * min + max) / 4.0, (min + max) / 2.0, max]
}

by_processor! {
    fn number(points: &[Point3<f32>], borders: &[f32; 5], out: &mut [u32]) {
        let first: [f32; 4] = [0.0, 32.0, 160.0, 376.0];
        let per_metre: [f32; 4] = std::array::from_fn(|k| RINGS[k] as f32 / (borders[k + 1] - borders[k]));
        for (out, p) in out.iter_mut().zip(points) {
            let r = (p.x * p.x + p.y * p.y).sqrt();
            let pick = |of: &[f32; 4]| {
                let inner = if r < borders[1] { of[0] } else { of[1] };
                let outer = if r < borders[3] { of[2] } else { of[3] };
                if r < borders[2] { inner } else { outer }
            };
            let zone = [borders[0], borders[1], borders[2], borders[3]];
            let sectors = pick(&[16.0, 32.0, 54.0, 32.0]);
            let ring = ((r - pick(&zone)) * pick(&per_metre)).floor().clamp(0.0, pick(&[1.0, 3.0, 3.0, 3.0]));
            let sector = (turns(p.x, p.y) * sectors).floor().clamp(0.0, sectors - 1.0);
            let patch = pick(&first) + ring * sectors + sector;
            let inside = r > borders[0] && r <= borders[4] && p.z.abs() < f32::INFINITY;
            // The value is small and whole; the conversion that saturates would not vectorise.
            *out = if inside { patch as u32 } else { NONE };
        }
    }
}

/// The angle of (x, y) from x in turns, 0 to 1, to 1e-4: where sectors end is a convention.
#[inline]
fn turns(x: f32, y: f32) -> f32 {
    let (ax, ay) = (x.abs(), y.abs());
    let t = ax.min(ay) / ax.max(ay).max(f32::MIN_POSITIVE);
    let s = t * t;
    // Arc tangent over [0, 1] by odd powers (Abramowitz and Stegun 4.4.49, over a full turn).
    let a = t * (0.999_866 + s * (-0.330_299_5 + s * (0.180_141 + s * (-0.085_133 + s * 0.020_835_1)))) * 0.159_154_94;
    let octant = if ay > ax { 0.25 - a } else { a };
    let half = if x < 0.0 { 0.5 - octant } else { octant };
    if y < 0.0 { 1.0 - half } else { half }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_point_in_range_is_in_the_patch_of_its_ring_and_sector() {
        let points: Vec<Point3<f32>> = (0..20_000u32)
            .map(|i| {
                let (r, a) = ((i % 977) as f32 * 0.1, i as f32 * 0.37);
                Point3::new(r * a.cos(), r * a.sin(), -1.7)
            })
            .collect();
        let patches = Patches::new(&points, 2.7, 80.0);
        let in_range = |p: &&Point3<f32>| p.coords.xy().norm() > 2.7 && p.coords.xy().norm() <= 80.0;
        assert!(patches.indices.len().abs_diff(points.iter().filter(in_range).count()) <= 1);
        for patch in 0..NUM_PATCHES {
            let members: Vec<&Point3<f32>> =
                patches.places(patch).map(|place| &points[patches.indices[place] as usize]).collect();
            let ring = ring_of(patch);
            let depth = if ring < 2 {
                9.67 / 2.0
            } else if ring < 6 {
                9.67 / 4.0
            } else if ring < 10 {
                19.33 / 4.0
            } else {
                38.65 / 4.0
            };
            for p in &members {
                assert!((p.coords.xy().norm() - members[0].coords.xy().norm()).abs() < depth + 0.1, "{patch}");
                assert!(p.coords.xy().angle(&members[0].coords.xy()) < std::f32::consts::TAU / 16.0 + 0.01);
            }
        }
    }

    #[test]
    fn the_turn_agrees_with_the_arc_tangent() {
        for i in 0..1000 {
            let angle = f64::from(i) * 0.00628;
            let expected = (angle / std::f64::consts::TAU) as f32;
            assert!((turns(angle.cos() as f32, angle.sin() as f32) - expected).abs() < 1e-4);
        }
        assert!((0.0..=1.0).contains(&turns(0.0, 0.0)));
    }
}
