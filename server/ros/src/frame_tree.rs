//! How frames lie to each other, as `/tf` and `/tf_static` tell it part by part.

use crate::convert::{self, ConvertError};
use crate::messages::TFMessage;
use percept_geometry::Pose;
use std::collections::{BTreeMap, BTreeSet};

/// Frames that are kept at most: robots have some hundred.
const MAX_FRAMES: usize = 4096;

/// Frames by their parents, each as it was told last. Names of ROS 1 may begin with a slash, which counts for nothing.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FrameTree {
    parents: BTreeMap<String, (String, Pose)>,
}

impl FrameTree {
    /// Whether nothing is known.
    pub fn is_empty(&self) -> bool {
        self.parents.is_empty()
    }

    /// Frames, those that are only parents left out.
    pub fn len(&self) -> usize {
        self.parents.len()
    }

    /// Takes in where `child` is in `parent`; a frame has one parent, the last that was told. Beyond 4,096 frames, new ones are not kept.
    pub fn insert(&mut self, parent: &str, child: &str, t_parent_child: Pose) {
        let (parent, child) = (bare(parent), bare(child));
        let is_sound = !child.is_empty() && parent != child;
        if is_sound && (self.parents.len() < MAX_FRAMES || self.parents.contains_key(child)) {
            self.parents.insert(child.to_owned(), (parent.to_owned(), t_parent_child));
        }
    }

    /// Takes in all transforms of a message that are sound.
    ///
    /// # Errors
    /// The first that is not; the others are in.
    pub fn take(&mut self, message: &TFMessage<'_>) -> Result<(), ConvertError> {
        let mut failed = None;
        for t in &message.transforms {
            match convert::transform(&t.transform) {
                Ok(pose) => self.insert(t.header.frame_id, t.child_frame_id, pose),
                Err(e) => failed = failed.or(Some(e)),
            }
        }
        failed.map_or(Ok(()), Err)
    }

    /// Whether a frame is known, as child or as parent.
    pub fn contains(&self, frame: &str) -> bool {
        let frame = bare(frame);
        self.parents.contains_key(frame) || self.parents.values().any(|(parent, _)| parent == frame)
    }

    /// The one frame of this name behind a prefix, as `robot1/base_link` is of `base_link`; none if there are several.
    pub fn prefixed(&self, name: &str) -> Option<&str> {
        let is_it = |frame: &&str| frame.strip_suffix(name).is_some_and(|prefix| prefix.ends_with('/'));
        let frames = self.parents.iter().flat_map(|(child, (parent, _))| [child.as_str(), parent.as_str()]);
        let found: BTreeSet<&str> = frames.filter(is_it).collect();
        found.first().copied().filter(|_| found.len() == 1)
    }

    /// The frames above a frame, nearest first.
    pub fn above<'a>(&'a self, frame: &'a str) -> Vec<&'a str> {
        self.ancestors(bare(frame)).into_iter().skip(1).map(|(name, _)| name).collect()
    }

    /// Parent of a frame, and `t_parent_frame`.
    pub fn parent(&self, frame: &str) -> Option<(&str, &Pose)> {
        self.parents.get(bare(frame)).map(|(parent, t)| (parent.as_str(), t))
    }

    /// From frame `b` to frame `a`; none where no chain of transforms joins them.
    pub fn t_a_b(&self, a: &str, b: &str) -> Option<Pose> {
        let (a, b) = (bare(a), bare(b));
        let (of_a, of_b) = (self.ancestors(a), self.ancestors(b));
        let common = of_b.iter().find_map(|(name, t)| of_a.iter().find(|o| o.0 == *name).map(|o| (o.1, *t)));
        common.map(|(t_common_a, t_common_b)| t_common_a.inverse() * t_common_b)
    }

    /// A frame and those above it, with the transform from the frame to each; a ring of frames is walked once.
    fn ancestors<'a>(&'a self, frame: &'a str) -> Vec<(&'a str, Pose)> {
        let mut out = vec![(frame, Pose::identity())];
        while let Some((parent, t_parent_child)) = self.parents.get(out[out.len() - 1].0) {
            if out.iter().any(|(name, _)| name == parent) {
                break;
            }
            let t_parent_frame = t_parent_child * out[out.len() - 1].1;
            out.push((parent, t_parent_frame));
        }
        out
    }
}

fn bare(frame: &str) -> &str {
    frame.strip_prefix('/').unwrap_or(frame)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_found_through_their_common_ancestor() {
        let mut tree = FrameTree::default();
        tree.insert("odom", "base_link", Pose::translation(5.0, 0.0, 0.0));
        tree.insert("/base_link", "/mast", Pose::translation(0.0, 0.0, 1.0));
        tree.insert("mast", "laser", Pose::translation(0.2, 0.0, 0.0));
        tree.insert("base_link", "camera", Pose::translation(0.0, 0.1, 0.0));
        let at = |a, b| tree.t_a_b(a, b).map(|t| t.translation.vector);
        assert_eq!(at("base_link", "laser"), Some(nalgebra::Vector3::new(0.2, 0.0, 1.0)));
        assert_eq!(at("camera", "laser"), Some(nalgebra::Vector3::new(0.2, -0.1, 1.0)));
        assert_eq!(at("laser", "laser"), Some(nalgebra::Vector3::zeros()));
        assert_eq!((at("laser", "wheel"), at("wheel", "laser")), (None, None));
        assert!(tree.contains("odom") && !tree.contains("wheel"));
        assert_eq!(tree.above("/laser"), ["mast", "base_link", "odom"]);
        tree.insert("a/odom", "a/base_link", Pose::identity());
        assert_eq!((tree.prefixed("base_link"), tree.prefixed("link")), (Some("a/base_link"), None));
        tree.insert("b/odom", "b/base_link", Pose::identity());
        assert_eq!(tree.prefixed("base_link"), None);
    }

    #[test]
    fn rings_and_floods_of_frames_end() {
        let mut tree = FrameTree::default();
        tree.insert("a", "b", Pose::identity());
        tree.insert("b", "a", Pose::identity());
        tree.insert("a", "a", Pose::identity());
        assert_eq!(tree.t_a_b("a", "c"), None);
        assert!(tree.t_a_b("a", "b").is_some());
        (0..10_000).for_each(|i| tree.insert("a", &format!("f{i}"), Pose::identity()));
        assert_eq!(tree.len(), MAX_FRAMES);
    }
}
