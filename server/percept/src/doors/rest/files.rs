//! Maps as files: entity tags, ranges, digests.

use super::super::grpc::Api;
use super::range::{self, Asked};
use super::refused::Refused;
use super::{calls, transcode};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use percept_service::reason;
use percept_service::{Asker, CallContext, Error};
use percept_wire::parts::InParts;
use percept_wire::v1::{self, MapFormat};
use prost::Message;
use prost_reflect::MessageDescriptor;
use sha2::{Digest, Sha256};
use v1::maps_service_server::MapsService;
use v1::operations_service_server::OperationsService;
use v1::read_operation_result_response::Result as Outcome;

/// Names of files and the formats that they are.
pub(super) const FILES: [(&str, MapFormat); 25] = [
    ("occupancy.png", MapFormat::OccupancyPng),
    ("map.pgm", MapFormat::Nav2Pgm),
    ("map.yaml", MapFormat::Nav2Yaml),
    ("cloud.ply", MapFormat::CloudPly),
    ("cloud.pcd", MapFormat::CloudPcd),
    ("cloud.las", MapFormat::CloudLas),
    ("cloud.laz", MapFormat::CloudLaz),
    ("cloud.glb", MapFormat::CloudGlb),
    ("cloud.drc", MapFormat::CloudDraco),
    ("voxels.bt", MapFormat::VoxelsBt),
    ("voxels.ot", MapFormat::VoxelsOt),
    ("occupancy.tif", MapFormat::OccupancyTiff),
    ("occupancy.pgw", MapFormat::OccupancyPgw),
    ("mesh.ply", MapFormat::MeshPly),
    ("mesh.glb", MapFormat::MeshGlb),
    ("mesh.drc", MapFormat::MeshDraco),
    ("trajectory.tum", MapFormat::TrajectoryTum),
    ("overview.png", MapFormat::OverviewPng),
    ("cloud.png", MapFormat::CloudTopPng),
    ("cloud-view.png", MapFormat::CloudViewPng),
    ("mesh-view.png", MapFormat::MeshViewPng),
    ("voxels-view.png", MapFormat::VoxelsViewPng),
    ("heights.png", MapFormat::HeightsPng),
    ("traversability.png", MapFormat::TraversabilityPng),
    ("layers.png", MapFormat::LayersPng),
];

/// A message that begins with a picture.
#[derive(Message)]
struct Pictured {
    #[prost(bytes = "bytes", tag = "1")]
    png: Bytes,
}

/// The picture in an answer whose first field it is.
///
/// # Errors
/// `INTERNAL` if it has none.
pub(super) fn picture(answer: Vec<u8>) -> Result<Response, Error> {
    let Pictured { png } = Pictured::decode(Bytes::from(answer)).map_err(Error::internal)?;
    Ok(([(header::CONTENT_TYPE, "image/png"), (header::CACHE_CONTROL, "no-cache")], png).into_response())
}

const MAP_VERSION: HeaderName = HeaderName::from_static("percept-map-version");
const CONTENT_DIGEST: HeaderName = HeaderName::from_static("content-digest");
const REPR_DIGEST: HeaderName = HeaderName::from_static("repr-digest");

struct File {
    name: String,
    media_type: HeaderValue,
    map_version: u64,
    bytes: Bytes,
    sha256: [u8; 32],
}

/// `ExportMap` of the session in `request`, in the format that `name` stands for.
///
/// # Errors
/// `FILE_NOT_FOUND`, `RANGE_NOT_SATISFIABLE` (416), and those of the rpc.
pub(super) async fn export(
    api: &Api,
    context: CallContext,
    request: Bytes,
    name: &str,
    headers: &HeaderMap,
) -> Result<Response, Refused> {
    let mut request = v1::ExportMapRequest::decode(request).map_err(Error::internal)?;
    let Some((_, format)) = FILES.iter().find(|(n, _)| *n == name) else {
        let known: Vec<&str> = FILES.iter().map(|f| f.0).collect();
        let shown: String = name.chars().take(80).collect();
        let message = format!("name is {shown:?}; there are {}", known.join(", "));
        return Err(Error::not_found(reason::FILE_NOT_FOUND, "name", message).into());
    };
    request.format = (*format).into();
    let compute = api.service.compute().clone();
    let session = request.source.as_ref().and_then(|s| s.source.clone());
    let session = session.map_or_else(String::new, |v1::map_source::Source::SessionId(id)| id);
    let parts = calls::collect(api.export_map(calls::asked(context, request)).await?.into_inner()).await?;
    let (name, format, headers) = (name.to_owned(), *format, headers.clone());
    let work = move || answer(&joined(&name, format, parts)?, &headers);
    compute.query(&Asker::named(session), work).await?
}

