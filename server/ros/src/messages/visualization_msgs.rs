//! Shapes for RViz and its like.

use super::{ColorRGBA, CompressedImage, Duration, Header, Point, Pose, Vector3};
use std::borrow::Cow;

message! {
    /// A place on a texture, 0 to 1.
    #[derive(Copy)]
    "visualization_msgs/msg/UVCoordinate" UVCoordinate {
        /// To the right.
        u: f32,
        /// Down.
        v: f32,
    }

    /// A file of a mesh.
    "visualization_msgs/msg/MeshFile" MeshFile<'a> {
        /// Its name, for the ending.
        filename: &'a str,
        /// Its bytes.
        data: Cow<'a, [u8]>,
    }

    /// A shape.
    "visualization_msgs/msg/Marker" Marker<'a> {
        /// When, and the frame.
        header: Header<'a>,
        /// Namespace of the identity.
        ns: &'a str,
        /// Identity in the namespace: a marker replaces that of the same.
        id: i32,
        /// 0 arrow, 1 cube, 2 sphere, 3 cylinder, 4 line strip, 5 line list, 6 cubes, 7 spheres, 8 points, 9 text, 10 mesh,
        /// 11 triangles, 12 arrow strip.
        r#type: i32,
        /// 0 add or change, 2 delete, 3 delete all.
        action: i32,
        /// Pose in the frame.
        pose: Pose,
        /// Lengths along the axes, m; of lines the width in x.
        scale: Vector3,
        /// Colour.
        color: ColorRGBA,
        /// How long it is shown; 0 for ever.
        lifetime: Duration,
        /// Whether it moves with its frame.
        frame_locked: bool,
        /// Points of lists and strips.
        points: Vec<Point>,
        /// A colour for each point, or none.
        colors: Vec<ColorRGBA>,
        /// Where the texture is found.
        texture_resource: &'a str [ros2],
        /// The texture.
        texture: CompressedImage<'a> [ros2],
        /// A place on the texture for each point.
        uv_coordinates: Vec<UVCoordinate> [ros2],
        /// The text.
        text: &'a str,
        /// Where the mesh is found.
        mesh_resource: &'a str,
        /// The mesh.
        mesh_file: MeshFile<'a> [ros2],
        /// Whether the mesh has its own colours.
        mesh_use_embedded_materials: bool,
    }

    /// Shapes.
    "visualization_msgs/msg/MarkerArray" MarkerArray<'a> {
        /// The shapes.
        markers: Vec<Marker<'a>>,
    }
}
