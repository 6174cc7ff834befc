//! The map of one session: keyframes where they are believed to be, in submaps that hold what was seen.

mod correct;
mod division;
mod rebuild;
mod working_set;

use crate::error::{check_keyframe, check_pose};
use crate::given::is_given;
use crate::keyframe_view::KeyframeView;
use crate::layer_slot::Fetched;
use crate::layers::{LayerSlots, LayersUpdate};
use crate::params::MapParams;
use crate::store::MapStore;
use crate::submap::Submap;
use crate::submap_id::SubmapId;
use crate::{MapLayers, MappingError, SubmapLayers};
pub use correct::CorrectionReport;
use division::Division;
pub use division::MapEntry;
use percept_geometry::{KeptScan, KeyframeId, KeyframeScan, Pose, SensorId, Timestamp};
use rebuild::Rebuild;
pub use rebuild::{RebuildStep, RebuildStepDone};
use std::collections::BTreeMap;
use std::sync::{Arc, Weak};
pub use working_set::StoreAhead;

/// A keyframe of the map.
#[derive(Debug, Clone)]
pub struct MapKeyframe {
    /// Where it is believed to have been.
    pub t_map_base: Pose,
    /// Sensor.
    pub sensor: SensorId,
    /// Of what it saw; none if that was given.
    seen: Option<Timestamp>,
    submap: SubmapId,
    /// Points and misses.
    size: usize,
    /// How far its beams reach that say something, metres.
    reach_m: f64,
    /// Base at the keyframe before, culled or not, seen from base, if odometry measured the way from there.
    t_base_before: Option<Pose>,
    scan: KeptScan,
}

/// Keyframes with their poses, in submaps whose layers make up the map's.
///
/// Keyframes enter in the order of their numbers. Each submap's layers are what integrating its keyframes in that order
/// gives. A correction moves submaps as a whole, at once; whatever its layers then do not fit exactly is built anew beside what
/// is shown, a little at a time ([`Map::advance`]), first where keyframes are off by more than [`MapParams::tolerance_m`]. Once
/// nothing is left to build, the map is the one that its keyframes give when they are inserted where they are now: so a map
/// that is restored is the map that was stored. Adding a keyframe costs one keyframe's work, however large the map.
#[derive(Debug)]
pub struct Map {
    params: MapParams,
    robot: u32,
    run: u32,
    division: Division,
    keyframes: BTreeMap<KeyframeId, MapKeyframe>,
    /// What those scans take that are in memory.
    scan_bytes: usize,
    /// In the order in which they were begun.
    submaps: Vec<Submap>,
    /// Of the submap that is being filled.
    active: Option<Arc<SubmapLayers>>,
    rebuild: Rebuild,
    shown: MapLayers,
    store: Option<Arc<dyn MapStore>>,
    fetched: Arc<Fetched>,
    /// What the caller keeps beside the map.
    beside_bytes: usize,
    /// What is being stored ahead, as long as it is.
    storing: Weak<()>,
}

impl Map {
    /// An empty map, version 0, of the first run of the first robot.
    ///
    /// # Errors
    /// `InvalidParam`.
    pub fn new(params: MapParams) -> Result<Self, MappingError> {
        Self::of_run(params, 0, 0)
    }

    /// An empty map, version 0, whose submaps belong to a run of a robot.
    ///
    /// # Errors
    /// `InvalidParam`.
    pub fn of_run(params: MapParams, robot: u32, run: u32) -> Result<Self, MappingError> {
        params.validate()?;
        Ok(Self {
            params,
            robot,
            run,
            division: Division::default(),
            keyframes: BTreeMap::new(),
            scan_bytes: 0,
            submaps: vec![],
            active: None,
            rebuild: Rebuild::default(),
            shown: MapLayers::empty(&params),
            store: None,
            fetched: Arc::default(),
            beside_bytes: 0,
            storing: Weak::new(),
        })
    }

    /// Parameters.
    pub fn params(&self) -> &MapParams {
        &self.params
    }

    /// The keyframes by number.
    pub fn keyframes(&self) -> &BTreeMap<KeyframeId, MapKeyframe> {
        &self.keyframes
    }

    /// What a keyframe saw; none if there is no such keyframe, or if its scan is out of memory and cannot be had again.
    pub fn scan(&self, id: KeyframeId) -> Option<Arc<KeyframeScan>> {
        self.keyframes.get(&id)?.scan.get()
    }

    /// What a keyframe saw, for who needs it now and then: it goes out of memory with the map's.
    pub fn kept_scan(&self, id: KeyframeId) -> Option<&KeptScan> {
        self.keyframes.get(&id).map(|k| &k.scan)
    }

    /// The submaps, in the order in which they were begun.
    pub fn submaps(&self) -> &[Submap] {
        &self.submaps
    }

    /// The layers as they are now: an immutable picture that shares their storage.
    pub fn layers(&self) -> MapLayers {
        self.shown.clone()
    }

    /// Rises with every change of the map.
    pub fn version(&self) -> u64 {
        self.shown.version
    }

