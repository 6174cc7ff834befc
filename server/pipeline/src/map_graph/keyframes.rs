//! The keyframes by number, and where they are in the map. Those that newer ones stand for keep their number and their place,
//! relative to those.

use crate::{Chunks, KeyframeInfo, Merged};
use percept_geometry::{KeyframeId, Pose};
use percept_slam::MergedKeyframe;
use std::collections::BTreeMap;
use std::ops::Deref;

/// All keyframes by number, merged ones too: trajectories hang on them.
#[derive(Debug, Clone, Default)]
pub(crate) struct Keyframes(Chunks<KeyframeInfo>);

impl Deref for Keyframes {
    type Target = Chunks<KeyframeInfo>;

    fn deref(&self) -> &Chunks<KeyframeInfo> {
        &self.0
    }
}

impl Keyframes {
    /// As they were stored; merged ones are put where those are that stand for them.
    pub(super) fn restored(infos: Vec<KeyframeInfo>) -> Self {
        let mut keyframes = Self(infos.into_iter().collect());
        keyframes.carry();
        keyframes
    }

    /// As they are now, for readers.
    pub(crate) fn shared(&self) -> Chunks<KeyframeInfo> {
        self.0.clone()
    }

    /// A keyframe, if there is one of this number.
    pub(crate) fn of(&self, id: KeyframeId) -> Option<&KeyframeInfo> {
        self.0.get(usize::try_from(id.0).ok()?)
    }

    /// The number that the next one gets.
    pub(super) fn next_id(&self) -> KeyframeId {
        KeyframeId(self.0.len() as u64)
    }

    /// Adds one, whose number is [`Self::next_id`].
    pub(super) fn push(&mut self, info: KeyframeInfo) {
        self.0.push(info);
    }

    /// Puts keyframes where they are from now on, and lets newer ones stand for merged ones. By what each was moved in the map,
    /// and those that others stand for from now on, or through yet others than before.
    pub(super) fn revise(
        &mut self,
        t_map_base: &BTreeMap<KeyframeId, Pose>,
        merged: &[MergedKeyframe],
    ) -> (BTreeMap<KeyframeId, Pose>, Vec<(KeyframeInfo, Merged)>) {
        let changed = self.merge(merged);
        let mut moved: BTreeMap<KeyframeId, Pose> = BTreeMap::new();
        for (id, t_map_base) in t_map_base {
            let Some(info) = self.0.get_mut(id.0 as usize) else { continue };
            moved.insert(*id, t_map_base * info.t_map_base.inverse());
            info.t_map_base = *t_map_base;
        }
        moved.extend(self.carry());
        let changed = changed.into_iter().filter_map(|k| Some((self.0[k].clone(), self.0[k].merged?)));
        (moved, changed.collect())
    }

    /// Puts merged keyframes where those are that stand for them; what each of them was moved by, in the map.
    fn carry(&mut self) -> Vec<(KeyframeId, Pose)> {
        let carried = |k: &KeyframeInfo| {
            let merged = k.merged?;
            let t_map_base = self.of(merged.into)?.t_map_base * merged.t_into_base;
            (t_map_base != k.t_map_base).then_some((k.id, t_map_base))
        };
        let to: Vec<(KeyframeId, Pose)> = self.0.iter().filter_map(carried).collect();
        let mut moved = vec![];
        for (id, t_map_base) in to {
            let Some(info) = self.0.get_mut(id.0 as usize) else { continue };
            moved.push((id, t_map_base * info.t_map_base.inverse()));
            info.t_map_base = t_map_base;
        }
        moved
    }

    /// Notes which keyframes are merged into which; those that were merged into one that is now merged itself follow. The
    /// numbers of all whose entry changed.
    fn merge(&mut self, merged: &[MergedKeyframe]) -> Vec<usize> {
        if merged.is_empty() {
            return vec![];
        }
        for m in merged {
            if let Some(info) = self.0.get_mut(m.id.0 as usize) {
                info.merged = Some(Merged { into: m.into, t_into_base: m.t_into_base });
                info.num_points = 0;
            }
        }
        let mut changed: Vec<usize> = merged.iter().map(|m| m.id.0 as usize).collect();
        let follow = |(k, info): (usize, &KeyframeInfo)| {
            let before = info.merged?;
            let mut merged = before;
            // Newer keyframes stand for older ones, so this ends at one that is alive.
            while let Some(next) = self.of(merged.into).and_then(|i| i.merged) {
                merged = Merged { into: next.into, t_into_base: next.t_into_base * merged.t_into_base };
            }
            (merged.into != before.into).then_some((k, merged))
        };
        let following: Vec<(usize, Merged)> = self.0.iter().enumerate().filter_map(follow).collect();
        for (k, merged) in following {
            changed.push(k);
            if let Some(info) = self.0.get_mut(k) {
                info.merged = Some(merged);
            }
        }
        changed.sort_unstable();
        changed.dedup();
        changed
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_geometry::{SensorId, Timestamp, se3};

    fn keyframe(id: u64, x: f64) -> KeyframeInfo {
        let pose = se3::from_xy_yaw(x, 0.0, 0.0);
        KeyframeInfo {
            id: KeyframeId(id),
            stamp: Timestamp(id as i64),
            sensor: SensorId::from("laser"),
            t_map_base: pose,
            t_odom_base: pose,
            num_points: 9,
            merged: None,
        }
    }

    fn x(keyframes: &Keyframes, id: usize) -> f64 {
        keyframes[id].t_map_base.translation.x
    }

    #[test]
    fn merged_keyframes_move_with_the_one_that_stands_for_them_in_the_end() {
        let mut keyframes = Keyframes::restored((0..3).map(|k| keyframe(k, k as f64)).collect());
        let merged = |id, into| MergedKeyframe {
            id: KeyframeId(id),
            into: KeyframeId(into),
            t_into_base: se3::from_xy_yaw(-1.0, 0.0, 0.0),
        };
        let (moved, changed) = keyframes.revise(&BTreeMap::new(), &[merged(0, 1)]);
        assert_eq!((moved.len(), changed.len(), keyframes[0].num_points), (0, 1, 0));
        // Number 1 goes, too, while number 2 is put 10 m further on: both follow it.
        let to = BTreeMap::from([(KeyframeId(2), se3::from_xy_yaw(12.0, 0.0, 0.0))]);
        let (moved, changed) = keyframes.revise(&to, &[merged(1, 2)]);
        assert_eq!([0, 1, 2].map(|k| x(&keyframes, k)), [10.0, 11.0, 12.0]);
        assert!(moved.len() == 3 && moved.values().all(|t| *t == se3::from_xy_yaw(10.0, 0.0, 0.0)));
        assert_eq!(changed.iter().map(|(k, m)| (k.id.0, m.into.0)).collect::<Vec<_>>(), [(0, 2), (1, 2)]);
        assert_eq!(keyframes.next_id(), KeyframeId(3));
    }
}
