//! A tree of bounding boxes over the solids: nearest hit of a ray, nearest surface of a point.

use crate::solid::Solid;
use nalgebra::{Point3, Vector3};
use percept_geometry::Aabb3;

/// Solids in a leaf at most.
const LEAF: usize = 2;

#[derive(Debug, Clone, PartialEq)]
struct Node {
    bounds: Aabb3,
    /// Leaf: first entry of `order`. Inner: index of the right child (the left one follows the node).
    start: u32,
    /// Solids in a leaf; 0 for an inner node.
    count: u32,
}

/// The tree; it holds indices into the slice that it was built over.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Bvh {
    nodes: Vec<Node>,
    order: Vec<u32>,
}

impl Bvh {
    /// Splits at the median of centres along the widest axis.
    pub(crate) fn build(solids: &[Solid]) -> Self {
        let bounds: Vec<Aabb3> = solids.iter().map(Solid::world_bounds).collect();
        let mut order: Vec<u32> = (0..solids.len() as u32).collect();
        let mut nodes = Vec::new();
        if !order.is_empty() {
            split(&bounds, &mut order, 0, &mut nodes);
        }
        Self { nodes, order }
    }

    /// Smallest `t` in (0, limit) at which the ray meets a solid, and which one.
    pub(crate) fn cast(
        &self,
        solids: &[Solid],
        origin: &Point3<f64>,
        direction: &Vector3<f64>,
        limit: f64,
    ) -> Option<(f64, u32)> {
        let inverse = direction.map(|d| 1.0 / d);
        let (mut best_t, mut best) = (limit, None);
        let mut stack = [(0u32, 0.0f64); 64];
        let mut depth = usize::from(!self.nodes.is_empty());
        while depth > 0 {
            depth -= 1;
            let (index, enter) = stack[depth];
            if enter >= best_t {
                continue;
            }
            let node = &self.nodes[index as usize];
            if node.count > 0 {
                for &solid in &self.order[node.start as usize..(node.start + node.count) as usize] {
                    if let Some(t) = solids[solid as usize].intersect(origin, direction)
                        && t < best_t
                    {
                        (best_t, best) = (t, Some(solid));
                    }
                }
                continue;
            }
            let (left, right) = (index + 1, node.start);
            let enters = [left, right].map(|c| enter_distance(&self.nodes[c as usize].bounds, origin, &inverse));
            let (near, far) = if enters[0] <= enters[1] { (0, 1) } else { (1, 0) };
            for side in [far, near] {
                if enters[side] < best_t {
                    stack[depth] = ([left, right][side], enters[side]);
                    depth += 1;
                }
            }
        }
        best.map(|solid| (best_t, solid))
    }

    /// Distance of a point from the nearest surface, metres; infinite if there is no solid.
    pub(crate) fn surface_distance(&self, solids: &[Solid], p: &Point3<f64>) -> f64 {
        let mut best = f64::INFINITY;
        let mut stack = if self.nodes.is_empty() { vec![] } else { vec![0u32] };
        while let Some(index) = stack.pop() {
            let node = &self.nodes[index as usize];
            let outside = (node.bounds.min - p).sup(&(p - node.bounds.max)).map(|c| c.max(0.0)).norm();
            if outside >= best {
                continue;
            }
            if node.count > 0 {
                for &solid in &self.order[node.start as usize..(node.start + node.count) as usize] {
                    best = best.min(solids[solid as usize].distance(p).abs());
                }
            } else {
                stack.extend([node.start, index + 1]);
            }
        }
        best
    }
}

/// Builds the subtree over `order`; `first` is where this slice begins in the whole.
fn split(bounds: &[Aabb3], order: &mut [u32], first: usize, nodes: &mut Vec<Node>) {
    let mut all = Aabb3::empty();
    let mut centers = Aabb3::empty();
    for &i in order.iter() {
        all.grow(&bounds[i as usize].min);
        all.grow(&bounds[i as usize].max);
        centers.grow(&bounds[i as usize].center());
    }
    let node = nodes.len();
    nodes.push(Node { bounds: all, start: first as u32, count: order.len() as u32 });
    if order.len() <= LEAF {
        return;
    }
    let axis = centers.size().imax();
    // Ties break by index, so that the tree depends on the solids alone.
    order.sort_by(|&a, &b| {
        let key = |i: u32| bounds[i as usize].center()[axis];
        key(a).total_cmp(&key(b)).then(a.cmp(&b))
    });
    let middle = order.len() / 2;
    let (left, right) = order.split_at_mut(middle);
    split(bounds, left, first, nodes);
    nodes[node].start = nodes.len() as u32;
    nodes[node].count = 0;
    split(bounds, right, first + middle, nodes);
}

/// Where a ray enters a box: 0 inside, infinite if it misses.
fn enter_distance(bounds: &Aabb3, origin: &Point3<f64>, inverse: &Vector3<f64>) -> f64 {
    let (mut enter, mut leave) = (0.0f64, f64::INFINITY);
    for i in 0..3 {
        let (a, b) = ((bounds.min[i] - origin[i]) * inverse[i], (bounds.max[i] - origin[i]) * inverse[i]);
        enter = enter.max(a.min(b));
        leave = leave.min(a.max(b));
    }
    if enter <= leave { enter } else { f64::INFINITY }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{World, WorldParams};

    #[test]
    fn the_tree_finds_what_trying_every_solid_finds() {
        let world = World::generate(&WorldParams { seed: 11, ..WorldParams::default() }).unwrap();
        let solids: Vec<Solid> = world.view(0.0).solids().copied().collect();
        let bvh = Bvh::build(&solids);
        let extent = world.extent();
        for i in 0..3000 {
            let share = |a: f64| (f64::from(i) * a).fract();
            let origin = Point3::new(extent.x * share(0.618), extent.y * share(0.755), 2.6 * share(0.57));
            let direction = Vector3::new(share(0.382) - 0.5, share(0.471) - 0.5, share(0.293) - 0.5);
            let brute = solids
                .iter()
                .filter_map(|s| s.intersect(&origin, &direction))
                .filter(|&t| t < 100.0)
                .fold(None, |best: Option<f64>, t| Some(best.map_or(t, |b| b.min(t))));
            assert_eq!(bvh.cast(&solids, &origin, &direction, 100.0).map(|hit| hit.0), brute);
            let nearest = solids.iter().map(|s| s.distance(&origin).abs()).fold(f64::INFINITY, f64::min);
            assert_eq!(bvh.surface_distance(&solids, &origin), nearest);
        }
    }
}
