//! The scene: objects that are looked for in the map around new keyframes, followed through time, and moved with the map. Outdoors
//! they are looked for in the keyframe's sweep itself: what drives is in no map.
//!
//! What passes between keyframes is looked for in the newest frames ([`crate::passing`]).
//!
//! They are looked for beside the frames. What was found enters at the first frame that is [`DELAY_S`] younger than the
//! keyframe, moved by what the keyframe was moved by meanwhile.

use crate::beside::{Executor, Task};
use crate::learned::LearnedLook;
use crate::live::News;
use crate::passing::Passing;
use crate::visibility::Beams;
use crate::{Chunks, DetectionSettings, KeyframeInfo, NewKeyframe, ParamsError, PipelineParams, Preset};
use nalgebra::{Point3, Translation3, UnitQuaternion};
use percept_geometry::{KeyframeId, OrientedBox3, PointCloud, Pose, SensorId, Timestamp};
use percept_mapping::{CloudMap, MapLayers};
use percept_perception::detection::outdoor::{OutdoorDetector, OutdoorParams};
use percept_perception::detection::{ClassExample, Detection, Detector, GaussianClassifier, ImageDetectors};
use percept_perception::segmentation::GroundParams;
use percept_scene::overlap::upright;
use percept_scene::{Correction, CorrectionError, Object, ObjectChange, ObjectId, Observation, Tracker, Visibility};
use percept_slam::{CloudScan, Scan};
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

/// What was found around a keyframe is taken in so many seconds after it. A search takes 0.05 to 0.1 s on one core around a 3D
/// lidar in rooms (`scale lidar3d`), so that frames of a busy server do not wait either; objects are told that much later.
const DELAY_S: f64 = 0.5;
/// Objects this near to the edge of the searched part of the map may be cut by it, metres. The map is seen so much farther than
/// objects are told: of a wall that reaches in there is enough then to be known as one (`DetectionParams::wall_min_length_m`), and
/// is not told as a thing with whatever stands before it.
const SEARCH_EDGE_M: f64 = 1.5;

/// Points of a keyframe in a thing's box that are a look at it: fewer come about by noise.
const LOOK: usize = 5;
/// And so far outside of it, metres: a voxel of the cloud that it was found in.
const AT_SIDES_M: f64 = 0.05;

/// Detector, tracker, objects.
pub(crate) struct Scene {
    settings: DetectionSettings,
    detector: Arc<Detector>,
    /// Outdoors: how objects are looked for in a sweep.
    outdoor: Option<OutdoorParams>,
    executor: Option<Arc<dyn Executor>>,
    /// Begun and not taken in, oldest first.
    searches: VecDeque<Search>,
    /// Learned detectors that the settings may name.
    image_detectors: ImageDetectors,
    /// Classes that people showed.
    examples: Arc<Vec<ClassExample>>,
    passing: Passing,
    tracker: Tracker,
    objects: Arc<Vec<Object>>,
    tracked: Arc<Vec<Object>>,
}

/// A search for objects around a keyframe.
struct Search {
    keyframe: KeyframeId,
    stamp: Timestamp,
    /// Base to map when it was begun.
    t_map_base: Pose,
    range_m: f64,
    what: Searched,
    task: Task<Found>,
}

/// What was searched for objects.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Searched {
    /// All that the map holds around the robot.
    Around,
    /// What one sweep shows.
    Sweep,
}

/// What came of a search.
struct Found {
    /// In the map as it was when the search was begun.
    observations: Vec<Observation>,
    beams: Beams,
    /// What the map held there; none of a sweep.
    cloud: Option<CloudMap>,
    /// Where the map has something of which nothing is left.
    empty: Vec<OrientedBox3>,
}

impl Scene {
    /// Without objects.
    ///
    /// # Errors
    /// A parameter out of bounds.
    pub(crate) fn new(params: &PipelineParams) -> Result<Self, ParamsError> {
        Ok(Self {
            settings: params.detection.clone(),
            detector: detector(params, &[])?,
            outdoor: outdoor(params),
            image_detectors: ImageDetectors::default(),
            examples: Arc::default(),
            passing: Passing::default(),
            executor: None,
            searches: VecDeque::new(),
            tracker: Tracker::new(params.tracker.clone()).map_err(|e| ParamsError::of("tracker", e))?,
            objects: Arc::default(),
            tracked: Arc::default(),
        })
    }

    /// Looks for objects and follows them by other parameters from now on.
    ///
    /// # Errors
    /// A parameter out of bounds; nothing was changed.
    pub(crate) fn set_params(&mut self, params: &PipelineParams) -> Result<(), ParamsError> {
        let detector = detector(params, &self.examples)?;
        self.tracker.set_params(params.tracker.clone()).map_err(|e| ParamsError::of("tracker", e))?;
        (self.settings, self.detector, self.outdoor) = (params.detection.clone(), detector, outdoor(params));
        Ok(())
    }

