//! Points thinned to voxels, and which of these hang together.

use super::standing::Standing;
use crate::cloud::{Clusters, DisjointSets};
use nalgebra::{Point3, Vector3};

/// So many voxels are joined at most; of denser scans the voxels are larger.
const MAX_VOXELS: usize = 60_000;
/// Number of the voxel at the sensor.
const MIDDLE: i32 = 1 << 20;

/// Points sorted into voxels.
pub(super) struct Voxels {
    /// Means of x, y and height.
    pub(super) means: Vec<Point3<f32>>,
    /// Where each is along x and y; ascending.
    columns: Vec<(i32, i32)>,
    size_m: f64,
    indices: Vec<u32>,
    starts: Vec<usize>,
}

impl Voxels {
    pub(super) fn new(standing: &Standing, size_m: f64) -> Self {
        let mut size_m = size_m;
        loop {
            let out = Self::of_size(standing, size_m);
            if out.means.len() <= MAX_VOXELS {
                return out;
            }
            size_m *= 1.5;
        }
    }

    fn of_size(standing: &Standing, size_m: f64) -> Self {
        // Ranges are bounded to 500 m and voxels to 2 cm: 21 bits hold each.
        let index = |v: f32| u64::from(((f64::from(v) / size_m).floor() as i32 + MIDDLE) as u32 & 0x1f_ffff);
        let mut keys: Vec<(u64, u32)> = standing
            .points
            .iter()
            .zip(&standing.heights)
            .zip(0u32..)
            .map(|((p, &h), i)| (index(p.x) << 42 | index(p.y) << 21 | index(h), i))
            .collect();
        keys.sort_unstable();
        let mut out = Self {
            means: Vec::new(),
            columns: Vec::new(),
            size_m,
            indices: keys.iter().map(|k| k.1).collect(),
            starts: vec![],
        };
        let mut sum = Vector3::zeros();
        for (place, (key, i)) in keys.iter().enumerate() {
            if place == 0 || keys[place - 1].0 != *key {
                out.close(&mut sum, place);
                out.columns.push(((key >> 42) as i32 - MIDDLE, (key >> 21 & 0x1f_ffff) as i32 - MIDDLE));
            }
            let (p, h) = (&standing.points[*i as usize], standing.heights[*i as usize]);
            sum += Vector3::new(f64::from(p.x), f64::from(p.y), f64::from(h));
        }
        out.close(&mut sum, keys.len());
        out
    }

    /// Ends the voxel that is being summed up before `place`, and begins the next.
    fn close(&mut self, sum: &mut Vector3<f64>, place: usize) {
        if let Some(&start) = self.starts.last() {
            self.means.push(Point3::from(*sum / (place - start) as f64).cast());
        }
        self.starts.push(place);
        *sum = Vector3::zeros();
    }

    /// Indices of its points.
    pub(super) fn members(&self, voxel: usize) -> &[u32] {
        &self.indices[self.starts[voxel]..self.starts[voxel + 1]]
    }

    /// Clusters of voxels whose `points` (one each, as far along x and y as its mean) are at most `eps + slope * range`
    /// apart, the smaller of the two: the answer of [`cluster`](crate::cloud::cluster). There a tree is searched; here
    /// columns beside each other are compared, and of two columns that each hang together one pair is enough.
    pub(super) fn joined(&self, points: &[Point3<f32>], eps: f64, slope: f64) -> Clusters {
        let mut sets = DisjointSets::new(points.len());
        let reaches: Vec<f32> = points.iter().map(|p| (eps + slope * p.coords.cast::<f64>().norm()) as f32).collect();
        let near = |i: usize, j: usize| {
            let eps = reaches[i].min(reaches[j]);
            (points[i] - points[j]).norm_squared() <= eps * eps
        };
        let columns = self.columns();
        let mut hangs_together = Vec::with_capacity(columns.len());
        for column in &columns {
            let mut all = true;
            // By height: what is not near to the next one up is near to none above, but where that is far aside.
            for i in column.voxels.clone() {
                let mut above = i + 1..column.voxels.end;
                match above.find(|&j| near(i, j)) {
                    Some(j) => sets.unite(i as u32, j as u32),
                    None => all &= i + 1 == column.voxels.end,
                }
            }
            hangs_together.push(all);
        }
        for (c, column) in columns.iter().enumerate() {
            let reach = column.voxels.clone().map(|i| reaches[i]).fold(0.0, f32::max);
            let steps = (f64::from(reach) / self.size_m) as i32 + 1;
            let (x, y) = column.at;
            for dx in 0..=steps {
                // Pairs are met once: the later one of the list is looked for.
                let from = if dx == 0 { c + 1 } else { columns.partition_point(|o| o.at < (x + dx, y - steps)) };
                for o in (from..columns.len()).take_while(|&o| columns[o].at <= (x + dx, y + steps)) {
                    let one_is_enough = hangs_together[c] && hangs_together[o];
                    'pairs: for i in column.voxels.clone() {
                        for j in columns[o].voxels.clone().filter(|&j| near(i, j)) {
                            sets.unite(i as u32, j as u32);
                            if one_is_enough {
                                break 'pairs;
                            }
                        }
                    }
                }
            }
        }
        sets.clusters(1, |_| true)
    }

    /// Voxels over each other, ascending.
    fn columns(&self) -> Vec<Column> {
        let mut out: Vec<Column> = Vec::new();
        for (i, &at) in self.columns.iter().enumerate() {
            match out.last_mut().filter(|column| column.at == at) {
                Some(column) => column.voxels.end = i + 1,
                None => out.push(Column { at, voxels: i..i + 1 }),
            }
        }
        out
    }
}

/// Voxels over each other.
struct Column {
    at: (i32, i32),
    voxels: std::ops::Range<usize>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::{ClusterParams, cluster};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn joining_voxels_equals_the_search_of_a_tree(
            points in prop::collection::vec((-6.0..6.0f32, -6.0..6.0f32, 0.0..3.0f32), 1..200),
            eps in 0.1..0.8f64,
            slope in 0.001..0.1f64,
        ) {
            let points: Vec<Point3<f32>> = points.into_iter().map(|(x, y, z)| Point3::new(x, y, z)).collect();
            let heights = points.iter().map(|p| p.z).collect();
            let voxels = Voxels::new(&Standing { points, heights, above: vec![] }, 0.1);
            let plain = cluster(&voxels.means, &ClusterParams { eps_m: eps, min_points: 1, eps_slope: slope }).unwrap();
            prop_assert_eq!(voxels.joined(&voxels.means, eps, slope), plain);
        }
    }
}
