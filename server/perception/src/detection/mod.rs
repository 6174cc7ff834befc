//! A cloud in, objects out: propose, fit a box, classify.