    /// May use these learned detectors from now on.
    pub(crate) fn set_image_detectors(&mut self, detectors: ImageDetectors) {
        self.image_detectors = detectors;
    }

    /// Knows these classes beside the built-in ones from now on.
    pub(crate) fn set_examples(&mut self, params: &PipelineParams, examples: Arc<Vec<ClassExample>>) {
        // The parameters are in force already.
        if let Ok(detector) = detector(params, &examples) {
            (self.detector, self.examples) = (detector, examples);
        }
    }

    /// Does as a person says of an object.
    ///
    /// # Errors
    /// [`CorrectionError`]; nothing was changed.
    pub(crate) fn annotate(
        &mut self,
        id: ObjectId,
        correction: Correction,
    ) -> Result<Vec<ObjectChange>, CorrectionError> {
        let changes = self.tracker.annotate(id, correction)?;
        self.show();
        Ok(changes)
    }

    /// Confirmed objects by id, those gone included, as they are told.
    pub(crate) fn objects(&self) -> Arc<Vec<Object>> {
        Arc::clone(&self.objects)
    }

    /// The same as they are followed and stored: with those that people set aside.
    pub(crate) fn tracked(&self) -> Arc<Vec<Object>> {
        Arc::clone(&self.tracked)
    }

    fn show(&mut self) {
        self.tracked = Arc::new(self.tracker.objects());
        let is_as_told = self.tracked.iter().all(|o| o.annotation.is_listed());
        self.objects = if is_as_told { Arc::clone(&self.tracked) } else { Arc::new(self.tracker.listed()) };
    }

    /// Number that the next object gets.
    pub(crate) fn next_object_id(&self) -> u64 {
        self.tracker.next_id()
    }

    /// Brings back objects that were stored.
    pub(crate) fn restore(&mut self, params: &PipelineParams, objects: &[Object], next_object_id: u64) {
        if let Ok(tracker) = Tracker::restore(params.tracker.clone(), objects, next_object_id) {
            self.tracker = tracker;
        }
        self.show();
    }

    /// Looks for objects beside frames, on threads of the executor's.
    pub(crate) fn set_executor(&mut self, executor: Arc<dyn Executor>) {
        self.executor = Some(executor);
    }

    /// Begins to look for objects in the map around a new keyframe; outdoors in the sweep that it was made of, and among what it saw
    /// `moving`, base frame.
    pub(crate) fn look_around(&mut self, layers: MapLayers, keyframe: &NewKeyframe, moving: PointCloud, of: &Scan) {
        // A camera alone sees too little for that.
        if !self.settings.enabled || keyframe.scan.planar || matches!(of, Scan::Image(_)) {
            return;
        }
        if let (Some(params), Scan::Cloud(sweep)) = (self.outdoor, of) {
            return self.look_through(params, sweep.clone(), keyframe, moving);
        }
        let (t_map_base, range_m) = (keyframe.info.t_map_base, self.settings.range_m);
        let (detector, cloud, scan) = (Arc::clone(&self.detector), layers.cloud, Arc::clone(&keyframe.scan));
        let learned = LearnedLook::of(&self.image_detectors, &self.settings.learned, of);
        let task = Task::begin(self.executor.as_ref(), move || {
            let center: Point3<f64> = t_map_base.translation.vector.into();
            let around = cloud.points_within(&center, range_m + SEARCH_EDGE_M);
            // The fused cloud is sound by construction; a detector that refuses it finds nothing.
            let mut found = detector.detect(&around).unwrap_or_default();
            found.retain(|d| (d.bbox.center() - center).norm() < range_m);
            let seen = scan.hits.transformed(&t_map_base).positions;
            let observation = |d: &Detection| Observation {
                class: d.class,
                confidence: d.confidence,
                bbox: d.bbox,
                num_points: d.num_points,
                is_moving: false,
                is_seen: is_seen(&d.bbox, &seen),
            };
            // What is still in the cloud while beams go through its place is what has not been taken out of it yet.
            let beams = Beams::new(&scan);
            let is_empty = |d: &Detection| beams.finds_empty(&t_map_base, &d.bbox, &around.positions);
            let empty = found.extract_if(.., |d| is_empty(d)).map(|d| d.bbox).collect();
            let mut observations = found.iter().map(observation).collect();
            if let Some(learned) = learned {
                learned.add_to(&mut observations, &t_map_base);
            }
            Found { observations, beams, cloud: Some(cloud), empty }
        });
        self.begun(keyframe, task, Searched::Around);
    }