    /// Versions go on after one that was told of the same map before; for a map that is empty.
    pub fn go_on_from(&mut self, version: u64) {
        self.shown.version = version;
    }

    /// Adds a keyframe, newer than all there are.
    ///
    /// # Errors
    /// `DuplicateKeyframe`, `KeyframeNotNewest`, `PoseNotFinite`, `Scan`; the map is unchanged then.
    pub fn insert(&mut self, id: KeyframeId, entry: &MapEntry, scan: Arc<KeyframeScan>) -> Result<(), MappingError> {
        let t_map_base = entry.t_map_base;
        check_keyframe(&t_map_base, &scan)?;
        check_pose(&entry.t_odom_base)?;
        if self.keyframes.contains_key(&id) {
            return Err(MappingError::DuplicateKeyframe { id });
        }
        if let Some((newest, _)) = self.keyframes.last_key_value().filter(|(newest, _)| **newest > id) {
            return Err(MappingError::KeyframeNotNewest { id, newest: *newest });
        }
        let (number, t_base_before) = self.division.next(entry);
        let submap_id = SubmapId { robot: self.robot, run: self.run, number };
        let version = self.shown.version + 1;
        if self.submaps.last().is_none_or(|s| s.id != submap_id) {
            self.freeze(version);
            self.submaps.push(Submap::new(submap_id, &self.params));
        }
        let Some(submap) = self.submaps.last_mut() else { return Ok(()) };
        let t_submap_base = submap.t_map_submap.inverse() * t_map_base;
        let view = KeyframeView::new(&t_submap_base, &scan).coming_from(t_base_before);
        let update = LayersUpdate::new(&self.params, &view);
        let touched = update.touched(&self.params);
        let layers = self.active.get_or_insert_with(|| Arc::new(SubmapLayers::new(&self.params)));
        Arc::make_mut(layers).add(&update);
        submap.slots = Arc::new(LayerSlots::new(&self.params, layers));
        submap.boxes = submap.boxes.joined(&touched);
        let seen = (!is_given(&scan.sensor)).then_some(scan.stamp);
        submap.add_keyframe(id, t_submap_base, seen);
        let keyframe = MapKeyframe {
            t_map_base,
            sensor: scan.sensor.clone(),
            seen,
            submap: submap_id,
            size: scan.hits.len() + scan.misses.len(),
            reach_m: self.params.reach_of(&scan),
            t_base_before,
            scan: scan.into(),
        };
        self.shown.touch(version, &submap.in_map(&touched, self.params.margin_m()), true);
        self.scan_bytes += keyframe.scan.memory_bytes();
        self.keyframes.insert(id, keyframe);
        self.rebuild.take_in(submap_id, id, &t_map_base);
        self.expire(version, seen);
        self.show(version);
        self.hold_to_budget();
        Ok(())
    }

    /// Notes a keyframe that was in the map and is not any more, in its turn: those after it belong to the submaps that they
    /// belonged to when it was there.
    pub fn skip(&mut self, entry: &MapEntry) {
        self.division.next(entry);
    }

    /// Nothing will be added to the submap that is being filled, if there is one. What is seen of it stays the same.
    fn freeze(&mut self, version: u64) {
        let Some(mut layers) = self.active.take() else { return };
        let Some(submap) = self.submaps.last_mut() else { return };
        Arc::make_mut(&mut layers).freeze();
        submap.slots = Arc::new(LayerSlots::frozen(&self.params, &layers));
        submap.is_frozen = true;
        self.shown.lay_under(version, &submap.boxes_in_map(self.params.margin_m()));
    }

    /// Submaps that were seen too long before a stamp are not shown from now on.
    fn expire(&mut self, version: u64, now: Option<Timestamp>) {
        let (Some(now), time_to_live_s, margin) = (now, self.params.time_to_live_s, self.params.margin_m()) else {
            return;
        };
        let is_old = |s: &&mut Submap| s.seen.is_some_and(|seen| now.seconds_since(seen) > time_to_live_s);
        if time_to_live_s > 0.0 {
            for submap in self.submaps.iter_mut().filter(|s| s.is_frozen && !s.is_expired).filter(is_old) {
                submap.is_expired = true;
                self.shown.touch(version, &submap.boxes_in_map(margin), false);
            }
        }
    }

    /// Shows what there is now.
    fn show(&mut self, version: u64) {
        let margin = self.params.margin_m();
        let parts: Vec<_> = self.submaps.iter().filter(|s| !s.is_expired).map(|s| s.part(margin)).collect();
        self.shown.set(version, &parts);
    }

    fn position(&self, id: SubmapId) -> Option<usize> {
        self.submaps.iter().position(|s| s.id == id)
    }
}

impl MapParams {
    /// How far from base a scan says something that is kept, metres.
    fn reach_of(&self, scan: &KeyframeScan) -> f64 {
        let ranges = scan.hits.positions.iter().chain(&scan.misses).map(|p| f64::from(p.coords.norm()));
        ranges.filter(|r| r.is_finite()).fold(0.0, f64::max).min(self.range_max_m())
    }
}
