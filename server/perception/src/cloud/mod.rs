//! Clouds in, structure out: fewer points, normals, planes, clusters, boxes.
