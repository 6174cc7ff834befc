//! What a session was sent, and its poses, as MCAP files of ROS 2 messages: for Foxglove, ROS 2 and `percept replay`.
//!
//! Comes in: frames with the declarations of their sensors, poses of base in the map. Goes out: files that are read while and
//! after they are written. It knows no session, and reads nothing back. Start with [`Recorder`].
//!
//! | topic | type | of |
//! |---|---|---|
//! | `/<sensor>/scan` | `sensor_msgs/msg/LaserScan` | planar scans |
//! | `/<sensor>/points` | `sensor_msgs/msg/PointCloud2` | clouds, with the channels that they have |
//! | `/<sensor>/depth/image_raw`, `…/camera_info` | `sensor_msgs/msg/Image` (`32FC1`), `CameraInfo` | depth images |
//! | `/<sensor>/color/image_raw`, `…/camera_info` | `sensor_msgs/msg/Image` (`rgb8`), `CameraInfo` | colour, alone or of depth |
//! | `/<sensor>/imu` | `sensor_msgs/msg/Imu` | inertial samples |
//! | `/<sensor>/odometry` | `nav_msgs/msg/Odometry` | wheels: `<sensor>` in `<sensor>/odom` |
//! | `/tf_static` | `tf2_msgs/msg/TFMessage` | mounts: each sensor's frame in `base_link` |
//! | `/tf` | `tf2_msgs/msg/TFMessage` | `base_link` in `map` |
//! | `/percept/pose` | `geometry_msgs/msg/PoseWithCovarianceStamped` | the same with its covariance |
//!
//! `<sensor>` is the sensor's id as ROS allows it, and its frame: what is no letter or digit is `_`, and of two ids that would be
//! one the second has a number.
//!
//! **Times** are the session's: a sensor's stamp and its declared `time_offset_s`, in the message, as its log time and as its
//! time of publication. So frames of all sensors come in one order when they are read, and a replay, which declares no offsets,
//! gives each frame the stamp that it had in the session.
//!
//! **Poses** are results, and a replay takes none of them for a measurement: of transforms it takes odometry alone, which is
//! what lies in a frame `odom`. There is none of that name here. Images are called raw, because a topic that is called
//! rectified is read without the lens's distortion.
//!
//! **What is lost**: what messages have no place for. Echoes of a scan behind the first, an odometry step's covariance, how far
//! a sensor sees; of a scan's angles and limits, what 32 bits cannot hold; stamps after 2038 are in the log times alone.

mod error;
mod files;
mod messages;
mod names;
mod recorder;
mod room;
mod state;

pub use error::RecordError;
pub use recorder::{Recorder, RecorderSettings};
pub use room::SharedRoom;
pub use state::{Dropped, RecordingState};
