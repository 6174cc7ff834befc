//! Keyframes among which a lost robot is looked for.

use super::kept::Kept;
use super::query::{self, Query};
use super::walls;
use crate::loops::{Evidence, KeyframePoses, Relocalisation};
use nalgebra::{Point2, Vector3};
use percept_geometry::{KeptScan, KeyframeId, KeyframeScan, Pose};
use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::sync::Arc;

/// All keyframes that a sensor has seen in space.
#[derive(Debug, Default)]
pub(in crate::loops) struct Seen {
    pub(super) kept: BTreeMap<KeyframeId, Kept>,
    /// Where the newest one was when it came, and the length of the way up to it, metres.
    newest: Option<(Vector3<f64>, f64)>,
}

impl Seen {
    /// Takes a keyframe in; answers with the length of the way up to it, metres, none for what was not seen in space.
    pub(in crate::loops) fn keep(&mut self, id: KeyframeId, kept: &KeptScan, poses: &KeyframePoses) -> Option<f64> {
        let scan = kept.get()?;
        let t_map_base = poses.get(&id).filter(|_| !scan.planar)?;
        let here = t_map_base.translation.vector;
        let travel = self.newest.map_or(0.0, |(there, travel)| travel + (there - here).norm());
        self.newest = Some((here, travel));
        let walls = walls::of(&scan, &walls::leveling(t_map_base));
        self.kept.insert(id, Kept { scan: kept.clone(), walls, travel });
        Some(travel)
    }

    /// Bytes beside the scans, about.
    pub(in crate::loops) fn memory_bytes(&self) -> usize {
        let walls: usize = self.kept.values().map(|k| k.walls.capacity()).sum();
        self.kept.len() * size_of::<(KeyframeId, Kept)>() + walls * size_of::<Point2<f32>>()
    }

    /// A keyframe has left the graph.
    pub(in crate::loops) fn forget(&mut self, id: KeyframeId) {
        self.kept.remove(&id);
    }

    /// Where a robot is that has driven since it was lost ([`crate::loops::PlaceRecognition::relocalise_driven`]).
    pub(in crate::loops) fn relocalise_driven(
        &self,
        before: &[(Pose, Arc<KeyframeScan>)],
        scan: &KeyframeScan,
        poses: &KeyframePoses,
    ) -> Option<Relocalisation> {
        let before: Vec<_> = before.iter().map(|(t, s)| (*t, s.as_ref())).collect();
        let known = self.known(poses);
        let find = |before: &[(Pose, &KeyframeScan)]| {
            let query = Query::new(before, scan, None);
            query.find(&self.kept, &known, (0.0, PI), &query.wanted()?)
        };
        // Most of what it saw may be where nobody has been before: the newest part of it is not, perhaps.
        find(&before).or_else(|| find(query::newest_part(&before, scan)?))
    }

    /// What a scan says of where it is believed to have been taken ([`crate::loops::PlaceRecognition::check`]).
    pub(in crate::loops) fn check(&self, scan: &KeyframeScan, t_map_base: &Pose, poses: &KeyframePoses) -> Evidence {
        query::check(scan, t_map_base, &self.kept, &self.known(poses))
    }

    /// Where the keyframes are believed to be, base to map.
    fn known(&self, poses: &KeyframePoses) -> BTreeMap<KeyframeId, Pose> {
        poses.iter().filter(|(id, _)| self.kept.contains_key(id)).map(|(id, t)| (*id, *t)).collect()
    }
}
