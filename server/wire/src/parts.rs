//! Answers in parts that every gRPC client takes, and joined again. `toolbox.proto` has the rule.

use crate::convert::{geometry, maps};
use crate::v1;
use bytes::Bytes;
use prost::Message;
use v1::pipeline_step_result::Answer as Found;
use v1::read_operation_result_response::Result as Outcome;

/// Bytes of lists and arrays in one part: whole rows of 12 (three float32), 72, 128 and 132 bytes, and far enough below
/// gRPC's default limit of 4 MiB for what else the first part holds.
const PART_BYTES: usize = 99 << 14;

/// An answer that may be larger than one message.
pub trait InParts: Sized {
    /// Cuts it; at least one part.
    fn parts(self) -> Vec<Self>;
    /// All parts as one, in order.
    fn joined(parts: Vec<Self>) -> Self;
}

/// A field that goes on from part to part.
trait Divisible: Sized {
    /// Pieces of at most [`PART_BYTES`], with their sizes.
    fn pieces(self) -> Vec<(usize, Self)>;
    fn whole(pieces: Vec<Self>) -> Self;
}

impl Divisible for Bytes {
    fn pieces(self) -> Vec<(usize, Self)> {
        let piece = |start: usize| self.slice(start..(start + PART_BYTES).min(self.len()));
        (0..self.len()).step_by(PART_BYTES).map(piece).map(|b| (b.len(), b)).collect()
    }

    fn whole(mut pieces: Vec<Self>) -> Self {
        if pieces.len() > 1 { pieces.concat().into() } else { pieces.pop().unwrap_or_default() }
    }
}

impl<T: Message> Divisible for Vec<T> {
    fn pieces(self) -> Vec<(usize, Self)> {
        let mut out: Vec<(usize, Self)> = vec![];
        for item in self {
            // With its key and length.
            let size = item.encoded_len() + 8;
            match out.last_mut() {
                Some((used, piece)) if *used + size <= PART_BYTES => {
                    *used += size;
                    piece.push(item);
                }
                _ => out.push((size, vec![item])),
            }
        }
        out
    }

    fn whole(pieces: Vec<Self>) -> Self {
        pieces.into_iter().flatten().collect()
    }
}

impl Divisible for Option<v1::PointCloud> {
    fn pieces(self) -> Vec<(usize, Self)> {
        let Some(cloud) = self else { return vec![] };
        let n = cloud.num_points as usize;
        let per_point = (cloud.encoded_len() / n.max(1)).max(12);
        let step = PART_BYTES / (per_point + 1);
        let piece = |start: usize| {
            let end = (start + step).min(n);
            let rows = |data: &Bytes, bytes: usize| data.slice(start * bytes..end * bytes);
            let channel = |data: &Option<Bytes>, bytes| data.as_ref().map(|d| rows(d, bytes));
            let piece = v1::PointCloud {
                num_points: (end - start) as u32,
                positions: rows(&cloud.positions, 12),
                colours: channel(&cloud.colours, 3),
                intensities: channel(&cloud.intensities, 4),
                normals: channel(&cloud.normals, 12),
                time_offsets_s: channel(&cloud.time_offsets_s, 4),
            };
            (piece.encoded_len(), Some(piece))
        };
        (0..n.max(1)).step_by(step).map(piece).collect()
    }

    fn whole(pieces: Vec<Self>) -> Self {
        let mut clouds: Vec<v1::PointCloud> = pieces.into_iter().flatten().collect();
        if clouds.len() > 1 { Some(geometry::joined(&clouds)) } else { clouds.pop() }
    }
}

/// Parts of an answer that grow.
struct Cut<T> {
    parts: Vec<T>,
    room: usize,
}

impl<T: Default> Cut<T> {
    /// Puts the pieces of a field in order: the first where there is room, each other in a part of its own.
    fn add<P>(&mut self, pieces: Vec<(usize, P)>, put: impl Fn(&mut T, P)) {
        for (i, (size, piece)) in pieces.into_iter().enumerate() {
            if i > 0 || size > self.room {
                self.parts.push(T::default());
                self.room = PART_BYTES;
            }
            self.room = self.room.saturating_sub(size);
            if let Some(part) = self.parts.last_mut() {
                put(part, piece);
            }
        }
    }
}

