//! Things that are put into a world, beam by beam: a keyframe then shows what it would have shown with them.

use crate::drive::Keyframe;
use nalgebra::{Point3, Vector3};
use percept_geometry::{Aabb3, KeyframeScan};
use percept_sim::World;
use std::sync::Arc;

#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Body {
    /// An upright box.
    Block(Aabb3),
    /// A box whose top rises from nothing at its smallest x to all of its height at its largest.
    Ramp(Aabb3),
    /// A hole in the floor, as deep as its smallest z says; its largest z is the floor's, 0.
    Pit(Aabb3),
}

impl Body {
    pub(crate) fn bounds(&self) -> &Aabb3 {
        match self {
            Self::Block(b) | Self::Ramp(b) | Self::Pit(b) => b,
        }
    }

    /// Where a beam that would end `far` away ends because of this body, metres.
    fn end(&self, from: &Point3<f64>, direction: &Vector3<f64>, far: f64) -> f64 {
        let bounds = self.bounds();
        let (mut enter, mut leave) = (f64::NEG_INFINITY, f64::INFINITY);
        // The half-space of points with `normal * p <= most`.
        let mut cut = |normal: Vector3<f64>, most: f64| {
            let (along, before) = (normal.dot(direction), most - normal.dot(&from.coords));
            if along.abs() < 1e-12 {
                if before < 0.0 {
                    enter = f64::INFINITY;
                }
            } else if along > 0.0 {
                leave = leave.min(before / along);
            } else {
                enter = enter.max(before / along);
            }
        };
        for i in 0..3 {
            let axis = Vector3::ith(i, 1.0);
            cut(-axis, -bounds.min[i]);
            // Above a pit all is open.
            if !(matches!(self, Self::Pit(_)) && i == 2) {
                cut(axis, bounds.max[i]);
            }
        }
        match self {
            Self::Block(_) => {}
            Self::Ramp(_) => {
                let size = bounds.size();
                let rise = size.z / size.x;
                cut(Vector3::new(-rise, 0.0, 1.0), bounds.min.z - rise * bounds.min.x);
            }
            Self::Pit(_) => {
                let floor = (from + direction * far).z.abs() < 1e-3;
                let at = from + direction * far;
                let is_over = at.x > bounds.min.x && at.x < bounds.max.x && at.y > bounds.min.y && at.y < bounds.max.y;
                return if floor && is_over { leave } else { far };
            }
        }
        if enter > 0.0 && enter < leave { far.min(enter) } else { far }
    }
}

/// Where a beam ends in a world with these bodies in it, metres; none beyond `limit`.
pub(crate) fn cast(
    world: &World,
    bodies: &[Body],
    from: &Point3<f64>,
    direction: &Vector3<f64>,
    limit: f64,
) -> Option<(f64, f64)> {
    let far = world.cast(from, direction, 0.0, limit)?.distance;
    Some((far, bodies.iter().fold(far, |far, body| body.end(from, direction, far))))
}

/// Farther than a world is wide, metres.
const FAR_M: f64 = 60.0;
/// Beams that err by more mix what is before an edge with what is behind it, metres.
const MIXED_M: f64 = 0.3;

/// The keyframe as it would be with these bodies: a beam that one of them ends, ends there with the error that it had. Its colours are
/// left out.
pub(crate) fn with_bodies(world: &World, bodies: &[Body], keyframe: &Keyframe) -> Arc<KeyframeScan> {
    let (sensor, t_base_world) = (keyframe.sensor(), keyframe.t_world_base.inverse());
    let mut scan = KeyframeScan::clone(&keyframe.scan);
    (scan.hits.colors, scan.hits.intensities) = (None, None);
    scan.hits.positions.retain_mut(|p| {
        let seen = keyframe.t_world_base * p.cast::<f64>() - sensor;
        let Some(direction) = seen.try_normalize(1e-6) else { return false };
        let Some((before, now)) = cast(world, bodies, &sensor, &direction, FAR_M) else { return false };
        if before != now {
            let error = seen.norm() - before;
            if error.abs() > MIXED_M {
                return false;
            }
            *p = (t_base_world * (sensor + direction * (now + error))).cast();
        }
        true
    });
    Arc::new(scan)
}
