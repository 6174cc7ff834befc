//! What the RGB-D kinds share.

use super::OpenOptions;
use super::files::Folder;
use super::frames::Load;
use crate::text::Lines;
use crate::{FormatError, Limits, images};
use nalgebra::Translation3;
use percept_geometry::{CameraIntrinsics, GeometryError, Pose, SensorData, SensorId, SensorKind, SensorSpec};
use std::path::{Path, PathBuf};

const CAMERA: &str = "camera";

/// Depth and colour files of one frame.
#[derive(Debug, Clone)]
pub(super) struct Images {
    pub(super) depth: PathBuf,
    pub(super) color: Option<PathBuf>,
}

/// Reads and decodes images.
#[derive(Debug)]
pub(super) struct RgbdLoader {
    pub(super) images: Vec<Images>,
    pub(super) metres_per_unit: f64,
    pub(super) limits: Limits,
}

impl Load for RgbdLoader {
    fn sensor(&self) -> SensorId {
        CAMERA.into()
    }

    fn load(&self, index: usize) -> Result<SensorData, FormatError> {
        let Images { depth: depth_path, color } = &self.images[index];
        let bytes = crate::read_file(depth_path, &self.limits)?;
        let depth = images::decode_depth(&bytes, self.metres_per_unit, &self.limits);
        let depth = depth.map_err(|e| e.in_file(depth_path))?;
        let Some(color_path) = color else {
            return Ok(SensorData::Depth(depth));
        };
        let bytes = crate::read_file(color_path, &self.limits)?;
        let color = images::decode_color(&bytes, &self.limits).map_err(|e| e.in_file(color_path))?;
        if (color.width(), color.height()) != (depth.width(), depth.height()) {
            let (expected, actual) = (depth.data().len(), color.width() * color.height());
            let error = GeometryError::ShapeMismatch { field: "color", expected, actual };
            return Err(FormatError::from(error).in_file(color_path));
        }
        Ok(SensorData::Rgbd(depth, color))
    }
}

/// t_base_camera: the base lies in the camera and looks along its optical axis.
pub(super) fn t_base_camera() -> Pose {
    Pose::from_parts(Translation3::identity(), SensorSpec::optical_rotation())
}

/// The camera of these images: `Rgbd` if all of them have colour, else `Depth`, for which colours are dropped.
pub(super) fn camera(
    images: &mut [Images],
    intrinsics: CameraIntrinsics,
    options: &OpenOptions,
) -> Result<SensorSpec, FormatError> {
    let with_color = !options.depth_only && images.iter().all(|i| i.color.is_some());
    if !with_color {
        images.iter_mut().for_each(|i| i.color = None);
    }
    let first = images.first().ok_or(FormatError::Missing { format: "RGB-D", field: "frames" })?;
    let bytes = crate::read_file(&first.depth, &options.limits)?;
    let (width, height) = images::declared_size(&bytes).map_err(|e| e.in_file(&first.depth))?;
    let spec = SensorSpec {
        id: CAMERA.into(),
        kind: if with_color { SensorKind::Rgbd } else { SensorKind::Depth },
        t_base_sensor: t_base_camera(),
        intrinsics: Some(CameraIntrinsics { width, height, ..intrinsics }),
        time_offset_s: 0.0,
        range_max_m: None,
    };
    spec.validate()?;
    Ok(spec)
}

/// `camera-intrinsics.txt` (3x3), or `calibration.txt` (fx fy cx cy), if the folder has one.
pub(super) fn read_intrinsics(folder: &Folder, limits: &Limits) -> Result<Option<CameraIntrinsics>, FormatError> {
    let read = |path: &Path| crate::read_file(path, limits);
    if let Some(path) = folder.named("camera-intrinsics", ".txt") {
        return parse_matrix(&read(path)?).map(Some).map_err(|e| e.in_file(path));
    }
    if let Some(path) = folder.named("calibration", ".txt") {
        return parse_numbers(&read(path)?).map(Some).map_err(|e| e.in_file(path));
    }
    Ok(None)
}

const FORMAT: &str = "intrinsics";

/// fx 0 cx, 0 fy cy, 0 0 1. The size is not in the file.
fn parse_matrix(bytes: &[u8]) -> Result<CameraIntrinsics, FormatError> {
    let mut rows = Lines::new(FORMAT, bytes).contents();
    let mut row = || match rows.next() {
        Some(line) => line.numbers::<3>("matrix"),
        None => Err(FormatError::Missing { format: FORMAT, field: "row of the 3x3 matrix" }),
    };
    let ([fx, _, cx], [_, fy, cy], _) = (row()?, row()?, row()?);
    Ok(CameraIntrinsics::pinhole(0, 0, fx, fy, cx, cy))
}

fn parse_numbers(bytes: &[u8]) -> Result<CameraIntrinsics, FormatError> {
    let line = Lines::new(FORMAT, bytes).contents().next();
    let mut fields = line.ok_or(FormatError::Missing { format: FORMAT, field: "fx fy cx cy" })?.fields();
    let mut next = |name| fields.finite(name);
    let (fx, fy, cx, cy) = (next("fx")?, next("fy")?, next("cx")?, next("cy")?);
    Ok(CameraIntrinsics::pinhole(0, 0, fx, fy, cx, cy))
}