/// A field that is there, or one of a message in the answer.
macro_rules! there {
    ($m:expr, $field:ident) => {
        Some(&mut $m.$field)
    };
    ($m:expr, $outer:ident . $field:ident) => {
        $m.$outer.as_mut().map(|outer| &mut outer.$field)
    };
}

/// The same, brought about.
macro_rules! place {
    ($m:expr, $field:ident) => {
        $m.$field
    };
    ($m:expr, $outer:ident . $field:ident) => {
        $m.$outer.get_or_insert_default().$field
    };
}

/// Answers with the fields that go on.
macro_rules! in_parts {
    ($($answer:ident { $($outer:ident $(. $inner:ident)?),+ })+) => {$(
        impl InParts for v1::$answer {
            fn parts(mut self) -> Vec<Self> {
                let taken = ($(there!(self, $outer $(. $inner)?).map(std::mem::take),)+);
                let mut cut = Cut { parts: vec![self], room: PART_BYTES };
                in_parts!(@add cut, taken, [0 1 2 3 4 5 6 7 8], $([$outer $(. $inner)?])+);
                cut.parts
            }

            fn joined(mut parts: Vec<Self>) -> Self {
                $(
                    let pieces = parts.iter_mut().filter_map(|p| there!(p, $outer $(. $inner)?).map(std::mem::take));
                    let pieces: Vec<_> = pieces.collect();
                    if let (Some(head), false) = (parts.first_mut(), pieces.is_empty()) {
                        place!(head, $outer $(. $inner)?) = Divisible::whole(pieces);
                    }
                )+
                parts.into_iter().next().unwrap_or_default()
            }
        }
    )+};
    (@add $cut:ident, $taken:ident, [$i:tt $($more:tt)*], [$($path:tt)+] $($rest:tt)*) => {
        let pieces = $taken.$i.map(Divisible::pieces).unwrap_or_default();
        $cut.add(pieces, |part, piece| place!(part, $($path)+) = piece);
        in_parts!(@add $cut, $taken, [$($more)*], $($rest)*);
    };
    (@add $cut:ident, $taken:ident, [$($more:tt)*],) => {};
}

in_parts! {
    ListCloudsResponse { clouds }
    DecodeCloudResponse { cloud }
    EncodeCloudResponse { file.data }
    RemoveNonFiniteResponse { cloud }
    SamplePointsResponse { cloud, indices }
    CropCloudResponse { cloud, indices }
    TransformCloudResponse { cloud }
    RemoveRadiusOutliersResponse { cloud, indices }
    RemoveStatisticalOutliersResponse { cloud, indices }
    DownsampleVoxelsResponse { cloud }
    EstimateNormalsResponse { cloud }
    FindNeighboursResponse { offsets, indices, distances_m }
    ComputeLocalFeaturesResponse { linearity, planarity, scattering, verticality, curvature }
    ComputeConvexHullResponse { vertices, triangles }
    SegmentPlanesResponse { planes, labels }
    SegmentGroundResponse { patches, indices }
    ClusterPointsResponse { labels }
    GrowRegionsResponse { labels }
    ComputeSupervoxelsResponse { labels, centres, normals, edges }
    GroupConvexResponse { labels }
    SegmentObjectsResponse { labels }
    DetectObjectsResponse { detections }
    ComputePointFeaturesResponse { features }
    UnprojectDepthResponse { cloud }
    ConvertDepthResponse { depth.data }
    ConvertColourResponse { colour.data }
    FilterDepthResponse { depth.data }
    ComputeDepthNormalsResponse { normals }
    SegmentDepthPlanesResponse { planes, labels }
    FindDepthEdgesResponse { edges }
    RegisterColourResponse { colour.data, seen }
    ExtractFeaturesResponse { points, sizes_px, angles_rad, responses, octaves, descriptors }
    MatchFeaturesResponse { pairs, distances }
    DetectInImageResponse { detections }
    ListImageDetectorsResponse { detectors }
    ListDetectorsResponse { detectors }
    EstimateEssentialResponse { inliers }
    EstimateHomographyResponse { inliers }
    EstimateTwoViewResponse { essential.inliers, homography.inliers }
    TriangulatePointsResponse { positions, covariances, parallax_rad, rmse_px, in_front }
    SolvePnpResponse { inliers }
    RenderCloudResponse { png }
    RenderDepthResponse { png }
    DrawPathResponse { png }
    DrawPathOnMapResponse { png }
    CompareMapsResponse { png }
    ClusterShapes { clusters }
    EvaluateTrajectoryResponse { pairs }
    GetSceneGraphResponse { graph.nodes, graph.relations }
    GetRoomsResponse { rooms, doors, places, links }
    GetVoxelsResponse { blocks }
    QueryPointsResponse { points }
    CastRaysResponse { rays }
    CheckBoxesResponse { boxes }
    GetHeightsResponse { ground_m, sigma_m, top_m, slope_rad, step_m, roughness_m, traversability, is_drop }
    GetMeshResponse { positions, normals, colours, triangles, draco }
    GetChangesResponse { regions }
}

