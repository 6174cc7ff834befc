//! The number types of binary clouds.

/// A number's type.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Scalar {
    I8,
    I16,
    I32,
    I64,
    U8,
    U16,
    U32,
    U64,
    F32,
    F64,
}

impl Scalar {
    /// Bytes of a number.
    pub(crate) fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    /// The number at the start of `bytes`, which hold at least `size` bytes.
    #[inline]
    pub(crate) fn read(self, bytes: &[u8], big_endian: bool) -> f64 {
        #[inline]
        fn array<const N: usize>(bytes: &[u8], big_endian: bool) -> [u8; N] {
            let mut out = [0; N];
            out.copy_from_slice(&bytes[..N]);
            if big_endian {
                out.reverse();
            }
            out
        }
        match self {
            Self::I8 => f64::from(bytes[0] as i8),
            Self::U8 => f64::from(bytes[0]),
            Self::I16 => f64::from(i16::from_le_bytes(array(bytes, big_endian))),
            Self::U16 => f64::from(u16::from_le_bytes(array(bytes, big_endian))),
            Self::I32 => f64::from(i32::from_le_bytes(array(bytes, big_endian))),
            Self::U32 => f64::from(u32::from_le_bytes(array(bytes, big_endian))),
            Self::I64 => i64::from_le_bytes(array(bytes, big_endian)) as f64,
            Self::U64 => u64::from_le_bytes(array(bytes, big_endian)) as f64,
            Self::F32 => f64::from(f32::from_le_bytes(array(bytes, big_endian))),
            Self::F64 => f64::from_le_bytes(array(bytes, big_endian)),
        }
    }
}
