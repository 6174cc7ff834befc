//! Depth images in, points and normals out, in the optical frame.
