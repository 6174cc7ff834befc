//! One message in, facts out; no memory.
//!
//! Comes in: a cloud, a depth image, two clouds to align. Goes out: neighbours, points, planes, clusters,
//! detections, poses. Nothing here remembers the message before, reads a clock or touches a file.
//! Results depend on the input and the seed, not on the number of threads.
//!
//! Start with [`search`] (who is near whom), then [`depth`] (images to points), [`features2d`] (images to
//! keypoints), [`cloud`] (points to structure), [`registration`] (where two clouds meet), [`multiview`] (where cameras stood) and
//! [`detection`] (structure to objects); [`render`] draws clouds and depth images to look at.

pub mod cloud;
pub mod depth;
pub mod detection;
pub mod features2d;
pub mod multiview;
pub mod registration;
pub mod render;
pub mod search;
pub mod segmentation;
