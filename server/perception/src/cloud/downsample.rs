//! One point a voxel.

use super::{CloudError, positive};
use nalgebra::{Point3, Vector3};
use percept_geometry::{PointCloud, cloud::is_finite};

/// The centroid of the points of every voxel of edge `voxel_size_m`, in the order in which the voxels first
/// appear; channels are averaged, normals made unit again (zero if they cancel). Voxels are aligned with the
/// frame's origin. Points that are not finite are dropped.
///
/// # Errors
/// `Input` if the size is not positive or a channel has another length; `VoxelTooSmall` if indices overflow.
pub fn voxel_downsample(cloud: &PointCloud, voxel_size_m: f64) -> Result<PointCloud, CloudError> {
    positive("voxel_size_m", voxel_size_m)?;
    cloud.validate()?;
    let has_channels = cloud.colors.is_some()
        || cloud.intensities.is_some()
        || cloud.normals.is_some()
        || cloud.time_offsets_s.is_some();
    let mut table = Table::with_room_for(cloud.len());
    let mut slots = if has_channels { vec![NONE; cloud.len()] } else { vec![] };
    assign(&cloud.positions, voxel_size_m, &mut table, &mut slots);
    if table.overflow {
        return Err(too_small(&cloud.positions, voxel_size_m));
    }
    let mean = Mean { slots: &slots, voxels: &table.voxels };
    Ok(PointCloud {
        positions: table.voxels.iter().map(VoxelSum::centroid).collect(),
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

fn too_small(positions: &[Point3<f32>], voxel_size_m: f64) -> CloudError {
    let finite = positions.iter().filter(|p| is_finite(p));
    let coordinate_m = f64::from(finite.flat_map(|p| [p.x, p.y, p.z]).fold(0.0f32, |m, v| m.max(v.abs())));
    CloudError::VoxelTooSmall { voxel_size_m, coordinate_m, at_least_m: coordinate_m / f64::from(i32::MAX) }
}

/// No slot: the point is not finite, or the place in the table is empty.
const NONE: u32 = u32::MAX;
/// Points whose voxels are computed at once, so that the arithmetic is vectorised and the lookup is not in its way.
const BLOCK: usize = 128;

/// A voxel and the sum of its points. Sums in f64 keep what f32 coordinates of 1e7 m have.
#[derive(Clone, Copy)]
struct VoxelSum {
    voxel: [i32; 3],
    count: u32,
    sum: [f64; 3],
}

impl VoxelSum {
    fn centroid(&self) -> Point3<f32> {
        let n = f64::from(self.count);
        Point3::from(self.sum.map(|s| (s / n) as f32))
    }
}

/// Voxels in the order of their appearance, found by open addressing with linear probing.
struct Table {
    /// Slots by hash; a power of two, at most half full.
    places: Vec<u32>,
    shift: u32,
    voxels: Vec<VoxelSum>,
    /// A voxel index did not fit.
    overflow: bool,
}

impl Table {
    fn with_room_for(points: usize) -> Self {
        // Clouds that are worth thinning have many points a voxel; others grow the table.
        let size = (points / 8).next_power_of_two().clamp(1 << 10, 1 << 22);
        Self { places: vec![NONE; size], shift: 64 - size.trailing_zeros(), voxels: Vec::new(), overflow: false }
    }

    #[inline(always)]
    fn hash(&self, [x, y, z]: [i32; 3]) -> usize {
        // Distinct odd factors in 64 bits, then Fibonacci hashing by the upper ones.
        let mixed = (x as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15)
            ^ (y as u64).wrapping_mul(0xc2b2_ae3d_27d4_eb4f)
            ^ (z as u64).wrapping_mul(0x1656_67b1_9e37_79f9);
        (mixed.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> self.shift) as usize
    }

    #[inline(always)]
    fn slot_of(&mut self, voxel: [i32; 3]) -> u32 {
        let mut place = self.hash(voxel);
        loop {
            let slot = self.places[place];
            if slot == NONE {
                return self.insert(voxel, place);
            }
            if self.voxels[slot as usize].voxel == voxel {
                return slot;
            }
            place = (place + 1) & (self.places.len() - 1);
        }
    }

    #[inline(never)]
    fn insert(&mut self, voxel: [i32; 3], place: usize) -> u32 {
        let slot = self.voxels.len() as u32;
        self.voxels.push(VoxelSum { voxel, count: 0, sum: [0.0; 3] });
        self.overflow |= voxel.iter().any(|v| *v == i32::MAX || *v == i32::MIN);
        self.places[place] = slot;
        if self.voxels.len() * 2 > self.places.len() {
            self.grow();
        }
        slot
    }

    fn grow(&mut self) {
        let size = 4 * self.places.len();
        self.places = vec![NONE; size];
        self.shift = 64 - size.trailing_zeros();
        for slot in 0..self.voxels.len() {
            let mut place = self.hash(self.voxels[slot].voxel);
            while self.places[place] != NONE {
                place = (place + 1) & (size - 1);
            }
            self.places[place] = slot as u32;
        }
    }
}

percept_geometry::by_processor! {
    /// Adds every finite point to its voxel; `slots`, if it has room, gets each point's slot.
    fn assign(positions: &[Point3<f32>], size: f64, table: &mut Table, slots: &mut [u32]) {
        let mut voxels = [[0i32; 3]; BLOCK];
        let mut finite = [false; BLOCK];
        let (mut last, mut slot) = ([i32::MIN; 3], NONE);
        for (block, points) in positions.chunks(BLOCK).enumerate() {
            for ((v, f), p) in voxels.iter_mut().zip(&mut finite).zip(points) {
                // Saturates beyond the range of i32, which is seen when the voxel is inserted.
                let index = |c: f32| (f64::from(c) / size).floor() as i32;
                *v = [index(p.x), index(p.y), index(p.z)];
                *f = is_finite(p);
            }
            for (k, p) in points.iter().enumerate() {
                if !finite[k] {
                    continue;
                }
                // Neighbours in a cloud are neighbours in space: often the same voxel again.
                if voxels[k] != last || slot == NONE {
                    slot = table.slot_of(voxels[k]);
                    last = voxels[k];
                }
                let sum = &mut table.voxels[slot as usize];
                sum.count += 1;
                sum.sum[0] += f64::from(p.x);
                sum.sum[1] += f64::from(p.y);
                sum.sum[2] += f64::from(p.z);
                if let Some(s) = slots.get_mut(block * BLOCK + k) {
                    *s = slot;
                }
            }
        }
    }
}

/// Averages over the members of each voxel.
struct Mean<'a> {
    slots: &'a [u32],
    voxels: &'a [VoxelSum],
}

impl Mean<'_> {
    fn of(&self, value: impl Fn(usize) -> Vector3<f64>) -> Vec<Vector3<f64>> {
        let mut sums = vec![Vector3::zeros(); self.voxels.len()];
        self.members().for_each(|(i, slot)| sums[slot] += value(i));
        sums.iter_mut().zip(self.voxels).for_each(|(s, v)| *s /= f64::from(v.count));
        sums
    }

    fn of_scalar(&self, channel: &[f32]) -> Vec<f32> {
        let mut sums = vec![0.0f64; self.voxels.len()];
        self.members().for_each(|(i, slot)| sums[slot] += f64::from(channel[i]));
        sums.iter().zip(self.voxels).map(|(s, v)| (s / f64::from(v.count)) as f32).collect()
    }

    fn members(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        self.slots.iter().enumerate().filter(|(_, s)| **s != NONE).map(|(i, s)| (i, *s as usize))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_geometry::Voxel;
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