impl InParts for v1::RunPipelineResponse {
    fn parts(mut self) -> Vec<Self> {
        let results: Vec<_> = std::mem::take(&mut self.results).into_iter().flat_map(InParts::parts).collect();
        let cloud = self.cloud.take();
        let mut cut = Cut { parts: vec![self], room: PART_BYTES };
        cut.add(results.pieces(), |part, piece| part.results = piece);
        cut.add(cloud.pieces(), |part, piece| part.cloud = piece);
        cut.parts
    }

    fn joined(mut parts: Vec<Self>) -> Self {
        let mut steps: Vec<Vec<v1::PipelineStepResult>> = vec![];
        for result in parts.iter_mut().flat_map(|p| std::mem::take(&mut p.results)) {
            match steps.last_mut() {
                Some(step) if step[0].step == result.step => step.push(result),
                _ => steps.push(vec![result]),
            }
        }
        let cloud = Divisible::whole(parts.iter_mut().map(|p| p.cloud.take()).collect());
        let head = parts.into_iter().next().unwrap_or_default();
        Self { results: steps.into_iter().map(InParts::joined).collect(), cloud, ..head }
    }
}

/// A file's parts are its chunks.
impl InParts for v1::ExportMapResponse {
    fn parts(self) -> Vec<Self> {
        let whole = self.chunk.unwrap_or_default();
        let chunks = maps::chunks_of_file(&whole.header.unwrap_or_default(), &whole.data);
        chunks.into_iter().map(|chunk| Self { chunk: Some(chunk) }).collect()
    }

    fn joined(parts: Vec<Self>) -> Self {
        let mut chunks: Vec<v1::FileChunk> = parts.into_iter().filter_map(|p| p.chunk).collect();
        let header = chunks.iter_mut().find_map(|c| c.header.take());
        let data = Divisible::whole(chunks.into_iter().map(|c| c.data).collect());
        Self { chunk: Some(v1::FileChunk { header, offset: 0, data }) }
    }
}

/// What an operation found, in the parts of the plain call.
impl InParts for v1::ReadOperationResultResponse {
    fn parts(self) -> Vec<Self> {
        let results = match self.result {
            Some(Outcome::ExportMap(answer)) => answer.parts().into_iter().map(Outcome::ExportMap).collect(),
            Some(Outcome::RunPipeline(answer)) => answer.parts().into_iter().map(Outcome::RunPipeline).collect(),
            result => Vec::from_iter(result),
        };
        results.into_iter().map(|result| Self { result: Some(result) }).collect()
    }

    fn joined(parts: Vec<Self>) -> Self {
        let (mut files, mut pipelines, mut other) = (vec![], vec![], None);
        for result in parts.into_iter().filter_map(|p| p.result) {
            match result {
                Outcome::ExportMap(part) => files.push(part),
                Outcome::RunPipeline(part) => pipelines.push(part),
                result => other = Some(result),
            }
        }
        let file = (!files.is_empty()).then(|| Outcome::ExportMap(InParts::joined(files)));
        let pipeline = (!pipelines.is_empty()).then(|| Outcome::RunPipeline(InParts::joined(pipelines)));
        Self { result: other.or(file).or(pipeline) }
    }
}

