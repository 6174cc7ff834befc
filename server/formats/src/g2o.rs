//! Pose graphs as g2o text: poses in the plane (`VERTEX_SE2`, `EDGE_SE2`) or in space (`VERTEX_SE3:QUAT`,
//! `EDGE_SE3:QUAT`).
//!
//! Source: Kümmerle et al., "g2o: a general framework for graph optimization", 2011, and the files that its tools write.
//! A file may lack the poses. `FIX` names poses that are held; parameters of other kinds are refused, not skipped.

use crate::text::{Fields, Line, Lines};
use crate::{FormatError, Limits};
use percept_geometry::information::{from_upper_triangle, is_information, nearest_information, upper_triangle};
use percept_geometry::{Pose, se3};
use std::io::Write;

const FORMAT: &str = "g2o";

/// A measured pose of one vertex seen from another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct G2oEdge<P, const I: usize> {
    /// Number of the vertex that the measurement is seen from.
    pub from: u64,
    /// Number of the vertex that is measured.
    pub to: u64,
    /// The measurement.
    pub t_from_to: P,
    /// Upper triangle of the information matrix, row by row.
    pub information: [f64; I],
}

/// Vertices and edges in the order of the file.
#[derive(Debug, Clone, PartialEq)]
pub struct G2oGraph<P, const I: usize> {
    /// Numbers and poses; those that edges name may be missing.
    pub vertices: Vec<(u64, P)>,
    /// Measurements.
    pub edges: Vec<G2oEdge<P, I>>,
    /// Numbers of the vertices that are held.
    pub fixed: Vec<u64>,
}

impl<P, const I: usize> G2oGraph<P, I> {
    /// Whether there is neither a vertex nor an edge.
    pub fn is_empty(&self) -> bool {
        self.vertices.is_empty() && self.edges.is_empty()
    }
}

impl<P, const I: usize> Default for G2oGraph<P, I> {
    fn default() -> Self {
        Self { vertices: vec![], edges: vec![], fixed: vec![] }
    }
}

/// What becomes of an edge whose information would reward errors: graphs exist in which every third is of that kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Indefinite {
    /// The file is refused, with the edge's line: no poses explain it best.
    #[default]
    Refuse,
    /// The nearest matrix that is positive semi-definite takes its place.
    Project,
}

/// `[x, y, yaw]`: metres and radians.
pub type PlanarRow = [f64; 3];

/// A graph in the plane or in space.
#[derive(Debug, Clone, PartialEq)]
pub enum G2oFile {
    /// Errors are x, y, yaw.
    Planar(G2oGraph<PlanarRow, 6>),
    /// Errors are x, y, z and the vector part of a quaternion.
    Spatial(G2oGraph<Pose, 21>),
}

/// Reads a graph. A file without edges and vertices is one in the plane that is empty.
///
/// # Errors
/// `Malformed` with the line: unknown rows, planar and spatial rows in one file, numbers that are not finite, an edge
/// from a vertex to itself, information that is not positive semi-definite unless that is to be projected. `TooLarge` for
/// more rows than `limits.max_points`.
pub fn parse_g2o(bytes: &[u8], limits: &Limits, indefinite: Indefinite) -> Result<G2oFile, FormatError> {
    let (mut planar, mut spatial) = (G2oGraph::default(), G2oGraph::default());
    let mut fixed = vec![];
    for (count, line) in Lines::new(FORMAT, bytes).contents().enumerate() {
        limits.points(count as u64 + 1)?;
        let mut fields = line.fields();
        let tag = fields.required("tag")?;
        match tag {
            b"VERTEX_SE2" => planar.vertices.push((id(&line, &mut fields)?, numbers(&mut fields, "pose")?)),
            b"EDGE_SE2" => {
                let read = |_: &Line<'_>, fields: &mut Fields<'_>| numbers(fields, "measurement");
                planar.edges.push(edge::<_, 3, 6>(&line, &mut fields, read, indefinite)?);
            }
            b"VERTEX_SE3:QUAT" => spatial.vertices.push((id(&line, &mut fields)?, pose(&line, &mut fields)?)),
            b"EDGE_SE3:QUAT" => spatial.edges.push(edge::<_, 6, 21>(&line, &mut fields, pose, indefinite)?),
            b"FIX" => {
                fixed.push(id(&line, &mut fields)?);
                while let Some(token) = fields.token() {
                    let number = crate::text::parse(token);
                    fixed.push(number.ok_or_else(|| line.malformed("vertex", token, "a number from 0"))?);
                }
            }
            _ => {
                let known = "VERTEX_SE2, EDGE_SE2, VERTEX_SE3:QUAT, EDGE_SE3:QUAT or FIX";
                return Err(line.malformed("tag", tag, known));
            }
        }
        fields.end()?;
        if !planar.is_empty() && !spatial.is_empty() {
            return Err(line.malformed("tag", tag, "rows in the plane or in space, not both"));
        }
    }
    Ok(if spatial.is_empty() {
        G2oFile::Planar(G2oGraph { fixed, ..planar })
    } else {
        G2oFile::Spatial(G2oGraph { fixed, ..spatial })
    })
}

