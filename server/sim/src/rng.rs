//! Streams of random numbers named by what they are for, so that threads cannot disturb each other.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// What a stream is for; streams of different purposes are independent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u64)]
pub(crate) enum Purpose {
    Layout = 1,
    Furniture = 2,
    Person = 3,
    DepthCamera = 4,
    Lidar3d = 5,
    Lidar2d = 6,
    Odometry = 7,
    Imu = 8,
    Transport = 9,
    Kidnap = 10,
}

/// The stream of `seed` for a purpose, a frame (or room) and a row (or column).
pub(crate) fn stream(seed: u64, purpose: Purpose, frame: u64, row: u64) -> ChaCha8Rng {
    let mut key = [0u8; 32];
    for (slot, value) in key.chunks_exact_mut(8).zip([seed, purpose as u64, frame, row]) {
        slot.copy_from_slice(&value.to_le_bytes());
    }
    ChaCha8Rng::from_seed(key)
}

/// A well-mixed 32-bit hash of three integers, for textures.
///
/// Source: the finaliser of MurmurHash3 (Appleby, public domain) over a linear combination.
pub(crate) fn hash(a: i32, b: i32, seed: u32) -> u32 {
    let mut h =
        (a as u32).wrapping_mul(0x9E37_79B1) ^ (b as u32).wrapping_mul(0x85EB_CA77) ^ seed.wrapping_mul(0xC2B2_AE3D);
    h ^= h >> 16;
    h = h.wrapping_mul(0x85EB_CA6B);
    h ^= h >> 13;
    h = h.wrapping_mul(0xC2B2_AE35);
    h ^ (h >> 16)
}

/// The hash as a number in [0, 1).
pub(crate) fn hash_unit(a: i32, b: i32, seed: u32) -> f32 {
    (hash(a, b, seed) >> 8) as f32 * (1.0 / 16_777_216.0)
}
