//! Keyframes that newer ones stand for keep their number and their place, relative to those.

use crate::{KeyframeInfo, Merged};
use percept_geometry::{KeyframeId, Pose};
use percept_slam::MergedKeyframe;

/// Puts merged keyframes where those are that stand for them; what each of them was moved by, in the map.
pub(super) fn carry(keyframes: &mut [KeyframeInfo]) -> Vec<(KeyframeId, Pose)> {
    let mut moved = vec![];
    for k in 0..keyframes.len() {
        let Some(merged) = keyframes[k].merged else { continue };
        let Some(into) = keyframes.get(merged.into.0 as usize).map(|i| i.t_map_base) else { continue };
        let (t_map_base, before) = (into * merged.t_into_base, keyframes[k].t_map_base);
        if t_map_base != before {
            keyframes[k].t_map_base = t_map_base;
            moved.push((keyframes[k].id, t_map_base * before.inverse()));
        }
    }
    moved
}

/// Notes which keyframes are merged into which; those that were merged into one that is now merged itself follow. The
/// numbers of all whose entry changed.
pub(super) fn merge(keyframes: &mut [KeyframeInfo], merged: &[MergedKeyframe]) -> Vec<usize> {
    for m in merged {
        if let Some(info) = keyframes.get_mut(m.id.0 as usize) {
            info.merged = Some(Merged { into: m.into, t_into_base: m.t_into_base });
            info.num_points = 0;
        }
    }
    let mut changed: Vec<usize> = merged.iter().map(|m| m.id.0 as usize).collect();
    for k in 0..keyframes.len() {
        let Some(mut merged) = keyframes[k].merged else { continue };
        // Newer keyframes stand for older ones, so this ends at one that is alive.
        while let Some(next) = keyframes.get(merged.into.0 as usize).and_then(|i| i.merged) {
            merged = Merged { into: next.into, t_into_base: next.t_into_base * merged.t_into_base };
            changed.push(k);
        }
        keyframes[k].merged = Some(merged);
    }
    changed.sort_unstable();
    changed.dedup();
    changed
}
