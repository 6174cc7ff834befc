//! 256 bits of a SIFT descriptor, compared by how many differ.
//!
//! **Source:** Zhou, Li, Lu, Tian, "SIFT match verification by geometric coding / Binary SIFT", ICIMCS 2012.

/// Two bits a number: whether it is above the descriptor's median, and whether it is above its upper quartile.
///
/// Bit `i` of the first 128 is number `i` above the median (the mean of the 64th and 65th largest), bit `i` of the last
/// 128 above the quartile (of the 32nd and 33rd). So a flat number and a steep one differ in two bits and neighbours in
/// one; both thresholds come from the descriptor itself, and a change of contrast moves none.
pub fn binary_sift(descriptor: &[u8; 128]) -> [u64; 4] {
    let mut sorted = *descriptor;
    sorted.sort_unstable();
    // Twice the means, so that they stay whole.
    let twice_mean = |k: usize| u16::from(sorted[k - 1]) + u16::from(sorted[k]);
    let (median, quartile) = (twice_mean(64), twice_mean(96));
    let mut bits = [0u64; 4];
    for (i, &value) in descriptor.iter().enumerate() {
        let twice = 2 * u16::from(value);
        bits[i / 64] |= u64::from(twice > median) << (i % 64);
        bits[2 + i / 64] |= u64::from(twice > quartile) << (i % 64);
    }
    bits
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bit(bits: &[u64; 4], i: usize) -> bool {
        bits[i / 64] >> (i % 64) & 1 == 1
    }

    #[test]
    fn the_larger_half_and_the_largest_quarter_are_marked_whatever_the_contrast() {
        // Each of 0..128 once: 64 of them are above the median, 63.5, and 32 above the quartile, 95.5.
        let numbers: [u8; 128] = std::array::from_fn(|i| (i * 37 % 128) as u8);
        let bits = binary_sift(&numbers);
        for (i, &n) in numbers.iter().enumerate() {
            assert_eq!((bit(&bits, i), bit(&bits, 128 + i)), (n >= 64, n >= 96), "{i}");
        }
        assert_eq!(binary_sift(&numbers.map(|n| 2 * n)), bits);
        // Two numbers that change places over both thresholds cost two bits each.
        let mut other = numbers;
        let (low, high) =
            (numbers.iter().position(|n| *n == 0).unwrap(), numbers.iter().position(|n| *n == 127).unwrap());
        other.swap(low, high);
        let differing: u32 = binary_sift(&other).iter().zip(&bits).map(|(a, b)| (a ^ b).count_ones()).sum();
        assert_eq!(differing, 4);
    }

    #[test]
    fn equal_numbers_are_not_above_themselves() {
        assert_eq!(binary_sift(&[7; 128]), [0; 4]);
        // 40 of 200, the rest 0: above the median, which is 0, and not above the quartile, which is 200.
        let numbers: [u8; 128] = std::array::from_fn(|i| if i < 40 { 200 } else { 0 });
        let forty = (1u64 << 40) - 1;
        assert_eq!(binary_sift(&numbers), [forty, 0, 0, 0]);
    }
}
