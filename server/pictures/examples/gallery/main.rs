//! Draws every kind of picture from made-up maps, and of maps (nav2's yaml) and clouds from files, if some are given:
//! `cargo run --release -p percept-pictures --example gallery -- FOLDER [FILE …]`.

mod scene;
mod solid;

use percept_geometry::{PointCloud, RgbImage};
use percept_pictures::{self as pictures, View};
use std::error::Error;
use std::path::{Path, PathBuf};
use std::time::Instant;

type Done = Result<(), Box<dyn Error>>;

fn main() -> Done {
    let folder = std::env::args().nth(1).map(PathBuf::from).unwrap_or_else(|| PathBuf::from("gallery"));
    std::fs::create_dir_all(&folder)?;
    let files: Vec<PathBuf> = std::env::args().skip(2).map(PathBuf::from).collect();
    if !files.is_empty() {
        return files.iter().try_for_each(|file| from_file(&folder, file));
    }
    flat(&folder)?;
    space(&folder)
}

fn from_file(folder: &Path, file: &Path) -> Done {
    let limits = percept_formats::Limits::default();
    let name = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    if file.extension().is_some_and(|extension| extension == "yaml") {
        let grid = percept_formats::nav2::read(file, &limits)?;
        save(folder, &name, || pictures::overview(&grid, &pictures::Overlay::default(), &name))?;
        return Ok(());
    }
    let cloud = percept_formats::read_cloud_file(file, &limits)?.cloud;
    save(folder, &name, || pictures::cloud_view(&cloud, &View::default(), &name))?;
    let above = View { cut_above_m: None, ..View::above() };
    save(folder, &format!("{name}_above"), || pictures::cloud_view(&cloud, &above, &name))?;
    Ok(())
}

/// Writes a picture and says how long it took to draw.
fn save(
    folder: &Path,
    name: &str,
    draw: impl FnOnce() -> Result<RgbImage, pictures::PictureError>,
) -> Result<RgbImage, Box<dyn Error>> {
    let start = Instant::now();
    let image = draw()?;
    let drawn = start.elapsed();
    std::fs::write(folder.join(format!("{name}.png")), pictures::encode_png(&image)?)?;
    println!("{name}: {} x {}, {:.0} ms", image.width(), image.height(), 1e3 * drawn.as_secs_f64());
    Ok(image)
}

fn flat(folder: &Path) -> Done {
    let flat = scene::flat();
    let overlay = scene::overlay();
    save(folder, "overview", || pictures::overview(&flat, &overlay, "Flat, second floor"))?;
    save(folder, "crowded", || pictures::overview(&flat, &scene::crowd(), "Things everywhere"))?;
    let closet = scene::empty_room(24, 16, 0.1);
    save(folder, "small_room", || pictures::overview(&closet, &pictures::Overlay::default(), "Closet"))?;
    let corridor = scene::empty_room(1200, 40, 0.05);
    save(folder, "corridor", || pictures::overview(&corridor, &scene::walk(), "Corridor"))?;
    let huge = scene::empty_room(16_000, 12_000, 0.05);
    save(folder, "huge", || pictures::overview(&huge, &scene::walk(), "A whole plant"))?;
    let nothing = scene::empty_room(0, 0, 0.05);
    save(folder, "nothing", || pictures::overview(&nothing, &pictures::Overlay::default(), "A new session"))?;
    save(folder, "path", || pictures::path_picture(&flat, &scene::path(), "From the kitchen to the bedroom"))?;
    save(folder, "no_path", || pictures::path_picture(&flat, &scene::no_path(), "To the store room"))?;
    let hills = scene::hills();
    save(folder, "heights", || pictures::heights(&hills, "Yard with a ramp"))?;
    let can_drive = percept_mapping::Traversability::of(&hills, &percept_mapping::HeightParams::default());
    save(folder, "traversability", || pictures::traversability(&can_drive, "Yard with a ramp"))?;
    let later = scene::flat_later();
    save(folder, "before_after", || {
        pictures::before_after(&flat, &later, 0.0, "Flat, Monday and Tuesday").map(|(image, _)| image)
    })?;
    Ok(())
}

fn space(folder: &Path) -> Done {
    let oblique = View { cut_above_m: Some(2.3), ..View::default() };
    let mesh = save(folder, "mesh", || pictures::mesh_view(&solid::mesh(true), &oblique, "Flat, surface"))?;
    let grey = solid::mesh(false);
    save(folder, "mesh_heights", || pictures::mesh_view(&grey, &oblique, "Flat, surface without colours"))?;
    save(folder, "mesh_above", || pictures::mesh_view(&solid::mesh(true), &View::above(), "Flat, surface"))?;
    let cloud = solid::cloud(900.0, true);
    save(folder, "cloud", || pictures::cloud_view(&cloud, &oblique, "Flat, cloud"))?;
    let cloud = solid::cloud(900.0, false);
    save(folder, "cloud_heights", || pictures::cloud_view(&cloud, &oblique, "Flat, cloud"))?;
    let above = save(folder, "cloud_above", || pictures::cloud_view(&cloud, &View::above(), "Flat, cloud"))?;
    let voxels = solid::voxels(0.1);
    save(folder, "voxels", || pictures::voxels_view(&voxels, 0.1, &oblique, "Flat, voxels"))?;
    save(folder, "voxels_above", || pictures::voxels_view(&voxels, 0.1, &View::above(), "Flat, voxels"))?;
    let slice =
        save(folder, "voxels_slice", || pictures::voxels_slice(&voxels, 0.1, 0.72, "Flat, at the height of tables"))?;
    save(folder, "side_by_side", || {
        pictures::side_by_side(&[(&mesh, "Surface"), (&above, "Cloud from above"), (&slice, "Voxels at 0.7 m")], 2)
    })?;
    save(folder, "empty_cloud", || pictures::cloud_view(&PointCloud::default(), &oblique, "Nothing"))?;
    let terrain = solid::terrain(2240);
    save(folder, "mesh_ten_million", || pictures::mesh_view(&terrain, &View::default(), "Ten million triangles"))?;
    let cloud = PointCloud::from_positions(terrain.positions.iter().chain(&terrain.positions).copied().collect());
    save(folder, "cloud_ten_million", || pictures::cloud_view(&cloud, &View::default(), "Ten million points"))?;
    Ok(())
}
