//! A cloud from a file of any format that is known, and back.

use crate::layout::Rows;
use crate::{FormatError, Limits, Place, kitti, las, pcd, ply, xyz};
use percept_geometry::{PointCloud, Pose};
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Formats of clouds, with their encoding.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CloudFormat {
    /// PLY; every channel.
    Ply(ply::Encoding),
    /// PCD; every channel.
    Pcd(pcd::Encoding),
    /// Text: colours and normals, or intensities.
    Xyz,
    /// KITTI's velodyne `.bin`: intensities.
    KittiBin,
    /// LAS 1.2 with millimetres: colours and intensities.
    Las,
    /// LAS packed by LASzip.
    Laz,
}

/// What a file of a cloud holds.
#[derive(Debug, Clone, PartialEq)]
pub struct CloudFile {
    /// The points (m), relative to `origin_m`; points without return (NaN) are kept.
    pub cloud: PointCloud,
    /// What to add to every position, in f64; zero unless the file has coordinates that f32 would spoil.
    pub origin_m: [f64; 3],
    /// The format found.
    pub format: CloudFormat,
    /// N labels, if the file has them (PCD).
    pub labels: Option<Vec<u32>>,
    /// Columns and rows of an organised cloud (PCD): N x 1 of one that is not.
    pub width: usize,
    /// See `width`.
    pub height: usize,
    /// Where the sensor stood, if the file says so (PCD); not applied.
    pub t_cloud_viewpoint: Pose,
}

impl CloudFile {
    fn plain(cloud: PointCloud, format: CloudFormat) -> Self {
        let width = cloud.len();
        let t_cloud_viewpoint = Pose::identity();
        Self { cloud, origin_m: [0.0; 3], format, labels: None, width, height: 1, t_cloud_viewpoint }
    }

    fn of_pcd(file: pcd::Pcd, format: CloudFormat) -> Self {
        let pcd::Pcd { cloud, labels, width, height, t_cloud_viewpoint } = file;
        Self { cloud, origin_m: [0.0; 3], format, labels, width, height, t_cloud_viewpoint }
    }
}

/// What the bytes are: by their beginning, else (KITTI, which has none, and text) by the ending of `name_hint`.
///
/// # Errors
/// `Malformed` if neither tells.
pub fn sniff_cloud(bytes: &[u8], name_hint: &str) -> Result<CloudFormat, FormatError> {
    let ending = name_hint.rsplit('.').next().unwrap_or_default().to_ascii_lowercase();
    if bytes.starts_with(b"ply\n") || bytes.starts_with(b"ply\r") || ending == "ply" {
        return Ok(CloudFormat::Ply(ply::encoding(bytes)));
    }
    if bytes.starts_with(b"LASF") || ending == "las" || ending == "laz" {
        return Ok(if las::is_compressed(bytes) { CloudFormat::Laz } else { CloudFormat::Las });
    }
    if is_pcd(bytes) || ending == "pcd" {
        return Ok(CloudFormat::Pcd(pcd::encoding(bytes)));
    }
    let is_text = bytes.iter().take(4096).all(|b| matches!(b, b'\t' | b'\r' | b'\n' | b' '..=b'~' | 128..));
    match ending.as_str() {
        "bin" => Ok(CloudFormat::KittiBin),
        "xyz" | "xyzrgb" | "xyzn" | "txt" | "csv" | "asc" | "pts" => Ok(CloudFormat::Xyz),
        _ if is_text && !bytes.is_empty() => Ok(CloudFormat::Xyz),
        _ => {
            let expected = "the beginning of a PLY, PCD, LAS or text file, or a name that ends in .bin";
            Err(FormatError::malformed("cloud", Place::Byte(0), "signature", &bytes[..bytes.len().min(8)], expected))
        }
    }
}

/// Whether the first line that is no comment begins as a PCD header does.
fn is_pcd(bytes: &[u8]) -> bool {
    let first = bytes.split(|&b| b == b'\n').take(64).map(<[u8]>::trim_ascii).find(|l| !l.is_empty() && l[0] != b'#');
    bytes.starts_with(b"# .PCD")
        || first.is_some_and(|l| [&b"VERSION"[..], b"FIELDS", b"COLUMNS"].iter().any(|k| l.starts_with(k)))
}

/// A cloud from the bytes of a file in any known format, found by [`sniff_cloud`].
///
/// # Errors
/// `Malformed` if the format is not known; else the decoder's.
pub fn load_cloud(bytes: &[u8], name_hint: &str, limits: &Limits) -> Result<CloudFile, FormatError> {
    let format = sniff_cloud(bytes, name_hint)?;
    Ok(match format {
        CloudFormat::Ply(_) => CloudFile::plain(ply::decode(bytes, limits)?, format),
        CloudFormat::Pcd(_) => CloudFile::of_pcd(pcd::decode(bytes, limits)?, format),
        CloudFormat::KittiBin => CloudFile::plain(kitti::decode_bin(bytes, limits)?, format),
        CloudFormat::Xyz => {
            let (cloud, origin_m) = xyz::decode(bytes, limits)?;
            CloudFile { origin_m, ..CloudFile::plain(cloud, format) }
        }
        CloudFormat::Las | CloudFormat::Laz => {
            let (cloud, origin_m) = las::decode(bytes, limits)?;
            CloudFile { origin_m, ..CloudFile::plain(cloud, format) }
        }
    })
}