/// What a step found, by the kind of its answer.
macro_rules! by_answer {
    ($($kind:ident)+) => {
        impl InParts for v1::PipelineStepResult {
            fn parts(mut self) -> Vec<Self> {
                let step = self.step;
                let mut found: Vec<Found> = match self.answer.take() {
                    Some(Found::Indices(data)) => data.pieces().into_iter().map(|(_, b)| Found::Indices(b)).collect(),
                    $(Some(Found::$kind(answer)) => answer.parts().into_iter().map(Found::$kind).collect(),)+
                    Some(shape @ Found::Shape(_)) => vec![shape],
                    None => vec![],
                };
                let rest = if found.is_empty() { vec![] } else { found.split_off(1) };
                self.answer = found.pop();
                let part = |answer| Self { step, answer: Some(answer), ..Self::default() };
                std::iter::once(self).chain(rest.into_iter().map(part)).collect()
            }

            fn joined(mut parts: Vec<Self>) -> Self {
                let found: Vec<Found> = parts.iter_mut().filter_map(|p| p.answer.take()).collect();
                let answer = match found.first() {
                    Some(Found::Indices(_)) => {
                        let pieces = found.into_iter().filter_map(|f| if let Found::Indices(b) = f { Some(b) } else { None });
                        Some(Found::Indices(Divisible::whole(pieces.collect())))
                    }
                    $(Some(Found::$kind(_)) => {
                        let parts = found.into_iter().filter_map(|f| if let Found::$kind(a) = f { Some(a) } else { None });
                        Some(Found::$kind(InParts::joined(parts.collect())))
                    })+
                    Some(Found::Shape(_)) | None => found.into_iter().next(),
                };
                Self { answer, ..parts.into_iter().next().unwrap_or_default() }
            }
        }
    };
}

by_answer!(Planes Clusters Shapes Detections Ground Regions Objects);

#[cfg(test)]
mod tests {
    use super::*;

    /// What gRPC clients take that were told nothing.
    const DEFAULT_LIMIT: usize = 4 << 20;

    fn bytes(len: usize) -> Bytes {
        (0..len).map(|i| (i % 251) as u8).collect::<Vec<u8>>().into()
    }

    fn cloud(n: usize) -> v1::PointCloud {
        v1::PointCloud {
            num_points: n as u32,
            positions: bytes(12 * n),
            colours: Some(bytes(3 * n)),
            intensities: None,
            normals: Some(bytes(12 * n)),
            time_offsets_s: Some(bytes(4 * n)),
        }
    }

    fn there_and_back<T: InParts + Message + Clone + PartialEq + Default>(whole: &T, at_least: usize) -> Vec<T> {
        let parts = whole.clone().parts();
        assert!(parts.len() >= at_least, "{} parts", parts.len());
        assert!(parts.iter().all(|p| p.encoded_len() < DEFAULT_LIMIT));
        assert!(T::joined(parts.clone()) == *whole);
        parts
    }

    #[test]
    fn small_answers_are_one_part() {
        there_and_back(&v1::RemoveNonFiniteResponse::default(), 1);
        let small = v1::CropCloudResponse { cloud: Some(cloud(3)), indices: bytes(12), kept: None };
        assert_eq!(there_and_back(&small, 1).len(), 1);
        let empty = v1::CropCloudResponse { cloud: Some(cloud(0)), ..Default::default() };
        assert_eq!(there_and_back(&empty, 1).len(), 1);
    }

