//! Maps that were left because nothing fitted them, kept for the image that does.
//!
//! **Source:** Elvira, Tardos and Montiel, "ORBSLAM-Atlas: a robust and accurate multi-map system", 2019.

use super::frame::{Frame, Lens};
use super::pose::PlacedCamera;
use super::scale::Scaling;
use super::tracker::Tracker;
use super::{Mono, knows_way};
use crate::motion_prior::MotionPrior;
use percept_geometry::{Pose, Timestamp};

/// Maps kept at most; the smallest goes first. Halved and doubled 25.1 ([`super`]), where the map is never left.
const MAX_MAPS: usize = 4;

/// A map and what makes odom poses of its own.
pub(super) struct InactiveMap {
    pub(super) tracker: Tracker,
    pub(super) scaling: Scaling,
    /// Base to odom when its first view was taken.
    pub(super) t_odom_start: Pose,
}

/// The maps, and whose turn it is: a search in all of them would make one image cost as much as many.
#[derive(Default)]
pub(super) struct Atlas {
    maps: Vec<InactiveMap>,
    turn: usize,
}

impl Atlas {
    pub(super) fn is_empty(&self) -> bool {
        self.maps.is_empty()
    }

    /// Keeps a map, unless it is too young to be found in again.
    pub(super) fn put(&mut self, map: InactiveMap) {
        if !map.tracker.has_map() || map.tracker.is_young() {
            return;
        }
        self.maps.push(map);
        if self.maps.len() > MAX_MAPS {
            let sizes = self.maps.iter().map(|m| m.tracker.map.views.len()).enumerate();
            if let Some((smallest, _)) = sizes.min_by_key(|&(_, n)| n) {
                self.maps.remove(smallest);
            }
        }
    }

    /// The map whose turn it is, if the image fits it: taken out, with the image placed in it.
    pub(super) fn find(&mut self, stamp: Timestamp, frame: Frame, lens: &Lens) -> Option<(InactiveMap, PlacedCamera)> {
        if self.maps.is_empty() {
            return None;
        }
        self.turn = (self.turn + 1) % self.maps.len();
        let placed = self.maps[self.turn].tracker.find(stamp, frame, lens)?;
        Some((self.maps.remove(self.turn), placed))
    }
}

impl Mono {
    /// Where base is in metres, whatever the unit of the map: as the priors say, until a pose in metres is found.
    pub(super) fn reckon(&mut self, prior: Option<&MotionPrior>, since: f64) {
        let is_first = since <= 0.0;
        self.reckoned.1 &= is_first || prior.is_some_and(knows_way);
        self.reckoned.0 *= prior.map_or_else(Pose::identity, |p| p.t_prev_now);
    }

    /// A map that nothing fits for long gives way to a new one, where metres tie both together: the session joins what hangs
    /// on it when it recognises the place, and an image that fits the old map brings that back. A map in a unit of its own
    /// that no wheels lead out of is all there is, and stays.
    pub(super) fn give_up(&mut self) {
        let is_tied = self.scaling.scale().is_metric() || self.reckoned.1 || !self.atlas.is_empty();
        if self.num_lost < self.restart_after || !is_tied {
            return;
        }
        self.set_aside();
        self.t_odom_base = self.reckoned.0;
    }

    /// Puts the map away and begins anew.
    fn set_aside(&mut self) {
        let tracker = std::mem::replace(&mut self.tracker, Tracker::new(&self.params));
        let mut scaling = std::mem::take(&mut self.scaling);
        scaling.interrupt();
        self.atlas.put(InactiveMap { tracker, scaling, t_odom_start: self.t_odom_start });
    }

    /// An image that does not fit the map may fit one that was left: that is gone on with.
    pub(super) fn take_back(&mut self, stamp: Timestamp, frame: Frame, lens: &Lens) -> Option<PlacedCamera> {
        let (found, placed) = self.atlas.find(stamp, frame, lens)?;
        self.set_aside();
        (self.tracker, self.scaling, self.t_odom_start) = (found.tracker, found.scaling, found.t_odom_start);
        self.reference = None;
        Some(placed)
    }
}
