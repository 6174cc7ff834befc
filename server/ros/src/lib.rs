//! ROS messages in and out: their bytes, their names on a network, and the geometry that they carry.
//!
//! Comes in: payloads of ROS 2 (CDR) or ROS 1, key expressions, liveliness tokens and attachments as text and bytes. Goes out:
//! messages as structs, `percept_geometry`'s types, and the same back again. It opens no connection, reads no file and has no
//! clock. Start with [`Message`], then [`convert`].
//!
//! A message is declared once, in [`messages`]; codec, type hash and text definition follow from that declaration.
//!
//! ```
//! use percept_ros::{Message, messages::{Header, Time}};
//!
//! let bytes = Header::new(Time { sec: 1, nanosec: 500 }, "map").encode()?;
//! assert_eq!(Header::decode(&bytes)?.frame_id, "map");
//! assert!(Header::type_hash().to_string().starts_with("RIHS01_f49fb3ae"));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod cdr;
pub mod convert;
pub mod description;
mod error;
mod frame_tree;
pub mod messages;
pub mod readings;
pub mod rmw_zenoh;
pub mod ros2dds;
pub mod topics;
mod type_hash;
mod type_name;
mod value;

pub use cdr::{Encoding, Message, Wire};
pub use error::{DecodeError, EncodeError, Fault};
pub use frame_tree::FrameTree;
pub use type_hash::{TypeHash, TypeHashError};
pub use type_name::{TypeName, TypeNameError};
pub use value::Value;
