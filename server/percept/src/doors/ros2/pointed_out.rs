//! What somebody points out on the map in RViz: where to go, and where the robot is.

use super::checks::no_message;
use super::link::Found;
use super::publish::Goal;
use super::settings::Robot;
use percept_geometry::Pose;
use percept_ros::messages::{self, Header, PoseStamped, PoseWithCovarianceStamped};
use percept_ros::{Message, convert};
use percept_service::{Caller, Error, reason};
use tokio::sync::mpsc;
use tokio::task::JoinHandle;

/// RViz' "2D Goal Pose".
const GOAL: &str = "goal_pose";
/// RViz' "2D Pose Estimate".
const PLACE: &str = "initialpose";

/// Whether a topic says such a thing.
pub(super) fn is_wanted(robot: &Robot, found: &Found) -> bool {
    let is = |name, type_name| found.topic == robot.topic(name) && found.type_name == type_name;
    is(GOAL, PoseStamped::TYPE_NAME) || is(PLACE, PoseWithCovarianceStamped::TYPE_NAME)
}

/// Does as it is told by such topics.
pub(super) struct PointedOut {
    goals: mpsc::Sender<Goal>,
    /// Waits for what comes of the newest place.
    placing: Option<JoinHandle<()>>,
}

impl PointedOut {
    pub(super) fn new(goals: mpsc::Sender<Goal>) -> Self {
        Self { goals, placing: None }
    }

    /// Takes a message; none if its topic is another one.
    pub(super) fn take(
        &mut self,
        robot: &Robot,
        caller: &Caller,
        topic: &str,
        bytes: &[u8],
    ) -> Option<Result<(), Error>> {
        if *topic == *robot.topic(GOAL) {
            return Some(goal(robot, bytes).map(|t_map_goal| {
                // One that is being planned to is as good as forgotten when the next comes.
                let _ = self.goals.try_send(Goal { t_map_goal });
            }));
        }
        (*topic == *robot.topic(PLACE)).then(|| self.place(robot, caller, bytes))
    }

    /// Says where the robot is, beside what comes in: the frame that shows whether that is so comes behind it.
    fn place(&mut self, robot: &Robot, caller: &Caller, bytes: &[u8]) -> Result<(), Error> {
        let message = PoseWithCovarianceStamped::decode(bytes).map_err(no_message)?;
        let t_map_base = in_map(robot, &message.header, &message.pose.pose)?;
        let (caller, session) = (caller.clone(), robot.session.clone());
        let placing = tokio::spawn(async move {
            match caller.set_pose(&session, t_map_base).await {
                Ok((_, true)) => tracing::info!(session, "the robot is where initialpose says, by what it sees"),
                Ok((_, false)) => {
                    tracing::info!(session, "the robot is where initialpose says: nothing is mapped there")
                }
                Err(error) => tracing::warn!(session, reason = error.reason, %error, "initialpose is not believed"),
            }
        });
        if let Some(before) = self.placing.replace(placing) {
            before.abort();
        }
        Ok(())
    }
}

fn goal(robot: &Robot, bytes: &[u8]) -> Result<Pose, Error> {
    let message = PoseStamped::decode(bytes).map_err(no_message)?;
    in_map(robot, &message.header, &message.pose)
}

fn in_map(robot: &Robot, header: &Header<'_>, pose: &messages::Pose) -> Result<Pose, Error> {
    let frame = header.frame_id.trim_start_matches('/');
    if !frame.is_empty() && frame != robot.map_frame {
        let words = format!("the pose is in {frame}; give it in {}", robot.map_frame);
        return Err(Error::invalid(reason::OUT_OF_RANGE, "header.frame_id", words));
    }
    convert::pose(pose).map_err(|e| Error::invalid(reason::MESSAGE_INVALID, "pose", e.to_string()))
}
