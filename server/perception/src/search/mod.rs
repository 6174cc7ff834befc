//! Who is near whom: exact neighbours in a fixed cloud, and a local map that grows and forgets.
