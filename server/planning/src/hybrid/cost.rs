//! What driving an arc costs.

use super::HybridParams;
use crate::steering::Arc;
use crate::{Costmap, Pose2};

/// Weighs arcs over a costmap.
#[derive(Debug, Clone, Copy)]
pub(crate) struct DrivingCost<'a> {
    pub(crate) costmap: &'a Costmap,
    pub(crate) params: HybridParams,
}

impl DrivingCost<'_> {
    /// Of one arc, metres: the factors of the cells that the base crosses, times what backwards and turning cost.
    pub(crate) fn of_arc(&self, from: &Pose2, arc: &Arc) -> f64 {
        self.steering(arc) * self.weighted_length(from, arc)
    }

    /// Of arcs driven one after the other from a pose, with the changes of direction among them and from `before`.
    pub(crate) fn of_arcs(&self, arcs: &[(Pose2, Arc)], before: Option<Arc>) -> f64 {
        let mut before = before;
        let mut out = 0.0;
        for (from, arc) in arcs {
            out += self.of_arc(from, arc) + self.of_change(before, arc);
            before = Some(*arc);
        }
        out
    }

    /// Of going on with an arc after another.
    pub(crate) fn of_change(&self, before: Option<Arc>, arc: &Arc) -> f64 {
        let changes = before.is_some_and(|before| before.length * arc.length < 0.0);
        if changes { self.params.direction_change_cost_m } else { 0.0 }
    }

    /// Of a metre of this arc where cells cost nothing extra.
    pub(crate) fn steering(&self, arc: &Arc) -> f64 {
        let HybridParams { turning_radius_m, reverse_cost, turning_cost, .. } = self.params;
        let backwards = if arc.length < 0.0 { reverse_cost } else { 1.0 };
        backwards * (1.0 + (turning_cost - 1.0) * (arc.curvature.abs() * turning_radius_m).min(1.0))
    }

    /// Metres times the mean factor of cells a cell apart or less.
    pub(crate) fn weighted_length(&self, from: &Pose2, arc: &Arc) -> f64 {
        let length = arc.length.abs();
        let samples = (length / self.costmap.geometry().resolution_m).ceil().max(1.0);
        let at = |i: f64| arc.after(from, arc.length * (i + 0.5) / samples).position;
        let sum: f64 = (0..samples as usize).map(|i| self.costmap.factor_at(&at(i as f64))).sum();
        length * sum / samples
    }
}

impl Costmap {
    /// Cost of a metre at a point; infinite outside.
    pub(crate) fn factor_at(&self, p: &nalgebra::Point2<f64>) -> f64 {
        let index = self.geometry().cell(p).filter(|c| self.state(*c).is_some()).map(|c| self.at(c));
        index.map_or(f64::INFINITY, |i| f64::from(self.factors()[i]))
    }
}
