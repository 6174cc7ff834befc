//! Colours for numbers, labels and directions.

use nalgebra::Vector3;

/// Dark blue over green to dark red, even steps of a value.
const RAMP: [[u8; 3]; 9] = [
    [48, 18, 90],
    [63, 86, 205],
    [44, 157, 240],
    [26, 210, 190],
    [95, 240, 110],
    [185, 235, 60],
    [245, 185, 50],
    [235, 95, 25],
    [140, 15, 10],
];

/// Colour of a share from 0 to 1 (clamped; NaN is the lowest).
pub(super) fn ramp(share: f32) -> [u8; 3] {
    let at = if share.is_nan() { 0.0 } else { share.clamp(0.0, 1.0) } * (RAMP.len() - 1) as f32;
    let low = (at as usize).min(RAMP.len() - 2);
    let part = at - low as f32;
    let mix = |a: u8, b: u8| (f32::from(a) + (f32::from(b) - f32::from(a)) * part).round() as u8;
    std::array::from_fn(|i| mix(RAMP[low][i], RAMP[low + 1][i]))
}

/// Colour of a label: hues a golden angle apart, so that neighbours in number differ; grey for none.
pub(super) fn label(label: Option<u32>) -> [u8; 3] {
    let Some(label) = label else { return [150; 3] };
    let hue = (f64::from(label) * 0.618_033_988_75).fract() * 6.0;
    let value = [1.0, 0.8, 0.62][label as usize / 3 % 3];
    let channel = |shift: f64| {
        let k = (hue + shift) % 6.0;
        let part = (k.min(4.0 - k)).clamp(0.0, 1.0);
        (255.0 * value * (1.0 - 0.75 * part)) as u8
    };
    [channel(5.0), channel(3.0), channel(1.0)]
}

/// Colour of a direction: x, y, z from -1 to 1 as red, green, blue; grey where it is undefined (zero).
pub(super) fn direction(n: &Vector3<f32>) -> [u8; 3] {
    if n.norm_squared() < 1e-6 || !n.iter().all(|v| v.is_finite()) {
        return [150; 3];
    }
    std::array::from_fn(|i| (127.5 * (n[i].clamp(-1.0, 1.0) + 1.0)).round() as u8)
}