/// Bytes of a file with those channels of a cloud that the format knows; positions are relative to `origin_m`.
///
/// PLY, PCD and KITTI hold f32: their positions are written as they are, and an origin other than zero is refused.
///
/// # Errors
/// `Unsupported` for an origin that the format cannot keep; else the encoder's.
pub fn save_cloud(cloud: &PointCloud, origin_m: [f64; 3], format: CloudFormat) -> Result<Vec<u8>, FormatError> {
    let keeps_origin = matches!(format, CloudFormat::Xyz | CloudFormat::Las | CloudFormat::Laz);
    if !keeps_origin && origin_m != [0.0; 3] {
        let (value, supported) = (format!("{origin_m:?}"), "zero in a format of f32; save as XYZ, LAS or LAZ");
        return Err(FormatError::Unsupported { format: "cloud", field: "origin_m", value, supported });
    }
    match format {
        CloudFormat::Ply(encoding) => ply::encode(cloud, encoding),
        CloudFormat::Pcd(encoding) => pcd::encode_as(cloud, encoding),
        CloudFormat::Xyz => xyz::encode(cloud, origin_m),
        CloudFormat::KittiBin => {
            let mut out = Vec::with_capacity(16 * cloud.len());
            kitti::write_bin(&mut out, cloud)?;
            Ok(out)
        }
        CloudFormat::Las => las::encode(cloud, origin_m, false),
        CloudFormat::Laz => las::encode(cloud, origin_m, true),
    }
}

/// Bytes read at once: small enough to stay in the cache until they are decoded.
const PIECE_BYTES: usize = 128 << 10;

/// A cloud from a file: as [`load_cloud`], but binary PLY and PCD are decoded while they are read, so that the only
/// large memory taken is the cloud's.
///
/// # Errors
/// `Io` as the file system says, else those of [`load_cloud`], both naming the file.
pub fn read_cloud_file(path: &Path, limits: &Limits) -> Result<CloudFile, FormatError> {
    let io = |e: std::io::Error| FormatError::io(path, &e);
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let mut file = File::open(path).map_err(io)?;
    let declared = file.metadata().map_err(io)?.len();
    let mut piece = vec![0; PIECE_BYTES];
    let filled = fill(&mut file, &mut piece).map_err(io)?;
    let head = &piece[..filled];
    if let Some((rows, mut answer)) = streamed(head, &name, limits)
        && declared.saturating_sub(rows.offset as u64) >= (rows.num_points as u64).saturating_mul(rows.stride as u64)
    {
        limits.bytes(declared).map_err(|e| e.in_file(path))?;
        answer.cloud = read_rows(&mut file, &rows, piece, filled).map_err(io)?;
        return Ok(answer);
    }
    drop(file);
    load_cloud(&crate::read_file(path, limits)?, &name, limits).map_err(|e| e.in_file(path))
}

/// The rows of a file that can be decoded while it is read, and all of the answer but the points.
fn streamed(head: &[u8], name: &str, limits: &Limits) -> Option<(Rows, CloudFile)> {
    let format = sniff_cloud(head, name).ok()?;
    let (rows, answer) = match format {
        CloudFormat::Ply(_) => {
            let rows = ply::rows(head, limits)?;
            let width = rows.num_points;
            (rows, CloudFile { width, ..CloudFile::plain(PointCloud::default(), format) })
        }
        CloudFormat::Pcd(_) => {
            let (rows, empty) = pcd::rows(head, limits)?;
            (rows, CloudFile::of_pcd(empty, format))
        }
        _ => return None,
    };
    (rows.stride > 0 && rows.stride <= PIECE_BYTES).then_some((rows, answer))
}

/// As many bytes as there are, up to the length of `piece`.
fn fill(file: &mut File, piece: &mut [u8]) -> std::io::Result<usize> {
    let mut filled = 0;
    while filled < piece.len() {
        match file.read(&mut piece[filled..]) {
            Ok(0) => break,
            Ok(n) => filled += n,
            Err(e) if e.kind() == std::io::ErrorKind::Interrupted => {}
            Err(e) => return Err(e),
        }
    }
    Ok(filled)
}

/// Decodes rows piece by piece; the first `filled` bytes of the file are in `piece` already.
fn read_rows(file: &mut File, rows: &Rows, mut piece: Vec<u8>, filled: usize) -> std::io::Result<PointCloud> {
    let mut cloud = rows.layout.empty_cloud(rows.num_points);
    let mut left = rows.num_points;
    let (mut start, mut end) = (rows.offset, filled);
    loop {
        let n = ((end - start) / rows.stride).min(left);
        rows.layout.append(&piece[start..end], n, &mut cloud);
        left -= n;
        if left == 0 {
            return Ok(cloud);
        }
        // What is left of a row goes to the front.
        let used = start + n * rows.stride;
        piece.copy_within(used..end, 0);
        (start, end) = (0, end - used);
        let missing = left.saturating_mul(rows.stride) - end;
        let take = missing.min(piece.len() - end);
        file.read_exact(&mut piece[end..end + take])?;
        end += take;
    }
}
