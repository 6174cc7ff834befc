//! How many bits may differ between features that look alike, by the method that found them.
//!
//! SIFT's are where features that have nothing to do with each other are taken for alike as often as ORB's: then chance gives
//! a keyframe as many votes, and as many wrong pairs, by either method. Of all pairs of features of images of different
//! places (six sets of images, 500 features each; `evaluate unrelated`), 0.2 % of ORB's differ in at most 50 bits and
//! 1.8 % in at most 64; of SIFT's, whose bits are less even and less independent of each other, 0.2 % in at most 45 and
//! 1.8 % in at most 60.

use percept_geometry::FeatureMethod;

/// Most differing bits, of 256.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Alike {
    /// Of a feature that votes for a keyframe: one look, nothing to compare it with.
    pub(super) vote: u32,
    /// Of a pair that are each other's best, with the second best clearly worse.
    pub(super) pair: u32,
}

impl Alike {
    pub(super) fn of(method: FeatureMethod) -> Self {
        match method {
            FeatureMethod::Orb => Self { vote: 50, pair: 64 },
            FeatureMethod::Sift => Self { vote: 45, pair: 60 },
        }
    }
}