/// What an operation found: a file if it is one, unless a message is asked for; else the message.
///
/// # Errors
/// `RANGE_NOT_SATISFIABLE` (416), and those of the rpc.
pub(super) async fn result(
    api: &Api,
    context: CallContext,
    request: Bytes,
    output: MessageDescriptor,
    headers: &HeaderMap,
) -> Result<Response, Refused> {
    let request = v1::ReadOperationResultRequest::decode(request).map_err(Error::internal)?;
    let asker = Asker::named(context.principal.tenant.as_str());
    let compute = api.service.compute().clone();
    let stream = api.read_operation_result(calls::asked(context, request)).await?.into_inner();
    let parts = calls::collect(stream).await?;
    let result = compute.query(&asker, move || v1::ReadOperationResultResponse::joined(parts)).await?;
    match result.result {
        Some(Outcome::ExportMap(export)) if !transcode::wants_message(headers) => {
            let (chunk, headers) = (export.chunk.unwrap_or_default(), headers.clone());
            let name = chunk.header.as_ref().map(|h| h.file_name.clone()).unwrap_or_default();
            compute.query(&asker, move || answer(&file(name, chunk)?, &headers)).await?
        }
        result => {
            let answer = v1::ReadOperationResultResponse { result }.encode_to_vec();
            transcode::encode(output, headers, answer).await
        }
    }
}

fn joined(name: &str, format: MapFormat, parts: Vec<v1::ExportMapResponse>) -> Result<File, Error> {
    let mut whole = v1::ExportMapResponse::joined(parts).chunk.unwrap_or_default();
    if format == MapFormat::Nav2Yaml {
        whole.data = with_our_image(&whole.data).into();
        // The rpc's own digest is of the file before it was changed here.
        whole.header.get_or_insert_default().sha256.clear();
    }
    file(name.to_owned(), whole)
}

/// A file of its one chunk.
fn file(name: String, chunk: v1::FileChunk) -> Result<File, Error> {
    let (head, bytes) = (chunk.header.unwrap_or_default(), chunk.data);
    let sha256 = digest_of(&head.sha256).unwrap_or_else(|| Sha256::digest(&bytes).into());
    let media_type = head.media_type.parse().map_err(Error::internal)?;
    let map_version = head.stamp.map(|s| s.map_version).unwrap_or_default();
    Ok(File { name, media_type, map_version, bytes, sha256 })
}

/// A digest of lower-case hex.
fn digest_of(hex: &str) -> Option<[u8; 32]> {
    let mut digest = [0; 32];
    for (i, byte) in digest.iter_mut().enumerate() {
        *byte = u8::from_str_radix(hex.get(2 * i..2 * i + 2)?, 16).ok()?;
    }
    (hex.len() == 64).then_some(digest)
}

/// The description names the image by the name that it has here.
fn with_our_image(yaml: &[u8]) -> Vec<u8> {
    let text = String::from_utf8_lossy(yaml);
    let line = |line: &str| if line.starts_with("image:") { "image: map.pgm\n".to_owned() } else { line.to_owned() };
    text.split_inclusive('\n').map(line).collect::<String>().into_bytes()
}

fn answer(file: &File, headers: &HeaderMap) -> Result<Response, Refused> {
    let text = |name: HeaderName| headers.get(name).and_then(|v| v.to_str().ok());
    let tag = format!("\"{}\"", file.sha256.iter().map(|b| format!("{b:02x}")).collect::<String>());
    let mut response = if text(header::IF_NONE_MATCH).is_some_and(|list| range::holds(list, &tag)) {
        StatusCode::NOT_MODIFIED.into_response()
    } else {
        // A part of another version is of no use to who holds the rest of this one.
        let same = text(header::IF_RANGE).is_none_or(|t| t == tag);
        let size = file.bytes.len();
        match range::asked(text(header::RANGE).filter(|_| same), size) {
            Asked::Whole => content(file, StatusCode::OK, file.bytes.clone(), &file.sha256),
            Asked::Part(part) => {
                let bytes = file.bytes.slice(part.clone());
                let digest = Sha256::digest(&bytes).into();
                let mut response = content(file, StatusCode::PARTIAL_CONTENT, bytes, &digest);
                let place = format!("bytes {}-{}/{size}", part.start, part.end - 1);
                put(&mut response, header::CONTENT_RANGE, &place);
                response
            }
            Asked::Unsatisfiable => {
                let message = format!("the file has {size} bytes; ask for a range within them");
                let refused = Refused::http(StatusCode::RANGE_NOT_SATISFIABLE, reason::RANGE_NOT_SATISFIABLE, message);
                return Err(refused.with(header::CONTENT_RANGE, &format!("bytes */{size}")));
            }
        }
    };
    put(&mut response, header::ETAG, &tag);
    put(&mut response, header::CACHE_CONTROL, "no-cache");
    put(&mut response, MAP_VERSION, &file.map_version.to_string());
    Ok(response)
}

