//! Which submap a keyframe belongs to.

use nalgebra::Vector3;
use percept_geometry::Pose;

/// A submap reaches this far from its first keyframe, metres of odometry: a room or two. What a correction bends within that is
/// below the tolerance as a rule, and what it sees overlaps with the submaps before and after by less than all.
const REACH_M: f64 = 5.0;
/// Keyframes of a submap, however near: bounds what rebuilding one takes.
const MOST_KEYFRAMES: usize = 64;

/// A keyframe's place as it enters the map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MapEntry {
    /// Base to map, corrected.
    pub t_map_base: Pose,
    /// Base to odom, never corrected.
    pub t_odom_base: Pose,
    /// Whether nothing measured ties it to the keyframe before.
    pub after_gap: bool,
}

impl MapEntry {
    /// Where odometry is the map, and no gap before.
    pub fn at(t_map_base: Pose) -> Self {
        Self { t_map_base, t_odom_base: t_map_base, after_gap: false }
    }
}

/// Divides keyframes into submaps as they come, by what no correction changes: a map that is restored from its keyframes has
/// the submaps that it had.
#[derive(Debug, Default)]
pub(super) struct Division {
    /// Of the newest submap: its number, where its first keyframe was in odom, and how many it was given.
    newest: Option<(u32, Vector3<f64>, usize)>,
    /// The keyframe before, base to odom.
    t_odom_before: Option<Pose>,
}

impl Division {
    /// The number of the submap to which the next keyframe belongs, and base at the keyframe before, seen from base now, if odometry
    /// measured the way from there.
    pub(super) fn next(&mut self, entry: &MapEntry) -> (u32, Option<Pose>) {
        let before = self.t_odom_before.replace(entry.t_odom_base).filter(|_| !entry.after_gap);
        (self.number(entry), before.map(|t_odom_before| entry.t_odom_base.inv_mul(&t_odom_before)))
    }

    fn number(&mut self, entry: &MapEntry) -> u32 {
        let here = entry.t_odom_base.translation.vector;
        let number = match &mut self.newest {
            None => 0,
            Some((number, first, count))
                if !entry.after_gap && *count < MOST_KEYFRAMES && (here - *first).norm() <= REACH_M =>
            {
                *count += 1;
                return *number;
            }
            Some((number, ..)) => *number + 1,
        };
        self.newest = Some((number, here, 1));
        number
    }
}
