//! Clouds in, structure out: fewer points, normals, planes, clusters, boxes.

mod eigen;

pub use eigen::{SymmetricEigen3, symmetric_eigen3};
