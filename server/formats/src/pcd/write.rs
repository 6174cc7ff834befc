//! A cloud out: PCD 0.7, binary.

use crate::FormatError;
use percept_geometry::PointCloud;
use std::io::Write;

/// Bytes of a binary PCD file; see [`write()`].
///
/// # Errors
/// `Geometry` if a channel has another length than the positions.
pub fn encode(cloud: &PointCloud) -> Result<Vec<u8>, FormatError> {
    let mut out = Vec::with_capacity(512 + cloud.len() * 32);
    write(&mut out, cloud)?;
    Ok(out)
}

/// Writes a binary PCD file: `x y z` (m), then those of `rgb` (packed float, as PCL writes it), `intensity`,
/// `normal_x normal_y normal_z` that the cloud has. Time offsets are left out.
///
/// Wrap files in a `BufWriter`: each point is a write of its own.
///
/// # Errors
/// `Geometry` if a channel has another length than the positions; `Write` if the writer refuses.
pub fn write(out: &mut impl Write, cloud: &PointCloud) -> Result<(), FormatError> {
    cloud.validate()?;
    let mut names = vec!["x", "y", "z"];
    names.extend(cloud.colors.iter().map(|_| "rgb"));
    names.extend(cloud.intensities.iter().map(|_| "intensity"));
    names.extend(cloud.normals.iter().flat_map(|_| ["normal_x", "normal_y", "normal_z"]));
    let repeated = |word: &str| vec![word; names.len()].join(" ");
    let n = cloud.len();
    write!(
        out,
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS {}\nSIZE {}\nTYPE {}\nCOUNT {}\n\
         WIDTH {n}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {n}\nDATA binary\n",
        names.join(" "),
        repeated("4"),
        repeated("F"),
        repeated("1"),
    )?;
    let mut row = Vec::with_capacity(32);
    for i in 0..n {
        row.clear();
        cloud.positions[i].iter().for_each(|v| row.extend(v.to_le_bytes()));
        if let Some(colors) = &cloud.colors {
            let [r, g, b] = colors[i];
            row.extend([b, g, r, 0]);
        }
        if let Some(intensities) = &cloud.intensities {
            row.extend(intensities[i].to_le_bytes());
        }
        if let Some(normals) = &cloud.normals {
            normals[i].iter().for_each(|v| row.extend(v.to_le_bytes()));
        }
        out.write_all(&row)?;
    }
    Ok(())
}