    #[test]
    fn parts_of_a_cloud_are_clouds_and_arrays_go_on_by_whole_rows() {
        let n = 1_000_003;
        let large = v1::CropCloudResponse { cloud: Some(cloud(n)), indices: bytes(4 * n), kept: None };
        let parts = there_and_back(&large, 8);
        for cloud in parts.iter().filter_map(|p| p.cloud.as_ref()) {
            assert_eq!(cloud.positions.len(), 12 * cloud.num_points as usize);
            assert_eq!(cloud.colours.as_ref().map(Bytes::len), Some(3 * cloud.num_points as usize));
        }
        let features = v1::ComputePointFeaturesResponse { features: bytes(132 * 100_000) };
        assert!(there_and_back(&features, 8).iter().all(|p| p.features.len() % 132 == 0));
    }

    #[test]
    fn a_small_last_piece_takes_no_others_place() {
        // A cloud's pieces have some 52,000 points, a list's some 202,000 relations.
        for rest in [1, 700, 20_000] {
            let large = v1::TransformCloudResponse { cloud: Some(cloud(150_000 + rest)), kept: None };
            there_and_back(&large, 3);
            let one = v1::PosePair { stamp_ns: 1, ..Default::default() };
            let pairs = v1::EvaluateTrajectoryResponse { metrics: None, pairs: vec![one; 500_000 + rest] };
            there_and_back(&pairs, 3);
            let bytes = v1::GrowRegionsResponse { labels: bytes(4_000_000 + 4 * rest), num_regions: 3 };
            there_and_back(&bytes, 3);
        }
    }

    #[test]
    fn what_is_said_once_stands_in_the_first_part() {
        let depth = v1::DepthImage { width_px: 2000, height_px: 1000, data: bytes(8_000_000), ..Default::default() };
        let parts = there_and_back(&v1::FilterDepthResponse { depth: Some(depth) }, 4);
        assert_eq!(parts[0].depth.as_ref().map(|d| d.width_px), Some(2000));
        assert_eq!(parts[1].depth.as_ref().map(|d| d.width_px), Some(0));
    }

    #[test]
    fn an_operations_result_has_the_parts_of_the_plain_call() {
        let header = v1::FileHeader { size_bytes: 9_000_001, sha256: "0".repeat(64), ..Default::default() };
        let file = v1::FileChunk { header: Some(header), offset: 0, data: bytes(9_000_001) };
        let export = v1::ExportMapResponse { chunk: Some(file) };
        let pipeline = v1::RunPipelineResponse { cloud: Some(cloud(200_000)), ..Default::default() };
        let optimised = v1::OptimiseMapResponse { num_keyframes_moved: 3, map_version: 7 };
        let of = |result| v1::ReadOperationResultResponse { result: Some(result) };
        let parts = there_and_back(&of(Outcome::ExportMap(export.clone())), 3);
        assert!(parts == export.parts().into_iter().map(|p| of(Outcome::ExportMap(p))).collect::<Vec<_>>());
        let offset = |p: &v1::ReadOperationResultResponse| match &p.result {
            Some(Outcome::ExportMap(part)) => part.chunk.as_ref().map(|c| c.offset),
            _ => None,
        };
        assert_eq!(offset(&parts[2]), Some(2 << 20), "a chunk names its place");
        there_and_back(&of(Outcome::RunPipeline(pipeline)), 3);
        assert_eq!(there_and_back(&of(Outcome::OptimiseMap(optimised)), 1).len(), 1);
    }

    #[test]
    fn a_steps_answer_goes_on_under_its_number() {
        let planes = v1::SegmentPlanesResponse {
            planes: vec![v1::PlaneSegment { num_points: 7, ..Default::default() }; 3],
            labels: bytes(6_000_000),
        };
        let result = |step, answer| v1::PipelineStepResult { step, num_points_in: 9, answer, ..Default::default() };
        let whole = v1::RunPipelineResponse {
            results: vec![
                result(0, Some(Found::Indices(bytes(5_000_000)))),
                result(1, None),
                result(2, Some(Found::Planes(planes))),
            ],
            cloud: Some(cloud(200_000)),
            kept: None,
        };
        there_and_back(&whole, 8);
        let graph = v1::SceneGraph { relations: vec![v1::Relation::default(); 1_000_000], ..Default::default() };
        there_and_back(&v1::GetSceneGraphResponse { graph: Some(graph) }, 2);
    }
}
