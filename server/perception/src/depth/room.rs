//! Large results written once: memory is taken as it is, not cleared first.

use rayon::prelude::*;
use std::mem::MaybeUninit;

/// Room for values, filled from the front.
pub(super) struct Room<'a, T> {
    cells: &'a mut [MaybeUninit<T>],
    filled: usize,
}

impl<T: Copy> Room<'_, T> {
    /// Adds the first `count` of the block. All of it is written where there is room: what comes next goes over the
    /// rest. What the room cannot hold is dropped.
    #[inline(always)]
    pub(super) fn push<const N: usize>(&mut self, block: &[T; N], count: usize) {
        let count = count.min(N);
        match self.cells.get_mut(self.filled..).and_then(|cells| cells.first_chunk_mut::<N>()) {
            Some(cells) => {
                cells.write_copy_of_slice(block);
                self.filled += count;
            }
            None => self.push_last(&block[..count]),
        }
    }

    /// Apart, so that the copies above are of a length that is known.
    #[cold]
    #[inline(never)]
    fn push_last(&mut self, values: &[T]) {
        for (cell, value) in self.cells[self.filled..].iter_mut().zip(values) {
            *cell = MaybeUninit::new(*value);
            self.filled += 1;
        }
    }
}

/// What `fill` puts into a room of this capacity.
pub(super) fn filled<T: Copy>(capacity: usize, fill: impl FnOnce(&mut Room<'_, T>)) -> Vec<T> {
    let mut out = Vec::with_capacity(capacity);
    let mut room = Room { cells: &mut out.spare_capacity_mut()[..capacity], filled: 0 };
    fill(&mut room);
    let filled = room.filled;
    // SAFETY: a room counts only cells that were written, from the front and without a gap.
    #[allow(unsafe_code)]
    unsafe {
        out.set_len(filled);
    }
    out
}

/// As [`filled`], in bands of `band` values in parallel, each of which `fill` has to fill.
///
/// # Panics
/// If it does not.
pub(super) fn filled_in_bands<T: Copy + Send>(
    count: usize,
    band: usize,
    fill: impl Fn(usize, &mut Room<'_, T>) + Sync,
) -> Vec<T> {
    let mut out = Vec::with_capacity(count);
    let bands = out.spare_capacity_mut()[..count].par_chunks_mut(band.max(1)).enumerate();
    let written: usize = bands
        .map(|(i, cells)| {
            let mut room = Room { cells, filled: 0 };
            fill(i, &mut room);
            room.filled
        })
        .sum();
    assert_eq!(written, count, "every band is filled");
    // SAFETY: no band counts more than it has, so that all of them are full: every cell was written.
    #[allow(unsafe_code)]
    unsafe {
        out.set_len(count);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_pushed_is_there_and_no_more_than_there_is_room() {
        let out = filled(10, |room| {
            for k in 0..5u32 {
                room.push(&[k, 10 * k, 100 * k, 7], 3);
            }
        });
        assert_eq!(out, [0, 0, 0, 1, 10, 100, 2, 20, 200, 3]);
        assert!(filled::<u32>(0, |room| room.push(&[1], 1)).is_empty());
        let bands = filled_in_bands(10, 4, |i, room| (0..4).for_each(|_| room.push(&[i, 0], 1)));
        assert_eq!(bands, [0, 0, 0, 0, 1, 1, 1, 1, 2, 2]);
    }

    #[test]
    #[should_panic(expected = "every band is filled")]
    fn a_band_left_open_is_noticed() {
        filled_in_bands(10, 4, |i, room| room.push(&[i; 4], 4 - i));
    }
}
