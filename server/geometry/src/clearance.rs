//! Exact distance to the nearest obstacle.

/// Distance from each cell's centre to the nearest blocked cell (to its square, not its centre), in cells; 0 in blocked
/// cells, infinite if none is blocked. `blocked` is row-major `height x width`.
///
/// Source: Felzenszwalb and Huttenlocher, "Distance transforms of sampled functions", 2012, algorithm 1, with parabolas
/// at the cells' edges instead of their centres: an obstacle begins at its edge, half a cell nearer.
pub fn clearance_in_cells(blocked: &[bool], width: usize, height: usize) -> Vec<f32> {
    let vertical = vertical_distances(blocked, width, height);
    let mut out = vec![0.0f32; blocked.len()];
    let mut hull = Hull::default();
    for (row, out) in vertical.chunks(width.max(1)).zip(out.chunks_mut(width.max(1))) {
        hull.build(row);
        hull.evaluate(row, out);
    }
    out
}

/// In each column, distance from the centre of a cell to the nearest blocked square of that column.
fn vertical_distances(blocked: &[bool], width: usize, height: usize) -> Vec<f64> {
    let mut out = vec![f64::INFINITY; blocked.len()];
    let pass = |out: &mut Vec<f64>, y: usize, before: Option<usize>| {
        for x in 0..width {
            let i = y * width + x;
            let from_before = before.map_or(f64::INFINITY, |b| {
                let d = out[b * width + x];
                if d == 0.0 { 0.5 } else { d + 1.0 }
            });
            out[i] = if blocked[i] { 0.0 } else { out[i].min(from_before) };
        }
    };
    (0..height).for_each(|y| pass(&mut out, y, y.checked_sub(1)));
    (0..height).rev().for_each(|y| pass(&mut out, y, (y + 1 < height).then_some(y + 1)));
    out
}

/// Lower envelope of parabolas standing on the edges between the cells of a row.
#[derive(Default)]
struct Hull {
    /// Place of each parabola's foot (in cells; centres are whole numbers) and its height there.
    feet: Vec<(f64, f64)>,
    /// Where parabola i begins to be the lowest.
    starts: Vec<f64>,
}

impl Hull {
    fn build(&mut self, row: &[f64]) {
        self.feet.clear();
        self.starts.clear();
        for edge in 0..=row.len() {
            let left = if edge > 0 { row[edge - 1] } else { f64::INFINITY };
            let right = row.get(edge).copied().unwrap_or(f64::INFINITY);
            let height = left.min(right);
            if height.is_finite() {
                self.push(edge as f64 - 0.5, height * height);
            }
        }
    }

    fn push(&mut self, p: f64, f: f64) {
        let mut start = f64::NEG_INFINITY;
        while let (Some(&(q, g)), Some(&begin)) = (self.feet.last(), self.starts.last()) {
            start = ((f + p * p) - (g + q * q)) / (2.0 * (p - q));
            if start > begin {
                break;
            }
            self.feet.pop();
            self.starts.pop();
            start = f64::NEG_INFINITY;
        }
        self.feet.push((p, f));
        self.starts.push(start);
    }

    fn evaluate(&self, row: &[f64], out: &mut [f32]) {
        let mut k = 0;
        for (x, (own, out)) in row.iter().zip(out).enumerate() {
            let at = x as f64;
            while k + 1 < self.starts.len() && self.starts[k + 1] <= at {
                k += 1;
            }
            let beside = self.feet.get(k).map_or(f64::INFINITY, |(p, f)| (at - p) * (at - p) + f);
            *out = beside.min(own * own).sqrt() as f32;
        }
    }
}
