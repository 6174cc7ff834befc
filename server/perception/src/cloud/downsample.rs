//! One point a voxel.

use super::{CloudError, positive};
use nalgebra::{Point3, Vector3};
use percept_geometry::{PointCloud, Voxel, cloud::is_finite};
use rustc_hash::FxHashMap;

/// The centroid of the points of every voxel of edge `voxel_size_m`, in the order in which the voxels first
/// appear; channels are averaged, normals made unit again (zero if they cancel). Voxels are aligned with the
/// frame's origin. Points that are not finite are dropped.
///
/// # Errors
/// `Input` if the size is not positive or a channel has another length; `VoxelTooSmall` if indices overflow.
pub fn voxel_downsample(cloud: &PointCloud, voxel_size_m: f64) -> Result<PointCloud, CloudError> {
    positive("voxel_size_m", voxel_size_m)?;
    cloud.validate()?;
    let (members, num_voxels) = assign(&cloud.positions, voxel_size_m)?;
    let mut counts = vec![0u32; num_voxels];
    members.iter().for_each(|&(_, slot)| counts[slot as usize] += 1);
    let mean = Mean { members: &members, counts: &counts };
    let size = voxel_size_m;
    Ok(PointCloud {
        // Offsets from the voxel's corner keep their digits far from the origin.
        positions: mean
            .of(|i| {
                let p: Point3<f64> = cloud.positions[i].cast();
                p - corner(&p, size)
            })
            .into_iter()
            .zip(first_corners(cloud, &members, num_voxels, size))
            .map(|(offset, corner)| (corner + offset).cast())
            .collect(),
        colors: cloud.colors.as_ref().map(|c| {
            let means = mean.of(|i| Vector3::from(c[i]).cast::<f64>());
            means.iter().map(|m| [m.x, m.y, m.z].map(|v| v.round() as u8)).collect()
        }),
        intensities: cloud.intensities.as_ref().map(|c| mean.of_scalar(c)),
        normals: cloud.normals.as_ref().map(|c| {
            let means = mean.of(|i| c[i].cast::<f64>());
            means.iter().map(|m| m.try_normalize(1e-9).unwrap_or_default().cast()).collect()
        }),
        time_offsets_s: cloud.time_offsets_s.as_ref().map(|c| mean.of_scalar(c)),
    })
}

/// The voxel's slot of every finite point, slots numbered by first appearance, and how many there are.
fn assign(positions: &[Point3<f32>], size: f64) -> Result<(Vec<(u32, u32)>, usize), CloudError> {
    let mut slots: FxHashMap<Voxel, u32> = FxHashMap::default();
    let mut members = Vec::with_capacity(positions.len());
    let mut last = None;
    for (p, i) in positions.iter().zip(0..).filter(|(p, _)| is_finite(p)) {
        let voxel = Voxel::containing(&p.cast(), size).ok_or_else(|| too_small(positions, size))?;
        // Neighbours in a cloud are neighbours in space: often the same voxel again.
        let slot = match last {
            Some((same, slot)) if same == voxel => slot,
            _ => {
                let next = slots.len() as u32;
                *slots.entry(voxel).or_insert(next)
            }
        };
        last = Some((voxel, slot));
        members.push((i, slot));
    }
    Ok((members, slots.len()))
}

fn too_small(positions: &[Point3<f32>], voxel_size_m: f64) -> CloudError {
    let finite = positions.iter().filter(|p| is_finite(p));
    let coordinate_m = f64::from(finite.flat_map(|p| [p.x, p.y, p.z]).fold(0.0f32, |m, v| m.max(v.abs())));
    CloudError::VoxelTooSmall { voxel_size_m, coordinate_m, at_least_m: coordinate_m / f64::from(i32::MAX) }
}

fn corner(p: &Point3<f64>, size: f64) -> Point3<f64> {
    p.map(|c| (c / size).floor() * size)
}

fn first_corners(cloud: &PointCloud, members: &[(u32, u32)], num_voxels: usize, size: f64) -> Vec<Point3<f64>> {
    let mut out = Vec::with_capacity(num_voxels);
    for &(i, slot) in members {
        if slot as usize == out.len() {
            out.push(corner(&cloud.positions[i as usize].cast(), size));
        }
    }
    out
}

