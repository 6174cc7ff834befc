//! Which feature of an image shows which map point: search by place and look.

use super::frame::{Frame, Lens, NUM_LEVELS, PointId, SCALE_FACTOR, hamming, sigma};
use super::map::Map;
use super::pose::Sighting;
use nalgebra::Point3;
use percept_geometry::Pose;
use rustc_hash::FxHashSet;

/// Descriptors that differ in more bits are not the same place, of 256 (unrelated ones differ in 128)... ORB-SLAM2's
/// code has 100.
pub(super) const FAR_BITS: u32 = 90;
/// ... and this where nothing else speaks for the match. ORB-SLAM2's code has 50.
pub(super) const NEAR_BITS: u32 = 55;
/// Beyond 60 degrees from where it was seen a point looks different. As in ORB-SLAM2's code.
const MIN_COSINE: f64 = 0.5;

/// Finds the points that the last frame showed around where they are expected; returns how many.
///
/// Nearer points change more from image to image: the radius grows with the level.
pub(super) fn follow(
    frame: &mut Frame,
    last: &Frame,
    map: &Map,
    t_camera_map: &Pose,
    lens: &Lens,
    radius: f64,
) -> usize {
    let mut near = vec![];
    let mut count = 0;
    for (i, id) in last.points.iter().enumerate() {
        let Some((id, p)) = id.and_then(|id| Some((id, map.points.get(&id)?))) else { continue };
        let Some(at) = lens.project(&(t_camera_map * p.position)) else { continue };
        let octave = last.octaves[i];
        let levels = (octave.saturating_sub(1), octave + 1);
        frame.near(&at, radius * sigma(octave), levels, &mut near);
        if let Some(f) = nearest(frame, &near, &last.descriptors[i], FAR_BITS, 0.9) {
            frame.points[f] = Some(id);
            count += 1;
        }
    }
    count
}

/// Finds further points of the map in an image whose pose is nearly known; returns how many lay in the image.
pub(super) fn look_for(
    frame: &mut Frame,
    points: &[PointId],
    map: &mut Map,
    t_camera_map: &Pose,
    lens: &Lens,
    radius: f64,
) -> usize {
    let taken: FxHashSet<PointId> = frame.points.iter().flatten().copied().collect();
    let center = t_camera_map.inverse_transform_point(&Point3::origin());
    let (mut near, mut visible) = (vec![], 0);
    for &id in points.iter().filter(|id| !taken.contains(id)) {
        let Some(p) = map.points.get_mut(&id) else { continue };
        let Some(at) = lens.project(&(t_camera_map * p.position)) else { continue };
        let ray = p.position - center;
        let distance = ray.norm();
        let cosine = ray.dot(&p.direction) / distance;
        if !p.in_range(distance) || cosine < MIN_COSINE {
            continue;
        }
        p.visible += 1;
        visible += 1;
        let level = p.level_at(distance);
        // As in ORB-SLAM: 2.5 pixels straight on, 4 from aside.
        let straight = if cosine > 0.998 { 2.5 } else { 4.0 };
        let levels = (level.saturating_sub(1), (level + 1).min(NUM_LEVELS as u8 - 1));
        frame.near(&at, radius * straight * sigma(level), levels, &mut near);
        if let Some(f) = nearest(frame, &near, &p.descriptor, FAR_BITS, 0.8) {
            frame.points[f] = Some(id);
        }
    }
    visible
}

/// The free feature nearest in looks, if it is clearly nearer than any other on its level.
fn nearest(frame: &Frame, among: &[u32], look: &[u64; 4], most: u32, ratio: f64) -> Option<usize> {
    let (mut best, mut second, mut at) = (u32::MAX, u32::MAX, None);
    let mut levels = (0u8, 0u8);
    for &f in among {
        let f = f as usize;
        if frame.points[f].is_some() {
            continue;
        }
        let d = hamming(&frame.descriptors[f], look);
        if d < best {
            (second, best) = (best, d);
            levels = (frame.octaves[f], levels.0);
            at = Some(f);
        } else if d < second {
            second = d;
            levels.1 = frame.octaves[f];
        }
    }
    let alike = levels.0 == levels.1 && f64::from(best) > ratio * f64::from(second);
    at.filter(|_| best <= most && !alike)
}

/// Where the image shows map points, with the features' numbers.
pub(super) fn sightings(frame: &Frame, map: &Map) -> (Vec<Sighting>, Vec<u32>) {
    let found = frame.points.iter().enumerate().filter_map(|(f, id)| {
        let point = map.points.get(&(*id)?)?.position;
        Some((Sighting { point, pixel: frame.pixels[f], sigma: sigma(frame.octaves[f]) }, f as u32))
    });
    found.unzip()
}

/// Whether two octaves fit two distances of a camera from one point, within a factor of 1.5 levels.
pub(super) fn scales_agree(octaves: (u8, u8), distances: (f64, f64)) -> bool {
    let by_level = sigma(octaves.0) / sigma(octaves.1);
    // Nearer is larger, so that it is seen on a coarser level.
    let by_distance = distances.1 / distances.0;
    let factor = 1.5 * SCALE_FACTOR;
    by_distance < by_level * factor && by_distance * factor > by_level
}
