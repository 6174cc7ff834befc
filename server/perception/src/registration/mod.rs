//! Two clouds in, the pose that aligns them out.
