//! One image as the tracker sees it: ORB features at undistorted pixels, in a grid for search by place.

use crate::tracking::LostReason;
use nalgebra::{Point3, Vector2};
use percept_geometry::{CameraIntrinsics, RgbImage};
use percept_perception::features2d::{Descriptors, Orb, OrbParams};

/// Number of a point, in the order of creation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct PointId(pub(super) u32);

/// From one pyramid level to the next: ORB's usual factor.
pub(super) const SCALE_FACTOR: f64 = 1.2;
/// Pyramid levels: ORB's usual number.
pub(super) const NUM_LEVELS: usize = 8;
/// Edge of a cell of the search grid, pixels. Halved 24.1, doubled 25.6 ([`super`]).
const CELL_PX: f64 = 24.0;
/// Fewer features than this are no texture. Halved and doubled 25.1 ([`super`]).
pub(super) const MIN_FEATURES: usize = 80;
/// Rays farther than this from the optical axis are not used: tangent of 70 degrees. Halved and doubled 25.1
/// ([`super`]).
const MAX_TANGENT: f64 = 2.75;
/// A pixel darker or brighter than these holds no detail; so large a share of them is a wrong exposure. All three
/// halved and doubled, the second by its distance from white, 25.1: no image there is spoilt ([`super`]).
const DARK: u8 = 3;
const BRIGHT: u8 = 252;
const SPOILT_SHARE: f64 = 0.7;

/// Standard deviation of a keypoint on a level, pixels of the full image.
pub(super) fn sigma(octave: u8) -> f64 {
    SCALE_FACTOR.powi(i32::from(octave))
}

/// The rectified pinhole that undistorted pixels belong to: one focal length, centre at (0, 0).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Lens {
    /// Pixels.
    pub(super) focal: f64,
    /// What the image covers, undistorted pixels.
    pub(super) min: Vector2<f64>,
    pub(super) max: Vector2<f64>,
}

impl Lens {
    pub(super) fn of(k: &CameraIntrinsics) -> Self {
        let focal = 0.5 * (k.fx + k.fy);
        let (mut min, mut max) = (Vector2::repeat(f64::MAX), Vector2::repeat(f64::MIN));
        let (w, h) = ((k.width - 1) as f64, (k.height - 1) as f64);
        // The border's extremes lie at corners (pincushion) or at the middles of sides (barrel).
        for i in 0..=8 {
            let s = f64::from(i) / 8.0;
            for (u, v) in [(s * w, 0.0), (s * w, h), (0.0, s * h), (w, s * h)] {
                let p = k.ray(u, v).coords.xy().map(|x| if x.is_finite() { x } else { MAX_TANGENT });
                let p = p.map(|x| x.clamp(-MAX_TANGENT, MAX_TANGENT)) * focal;
                (min, max) = (min.inf(&p), max.sup(&p));
            }
        }
        Self { focal, min, max }
    }

    /// Undistorted pixel of a point in the camera; none behind it or outside the image.
    #[inline]
    pub(super) fn project(&self, p: &Point3<f64>) -> Option<Vector2<f64>> {
        if p.z <= 1e-6 {
            return None;
        }
        let pixel = p.coords.xy() * (self.focal / p.z);
        let inside = pixel.x >= self.min.x && pixel.x <= self.max.x && pixel.y >= self.min.y && pixel.y <= self.max.y;
        inside.then_some(pixel)
    }

    /// The pinhole for estimators that take intrinsics; its image size is of no account to them.
    pub(super) fn intrinsics(&self) -> CameraIntrinsics {
        let size = self.max - self.min;
        let side = |x: f64| (x.ceil() as usize).clamp(1, 16384);
        CameraIntrinsics::pinhole(side(size.x), side(size.y), self.focal, self.focal, 0.0, 0.0)
    }
}

/// Features of an image.
#[derive(Debug, Clone)]
pub(super) struct Frame {
    /// Undistorted, of the [`Lens`].
    pub(super) pixels: Vec<Vector2<f64>>,
    pub(super) octaves: Vec<u8>,
    pub(super) descriptors: Vec<[u64; 4]>,
    /// Which map point each feature shows.
    pub(super) points: Vec<Option<PointId>>,
    grid: Grid,
}

impl Frame {
    /// Bytes, about: of each feature place, octave, look and point.
    pub(super) fn memory_bytes(&self) -> usize {
        self.len() * (size_of::<Vector2<f64>>() + size_of::<[u64; 4]>() + size_of::<Option<PointId>>() + 1)
    }

    /// Where the point is that a feature shows at a distance along the camera's axis.
    pub(super) fn at_depth(&self, feature: usize, lens: &Lens, z: f64) -> Point3<f64> {
        Point3::from(self.pixels[feature].push(lens.focal) * (z / lens.focal))
    }

    pub(super) fn len(&self) -> usize {
        self.pixels.len()
    }

