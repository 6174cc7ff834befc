//! Image files inside messages: JPEG and PNG, with their sizes checked before their pixels are read.

use super::ConvertError;
use image::codecs::{jpeg::JpegDecoder, png::PngDecoder};
use image::{DynamicImage, ImageDecoder, ImageError, Limits};
use std::io::Cursor;

/// What decoders may take beside the pixels, bytes.
const DECODER_BYTES: u64 = 16 << 20;

/// The picture of a PNG or JPEG, told apart by their first bytes, of at most `max_pixels`.
pub(super) fn decode(message: &'static str, bytes: &[u8], max_pixels: u64) -> Result<DynamicImage, ConvertError> {
    let failed = |error: ImageError| ConvertError::Picture { message, reason: error.to_string() };
    let mut limits = Limits::default();
    // Eight bytes a pixel at most: four channels of 16 bits.
    limits.max_alloc = Some(max_pixels.saturating_mul(8).saturating_add(DECODER_BYTES));
    let checked = |decoder: &dyn ImageDecoder| {
        let (width, height) = decoder.dimensions();
        let value = u64::from(width) * u64::from(height);
        let too_large = ConvertError::TooLarge { message, field: "num_pixels", value, limit: max_pixels };
        if value <= max_pixels { Ok(()) } else { Err(too_large) }
    };
    match bytes {
        [0x89, b'P', ..] => {
            let decoder = PngDecoder::with_limits(Cursor::new(bytes), limits).map_err(failed)?;
            checked(&decoder)?;
            DynamicImage::from_decoder(decoder).map_err(failed)
        }
        [0xff, 0xd8, ..] => {
            if !has_end(bytes) {
                let reason = "the JPEG has no end-of-image marker: it is cut off".to_owned();
                return Err(ConvertError::Picture { message, reason });
            }
            let mut decoder = JpegDecoder::new(Cursor::new(bytes)).map_err(failed)?;
            checked(&decoder)?;
            decoder.set_limits(limits).map_err(failed)?;
            DynamicImage::from_decoder(decoder).map_err(failed)
        }
        _ => {
            let found = format!("{:02x?}", bytes.get(..4).unwrap_or(bytes));
            Err(ConvertError::invalid(message, "data", found, "a PNG (89 50) or a JPEG (ff d8)"))
        }
    }
}

/// Whether an end-of-image marker follows the last start of a scan: decoders fill up a cut image with grey and say nothing.
fn has_end(bytes: &[u8]) -> bool {
    let last = |marker: u8| bytes.windows(2).rposition(|w| w == [0xff, marker]);
    matches!((last(0xda), last(0xd9)), (Some(scan), Some(end)) if end > scan)
}
