//! percept-slam.