    /// Begins to look for objects in a keyframe's sweep.
    fn look_through(&mut self, params: OutdoorParams, sweep: CloudScan, keyframe: &NewKeyframe, moving: PointCloud) {
        let (t_map_base, range_m) = (keyframe.info.t_map_base, self.settings.range_m);
        let scan = Arc::clone(&keyframe.scan);
        let task = Task::begin(self.executor.as_ref(), move || {
            // As the detector wants it: from where the beams start, z up.
            let t_base_sensor = sweep.t_base_sensor;
            let turned = Pose::from_parts(Translation3::identity(), t_base_sensor.rotation);
            let levelled = sweep.cloud.transformed(&turned);
            let t_map_levelled = t_map_base * Pose::from_parts(t_base_sensor.translation, UnitQuaternion::identity());
            let sensor_height_m = t_base_sensor.translation.z + scan.base_height_m;
            let ground = GroundParams { sensor_height_m, ..params.ground };
            // A sweep was checked when it came; a mount below the ground finds nothing.
            let detector = OutdoorDetector::new(OutdoorParams { ground, ..params });
            let found = detector.and_then(|d| d.detect(&levelled)).unwrap_or_default();
            let (all, moving) = (levelled.transformed(&t_map_levelled), moving.transformed(&t_map_base));
            let observation = |d: &Detection| {
                let bbox = upright(&d.bbox.transformed(&t_map_levelled));
                let (class, confidence, num_points) = (d.class, d.confidence, d.num_points);
                let is_moving = moves(&bbox, &moving, &all);
                Observation { class, confidence, bbox, num_points, is_moving, is_seen: true }
            };
            let near = found.iter().filter(|d| d.bbox.center().coords.norm() <= range_m);
            Found {
                observations: near.map(observation).collect(),
                beams: Beams::new(&scan),
                cloud: None,
                empty: vec![],
            }
        });
        self.begun(keyframe, task, Searched::Sweep);
    }

    fn begun(&mut self, keyframe: &NewKeyframe, task: Task<Found>, what: Searched) {
        let (t_map_base, range_m) = (keyframe.info.t_map_base, self.settings.range_m);
        let (keyframe, stamp) = (keyframe.info.id, keyframe.info.stamp);
        self.searches.push_back(Search { keyframe, stamp, t_map_base, range_m, what, task });
    }

    /// Whether something is being looked for.
    pub(crate) fn is_looking(&self) -> bool {
        !self.searches.is_empty() || self.passing.is_looking()
    }

    /// Where what passes is expected at a stamp: boxes in the map frame.
    pub(crate) fn passing_boxes(&self, stamp: Timestamp) -> Vec<OrientedBox3> {
        self.tracker.passing_boxes(stamp)
    }

    /// Whether a frame is to be looked through for what passes. Outdoors keyframes alone are.
    pub(crate) fn wants_news(&self, sensor: &SensorId, stamp: Timestamp) -> bool {
        self.settings.enabled && self.outdoor.is_none() && self.passing.is_due(sensor, stamp)
    }

    /// Begins to look for what passes in what a frame shows in free space, and for what is gone from around `t_map_base`, from where
    /// it was taken.
    pub(crate) fn look_for_passing(
        &mut self,
        of: (&SensorId, Timestamp),
        (t_map_base, cloud): (&Pose, CloudMap),
        news: impl FnOnce() -> News + Send + 'static,
    ) {
        let standing = self.tracker.standing_near(&Point3::from(t_map_base.translation.vector), self.settings.range_m);
        self.passing.look(of, self.executor.as_ref(), (standing, cloud), news);
    }

    /// Takes in what was found and is due at a frame; all that was begun, if there is none. `keyframes` are where they are now.
    pub(crate) fn take_found(
        &mut self,
        frame: Option<Timestamp>,
        keyframes: &Chunks<KeyframeInfo>,
    ) -> Vec<ObjectChange> {
        let mut changes = vec![];
        let is_due = |s: &mut Search| frame.is_none_or(|now| now >= s.stamp.plus_seconds(DELAY_S));
        while let Some(search) = self.searches.pop_front_if(is_due) {
            changes.extend(self.take_in(&search, keyframes));
            self.show();
        }
        let (was_asked, passing) = self.passing.take_found(frame, &mut self.tracker);
        if was_asked {
            self.show();
        }
        changes.extend(passing);
        changes
    }

