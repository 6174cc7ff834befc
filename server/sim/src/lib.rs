//! percept-sim.
