//! The perception toolbox: one cloud or image in, facts out; no session.
//!
//! [`Service::toolbox`] runs a request's work on the pool, within its budget of time. What the work may use is a
//! [`Toolbox`]: the limits, the kept clouds, the time. The operations themselves are functions, one file a group;
//! they call `perception` and `formats` and turn what those refuse into errors with reason and field.

mod clouds;
mod depth_images;
mod features;
mod files;
mod images;
mod kept;
mod pictures;
mod pipeline;
mod regions;
mod registration;
mod shapes;
mod subsets;

pub use super::errors::{cloud_error, format_error, registration_error};
pub use clouds::*;
pub use depth_images::{DepthFilter, filter_depth};
pub use features::{FeatureMethod, extract_features, feature_error};
pub use files::{CloudFormat, decode_cloud, encode_cloud, suffix};
pub use images::{PosedView, detect_in_image, multiview_error, triangulate_points};
pub(crate) use kept::tenant_of;
pub use kept::{KeptCloud, KeptClouds, KeptList};
pub use pictures::{render_cloud, render_depth};
pub use pipeline::{Found, PlaneRemainder, Step, StepReport};
pub use regions::{group_convex, grow_regions, segment_ground, segment_objects, supervoxels};
pub use registration::{compute_point_features, register_clouds};
pub use shapes::{Boxes, NeighborhoodParams, convex_hull, find_neighbors, fit_boxes};
pub use subsets::{Region, Sample, crop_cloud, sample_points};

use crate::{Alive, CloudDetail, Error, ErrorCode, Limits, Progress, Result, Service};
use nalgebra::Point3;
use percept_geometry::PointCloud;
use percept_perception::detection::{DetectionParams, ImageDetectors};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// The cloud of a session's map that a request works on.
#[derive(Debug, Clone, PartialEq)]
pub struct SessionCloud {
    /// Field of the request that names it.
    pub field: String,
    /// The session.
    pub session: String,
    /// Only the part around a point (m, map frame; radius m).
    pub around: Option<(Point3<f64>, f64)>,
}

/// What the work of one request may use.
pub struct Toolbox {
    limits: Arc<Limits>,
    kept: Arc<KeptClouds>,
    /// Clouds of sessions that the request asks for.
    maps: Vec<(SessionCloud, Arc<PointCloud>)>,
    /// Whose kept clouds they are: others' are as if they were not there.
    owner: String,
    detector: DetectionParams,
    image_detectors: ImageDetectors,
    begin: Instant,
    budget: Duration,
    alive: Alive,
    progress: Progress,
}

impl Toolbox {
    /// The limits in force.
    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    /// How objects are found.
    pub fn detector(&self) -> &DetectionParams {
        &self.detector
    }

    /// Learned detectors.
    pub fn image_detectors(&self) -> &ImageDetectors {
        &self.image_detectors
    }

    /// A kept cloud; its time starts anew.
    ///
    /// # Errors
    /// `CLOUD_NOT_FOUND` naming `field`.
    pub fn kept(&self, field: &str, handle: &str) -> Result<Arc<PointCloud>> {
        self.kept.get(&self.owner, field, handle)
    }

    /// The cloud of a session that a field of the request asks for.
    ///
    /// # Errors
    /// `INTERNAL` if it was not asked for.
    pub fn session_cloud(&self, field: &str) -> Result<Arc<PointCloud>> {
        let found = self.maps.iter().find(|(wanted, _)| wanted.field == field);
        let none = || Error::internal(format!("no cloud was fetched for {field}"));
        found.map(|(_, cloud)| Arc::clone(cloud)).ok_or_else(none)
    }

    /// Keeps a cloud for later requests, at most `keep_s` seconds unused.
    ///
    /// # Errors
    /// `KEPT_CLOUDS_FULL` if the budget has no room; `OUT_OF_RANGE` naming `keep_s`.
    pub fn keep(&self, cloud: impl Into<Arc<PointCloud>>, keep_s: Option<f64>) -> Result<KeptCloud> {
        self.kept.keep(&self.owner, cloud.into(), keep_s)
    }

