//! Distances of one descriptor to many.

use percept_geometry::by_processor;

/// 256-bit descriptors, word by word, so that four are compared at once.
#[derive(Debug)]
pub(super) struct BinarySet([Vec<u64>; 4]);

impl BinarySet {
    pub(super) fn new(descriptors: &[[u64; 4]]) -> Self {
        Self(std::array::from_fn(|w| descriptors.iter().map(|d| d[w]).collect()))
    }

    /// Differing bits between `query` and each of the set.
    pub(super) fn distances(&self, query: &[u64; 4], out: &mut [u32]) {
        hamming(query, &self.0[0], &self.0[1], &self.0[2], &self.0[3], out);
    }
}

by_processor! {
    fn hamming(q: &[u64; 4], a: &[u64], b: &[u64], c: &[u64], d: &[u64], out: &mut [u32]) -> () {
        let n = out.len();
        let (a, b, c, d) = (&a[..n], &b[..n], &c[..n], &d[..n]);
        for i in 0..n {
            let bits = [a[i] ^ q[0], b[i] ^ q[1], c[i] ^ q[2], d[i] ^ q[3]];
            out[i] = bits.map(u64::count_ones).iter().sum();
        }
    }
}

/// 128-byte descriptors widened to 16 bits, with their squared lengths.
#[derive(Debug)]
pub(super) struct ByteSet {
    wide: Vec<[i16; 128]>,
    squares: Vec<u32>,
}

impl ByteSet {
    pub(super) fn new(descriptors: &[[u8; 128]]) -> Self {
        let square = |d: &[u8; 128]| d.iter().map(|&b| u32::from(b) * u32::from(b)).sum();
        Self {
            wide: descriptors.iter().map(|d| d.map(i16::from)).collect(),
            squares: descriptors.iter().map(square).collect(),
        }
    }

    /// Squared Euclidean distances between number `index` of `queries` and each of the set: exact integers.
    pub(super) fn distances(&self, queries: &Self, index: usize, out: &mut [u32]) {
        dots(&queries.wide[index], &self.wide, out);
        let square = queries.squares[index];
        out.iter_mut().zip(&self.squares).for_each(|(o, s)| *o = square + s - 2 * *o);
    }
}

by_processor! {
    /// Inner products of `q` and each of the set: two of it at a time.
    fn dots(q: &[i16; 128], set: &[[i16; 128]], out: &mut [u32]) -> () {
        for (pair, o) in set.chunks(2).zip(out.chunks_mut(2)) {
            if let ([a, b], [x, y]) = (pair, &mut *o) {
                let (mut s, mut t) = (0i32, 0i32);
                for i in 0..128 {
                    s += i32::from(q[i]) * i32::from(a[i]);
                    t += i32::from(q[i]) * i32::from(b[i]);
                }
                (*x, *y) = (s as u32, t as u32);
            } else {
                o[0] = q.iter().zip(&pair[0]).map(|(a, b)| i32::from(*a) * i32::from(*b)).sum::<i32>() as u32;
            }
        }
    }
}

/// The nearest one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Nearest {
    pub(super) index: u32,
    pub(super) distance: u32,
    /// Distance of the nearest but one; `u32::MAX` if there is none.
    pub(super) second: u32,
}

/// Of equally near ones the first; none of none.
pub(super) fn nearest(distances: &[u32]) -> Option<Nearest> {
    let (distance, second) = two_least(distances);
    let index = distances.iter().position(|&d| d == distance)? as u32;
    Some(Nearest { index, distance, second })
}

by_processor! {
    fn two_least(distances: &[u32]) -> (u32, u32) {
        let (mut first, mut second) = ([u32::MAX; 16], [u32::MAX; 16]);
        let (blocks, rest) = distances.as_chunks::<16>();
        for block in blocks {
            for i in 0..16 {
                second[i] = second[i].min(first[i].max(block[i]));
                first[i] = first[i].min(block[i]);
            }
        }
        let (mut a, mut b) = (u32::MAX, u32::MAX);
        for &d in first.iter().chain(&second).chain(rest) {
            b = b.min(a.max(d));
            a = a.min(d);
        }
        (a, b)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn distances_are_those_counted_one_by_one(bytes in prop::collection::vec(any::<u8>(), 128 * 7..128 * 9)) {
            let d: Vec<[u8; 128]> = bytes.chunks_exact(128).map(|c| c.try_into().unwrap()).collect();
            let set = ByteSet::new(&d);
            let mut out = vec![0; d.len()];
            set.distances(&set, 3, &mut out);
            for (o, e) in out.iter().zip(&d) {
                let truth: u32 = d[3].iter().zip(e).map(|(a, b)| u32::from(a.abs_diff(*b)).pow(2)).sum();
                prop_assert_eq!(*o, truth);
            }
            let bits: Vec<[u64; 4]> = bytes
                .chunks_exact(32)
                .map(|c| std::array::from_fn(|w| u64::from_le_bytes(c[w * 8..w * 8 + 8].try_into().unwrap())))
                .collect();
            let mut out = vec![0; bits.len()];
            BinarySet::new(&bits).distances(&bits[5], &mut out);
            for (o, e) in out.iter().zip(&bits) {
                let truth: u32 = (0..256).map(|i| u32::from((bits[5][i / 64] ^ e[i / 64]) >> (i % 64) & 1 == 1)).sum();
                prop_assert_eq!(*o, truth);
            }
        }

        #[test]
        fn the_two_least_are_those_of_sorting(mut d in prop::collection::vec(0u32..50, 2..100)) {
            let found = nearest(&d).unwrap();
            prop_assert_eq!(d.iter().position(|x| x == d.iter().min().unwrap()).unwrap() as u32, found.index);
            d.sort_unstable();
            prop_assert_eq!((found.distance, found.second), (d[0], d[1]));
        }
    }
}
