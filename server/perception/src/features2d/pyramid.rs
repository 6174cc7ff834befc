//! Images shrunk by a factor below two, by linear interpolation.

use percept_geometry::by_processor;

/// One level: `width x height` bytes, rows `stride` apart (the same for all levels, so that offsets within a patch are).
#[derive(Debug, Clone)]
pub(super) struct Level {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) stride: usize,
    pub(super) data: Vec<u8>,
}

impl Level {
    /// Bytes of one row.
    pub(super) fn row(&self, v: usize) -> &[u8] {
        &self.data[v * self.stride..v * self.stride + self.width]
    }
}

/// Left tap and weight of the right tap (of 256) for each output column or row; pixel centres correspond.
fn taps(input: usize, output: usize) -> (Vec<u32>, Vec<u16>) {
    let ratio = input as f64 / output as f64;
    (0..output)
        .map(|i| {
            let x = ((i as f64 + 0.5) * ratio - 0.5).clamp(0.0, (input - 1) as f64);
            let left = (x as usize).min(input.saturating_sub(2));
            (left as u32, ((x - left as f64) * 256.0 + 0.5) as u16)
        })
        .unzip()
}

/// `level` resampled to `width x height` (at least 2 x 2 each).
pub(super) fn resize(level: &Level, width: usize, height: usize) -> Level {
    let (columns, wx) = taps(level.width, width);
    let (rows, wy) = taps(level.height, height);
    let mut data = vec![0; level.stride * height];
    let mut blended = vec![0u16; level.width];
    for (v, out) in data.chunks_exact_mut(level.stride).enumerate() {
        let top = rows[v] as usize;
        blend(level.row(top), level.row(top + 1), wy[v], &mut blended);
        gather(&blended, &columns, &wx, &mut out[..width]);
    }
    Level { width, height, stride: level.stride, data }
}

by_processor! {
    /// Two rows mixed: 128 times grey.
    fn blend(top: &[u8], bottom: &[u8], weight: u16, out: &mut [u16]) -> () {
        let n = out.len().min(top.len()).min(bottom.len());
        let (top, bottom, out) = (&top[..n], &bottom[..n], &mut out[..n]);
        for i in 0..n {
            out[i] = (u16::from(top[i]) * (256 - weight) + u16::from(bottom[i]) * weight) >> 1;
        }
    }
}

by_processor! {
    fn gather(row: &[u16], columns: &[u32], weights: &[u16], out: &mut [u8]) -> () {
        for ((o, &c), &w) in out.iter_mut().zip(columns).zip(weights) {
            let pair = &row[c as usize..c as usize + 2];
            let (a, b, w) = (u32::from(pair[0]), u32::from(pair[1]), u32::from(w));
            *o = ((a * (256 - w) + b * w + (1 << 14)) >> 15) as u8;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ramp_stays_a_ramp() {
        let (w, h) = (60, 12);
        let data: Vec<u8> = (0..w * h).map(|i| (i % w * 4) as u8).collect();
        let level = Level { width: w, height: h, stride: w, data };
        let small = resize(&level, 50, 10);
        for u in 1..49 {
            let truth = ((u as f64 + 0.5) * 1.2 - 0.5) * 4.0;
            assert!((f64::from(small.row(5)[u]) - truth).abs() <= 1.0, "{u}");
        }
    }
}