    /// The kept clouds and their budget.
    pub fn list_kept(&self) -> KeptList {
        self.kept.list(&self.owner)
    }

    /// Forgets a kept cloud.
    ///
    /// # Errors
    /// `CLOUD_NOT_FOUND`.
    pub fn drop_kept(&self, handle: &str) -> Result<()> {
        self.kept.forget(&self.owner, handle)
    }

    /// Begins a step of several, if there is time left and somebody who waits.
    ///
    /// # Errors
    /// `COMPUTATION_TOO_LONG`, `CANCELLED`, `OPERATION_CANCELLED`.
    fn begin_step(&self, step: usize, steps: usize, name: &str) -> Result<()> {
        self.check_time()?;
        self.progress.step(step, steps, name);
        Ok(())
    }

    fn check_time(&self) -> Result<()> {
        self.progress.check()?;
        if !self.alive.is_wanted() {
            return Err(Error::new(
                ErrorCode::DeadlineExceeded,
                "CANCELLED",
                "the caller no longer waits for the answer",
            ));
        }
        if self.begin.elapsed() < self.budget { Ok(()) } else { Err(crate::compute::too_long(self.budget)) }
    }
}

/// How long a request may compute.
pub(crate) fn budget(limits: &Limits) -> Duration {
    Duration::from_millis(limits.max_computation_ms as u64)
}

impl Service {
    /// What sessions have mapped, for requests that ask for it.
    ///
    /// # Errors
    /// Those of [`cloud`](Self::cloud), and `CLOUD_TOO_LARGE`, naming the field.
    pub(crate) async fn session_clouds(
        &self,
        wanted: Vec<SessionCloud>,
    ) -> Result<Vec<(SessionCloud, Arc<PointCloud>)>> {
        let limit = self.limits.max_cloud_points;
        let mut maps = Vec::with_capacity(wanted.len());
        for wanted in wanted {
            let found = self.cloud(&wanted.session, wanted.around, CloudDetail::default()).await;
            let cloud = found.map_err(|e| e.within(&wanted.field))?.cloud;
            if cloud.len() > limit {
                let n = cloud.len();
                let words = format!("the session's cloud has {n} points, the limit is {limit}; ask for a part of it");
                return Err(Error::exhausted("CLOUD_TOO_LARGE", wanted.field.as_str(), words));
            }
            maps.push((wanted, Arc::new(cloud)));
        }
        Ok(maps)
    }

    /// Runs a toolbox request's work on the pool, with the kept clouds of `owner` and those of sessions.
    ///
    /// # Errors
    /// Those of the work; `COMPUTATION_TOO_LONG`.
    pub async fn toolbox<T: Send + 'static>(
        &self,
        owner: String,
        maps: Vec<(SessionCloud, Arc<PointCloud>)>,
        work: impl FnOnce(&Toolbox) -> Result<T> + Send + 'static,
    ) -> Result<T> {
        self.toolbox_within(owner, maps, budget(&self.limits), Progress::default(), work).await
    }

    /// The same within a budget of its own, heard of and cancelled through `progress`.
    ///
    /// # Errors
    /// Those of the work; `COMPUTATION_TOO_LONG`, `OPERATION_CANCELLED`.
    pub(crate) async fn toolbox_within<T: Send + 'static>(
        &self,
        owner: String,
        maps: Vec<(SessionCloud, Arc<PointCloud>)>,
        budget: Duration,
        progress: Progress,
        work: impl FnOnce(&Toolbox) -> Result<T> + Send + 'static,
    ) -> Result<T> {
        let (limits, kept) = (Arc::clone(&self.limits), Arc::clone(&self.kept));
        let detector = self.default_params().detection.detector;
        let image_detectors = self.registry.shelf.of_tenant(tenant_of(&owner));
        let asker = self.compute.admission().asker(tenant_of(&owner), &owner)?;
        let work = move |alive: &Alive| {
            progress.stage("reading what was sent");
            let (begin, alive) = (Instant::now(), alive.clone());
            work(&Toolbox { limits, kept, maps, owner, detector, image_detectors, begin, budget, alive, progress })
        };
        self.compute.request_within(&asker, budget, work).await?
    }
}
