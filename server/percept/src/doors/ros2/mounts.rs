//! Where sensors are declared to be, beside what their transforms say: those were put right or moved since, or move.

use percept_geometry::Pose;
use percept_ros::FrameTree;
use std::collections::BTreeMap;

/// A transform that says otherwise than a sensor was declared by more than this is told of, metres and radians: what calibrations
/// differ by is less.
const OTHERWISE: (f64, f64) = (0.03, 0.03);

/// Where sensors are declared to be, by topic.
#[derive(Debug, Default)]
pub(super) struct Mounts(BTreeMap<String, Mount>);

#[derive(Debug)]
struct Mount {
    frame: String,
    t_base_sensor: Pose,
    is_told: bool,
}

impl Mounts {
    /// Notes where the sensor of a topic is declared to be, and the frame of its messages.
    pub(super) fn note(&mut self, topic: &str, frame: &str, t_base_sensor: Pose) {
        self.0.insert(topic.to_owned(), Mount { frame: frame.to_owned(), t_base_sensor, is_told: false });
    }

    /// Topics of sensors whose transform from base has come to say otherwise, with words for an operator; each once.
    pub(super) fn contradicted(&mut self, frames: &FrameTree, base: &str) -> Vec<(String, String)> {
        let mut told = vec![];
        for (topic, mount) in self.0.iter_mut().filter(|(_, mount)| !mount.is_told) {
            let Some(now) = frames.t_a_b(base, &mount.frame) else { continue };
            let off = mount.t_base_sensor.inverse() * now;
            let (metres, radians) = (off.translation.vector.norm(), off.rotation.angle());
            if metres > OTHERWISE.0 || radians > OTHERWISE.1 {
                mount.is_told = true;
                let words = format!(
                    "its transform from {base} is {metres:.2} m and {:.0} degrees off its mount as declared, which stays: if it is \
                     the transform that is right, put t_base_sensor right (UpdateSensor) or delete the session; a sensor that \
                     moves on the robot is not supported",
                    radians.to_degrees()
                );
                told.push((topic.clone(), words));
            }
        }
        told
    }
}