fn id(line: &Line<'_>, fields: &mut Fields<'_>) -> Result<u64, FormatError> {
    let token = fields.required("vertex")?;
    crate::text::parse(token).ok_or_else(|| line.malformed("vertex", token, "a number from 0"))
}

fn numbers<const N: usize>(fields: &mut Fields<'_>, name: &str) -> Result<[f64; N], FormatError> {
    let mut out = [0.0; N];
    for value in &mut out {
        *value = fields.finite(name)?;
    }
    Ok(out)
}

/// Quaternions are rounded in many files: a norm within 5 % of 1 is brought to 1.
fn pose(line: &Line<'_>, fields: &mut Fields<'_>) -> Result<Pose, FormatError> {
    let v: [f64; 7] = numbers(fields, "pose")?;
    let norm = v[3..].iter().map(|q| q * q).sum::<f64>().sqrt();
    if (norm - 1.0).abs() > 0.05 {
        return Err(line.malformed("quaternion norm", norm.to_string().as_bytes(), "1"));
    }
    let scale = if (norm - 1.0).abs() < 1e-12 { 1.0 } else { norm };
    Ok(se3::pose_from_parts("pose", [v[0], v[1], v[2]], [3, 4, 5, 6].map(|i| v[i] / scale))?)
}

fn edge<P, const D: usize, const I: usize>(
    line: &Line<'_>,
    fields: &mut Fields<'_>,
    measurement: impl Fn(&Line<'_>, &mut Fields<'_>) -> Result<P, FormatError>,
    indefinite: Indefinite,
) -> Result<G2oEdge<P, I>, FormatError> {
    let (from, to) = (id(line, fields)?, id(line, fields)?);
    if from == to {
        return Err(line.malformed("vertex", to.to_string().as_bytes(), "another vertex than the edge's first"));
    }
    let t_from_to = measurement(line, fields)?;
    let mut information: [f64; I] = numbers(fields, "information")?;
    let matrix = from_upper_triangle::<D>(&information);
    if !is_information(&matrix) {
        if indefinite == Indefinite::Refuse {
            let edge = format!("of edge {from} {to}");
            return Err(line.malformed("information", edge.as_bytes(), "a positive semi-definite matrix"));
        }
        let nearest = nearest_information(&matrix);
        information.iter_mut().zip(upper_triangle(&nearest)).for_each(|(value, v)| *value = v);
    }
    Ok(G2oEdge { from, to, t_from_to, information })
}

/// Writes a graph so that it reads back equal.
///
/// # Errors
/// `Write` if the writer refuses.
pub fn write_g2o(out: &mut impl Write, file: &G2oFile) -> Result<(), FormatError> {
    match file {
        G2oFile::Planar(graph) => write_graph(out, graph, "SE2", |p| p.to_vec()),
        G2oFile::Spatial(graph) => write_graph(out, graph, "SE3:QUAT", |p| {
            let t = p.translation.vector;
            [&[t.x, t.y, t.z][..], &se3::quaternion_xyzw(p)].concat()
        }),
    }
}

