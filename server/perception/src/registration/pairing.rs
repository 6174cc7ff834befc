//! Nearest target points of moving source points, exact, and cheap when little has moved.

use crate::search::{KdTree, Neighbor};
use nalgebra::Point3;

/// Searches reach so much farther than pairs may be apart: room to move before a point without a partner has to be
/// searched for again.
const REACH: f32 = 1.2;
const NONE: u32 = u32::MAX;

/// What the last search for a point said.
///
/// Every other target point was at least `others` away from `from`. As long as the found one is nearer to the point's
/// new place than `others` less the way it moved, it is the nearest (triangle inequality), and no search is needed.
#[derive(Debug, Clone, Copy)]
pub(super) struct Known {
    from: Point3<f32>,
    index: u32,
    others: f32,
}

impl Known {
    /// Nothing: the next question is a search.
    pub(super) const NOTHING: Self = Self { from: Point3::new(f32::NAN, f32::NAN, f32::NAN), index: NONE, others: 0.0 };

    /// The target point nearest to `p`, if within `max_distance`; `buffer` is scratch.
    #[inline]
    pub(super) fn nearest(
        &mut self,
        p: &Point3<f32>,
        target: &[Point3<f32>],
        tree: &KdTree,
        max_distance: f32,
        buffer: &mut Vec<Neighbor>,
    ) -> Option<usize> {
        // Rounding of the three distances: a few parts in 1e7 each, of coordinates, too, far from the origin.
        let slack = 1e-6 * (self.others + p.coords.abs().max());
        let free = self.others - (p - self.from).norm() - slack;
        if self.index == NONE {
            // NaN compares as not free.
            if free > max_distance {
                return None;
            }
        } else {
            let distance = (p - target[self.index as usize]).norm();
            if distance <= free {
                return (distance <= max_distance).then_some(self.index as usize);
            }
        }
        self.search(p, tree, max_distance, buffer)
    }

    fn search(
        &mut self,
        p: &Point3<f32>,
        tree: &KdTree,
        max_distance: f32,
        buffer: &mut Vec<Neighbor>,
    ) -> Option<usize> {
        let reach = REACH * max_distance;
        tree.hybrid_into(p, reach, 2, buffer);
        let first = buffer.first().copied();
        *self = Self {
            from: *p,
            index: first.map_or(NONE, |n| n.index as u32),
            others: buffer.get(1).map_or(reach, |n| n.distance2.sqrt()),
        };
        first.filter(|n| n.distance2 <= max_distance * max_distance).map(|n| n.index)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_point_on_its_way_always_knows_its_nearest(
            target in prop::collection::vec(prop::array::uniform3(-2.0..2.0f32), 1..60),
            start in prop::array::uniform3(-2.5..2.5f32),
            steps in prop::collection::vec(prop::array::uniform3(-0.2..0.2f32), 1..30),
        ) {
            let target: Vec<_> = target.into_iter().map(Point3::from).collect();
            let tree = KdTree::build(&target);
            let (mut known, mut p, mut buffer) = (Known::NOTHING, Point3::from(start), vec![]);
            for step in steps {
                p += nalgebra::Vector3::from(step);
                let found = known.nearest(&p, &target, &tree, 0.7, &mut buffer);
                let best = target.iter().map(|q| (p - q).norm()).fold(f32::INFINITY, f32::min);
                match found {
                    Some(i) => prop_assert!((p - target[i]).norm() <= best + 1e-6),
                    None => prop_assert!(best > 0.7 - 1e-6),
                }
            }
        }
    }
}
