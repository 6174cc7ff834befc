//! A box of voxels.

use crate::PlanError;
use nalgebra::Point3;
use percept_geometry::{Aabb3, Voxel};
use percept_mapping::{MappingError, VoxelMap};

/// A box of 3D occupancy, aligned with the map's axes: [`DenseGrid`](percept_mapping::DenseGrid) with a height.
#[derive(Debug, Clone, PartialEq)]
pub struct DenseVoxels {
    /// Edge of a voxel, metres.
    pub voxel_size_m: f64,
    /// The voxel in the box's lowest corner; that corner lies at `low` times `voxel_size_m` in the map frame.
    pub low: Voxel,
    /// Voxels along x, y and z.
    pub size: [usize; 3],
    /// Percent occupied, 0 to 100, -1 where nothing is known: x fastest, then y, then z.
    pub percent: Vec<i8>,
}

/// Voxels are numbered with 32 bits.
const MOST_VOXELS: u64 = u32::MAX as u64;

impl DenseVoxels {
    /// Checks shape and values.
    ///
    /// # Errors
    /// `InvalidParam` naming `voxel_size_m`, `voxels.low`, `voxels.size` or `voxels.percent`; `GridTooLarge` beyond what
    /// 32 bits can number.
    pub fn new(voxel_size_m: f64, low: Voxel, size: [usize; 3], percent: Vec<i8>) -> Result<Self, PlanError> {
        let voxels = Self { voxel_size_m, low, size, percent };
        voxels.validate()?;
        Ok(voxels)
    }

    /// A box of which nothing is known, around all voxels that `region` (map frame, metres) touches. Memory is taken only
    /// after its size was found to be at most `max_voxels`.
    ///
    /// # Errors
    /// `InvalidParam` for a voxel size that is not positive, and for a region without volume or beyond the range of voxels;
    /// `GridTooLarge`.
    pub fn unknown(voxel_size_m: f64, region: &Aabb3, max_voxels: usize) -> Result<Self, PlanError> {
        check_voxel_size(voxel_size_m)?;
        let refuse = |value: f64| {
            let remedy = "give a box with volume, in metres, within 2^31 voxels of the origin";
            Err(PlanError::InvalidParam { field: "region", value, remedy })
        };
        for i in 0..3 {
            if !(region.max[i] > region.min[i] && region.max[i].is_finite() && region.min[i].is_finite()) {
                return refuse(region.max[i] - region.min[i]);
            }
        }
        let Some(low) = Voxel::containing(&region.min, voxel_size_m) else { return refuse(region.min.coords.amin()) };
        let Some(high) = Voxel::containing(&region.max, voxel_size_m) else { return refuse(region.max.coords.amax()) };
        let sides = [(low.x, high.x), (low.y, high.y), (low.z, high.z)].map(|(a, b)| i64::from(b) - i64::from(a) + 1);
        let voxels = sides.iter().try_fold(1u64, |product, side| product.checked_mul(*side as u64)).unwrap_or(u64::MAX);
        let limit = (max_voxels as u64).min(MOST_VOXELS);
        if voxels > limit {
            return Err(PlanError::GridTooLarge { cells: voxels, limit });
        }
        let size = sides.map(|side| side as usize);
        Ok(Self { voxel_size_m, low, size, percent: vec![-1; voxels as usize] })
    }

    /// What a map knows within `region` (map frame, metres), or within the smallest box around all that it knows.
    ///
    /// # Errors
    /// As [`DenseVoxels::unknown`]; `Map`. A map that knows nothing has no box: `InvalidParam`, unless a region is given.
    pub fn of_map(map: &VoxelMap, region: Option<&Aabb3>, max_voxels: usize) -> Result<Self, PlanError> {
        let size = map.params().voxel_size_m;
        let sized = region.map(|region| Self::unknown(size, region, max_voxels)).transpose()?;
        let blocks = map.blocks(region, false, 0, max_voxels).map_err(|error| match error {
            MappingError::RegionTooLarge { cells, limit } => PlanError::GridTooLarge { cells, limit },
            other => PlanError::Map(other),
        })?;
        let edge = 8.0 * size;
        let mut out = match sized {
            Some(out) => out,
            None => {
                let mut around = Aabb3::empty();
                for block in &blocks {
                    let corner = |up: f64| Point3::from(block.key.map(|k| (f64::from(k) + up) * edge));
                    // A little less, so that what only touches the next block is not in it.
                    around.grow(&corner(1e-6));
                    around.grow(&corner(1.0 - 1e-6));
                }
                Self::unknown(size, &around, max_voxels)?
            }
        };
        for block in &blocks {
            for (slot, value) in block.percent.iter().enumerate() {
                let [x, y, z] = [slot % 8, slot / 8 % 8, slot / 64].map(|v| v as i32);
                let voxel = Voxel::new(8 * block.key[0] + x, 8 * block.key[1] + y, 8 * block.key[2] + z);
                if let Some(index) = out.index(voxel) {
                    out.percent[index] = *value;
                }
            }
        }
        Ok(out)
    }

    /// Checks shape and values.
    ///
    /// # Errors
    /// As [`DenseVoxels::new`].
    pub fn validate(&self) -> Result<(), PlanError> {
        check_voxel_size(self.voxel_size_m)?;
        let refuse = |field, value, remedy| Err(PlanError::InvalidParam { field, value, remedy });
        let product = self.size.iter().try_fold(1u64, |product, side| product.checked_mul(*side as u64));
        match product {
            Some(0) => return refuse("voxels.size", 0.0, "give at least one voxel along each axis"),
            Some(voxels) if voxels > MOST_VOXELS => {
                return Err(PlanError::GridTooLarge { cells: voxels, limit: MOST_VOXELS });
            }
            Some(voxels) if voxels == self.percent.len() as u64 => {}
            _ => return refuse("voxels.size", self.percent.len() as f64, "give as many values as the box has voxels"),
        }
        let lows = [self.low.x, self.low.y, self.low.z];
        if let Some((low, _)) = lows.iter().zip(self.size).find(|(low, side)| i64::from(**low) + *side as i64 > 1 << 31)
        {
            return refuse("voxels.low", f64::from(*low), "keep the box within 2^31 voxels of the origin");
        }
        match self.percent.iter().find(|v| !(-1..=100).contains(*v)) {
            Some(value) => refuse("voxels.percent", f64::from(*value), "give 0 to 100, or -1 where nothing is known"),
            None => Ok(()),
        }
    }

    /// Index of a voxel; none outside of the box.
    pub fn index(&self, voxel: Voxel) -> Option<usize> {
        let along = |v: i32, low: i32, side: usize| {
            let off = usize::try_from(i64::from(v) - i64::from(low)).ok()?;
            (off < side).then_some(off)
        };
        let x = along(voxel.x, self.low.x, self.size[0])?;
        let y = along(voxel.y, self.low.y, self.size[1])?;
        let z = along(voxel.z, self.low.z, self.size[2])?;
        Some((z * self.size[1] + y) * self.size[0] + x)
    }
}

fn check_voxel_size(value: f64) -> Result<(), PlanError> {
    let is_sound = (1e-3..=100.0).contains(&value);
    let remedy = "choose 0.001 to 100";
    if is_sound { Ok(()) } else { Err(PlanError::InvalidParam { field: "voxel_size_m", value, remedy }) }
}
