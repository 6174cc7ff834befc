//! What the keyframes of a submap saw, in one cloud, with a picture of it from above.

use nalgebra::{Point3, Translation3};
use percept_geometry::{GrayImage, KeyframeId, KeyframeScan, PointCloud, Pose};
use percept_perception::cloud::voxel_downsample;
use percept_perception::features2d::{Features, Keypoint, Orb, OrbParams};
use rustc_hash::FxHashSet;

/// Pixels and voxels are this share of the usual range, rounded to a power of two so that maps can be compared, and
/// within these bounds (m). About a degree at that range; the bounds are those of 7.5 and 30 m.
const FINENESS: f64 = 1.0 / 60.0;
const VOXELS_M: (f64, f64) = (0.125, 0.5);
/// The picture reaches so many usual ranges from the anchor, and is at most so many pixels wide. The first halved 37 and
/// 103, doubled 30 and 106; the second halved and doubled as it is ([`super`]).
const REACH: f64 = 1.6;
const MOST_PIXELS: usize = 400;
/// Keypoints of a picture. Halved 30 and 106, doubled as it is ([`super`]).
const FEATURES: usize = 300;
/// Fewer points make no place. Halved as it is, doubled 30 and 106 ([`super`]).
const FEWEST_POINTS: usize = 300;

/// A keyframe with base to map.
pub(super) type Placed<'a> = (KeyframeId, &'a KeyframeScan, Pose);

/// A part of the way as one thing: it holds no points, as the keyframes do.
#[derive(Debug, Clone)]
pub(super) struct Submap {
    /// Ascending in the order of making.
    pub(super) number: u64,
    /// The keyframe in the middle, to which loops are tied.
    pub(super) anchor: KeyframeId,
    /// All of them, oldest first.
    pub(super) keyframes: Vec<KeyframeId>,
    /// Pixels of its picture, metres.
    pub(super) voxel_m: f64,
    /// Of the picture from above.
    pub(super) features: Features,
    /// Length of the way up to its end, and its own length, metres.
    pub(super) travel: f64,
    pub(super) length_m: f64,
}

impl Submap {
    /// Of keyframes; none where they saw too little.
    pub(super) fn gather(number: u64, keyframes: &[Placed<'_>], travel: f64, length_m: f64) -> Option<Self> {
        let (anchor, _, t_map_anchor) = keyframes.get(keyframes.len() / 2)?;
        let Surface { cloud, voxel_m, usual_range } = Surface::around(t_map_anchor, keyframes)?;
        let width = ((2.0 * REACH * usual_range / voxel_m).ceil() as usize).clamp(64, MOST_PIXELS);
        let orb = Orb::new(OrbParams { max_features: FEATURES, num_levels: 1, ..OrbParams::default() }).ok()?;
        let features = orb.extract(&from_above(&cloud.positions, voxel_m, width)?).ok()?;
        let keyframes = keyframes.iter().map(|k| k.0).collect();
        Some(Self { number, anchor: *anchor, keyframes, voxel_m, features, travel, length_m })
    }
}

/// What some keyframes saw.
#[derive(Debug)]
pub(super) struct Surface {
    /// One point a half voxel, metres: the axes are the session map's, the origin is at a pose in it.
    pub(super) cloud: PointCloud,
    pub(super) voxel_m: f64,
    /// How far the lidar sees, metres.
    usual_range: f64,
}

impl Submap {
    /// Bytes, about.
    pub(super) fn memory_bytes(&self) -> usize {
        // Descriptors have 256 bits.
        let features = self.features.keypoints.len() * (size_of::<Keypoint>() + 32);
        size_of::<Self>() + self.keyframes.capacity() * size_of::<KeyframeId>() + features
    }
}

impl Surface {
    /// Around a pose in the map; none where they saw too little.
    pub(super) fn around(t_map_here: &Pose, keyframes: &[Placed<'_>]) -> Option<Self> {
        let usual_range = keyframes.iter().map(|(_, scan, _)| range(scan)).fold(0.0, f64::max);
        let voxel_m = voxel_for(usual_range);
        let t_submap_map = Translation3::from(-t_map_here.translation.vector);
        let points = keyframes.iter().flat_map(|(_, scan, t_map_base)| {
            let t_submap_base = t_submap_map * t_map_base;
            scan.hits.positions.iter().map(move |p| (t_submap_base * p.cast::<f64>()).cast::<f32>())
        });
        let all = PointCloud::from_positions(points.collect());
        let cloud = voxel_downsample(&all, 0.5 * voxel_m).ok()?;
        (cloud.len() >= FEWEST_POINTS).then_some(Self { cloud, voxel_m, usual_range })
    }
}

/// How high things are at each place: the number of voxels with points above each other, as grey.
fn from_above(points: &[Point3<f32>], voxel_m: f64, width: usize) -> Option<GrayImage> {
    let half = 0.5 * width as f64;
    let mut seen = FxHashSet::default();
    let mut counts = vec![0u16; width * width];
    for p in points {
        let [x, y, z] = [p.x, p.y, p.z].map(|v| (f64::from(v) / voxel_m).floor());
        let (u, v) = (x + half, y + half);
        let inside = u >= 0.0 && v >= 0.0 && u < width as f64 && v < width as f64;
        if inside && seen.insert((u as u32, v as u32, z as i32)) {
            counts[v as usize * width + u as usize] += 1;
        }
    }
    // The floor is one voxel high and says nothing; the highest columns set the scale.
    let mut heights: Vec<u16> = counts.iter().copied().filter(|&c| c > 1).collect();
    if heights.is_empty() {
        return None;
    }
    let k = heights.len() * 19 / 20;
    let top = f64::from(*heights.select_nth_unstable(k).1).max(2.0);
    let grey = counts.iter().map(|&c| (255.0 * (f64::from(c.saturating_sub(1)) / (top - 1.0)).min(1.0)) as u8);
    GrayImage::new(width, width, grey.collect()).ok()
}

/// Edge of the voxels for what is seen so far, metres.
pub(super) fn voxel_for(range: f64) -> f64 {
    2f64.powf((range * FINENESS).log2().round()).clamp(VOXELS_M.0, VOXELS_M.1)
}

/// The 90th percentile of the distances from the sensor, metres, of about a thousand points; 0 without points.
pub(super) fn range(scan: &KeyframeScan) -> f64 {
    let (points, origin) = (&scan.hits.positions, scan.t_base_sensor.translation.vector.cast::<f32>());
    let step = (points.len() / 1000).max(1);
    let mut ranges: Vec<f32> = points.iter().step_by(step).map(|p| (p.coords - origin).norm()).collect();
    let k = ranges.len() * 9 / 10;
    if k < ranges.len() { f64::from(*ranges.select_nth_unstable_by(k, f32::total_cmp).1) } else { 0.0 }
}
