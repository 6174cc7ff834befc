//! Draws a cloud: `picture FILE VIEW OUT.png`, VIEW being top, front, side, perspective or camera.

use percept_formats::{Limits, pcd, ply, read_file};
use percept_perception::render::{RenderParams, View, render_cloud};
use std::error::Error;
use std::path::Path;

fn main() -> Result<(), Box<dyn Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [file, view, out] = &words[..] else { return Err("usage: picture FILE VIEW OUT.png".into()) };
    let limits = Limits::default();
    let bytes = read_file(Path::new(file), &limits)?;
    let cloud =
        if file.ends_with(".ply") { ply::decode(&bytes, &limits)? } else { pcd::decode(&bytes, &limits)?.cloud };
    let view: View = serde_json::from_value(serde_json::Value::String(view.clone()))?;
    let image = render_cloud(&cloud, None, &RenderParams { view, ..RenderParams::default() })?;
    std::fs::write(out, percept_formats::images::encode_rgb_png(&image)?)?;
    Ok(())
}