fn content(file: &File, status: StatusCode, bytes: Bytes, digest: &[u8; 32]) -> Response {
    let mut response = (status, bytes).into_response();
    response.headers_mut().insert(header::CONTENT_TYPE, file.media_type.clone());
    let manner = if file.name.ends_with(".png") { "inline" } else { "attachment" };
    put(&mut response, header::CONTENT_DISPOSITION, &format!("{manner}; filename=\"{}\"", file.name));
    put(&mut response, header::ACCEPT_RANGES, "bytes");
    put(&mut response, CONTENT_DIGEST, &format!("sha-256=:{}:", base64(digest)));
    put(&mut response, REPR_DIGEST, &format!("sha-256=:{}:", base64(&file.sha256)));
    response
}

fn put(response: &mut Response, name: HeaderName, value: &str) {
    if let Ok(value) = value.parse() {
        response.headers_mut().insert(name, value);
    }
}

/// RFC 4648, section 4.
fn base64(bytes: &[u8]) -> String {
    const ALPHABET: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let group = |three: &[u8]| {
        let bits = three.iter().enumerate().fold(0u32, |bits, (i, &b)| bits | u32::from(b) << (16 - 8 * i));
        let sign = move |i: usize| ALPHABET[(bits >> (18 - 6 * i)) as usize & 63] as char;
        let used = three.len() + 1;
        (0..4).map(move |i| if i < used { sign(i) } else { '=' })
    };
    bytes.chunks(3).flat_map(group).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn abc() -> File {
        let header = v1::FileHeader {
            media_type: "text/plain".to_owned(),
            stamp: Some(v1::MapStamp { map_version: 7, ..Default::default() }),
            ..Default::default()
        };
        let chunk = |header, offset, data: &'static [u8]| v1::ExportMapResponse {
            chunk: Some(v1::FileChunk { header, offset, data: Bytes::from_static(data) }),
        };
        let parts = vec![chunk(Some(header), 0, b"ab"), chunk(None, 2, b"c")];
        joined("trajectory.tum", MapFormat::TrajectoryTum, parts).unwrap()
    }

    /// SHA-256 of "abc": FIPS 180-4, example B.1.
    const ABC: &str = "\"ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad\"";

    fn asked(name: HeaderName, value: &str) -> HeaderMap {
        HeaderMap::from_iter([(name, value.parse().unwrap())])
    }

    #[test]
    fn the_tag_is_the_digest_and_a_known_file_is_not_sent_again() {
        let response = answer(&abc(), &HeaderMap::new()).unwrap();
        let headers = response.headers();
        assert_eq!((response.status(), &headers[header::ETAG]), (StatusCode::OK, &HeaderValue::from_static(ABC)));
        assert_eq!(headers["percept-map-version"], "7");
        assert_eq!(headers["content-digest"], "sha-256=:ungWv48Bz+pBQUDeXa4iI7ADYaOWF3qctBD/YfIAFa0=:");
        assert_eq!(headers[header::CONTENT_DISPOSITION], "attachment; filename=\"trajectory.tum\"");
        let again = answer(&abc(), &asked(header::IF_NONE_MATCH, ABC)).unwrap();
        assert_eq!(
            (again.status(), &again.headers()[header::ETAG]),
            (StatusCode::NOT_MODIFIED, &headers[header::ETAG])
        );
    }

    #[test]
    fn parts_are_sent_and_absent_ones_refused() {
        let part = answer(&abc(), &asked(header::RANGE, "bytes=1-")).unwrap();
        assert_eq!(part.status(), StatusCode::PARTIAL_CONTENT);
        assert_eq!(part.headers()[header::CONTENT_RANGE], "bytes 1-2/3");
        assert_ne!(part.headers()["content-digest"], part.headers()["repr-digest"]);
        let beyond = answer(&abc(), &asked(header::RANGE, "bytes=3-")).unwrap_err().into_response();
        assert_eq!(
            (beyond.status(), &beyond.headers()[header::CONTENT_RANGE]),
            (StatusCode::RANGE_NOT_SATISFIABLE, &HeaderValue::from_static("bytes */3"))
        );
        let mut other = asked(header::RANGE, "bytes=1-");
        other.insert(header::IF_RANGE, HeaderValue::from_static("\"old\""));
        assert_eq!(answer(&abc(), &other).unwrap().status(), StatusCode::OK);
    }

    #[test]
    fn every_format_has_one_name() {
        for number in 1..=FILES.len() as i32 {
            let named = FILES.iter().filter(|(_, f)| i32::from(*f) == number).count();
            assert_eq!(named, 1, "{number}");
        }
        assert!(MapFormat::try_from(FILES.len() as i32 + 1).is_err());
    }

    #[test]
    fn the_description_names_the_image_beside_it() {
        let yaml = with_our_image(b"image: robot.pgm\nmode: trinary\nresolution: 0.05\n");
        assert_eq!(yaml, b"image: map.pgm\nmode: trinary\nresolution: 0.05\n");
    }

    #[test]
    fn base64_is_as_the_standard_has_it() {
        // RFC 4648, section 10.
        for (plain, coded) in [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foobar", "Zm9vYmFy")] {
            assert_eq!(base64(plain.as_bytes()), coded);
        }
    }
}
