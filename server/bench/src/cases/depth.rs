//! Depth images: to points, smoothed, with normals.

use super::{Case, timed};
use crate::{Args, BenchError};
use percept_formats::images::decode_gray16;
use percept_formats::{Limits, read_file};
use percept_geometry::{CameraIntrinsics, DepthImage};
use percept_perception::depth::{
    BilateralParams, MedianParams, NormalMap, NormalMapParams, RayTable, UnprojectParams, bilateral, median_units,
    unproject_units,
};
use serde_json::json;
use std::path::{Path, PathBuf};

/// A frame of `dir`: millimetres and the camera of `K.txt`.
pub(super) struct Frame {
    units: Vec<u16>,
    pub(super) camera: CameraIntrinsics,
}

impl Frame {
    fn read(args: &Args) -> Result<Self, BenchError> {
        Self::number(&args.required::<PathBuf>("dir")?, args.or("frame", 0)?)
    }

    /// One frame of a folder.
    pub(super) fn number(dir: &Path, frame: usize) -> Result<Self, BenchError> {
        let limits = Limits::default();
        let bytes = read_file(&dir.join(format!("{frame:04}.depth.png")), &limits).map_err(BenchError::new)?;
        let image = decode_gray16(&bytes, &limits).map_err(BenchError::new)?;
        let k = read_file(&dir.join("K.txt"), &limits).map_err(BenchError::new)?;
        let k: Vec<f64> = String::from_utf8_lossy(&k).split_whitespace().filter_map(|w| w.parse().ok()).collect();
        let &[fx, _, cx, _, fy, cy, ..] = k.as_slice() else {
            return Err(BenchError("K.txt: not a 3 x 3 matrix".to_owned()));
        };
        Ok(Self { camera: CameraIntrinsics::pinhole(image.width, image.height, fx, fy, cx, cy), units: image.data })
    }

    pub(super) fn metres(&self) -> Result<DepthImage, BenchError> {
        DepthImage::from_u16(self.camera.width, self.camera.height, &self.units, 0.001).map_err(BenchError::new)
    }
}

/// `depth_to_cloud dir= frame=`: from 16-bit millimetres, the table of rays included.
pub(super) fn depth_to_cloud(args: &Args) -> Result<Box<dyn Case>, BenchError> {
    let frame = Frame::read(args)?;
    let params = UnprojectParams { min_depth_m: 0.0, max_depth_m: 5.0, ..UnprojectParams::default() };
    let work = move || {
        let rays = RayTable::new(&frame.camera).map_err(BenchError::new)?;
        unproject_units(&frame.units, 0.001, None, &rays, &params).map_err(BenchError::new)
    };
    Ok(timed(pixels(args)?, work, |cloud| json!({"out_points": cloud.len()})))
}

/// `depth_median dir= frame=`: 5 x 5 on 16-bit millimetres.
pub(super) fn depth_median(args: &Args) -> Result<Box<dyn Case>, BenchError> {
    let Frame { units, camera } = Frame::read(args)?;
    let params = MedianParams { size_px: args.or("size_px", 5)?, ..MedianParams::default() };
    let work = move || median_units(&units, camera.width, camera.height, &params).map_err(BenchError::new);
    Ok(timed(pixels(args)?, work, |units| json!({"sum": units.iter().map(|&u| u64::from(u)).sum::<u64>()})))
}

/// `depth_bilateral dir= frame=`: window of 5, 0.03 m, 5 px on metres.
pub(super) fn depth_bilateral(args: &Args) -> Result<Box<dyn Case>, BenchError> {
    let depth = Frame::read(args)?.metres()?;
    let params = BilateralParams { radius_px: 2, sigma_px: 5.0, sigma_depth_m: 0.03 };
    let work = move || bilateral(&depth, &params).map_err(BenchError::new);
    Ok(timed(pixels(args)?, work, |d| json!({"sum": d.data().iter().map(|&d| f64::from(d)).sum::<f64>()})))
}

/// `depth_normals dir= frame=`: from metres, the table of rays and the points included.
pub(super) fn depth_normals(args: &Args) -> Result<Box<dyn Case>, BenchError> {
    let frame = Frame::read(args)?;
    let depth = frame.metres()?;
    let params = NormalMapParams::default();
    let work = move || {
        let rays = RayTable::new(&frame.camera).map_err(BenchError::new)?;
        NormalMap::of_depth(&depth, &rays, &params).map_err(BenchError::new)
    };
    let defined = |map: &NormalMap| map.normals.iter().filter(|n| n.norm_squared() > 0.0).count();
    Ok(timed(pixels(args)?, work, move |map| json!({"normals": defined(map)})))
}

fn pixels(args: &Args) -> Result<usize, BenchError> {
    Ok(Frame::read(args)?.units.len())
}
