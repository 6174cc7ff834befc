//! What the newest frames see, laid over the grid: whom a person stands in the way of wants to know at once, not at the next
//! keyframe, and a robot that stands makes none.
//!
//! Nothing of it enters the map. As the layer of obstacles of nav2's costmap, which marks and clears by each scan; ours keeps
//! to the heights that a beam tells about, and lets go of what was not seen for a while.

use crate::error::check;
use crate::layer::{Layer, joined};
use crate::occupancy::ScanUpdate;
use crate::{KeyframeView, MappingError, OccupancyGrid, OccupancyMap, OccupancyParams};
use percept_geometry::{Aabb3, KeyframeScan, Pose};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of what the newest frames see.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LiveParams {
    /// What was seen in the last so many seconds counts, 0 to 10; 0: paths are planned on the map alone.
    pub time_s: f64,
    /// What was seen up to so far from the sensor counts, metres, 0.5 to 100: of what moves farther away a robot learns in time.
    pub range_m: f64,
}

impl Default for LiveParams {
    /// Two and a half seconds: a person who steps behind another one is not forgotten at once. 10 m are six seconds at a quick
    /// walk.
    fn default() -> Self {
        Self { time_s: 2.5, range_m: 10.0 }
    }
}

impl LiveParams {
    /// Checks every field.
    ///
    /// # Errors
    /// `InvalidParam` naming field, value and remedy.
    pub fn validate(&self) -> Result<(), MappingError> {
        check("time_s", self.time_s, 0.0, 10.0, "choose 0 to 10")?;
        check("range_m", self.range_m, 0.5, 100.0, "choose 0.5 to 100")
    }

    /// How a live frame speaks of the grid's cells: two of them outweigh whatever the map says, the map's surest cell too.
    fn steps(&self, map: &OccupancyParams) -> OccupancyParams {
        OccupancyParams {
            // One lifts what is as free as can be to the doubt, the second beyond.
            hit_log_odds: -map.min_log_odds,
            free_log_odds: -0.55 * map.max_log_odds,
            range_max_m: Some(self.range_m.min(map.range_max())),
            ..*map
        }
    }
}

/// A frame as it is laid over the grid.
#[derive(Debug, Clone)]
pub struct LiveFrame {
    /// Base to map.
    pub t_map_base: Pose,
    /// What was seen.
    pub scan: Arc<KeyframeScan>,
    /// Whether no newer frame of its sensor is known: it counts twice, so that who steps into the way is seen by it alone.
    pub is_newest: bool,
}

impl OccupancyMap {
    /// The grid with the newest frames laid over it, oldest first. Work runs on the current rayon pool.
    pub fn under_frames(&self, params: &LiveParams, frames: &[LiveFrame]) -> Self {
        let look = |frame: &LiveFrame| (self.look(params, frame), if frame.is_newest { 2 } else { 1 });
        self.under_looks(params, &frames.par_iter().map(look).collect::<Vec<_>>())
    }

    /// What a frame says of the grid's cells.
    pub(crate) fn look(&self, params: &LiveParams, frame: &LiveFrame) -> ScanUpdate {
        let steps = params.steps(self.params());
        let view = KeyframeView::new(&frame.t_map_base, &frame.scan);
        <OccupancyGrid as Layer>::prepare(&steps, &view).sparing_beside_hits()
    }

    /// The grid with what frames say laid over it, each so many times.
    pub(crate) fn under_looks(&self, params: &LiveParams, looks: &[(ScanUpdate, usize)]) -> Self {
        let steps = params.steps(self.params());
        let mut live = <OccupancyGrid as Layer>::new(&steps);
        let mut touched = Aabb3::empty();
        for (update, times) in looks {
            (0..*times).for_each(|_| live.apply(update));
            touched = joined(&touched, &<OccupancyGrid as Layer>::touched(&steps, update));
        }
        if touched.is_empty() { self.clone() } else { self.under(live, steps, &touched) }
    }
}
