//! Header and colour.

use super::Time;

message! {
    /// When and where what follows is true.
    #[derive(Copy, Eq)]
    "std_msgs/msg/Header" Header<'a> {
        /// Counts messages in ROS 1; 0 in ROS 2.
        seq: u32 [ros1],
        /// When.
        stamp: Time,
        /// The frame that coordinates are in.
        frame_id: &'a str,
    }

    /// A colour, each part 0 to 1.
    #[derive(Copy)]
    "std_msgs/msg/ColorRGBA" ColorRGBA {
        /// Red.
        r: f32,
        /// Green.
        g: f32,
        /// Blue.
        b: f32,
        /// Opacity.
        a: f32,
    }
}

impl<'a> Header<'a> {
    /// A header of this stamp and frame.
    pub fn new(stamp: impl Into<Time>, frame_id: &'a str) -> Self {
        Self { seq: 0, stamp: stamp.into(), frame_id }
    }
}
