//! RVL: 16-bit depth as runs of zeros and of differences, in groups of three bits.
//!
//! Source: A. D. Wilson, "Fast lossless depth image compression", ISS 2017. Nibbles lie in little-endian words of 32 bits, the
//! highest first; a nibble has three bits of the number, the lowest first, and one that says that more follow.

use super::ConvertError;

struct Nibbles<'a> {
    words: std::slice::Iter<'a, [u8; 4]>,
    word: u32,
    left: u32,
}

impl Nibbles<'_> {
    /// The next number; none at the end of the words, or if it is beyond 32 bits.
    fn number(&mut self) -> Option<u32> {
        let mut value = 0u32;
        for shift in (0..u32::BITS).step_by(3) {
            if self.left == 0 {
                self.word = u32::from_le_bytes(*self.words.next()?);
                self.left = 8;
            }
            let nibble = self.word >> 28;
            self.word <<= 4;
            self.left -= 1;
            value |= (nibble & 7) << shift;
            if nibble & 8 == 0 {
                return Some(value);
            }
        }
        None
    }
}

/// The `num_pixels` numbers of an image.
pub(super) fn decode(message: &'static str, bytes: &[u8], num_pixels: usize) -> Result<Vec<u16>, ConvertError> {
    let failed = |reason: String| ConvertError::Picture { message, reason };
    let mut nibbles = Nibbles { words: bytes.as_chunks::<4>().0.iter(), word: 0, left: 0 };
    let mut pixels: Vec<u16> = Vec::new();
    let mut previous = 0u16;
    while pixels.len() < num_pixels {
        let mut run = |what: &str, room: usize, done: usize| match nibbles.number() {
            Some(length) if length as usize <= room => Ok(length as usize),
            Some(length) => Err(failed(format!("RVL: {length} {what} at pixel {done}, {room} pixels are left"))),
            None => Err(failed(format!("RVL: the data end at pixel {done} of {num_pixels}"))),
        };
        let zeros = run("zeros", num_pixels - pixels.len(), pixels.len())?;
        pixels.resize(pixels.len() + zeros, 0);
        let values = run("values", num_pixels - pixels.len(), pixels.len())?;
        if zeros == 0 && values == 0 {
            return Err(failed(format!("RVL: an empty run at pixel {}", pixels.len())));
        }
        for _ in 0..values {
            let end = || failed(format!("RVL: the data end at pixel {} of {num_pixels}", pixels.len()));
            let zigzag = nibbles.number().ok_or_else(end)?;
            let difference = (zigzag >> 1) ^ (zigzag & 1).wrapping_neg();
            previous = previous.wrapping_add(difference as u16);
            pixels.push(previous);
        }
    }
    Ok(pixels)
}
