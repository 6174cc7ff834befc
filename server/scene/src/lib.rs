//! percept-scene.
