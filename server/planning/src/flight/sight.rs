//! Whether the ball can go straight from one voxel's centre to another's.

use super::field::Field;

impl Field<'_> {
    /// Whether all voxels are open that surround the straight way between two centres: then the ball fits along all of it.
    ///
    /// Along each axis the distance to a cube falls or rises all the way from one centre to the next, so that no point of the
    /// box between 2 x 2 x 2 centres is nearer to an obstacle than one of those eight. Not even the ball itself may need all
    /// of that: a way that touches may be refused.
    ///
    /// Source: the walk of Amanatides and Woo, "A fast voxel traversal algorithm for ray tracing", 1987, through the boxes
    /// between centres, in whole numbers; where several borders are crossed at once, they are in one step.
    pub(super) fn sees(&self, from: usize, to: usize) -> bool {
        let [width, height, _] = self.size();
        let (a, b) = (self.coordinates(from), self.coordinates(to));
        let strides = [1, width as i64, (width * height) as i64];
        let length: [i64; 3] = std::array::from_fn(|i| a[i].abs_diff(b[i]) as i64);
        let stride: [i64; 3] = std::array::from_fn(|i| if b[i] >= a[i] { strides[i] } else { -strides[i] });
        // Offsets from the corner of a box that is nearest to the start to all that the way passes between.
        let mut corners = [0i64; 8];
        let mut num = 1;
        for i in (0..3).filter(|i| length[*i] > 0) {
            for k in 0..num {
                corners[num + k] = corners[k] + stride[i];
            }
            num *= 2;
        }
        let mut crossed = [0i64; 3];
        let mut at = from as i64;
        loop {
            if !corners[..num].iter().all(|off| self.is_open((at + off) as usize)) {
                return false;
            }
            // The next border: the smallest (crossed + 1) / length.
            let mut first: Option<usize> = None;
            for i in (0..3).filter(|i| length[*i] > 0) {
                let sooner = |j: usize| (crossed[i] + 1) * length[j] < (crossed[j] + 1) * length[i];
                if first.is_none_or(sooner) {
                    first = Some(i);
                }
            }
            let Some(first) = first else { return true };
            if crossed[first] + 1 == length[first] {
                return true;
            }
            let (next, of) = (crossed[first] + 1, length[first]);
            for i in (0..3).filter(|i| length[*i] > 0) {
                if (crossed[i] + 1) * of == next * length[i] {
                    crossed[i] += 1;
                    at += stride[i];
                }
            }
        }
    }
}
