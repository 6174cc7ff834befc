//! Where a beam crosses the voxels: layer after layer across its main axis.

use super::touched::floor;
use nalgebra::{Point3, Vector3};

/// Where a beam crosses the plane through the centres of a layer of voxels.
#[derive(Debug, Clone, Copy)]
pub(super) struct Crossing {
    /// The beam's main axis: 0, 1 or 2.
    pub(super) axis: usize,
    /// Voxel whose centre is the last before the crossing along both other axes.
    pub(super) voxel: [i32; 3],
    /// How far beyond that centre the beam crosses along the two axes after the main one, in voxels: 0 to 1.
    pub(super) beyond: [f64; 2],
    /// From the sensor, along the beam, in voxels.
    pub(super) along: f64,
}

impl Crossing {
    /// The axis's two others.
    pub(super) fn others(&self) -> [usize; 2] {
        [(self.axis + 1) % 3, (self.axis + 2) % 3]
    }

    /// The voxel whose centre is nearest.
    pub(super) fn nearest(&self) -> [i32; 3] {
        let mut voxel = self.voxel;
        for (axis, beyond) in self.others().into_iter().zip(self.beyond) {
            voxel[axis] += i32::from(beyond >= 0.5);
        }
        voxel
    }
}

/// Voxels are numbered within this, so that none next to them falls out of an `i32`.
const MOST_VOXELS: f64 = (1u64 << 30) as f64;

/// Shows where a beam crosses layers of voxels from `near` to `far` along it, in order. All lengths in voxels; the direction is
/// of length 1. Nothing is shown of a beam that leaves the numbers that voxels have.
#[inline]
pub(super) fn crossings(
    sensor: &Point3<f64>,
    direction: &Vector3<f64>,
    range: (f64, f64),
    visit: impl FnMut(&Crossing),
) {
    // Once for each axis, so that what is at which place in memory is known.
    match direction.iamax() {
        0 => across::<0>(sensor, direction, range, visit),
        1 => across::<1>(sensor, direction, range, visit),
        _ => across::<2>(sensor, direction, range, visit),
    }
}

#[inline(always)]
fn across<const AXIS: usize>(
    sensor: &Point3<f64>,
    direction: &Vector3<f64>,
    (near, far): (f64, f64),
    mut visit: impl FnMut(&Crossing),
) {
    // Centres at whole numbers.
    let origin = sensor.coords - Vector3::repeat(0.5);
    let (from, to) = (origin + direction * near, origin + direction * far);
    // Not a number is not below.
    if !(near <= far && from.iter().chain(to.iter()).all(|v| v.abs() < MOST_VOXELS)) {
        return;
    }
    let (a, b) = (from[AXIS], to[AXIS]);
    let (low, high) = (-floor(-a.min(b)), floor(a.max(b)));
    let is_forward = direction[AXIS] > 0.0;
    let [b, c] = [(AXIS + 1) % 3, (AXIS + 2) % 3];
    let per_layer = 1.0 / direction[AXIS];
    for k in 0..=high - low {
        let layer = if is_forward { low + k } else { high - k };
        let along = (f64::from(layer) - origin[AXIS]) * per_layer;
        let (at_b, at_c) = (origin[b] + direction[b] * along, origin[c] + direction[c] * along);
        let mut voxel = [layer; 3];
        (voxel[b], voxel[c]) = (floor(at_b), floor(at_c));
        let beyond = [at_b - f64::from(voxel[b]), at_c - f64::from(voxel[c])];
        visit(&Crossing { axis: AXIS, voxel, beyond, along });
    }
}
