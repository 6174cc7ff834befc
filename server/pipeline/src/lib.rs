//! Everything for one robot: sensor frames in, an immutable [`Snapshot`] out.
//!
//! One writer, no clock, no files, no sockets: time comes with the frames, parallelism from the rayon pool
//! that the caller runs it in, and threads for what runs beside the frames from its [`Executor`]. Start with
//! [`Pipeline::process`].

mod beside;
mod chunks;
mod frame_error;
mod frontend;
mod later;
mod learned;
mod live;
mod lookup;
mod map_graph;
mod params;
mod passing;
mod pipeline;
mod preset;
mod related;
mod restored;
mod rooms;
mod scene;
mod second_look;
mod snapshot;
mod surroundings;
mod visibility;

pub use beside::Executor;
pub use chunks::Chunks;
pub use frame_error::FrameError;
pub use frontend::{MOSTLY_STRAY, share_of_strays};
pub use frontend::{MountOffset, WheelsFault, check_frame};
pub use live::Live;
pub use lookup::{LookupError, PoseAt};
pub use map_graph::{MapChange, NewKeyframe};
pub use params::{DetectionSettings, ParamsError, PipelineParams, SecondSensorParams, SlamParams};
pub use percept_slam::{ImuFault, Loop, LoopId, LoopState};
pub use pipeline::{FrameReport, NotEmpty, Pipeline, Told, may_change};
pub use preset::Preset;
pub use restored::{Restored, RestoredContent, RestoredKeyframe};
pub use snapshot::{KeyframeInfo, Merged, PoseEstimate, SessionMemory, Snapshot, TrajectoryEntry};
