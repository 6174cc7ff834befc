//! Open3D's `camera_intrinsic.json`: a camera, and what its recorder writes beside it.
//!
//! Source: Open3D 0.18, `PinholeCameraIntrinsic` and `RGBDVideoMetadata`: the matrix is written column after column.

use crate::{FormatError, Place};
use percept_geometry::CameraIntrinsics;
use serde_json::Value;
use std::ops::RangeInclusive;

const FORMAT: &str = "Open3D intrinsics";

/// What the file says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Open3dCamera {
    /// A pinhole, with the size of its images.
    pub intrinsics: CameraIntrinsics,
    /// Units of depth in a metre, if it is told.
    pub depth_scale: Option<f64>,
    /// Frames a second, if that is told.
    pub rate_hz: Option<f64>,
}

/// Reads `width`, `height`, `intrinsic_matrix`, and, where they are there, `depth_scale` and `fps`; other keys are stepped over.
///
/// # Errors
/// `Malformed` with the line for what is no JSON, or a value that cannot be meant; `Missing` for a key; `Geometry` for a camera
/// that cannot be.
pub fn parse_intrinsics(bytes: &[u8]) -> Result<Open3dCamera, FormatError> {
    let json: Value = serde_json::from_slice(bytes).map_err(|e| {
        let line = bytes.split(|&b| b == b'\n').nth(e.line().saturating_sub(1)).unwrap_or_default();
        FormatError::malformed(FORMAT, Place::Line(e.line() as u64), "text", line.trim_ascii(), "JSON")
    })?;
    let file = File { bytes, json: &json };
    let [width, height] = [file.side("width")?, file.side("height")?];
    let [fx, fy, cx, cy] = file.matrix()?;
    let intrinsics = CameraIntrinsics::pinhole(width, height, fx, fy, cx, cy);
    intrinsics.validate()?;
    let depth_scale = file.number("depth_scale", 0.1..=1e6, "units in a metre, 0.1 to 1e6")?;
    let rate_hz = file.number("fps", 0.001..=1e4, "frames a second, 0.001 to 10000")?;
    Ok(Open3dCamera { intrinsics, depth_scale, rate_hz })
}

struct File<'a> {
    bytes: &'a [u8],
    json: &'a Value,
}

impl File<'_> {
    fn required(&self, key: &'static str) -> Result<&Value, FormatError> {
        self.json.get(key).ok_or(FormatError::Missing { format: FORMAT, field: key })
    }

    /// An error about a key, at the line where it first stands.
    fn malformed(&self, key: &str, found: &Value, expected: &'static str) -> FormatError {
        let quoted = format!("\"{key}\"");
        let at = self.bytes.windows(quoted.len()).position(|w| w == quoted.as_bytes()).unwrap_or(0);
        let line = self.bytes[..at].iter().filter(|&&b| b == b'\n').count() as u64 + 1;
        FormatError::malformed(FORMAT, Place::Line(line), key, found.to_string().as_bytes(), expected)
    }

    fn side(&self, key: &'static str) -> Result<usize, FormatError> {
        let value = self.required(key)?;
        let side = value.as_u64().filter(|n| (1..=16384).contains(n)).and_then(|n| usize::try_from(n).ok());
        side.ok_or_else(|| self.malformed(key, value, "pixels, 1 to 16384"))
    }

    fn number(
        &self,
        key: &'static str,
        range: RangeInclusive<f64>,
        expected: &'static str,
    ) -> Result<Option<f64>, FormatError> {
        let Some(value) = self.json.get(key) else { return Ok(None) };
        match value.as_f64().filter(|v| range.contains(v)) {
            Some(number) => Ok(Some(number)),
            None => Err(self.malformed(key, value, expected)),
        }
    }

    /// fx, fy, cx, cy.
    fn matrix(&self) -> Result<[f64; 4], FormatError> {
        const KEY: &str = "intrinsic_matrix";
        let value = self.required(KEY)?;
        let numbers = value.as_array().map(|v| v.iter().map(Value::as_f64).collect::<Option<Vec<_>>>());
        let expected = "fx, 0, 0, 0, fy, 0, cx, cy, 1: column after column";
        match numbers.flatten().as_deref() {
            Some(&[fx, 0.0, 0.0, 0.0, fy, 0.0, cx, cy, 1.0]) => Ok([fx, fy, cx, cy]),
            _ => Err(self.malformed(KEY, value, expected)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn text(matrix: &str, more: &str) -> String {
        format!("{{\n  \"width\": 640,\n  \"height\": 480,\n  \"intrinsic_matrix\": [{matrix}]{more}\n}}\n")
    }

    const MATRIX: &str = "500.5, 0, 0, 0, 501, 0, 320, 240.25, 1";

    #[test]
    fn the_matrix_is_column_after_column() {
        let camera = parse_intrinsics(text(MATRIX, "").as_bytes()).unwrap();
        assert_eq!(camera.intrinsics, CameraIntrinsics::pinhole(640, 480, 500.5, 501.0, 320.0, 240.25));
        assert_eq!((camera.depth_scale, camera.rate_hz), (None, None));
        let camera = parse_intrinsics(text(MATRIX, ",\"depth_scale\": 4000, \"fps\": 30.0").as_bytes()).unwrap();
        assert_eq!((camera.depth_scale, camera.rate_hz), (Some(4000.0), Some(30.0)));
    }

    #[test]
    fn errors_name_key_and_line() {
        let refused = |text: String| parse_intrinsics(text.as_bytes()).unwrap_err().to_string();
        let rows = refused(text("500.5, 0, 320, 0, 501, 240, 0, 0, 1", ""));
        assert!(rows.contains("line 4: intrinsic_matrix is '[500.5,0,320,") && rows.contains("column after"), "{rows}");
        assert!(refused(text("1, 2", "")).contains("line 4: intrinsic_matrix is '[1,2]'"));
        assert!(refused(text("0, 0, 0, 0, 501, 0, 320, 240, 1", "")).contains("fx"));
        assert_eq!(
            refused(text(MATRIX, ",\n\"depth_scale\": 0")),
            "Open3D intrinsics, line 5: depth_scale is '0', expected units in a metre, 0.1 to 1e6"
        );
        assert!(refused(text(MATRIX, ",\n\"fps\": 1e-300")).contains("line 5: fps is '1e-300'"));
        let huge = text(MATRIX, "").replace("640", "99999999999");
        assert_eq!(refused(huge), "Open3D intrinsics, line 2: width is '99999999999', expected pixels, 1 to 16384");
        let cut = text(MATRIX, "");
        assert!(refused(cut[..cut.len() - 3].to_owned()).contains("expected JSON"));
        assert!(refused("{\"width\": 4}".to_owned()).contains("height is missing"));
    }

    proptest! {
        #[test]
        fn damaged_text_never_panics(hits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6)) {
            let mut bytes = text(MATRIX, ",\"fps\": 30").into_bytes();
            for (at, value) in hits {
                let at = at.index(bytes.len());
                bytes[at] = value;
            }
            let _ = parse_intrinsics(&bytes);
        }
    }
}