/// Averages over the members of each voxel.
struct Mean<'a> {
    members: &'a [(u32, u32)],
    counts: &'a [u32],
}

impl Mean<'_> {
    fn of(&self, value: impl Fn(usize) -> Vector3<f64>) -> Vec<Vector3<f64>> {
        let mut sums = vec![Vector3::zeros(); self.counts.len()];
        self.members.iter().for_each(|&(i, slot)| sums[slot as usize] += value(i as usize));
        sums.iter_mut().zip(self.counts).for_each(|(s, &n)| *s /= f64::from(n));
        sums
    }

    fn of_scalar(&self, channel: &[f32]) -> Vec<f32> {
        let mut sums = vec![0.0f64; self.counts.len()];
        self.members.iter().for_each(|&(i, slot)| sums[slot as usize] += f64::from(channel[i as usize]));
        sums.iter().zip(self.counts).map(|(s, &n)| (s / f64::from(n)) as f32).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn voxels_come_in_order_of_appearance_with_averaged_channels() {
        let cloud = PointCloud {
            positions: [[2.5, 0.5, 0.5], [0.2, 0.2, 0.2], [f32::NAN, 0.0, 0.0], [0.4, 0.8, 0.2], [-0.1, 0.0, 0.0]]
                .map(Point3::from)
                .to_vec(),
            colors: Some(vec![[9, 9, 9], [0, 10, 255], [1, 1, 1], [10, 21, 255], [7, 7, 7]]),
            intensities: Some(vec![1.0, 2.0, 3.0, 4.0, 5.0]),
            normals: Some(vec![Vector3::z(), Vector3::x(), Vector3::x(), Vector3::y(), Vector3::zeros()]),
            time_offsets_s: None,
        };
        let out = voxel_downsample(&cloud, 1.0).unwrap();
        assert_eq!(out.positions, [[2.5, 0.5, 0.5], [0.3, 0.5, 0.2], [-0.1, 0.0, 0.0]].map(Point3::from));
        assert_eq!(out.colors.unwrap(), [[9, 9, 9], [5, 16, 255], [7, 7, 7]]);
        assert_eq!(out.intensities.unwrap(), [1.0, 3.0, 5.0]);
        let h = 0.5f32.sqrt();
        assert_eq!(out.normals.unwrap(), [Vector3::z(), Vector3::new(h, h, 0.0), Vector3::zeros()]);
    }

    #[test]
    fn degenerate_clouds_give_answers_or_name_the_fault() {
        assert!(voxel_downsample(&PointCloud::default(), 0.1).unwrap().is_empty());
        let one = PointCloud::from_positions(vec![Point3::new(1e7, -1e7, 3.0); 5]);
        assert_eq!(voxel_downsample(&one, 0.05).unwrap().positions, [Point3::new(1e7, -1e7, 3.0)]);
        for size in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(voxel_downsample(&one, size).unwrap_err().to_string().starts_with("voxel_size_m"));
        }
        assert!(matches!(voxel_downsample(&one, 1e-6), Err(CloudError::VoxelTooSmall { .. })));
    }

    proptest! {
        #[test]
        fn every_point_is_in_the_voxel_of_one_output_point(
            points in prop::collection::vec(prop::array::uniform3(-3.0..3.0f32), 0..200), size in 0.05..2.0f64,
        ) {
            let cloud = PointCloud::from_positions(points.iter().map(|&p| Point3::from(p)).collect());
            let out = voxel_downsample(&cloud, size).unwrap();
            let mut voxels: Vec<Voxel> = cloud.positions.iter().filter_map(|p| Voxel::containing(&p.cast(), size)).collect();
            voxels.sort();
            voxels.dedup();
            prop_assert_eq!(out.len(), voxels.len());
            for p in &out.positions {
                let inside = |v: &Voxel| (v.center(size) - p.cast::<f64>()).abs().max() <= 0.5 * size + 1e-5;
                prop_assert!(voxels.iter().any(inside));
            }
        }
    }
}