fn write_graph<P, const I: usize>(
    out: &mut impl Write,
    graph: &G2oGraph<P, I>,
    kind: &str,
    row: impl Fn(&P) -> Vec<f64>,
) -> Result<(), FormatError> {
    let words = |v: &[f64]| v.iter().map(f64::to_string).collect::<Vec<_>>().join(" ");
    for (id, pose) in &graph.vertices {
        writeln!(out, "VERTEX_{kind} {id} {}", words(&row(pose)))?;
    }
    for id in &graph.fixed {
        writeln!(out, "FIX {id}")?;
    }
    for e in &graph.edges {
        writeln!(out, "EDGE_{kind} {} {} {} {}", e.from, e.to, words(&row(&e.t_from_to)), words(&e.information))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::SMatrix;
    use proptest::prelude::*;

    const SMALL: &str = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 7 1 0.5 0.1\nFIX 0\n# a remark\n\
        EDGE_SE2 0 7 1 0.5 0.1 500 0 0 500 0 5000\n";

    fn upper<const D: usize, const I: usize>(matrix: &SMatrix<f64, D, D>) -> [f64; I] {
        upper_triangle(matrix).collect::<Vec<_>>().try_into().unwrap()
    }

    #[test]
    fn information_that_rewards_errors_is_refused_with_its_line_or_projected() {
        let text = SMALL.replace("500 0 0 500 0 5000", "500 900 0 500 0 5000");
        let error = read(&text).unwrap_err().to_string();
        assert!(error.contains("line 5") && error.contains("edge 0 7"), "{error}");
        let projected = parse_g2o(text.as_bytes(), &Limits::default(), Indefinite::Project).unwrap();
        let G2oFile::Planar(graph) = projected else { panic!("not planar") };
        // Eigenvalues 1400, -400 and 5000, the first two along the diagonals of x and y.
        let expected = [700.0, 700.0, 0.0, 700.0, 0.0, 5000.0];
        assert!(graph.edges[0].information.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9));
    }

    fn read(text: &str) -> Result<G2oFile, FormatError> {
        parse_g2o(text.as_bytes(), &Limits::default(), Indefinite::Refuse)
    }

    #[test]
    fn a_planar_graph_is_read_with_its_numbers() {
        let Ok(G2oFile::Planar(graph)) = read(SMALL) else { panic!("not planar") };
        assert_eq!(graph.vertices, [(0, [0.0; 3]), (7, [1.0, 0.5, 0.1])]);
        assert_eq!(graph.fixed, [0]);
        assert_eq!(graph.edges[0].information, [500.0, 0.0, 0.0, 500.0, 0.0, 5000.0]);
        assert_eq!((graph.edges[0].from, graph.edges[0].to), (0, 7));
    }

    #[test]
    fn what_is_wrong_is_named_with_its_line() {
        for (text, what) in [
            ("VERTEX_SE2 0 0 0", "line 1"),
            ("VERTEX_SE2 0 0 0 0\nEDGE_SE2 0 0 1 0 0 1 0 0 1 0 1", "line 2"),
            ("VERTEX_SE2 -1 0 0 0", "vertex"),
            ("EDGE_SE2 0 1 1 0 inf 1 0 0 1 0 1", "finite"),
            ("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1 9", "end of line"),
            ("VERTEX_SE3:QUAT 0 0 0 0 0 0 0 2", "quaternion norm"),
            ("VERTEX_XYZ 0 0 0 0", "VERTEX_XYZ"),
            ("VERTEX_SE2 0 0 0 0\nVERTEX_SE3:QUAT 1 0 0 0 0 0 0 1", "not both"),
        ] {
            let error = read(text).expect_err(text).to_string();
            assert!(error.contains(what), "{text}: {error}");
        }
        let few = Limits { max_points: 2, ..Limits::default() };
        assert!(matches!(parse_g2o(SMALL.as_bytes(), &few, Indefinite::Refuse), Err(FormatError::TooLarge { .. })));
        assert!(matches!(read(""), Ok(G2oFile::Planar(g)) if g.edges.is_empty()));
    }

    proptest! {
        #[test]
        fn a_written_graph_reads_back(
            v in prop::collection::vec((any::<u32>(), prop::array::uniform3(-1e6..1e6f64)), 0..5),
            e in prop::collection::vec((0..9u64, prop::array::uniform3(-9.0..9.0f64), prop::array::uniform9(-1e4..1e4f64)), 0..5),
        ) {
            let edge = |(from, t_from_to, root): (_, _, [f64; 9])| {
                let root = SMatrix::<f64, 3, 3>::from_row_slice(&root);
                G2oEdge { from, to: from + 1, t_from_to, information: upper(&(root * root.transpose())) }
            };
            let file = G2oFile::Planar(G2oGraph {
                vertices: v.into_iter().map(|(id, p)| (u64::from(id), p)).collect(),
                edges: e.into_iter().map(edge).collect(),
                fixed: vec![3],
            });
            let mut text = vec![];
            write_g2o(&mut text, &file).unwrap();
            prop_assert_eq!(parse_g2o(&text, &Limits::default(), Indefinite::Refuse).unwrap(), file);
        }

        #[test]
        fn a_written_graph_in_space_reads_back(
            t in prop::array::uniform3(-1e6..1e6f64), axis in prop::array::uniform3(-3.0..3.0f64),
            root in prop::collection::vec(-1e4..1e4f64, 36),
        ) {
            let turn = nalgebra::UnitQuaternion::from_scaled_axis(axis.into());
            let pose = Pose::from_parts(nalgebra::Vector3::from(t).into(), turn);
            let root = SMatrix::<f64, 6, 6>::from_row_slice(&root);
            let information: [f64; 21] = upper(&(root * root.transpose()));
            let edges = vec![G2oEdge { from: 0, to: 1, t_from_to: pose, information }];
            let file = G2oFile::Spatial(G2oGraph { vertices: vec![(1, pose)], edges, fixed: vec![] });
            let mut text = vec![];
            write_g2o(&mut text, &file).unwrap();
            let Ok(G2oFile::Spatial(read)) = parse_g2o(&text, &Limits::default(), Indefinite::Refuse) else { panic!("not spatial") };
            prop_assert!((read.vertices[0].1.translation.vector - pose.translation.vector).norm() == 0.0);
            prop_assert!(read.vertices[0].1.rotation.angle_to(&pose.rotation) < 1e-12);
            prop_assert_eq!(read.edges[0].information, information);
        }
    }
}
