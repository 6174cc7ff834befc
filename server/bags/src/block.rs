//! Blocks: parts of a file that are read and unpacked at once.

use std::io::{self, Read};

/// How a block is packed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Compression {
    None,
    Lz4,
    Zstd,
    Bzip2,
}

impl Compression {
    /// By the names of MCAP and of ROS 1.
    pub(crate) fn named(name: &[u8]) -> Option<Self> {
        Some(match name {
            b"" | b"none" => Self::None,
            b"lz4" => Self::Lz4,
            b"zstd" => Self::Zstd,
            b"bz2" => Self::Bzip2,
            _ => return None,
        })
    }
}

/// Unpacked, a block has no more; recorders make them of 0.8 to 4 MB, and of one large message if need be.
pub(crate) const MAX_BYTES: u64 = 1 << 30;

/// Where a block lies.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Block {
    pub(crate) offset: u64,
    pub(crate) num_bytes: u64,
    pub(crate) compression: Compression,
    /// Log time of its earliest message, ns.
    pub(crate) first: i64,
}

/// What is in `packed`, up to where it breaks off, and why it does.
pub(crate) fn unpack(packed: impl Read, compression: Compression) -> (Vec<u8>, Option<io::Error>) {
    let mut out = Vec::new();
    let read = match compression {
        Compression::None => packed.take(MAX_BYTES).read_to_end(&mut out),
        Compression::Lz4 => lz4_flex::frame::FrameDecoder::new(packed).take(MAX_BYTES).read_to_end(&mut out),
        Compression::Bzip2 => bzip2_rs::DecoderReader::new(packed).take(MAX_BYTES).read_to_end(&mut out),
        Compression::Zstd => {
            zstd::Decoder::new(packed).and_then(|decoder| decoder.take(MAX_BYTES).read_to_end(&mut out))
        }
    };
    (out, read.err())
}
