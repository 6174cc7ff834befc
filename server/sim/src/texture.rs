//! What surfaces look like: deterministic patterns in their local coordinates, so that cameras see
//! features that stay where they are.

use crate::rng::{hash, hash_unit};
use nalgebra::{Point3, Vector3};

/// Which pattern a surface carries.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Pattern {
    /// Tiles with seams.
    Floor,
    /// Paint with posters.
    Wall,
    /// Panels.
    Ceiling,
    /// Speckled paint or wood.
    Speckle,
    /// Stripes along z, for clothes.
    Stripes,
}

/// A pattern with its colours (linear 0..1) and the seed of its details.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Material {
    pub(crate) pattern: Pattern,
    pub(crate) color: [f32; 3],
    pub(crate) seed: u32,
}

/// How bright a surface of this normal is: a fixed lamp and ambient light, the same from every view.
pub(crate) fn shade(normal: &Vector3<f64>) -> f32 {
    let lamp = 0.27 * normal.x + 0.18 * normal.y + 0.945 * normal.z;
    (0.72 + 0.28 * lamp) as f32
}

impl Material {
    /// Reflectance at a local point with this local normal, 0..1.
    pub(crate) fn albedo(&self, p: &Point3<f64>, normal: &Vector3<f64>) -> [f32; 3] {
        // Coordinates within the face that the normal mostly belongs to.
        let axis = normal.iamax();
        let (u, v) = match axis {
            0 => (p.y, p.z),
            1 => (p.x, p.z),
            _ => (p.x, p.y),
        };
        // Opposite faces and parallel walls get patterns of their own.
        // The offset keeps faces at round figures away from the rounding's border.
        let plane = floor_index(p[axis] * 2.0 + 0.7371);
        let seed = self.seed ^ hash(plane, axis as i32 + if normal[axis] > 0.0 { 3 } else { 0 }, 77);
        match self.pattern {
            Pattern::Floor => floor(self.color, u, v, self.seed),
            Pattern::Wall => wall(self.color, u, v, seed),
            Pattern::Ceiling => ceiling(self.color, u, v, self.seed),
            Pattern::Speckle => scale(self.color, 0.7 + 0.45 * noise(u, v, 0.035, seed)),
            Pattern::Stripes => {
                let band = hash_unit(floor_index(p.z * (1.0 / 0.07)), 0, self.seed);
                scale(self.color, 0.55 + 0.5 * band + 0.1 * noise(u, v, 0.04, seed))
            }
        }
    }
}

fn scale(color: [f32; 3], by: f32) -> [f32; 3] {
    color.map(|c| (c * by).min(1.0))
}

/// Floor without a call to the library, which costs most where every pixel needs several.
fn floor_index(x: f64) -> i32 {
    let truncated = x as i32;
    truncated - i32::from(f64::from(truncated) > x)
}

fn cell(x: f64, size: f64) -> (i32, f64) {
    let scaled = x / size;
    let index = floor_index(scaled);
    (index, scaled - f64::from(index))
}

/// Value noise, 0..1, smooth between the corners of cells of `size` metres.
fn noise(u: f64, v: f64, size: f64, seed: u32) -> f32 {
    let ((i, fu), (j, fv)) = (cell(u, size), cell(v, size));
    let smooth = |f: f64| (f * f * (3.0 - 2.0 * f)) as f32;
    let (fu, fv) = (smooth(fu), smooth(fv));
    let mix = |a: f32, b: f32, f: f32| a + (b - a) * f;
    mix(
        mix(hash_unit(i, j, seed), hash_unit(i + 1, j, seed), fu),
        mix(hash_unit(i, j + 1, seed), hash_unit(i + 1, j + 1, seed), fu),
        fv,
    )
}

/// Tiles of 0.4 m in a checker of two tones, each tile a little different, dark seams of 1 cm.
fn floor(color: [f32; 3], u: f64, v: f64, seed: u32) -> [f32; 3] {
    let ((i, fu), (j, fv)) = (cell(u, 0.4), cell(v, 0.4));
    if fu < 0.025 || fv < 0.025 {
        return scale(color, 0.4);
    }
    let checker = if (i + j) & 1 == 0 { 1.0 } else { 0.72 };
    scale(color, checker * (0.72 + 0.25 * hash_unit(i, j, seed) + 0.2 * noise(u, v, 0.03, seed)))
}

/// Panels of 0.6 m with seams.
fn ceiling(color: [f32; 3], u: f64, v: f64, seed: u32) -> [f32; 3] {
    let ((_, fu), (_, fv)) = (cell(u, 0.6), cell(v, 0.6));
    if fu < 0.02 || fv < 0.02 { scale(color, 0.6) } else { scale(color, 0.9 + 0.1 * noise(u, v, 0.05, seed)) }
}

/// Mottled paint, a skirting board, and a poster in about half of the places along it.
fn wall(color: [f32; 3], u: f64, v: f64, seed: u32) -> [f32; 3] {
    if v < 0.08 {
        return scale(color, 0.45);
    }
    let (slot, f) = cell(u, 1.1);
    let look = hash(slot, 1, seed);
    if look & 1 == 1 {
        let (left, right) = (0.1 + 0.002 * f64::from(look >> 8 & 63), 0.9 - 0.002 * f64::from(look >> 14 & 127));
        let (low, high) = (0.85 + 0.004 * f64::from(look >> 2 & 63), 1.55 + 0.004 * f64::from(look >> 21 & 127));
        if f > left && f < right && v > low && v < high {
            return poster(u, v, look);
        }
    }
    scale(color, 0.86 + 0.14 * noise(u, v, 0.06, seed))
}

/// Blocks of a few hashed colours.
fn poster(u: f64, v: f64, look: u32) -> [f32; 3] {
    let size = 0.05 + 0.0015 * f64::from(look >> 26 & 31);
    let ((i, _), (j, _)) = (cell(u, size), cell(v, size));
    let tone = hash(i, j, look) % 4;
    std::array::from_fn(|c| 0.1 + 0.85 * hash_unit(tone as i32, c as i32, look))
}