    /// Features within `radius` of `at` (a square) on the levels `levels`, ascending cell by cell.
    pub(super) fn near(&self, at: &Vector2<f64>, radius: f64, levels: (u8, u8), out: &mut Vec<u32>) {
        out.clear();
        let (lo, hi) =
            (self.grid.cell(&(at - Vector2::repeat(radius))), self.grid.cell(&(at + Vector2::repeat(radius))));
        for row in lo.1..=hi.1 {
            let cells = row * self.grid.columns;
            let range = self.grid.starts[cells + lo.0] as usize..self.grid.starts[cells + hi.0 + 1] as usize;
            out.extend(self.grid.items[range].iter().filter(|&&i| {
                let (p, level) = (&self.pixels[i as usize], self.octaves[i as usize]);
                level >= levels.0 && level <= levels.1 && (p.x - at.x).abs() <= radius && (p.y - at.y).abs() <= radius
            }));
        }
    }

    /// Where a feature is and its standard deviation, pixels.
    pub(super) fn seen(&self, feature: usize) -> (Vector2<f64>, f64) {
        (self.pixels[feature], sigma(self.octaves[feature]))
    }

    pub(super) fn binary(&self) -> Descriptors {
        Descriptors::Binary(self.descriptors.clone())
    }
}

/// Differing bits.
#[inline]
pub(super) fn hamming(a: &[u64; 4], b: &[u64; 4]) -> u32 {
    (a[0] ^ b[0]).count_ones() + (a[1] ^ b[1]).count_ones() + (a[2] ^ b[2]).count_ones() + (a[3] ^ b[3]).count_ones()
}

/// Feature numbers by cell.
#[derive(Debug, Clone)]
struct Grid {
    min: Vector2<f64>,
    columns: usize,
    rows: usize,
    starts: Vec<u32>,
    items: Vec<u32>,
}

impl Grid {
    fn new(lens: &Lens, pixels: &[Vector2<f64>]) -> Self {
        let cells = |x: f64| ((x / CELL_PX).ceil() as usize).clamp(1, 512);
        let size = lens.max - lens.min;
        let mut grid =
            Self { min: lens.min, columns: cells(size.x), rows: cells(size.y), starts: vec![], items: vec![] };
        let cell_of: Vec<usize> = pixels
            .iter()
            .map(|p| {
                let (x, y) = grid.cell(p);
                y * grid.columns + x
            })
            .collect();
        let mut starts = vec![0u32; grid.columns * grid.rows + 1];
        cell_of.iter().for_each(|&c| starts[c + 1] += 1);
        (1..starts.len()).for_each(|i| starts[i] += starts[i - 1]);
        let mut next = starts.clone();
        grid.items = vec![0; pixels.len()];
        for (i, &c) in cell_of.iter().enumerate() {
            grid.items[next[c] as usize] = i as u32;
            next[c] += 1;
        }
        grid.starts = starts;
        grid
    }

    /// Column and row, clamped to the grid.
    fn cell(&self, p: &Vector2<f64>) -> (usize, usize) {
        let at = |x: f64, n: usize| ((x / CELL_PX).max(0.0) as usize).min(n - 1);
        (at(p.x - self.min.x, self.columns), at(p.y - self.min.y, self.rows))
    }
}

/// Finds features: fewer than half of those wanted, and the threshold is lowered once, for dim and smooth scenes.
pub(super) fn extract(
    image: &RgbImage,
    k: &CameraIntrinsics,
    lens: &Lens,
    max_features: usize,
) -> Result<Frame, LostReason> {
    if (image.width(), image.height()) != (k.width, k.height) {
        return Err(LostReason::IntrinsicsMismatch);
    }
    let grey = image.to_gray();
    let spoilt = grey.data().iter().filter(|&&g| g <= DARK || g >= BRIGHT).count();
    if spoilt as f64 > SPOILT_SHARE * grey.data().len() as f64 {
        return Err(LostReason::BadExposure);
    }
    let with = |fast_threshold: u8| {
        let params = OrbParams { max_features, num_levels: NUM_LEVELS, scale_factor: SCALE_FACTOR, fast_threshold };
        Orb::new(params).and_then(|orb| orb.extract(&grey)).map_err(|_| LostReason::IntrinsicsMismatch)
    };
    let mut features = with(14)?;
    if features.keypoints.len() < max_features / 2 {
        features = with(7)?;
    }
    let Descriptors::Binary(all) = features.descriptors else { return Err(LostReason::NoTexture) };
    let (mut pixels, mut octaves, mut descriptors) = (vec![], vec![], vec![]);
    for (keypoint, descriptor) in features.keypoints.iter().zip(all) {
        let ray = k.ray(f64::from(keypoint.u), f64::from(keypoint.v)).coords.xy();
        if ray.iter().all(|x| x.abs() <= MAX_TANGENT) {
            pixels.push(ray * lens.focal);
            octaves.push(keypoint.octave.clamp(0, NUM_LEVELS as i32 - 1) as u8);
            descriptors.push(descriptor);
        }
    }
    if pixels.len() < MIN_FEATURES {
        return Err(LostReason::NoTexture);
    }
    let (grid, points) = (Grid::new(lens, &pixels), vec![None; pixels.len()]);
    Ok(Frame { pixels, octaves, descriptors, points, grid })
}
