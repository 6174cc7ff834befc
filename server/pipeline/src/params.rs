//! The tree of all parameters of a session.

use crate::Preset;
use percept_mapping::{LiveParams, MapParams};
use percept_perception::detection::DetectionParams;
use percept_planning::PlanParams;
use percept_scene::rooms::RoomParams;
use percept_scene::{RelationParams, TrackerParams};
use percept_slam::{BackEndParams, OdometryParams};
use serde::{Deserialize, Serialize};

/// A parameter outside its bounds: what each crate's `validate` said, with the path to the field.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{section}: {message}")]
pub struct ParamsError {
    /// Section of the tree, e.g. `map`.
    pub section: &'static str,
    /// Field, value, remedy.
    pub message: String,
}

impl ParamsError {
    /// What went wrong in a section.
    pub(crate) fn of(section: &'static str, e: impl std::fmt::Display) -> Self {
        Self { section, message: e.to_string() }
    }
}

/// How poses are found.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SlamParams {
    /// Sensor that moves the pose. Empty: the best declared (lidar3d, lidar2d, rgbd or depth, camera).
    pub pose_sensor: String,
    /// Only localises in the map that there is: nothing that the robot sees enters it, and where that contradicts the map the robot is
    /// lost and looked for. In a session without a map the robot is lost until one is imported. May be turned on and off at any time; after it
    /// is off the map goes on where the robot is.
    pub localisation_only: bool,
    /// Registration of frames, and when one becomes a keyframe.
    pub odometry: OdometryParams,
    /// Loops, and the corrections that follow from them.
    pub back_end: BackEndParams,
    /// Lidars and depth cameras beside the sensor that moves the pose.
    pub second_sensors: SecondSensorParams,
}

/// Lidars and depth cameras beside the sensor that moves the pose.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SecondSensorParams {
    /// Whether each of their frames is registered: that places them more exactly, helps the pose where its sensor sees too little, and
    /// leads while that is silent. A frame takes as much time as it would if that sensor moved the pose; without, frames are placed
    /// where the pose sensor says the robot is, which costs nothing.
    pub enabled: bool,
    /// While the pose sensor sees well, a frame is left out until base has moved so far since the last one, metres, 0 to 10. Less:
    /// more exact at once where the pose sensor fails, and slower.
    pub distance_m: f64,
    /// Or has turned so far, radians, 0 to pi.
    pub angle_rad: f64,
}

impl Default for SecondSensorParams {
    fn default() -> Self {
        Self { enabled: true, distance_m: 0.15, angle_rad: 0.1 }
    }
}

impl SecondSensorParams {
    fn validate(&self) -> Result<(), ParamsError> {
        let pi = std::f64::consts::PI;
        for (field, value, most) in [("distance_m", self.distance_m, 10.0), ("angle_rad", self.angle_rad, pi)] {
            if !(0.0..=most).contains(&value) {
                let message = format!("{field} is {value}; set it between 0 and {most:.2}");
                return Err(ParamsError { section: "slam.second_sensors", message });
            }
        }
        Ok(())
    }
}

/// What is looked for, and where.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DetectionSettings {
    /// Whether objects are looked for at all.
    pub enabled: bool,
    /// The map around the robot is searched up to this distance, metres, 1 to 50.
    pub range_m: f64,
    /// Name of a learned detector, the server's or an uploaded one, which looks for things in the colour images of keyframes with
    /// depth. Empty: none.
    pub learned: String,
    /// How objects are proposed, boxed and classified.
    pub detector: DetectionParams,
}

impl Default for DetectionSettings {
    fn default() -> Self {
        Self { enabled: true, range_m: 6.0, learned: String::new(), detector: DetectionParams::default() }
    }
}

/// Every parameter of a session.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PipelineParams {
    /// Poses.
    pub slam: SlamParams,
    /// Map layers.
    pub map: MapParams,
    /// What the newest frames see beside the map, for paths.
    pub live: LiveParams,
    /// Objects.
    pub detection: DetectionSettings,
    /// Identity of objects through time.
    pub tracker: TrackerParams,
    /// Relations of the scene graph.
    pub relations: RelationParams,
    /// What makes a room.
    pub rooms: RoomParams,
    /// Paths.
    pub planning: PlanParams,
    /// What the defaults of the rest are made for.
    pub preset: Preset,
}

impl PipelineParams {
    /// Checks every parameter against its bounds.
    ///
    /// # Errors
    /// The first that is out of bounds.
    pub fn validate(&self) -> Result<(), ParamsError> {
        fn named<E: std::fmt::Display>(section: &'static str) -> impl Fn(E) -> ParamsError {
            move |e| ParamsError::of(section, e)
        }
        self.slam.odometry.validate().map_err(named("slam.odometry"))?;
        self.slam.back_end.validate().map_err(named("slam.back_end"))?;
        self.slam.second_sensors.validate()?;
        self.map.validate().map_err(named("map"))?;
        self.live.validate().map_err(named("live"))?;
        self.detection.detector.validate().map_err(named("detection.detector"))?;
        if !(1.0..=50.0).contains(&self.detection.range_m) {
            let message = format!("range_m is {}; set it between 1 and 50", self.detection.range_m);
            return Err(ParamsError { section: "detection", message });
        }
        self.tracker.validate().map_err(named("tracker"))?;
        self.relations.validate().map_err(named("relations"))?;
        self.rooms.validate().map_err(named("rooms"))?;
        self.planning.validate().map_err(named("planning"))
    }
}