    fn take_in(&mut self, search: &Search, keyframes: &Chunks<KeyframeInfo>) -> Vec<ObjectChange> {
        let Found { mut observations, beams, cloud, mut empty } = search.task.finished();
        let keyframe = usize::try_from(search.keyframe.0).ok().and_then(|i| keyframes.get(i));
        let t_map_base = keyframe.map_or(search.t_map_base, |k| k.t_map_base);
        let t_new_old = t_map_base * search.t_map_base.inverse();
        if t_map_base != search.t_map_base {
            let boxes = observations.iter_mut().map(|o| &mut o.bbox).chain(&mut empty);
            boxes.for_each(|b| *b = upright(&b.transformed(&t_new_old)));
        }
        let center = Point3::from(t_map_base.translation.vector);
        // The detector sees all of the map around the robot: what it does not find there is no thing of its own. In a sweep that goes
        // for what is not hidden.
        let searched_m = search.range_m - SEARCH_EDGE_M;
        // Most of it, not a piece in its middle.
        let is_of = |e: &OrientedBox3, b: &OrientedBox3| 2.0 * e.volume() > b.volume() && e.contains(&b.center());
        let is_empty = |b: &OrientedBox3| empty.iter().any(|e| is_of(e, b) && b.contains(&e.center()));
        let has_gone = |b: &OrientedBox3| {
            let then = upright(&b.transformed(&t_new_old.inverse()));
            cloud.as_ref().is_none_or(|cloud| beams.has_gone(&search.t_map_base, &then, cloud))
        };
        let look = |b: &OrientedBox3| match beams.visibility(&t_map_base, b) {
            Visibility::SeenThrough if !has_gone(b) => Visibility::Occupied,
            looked => looked,
        };
        self.tracker.update(search.stamp, &observations, &|b| match look(b) {
            _ if is_empty(b) => Visibility::SeenThrough,
            Visibility::SeenThrough => Visibility::SeenThrough,
            Visibility::Unseen if search.what == Searched::Sweep => Visibility::Unseen,
            _ if (b.center() - center).norm() < searched_m => Visibility::Refuted,
            unsure => unsure,
        })
    }

    /// Keyframes moved, by `t_new_old` in the map: each object follows the one nearest in time to when it was last seen.
    pub(crate) fn follow(&mut self, keyframes: &Chunks<KeyframeInfo>, t_new_old: &BTreeMap<KeyframeId, Pose>) {
        let nearest = |stamp: Timestamp| {
            let after = keyframes.partition_point(|k| k.stamp < stamp);
            let around = [after.checked_sub(1), Some(after)].into_iter().flatten().filter_map(|i| keyframes.get(i));
            around.min_by_key(|k| k.stamp.nanos().abs_diff(stamp.nanos())).map(|k| k.id)
        };
        let moved_by = |last_seen| nearest(last_seen).and_then(|id| t_new_old.get(&id).copied());
        self.tracker.correct(&|_, last_seen| moved_by(last_seen).unwrap_or_else(Pose::identity));
        self.show();
    }
}

/// Whether more than half of the points in a box are among those that move. Few boxes hold any of those: only for them is
/// the whole cloud gone through.
fn moves(bbox: &OrientedBox3, moving: &PointCloud, all: &PointCloud) -> bool {
    let inside = |p: &&Point3<f32>| bbox.contains(&p.cast());
    let moving = moving.positions.iter().filter(inside).count();
    moving > 0 && all.positions.iter().filter(inside).take(2 * moving).count() < 2 * moving
}

/// Whether some points lie in a box, or at its sides.
fn is_seen(bbox: &OrientedBox3, points: &[Point3<f32>]) -> bool {
    let grown = OrientedBox3 { size: bbox.size.add_scalar(2.0 * AT_SIDES_M), ..*bbox };
    let (center, reach) = (grown.center().cast::<f32>(), 0.5 * grown.size.norm() as f32);
    let near = points.iter().filter(|p| nalgebra::distance_squared(p, &center) <= reach * reach);
    near.filter(|p| grown.contains(&p.cast())).take(LOOK).count() == LOOK
}

/// How objects are looked for in sweeps, where they are. What nobody can name is left out: hedges, poles, corners of houses.
fn outdoor(params: &PipelineParams) -> Option<OutdoorParams> {
    (params.preset == Preset::Outdoor).then(|| OutdoorParams { tell_unknown: false, ..OutdoorParams::default() })
}

/// A detector for what the fused cloud holds, however coarse that is, and for classes that people showed.
pub(crate) fn detector(params: &PipelineParams, examples: &[ClassExample]) -> Result<Arc<Detector>, ParamsError> {
    let detector = params.detection.detector.for_spacing(params.map.cloud.voxel_size_m);
    let classifier = Arc::new(GaussianClassifier::with_examples(examples));
    let detector = Detector::with_classifier(detector, classifier);
    detector.map(Arc::new).map_err(|e| ParamsError::of("detection.detector", e))
}
