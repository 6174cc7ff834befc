//! The handlers of the gRPC door by the bytes of their messages: what a stream answers is joined into one message.

use super::super::grpc::Api;
use bytes::Bytes;
use futures::future::BoxFuture;
use futures::{Stream, StreamExt};
use percept_service::{CallContext, Error};
use percept_wire::convert::geometry;
use percept_wire::v1;
use prost::Message;
use std::pin::pin;
use tonic::Status;

/// An rpc from encoded request to encoded response.
pub(super) type Call = fn(Api, CallContext, Bytes) -> BoxFuture<'static, Result<Vec<u8>, Status>>;

/// A request of the rpc, in somebody's name.
pub(super) fn asked<M>(context: CallContext, message: M) -> tonic::Request<M> {
    let mut request = tonic::Request::new(message);
    request.extensions_mut().insert(context);
    request
}

/// A request of its bytes, which were checked before.
///
/// # Errors
/// `INTERNAL`.
pub(super) fn decode<M: Message + Default>(request: Bytes) -> Result<M, Error> {
    M::decode(request).map_err(Error::internal)
}

/// A unary rpc.
macro_rules! call {
    ($rpc:ident) => {{
        fn call(api: Api, context: CallContext, request: Bytes) -> BoxFuture<'static, Result<Vec<u8>, Status>> {
            Box::pin(async move {
                let answer = api.$rpc(asked(context, decode(request).map_err(status::grpc)?)).await?;
                Ok(answer.into_inner().encode_to_vec())
            })
        }
        call
    }};
}

/// A unary rpc of a kind.
macro_rules! unary {
    ($kind:ident $rpc:ident) => {
        Kind::$kind(call!($rpc))
    };
}

/// A unary rpc that answers with a session or a sensor.
macro_rules! tagged {
    ($rpc:ident, $answer:ident, $field:ident) => {{
        fn tag(answer: &[u8]) -> Option<String> {
            Some(v1::$answer::decode(answer).ok()?.$field?.etag)
        }
        Kind::Tagged(call!($rpc), tag)
    }};
}

/// A streaming rpc whose messages are joined by the function.
macro_rules! joined {
    ($rpc:ident, $join:expr) => {{
        fn call(api: Api, context: CallContext, request: Bytes) -> BoxFuture<'static, Result<Vec<u8>, Status>> {
            Box::pin(async move {
                let answer = api.$rpc(asked(context, decode(request).map_err(status::grpc)?)).await?;
                Ok($join(collect(answer.into_inner()).await?).encode_to_vec())
            })
        }
        Kind::Message(call)
    }};
}

/// A streaming rpc whose answer comes in parts.
macro_rules! parts {
    ($kind:ident $rpc:ident) => {{
        fn call(api: Api, context: CallContext, request: Bytes) -> BoxFuture<'static, Result<Vec<u8>, Status>> {
            Box::pin(async move {
                let answer = api.$rpc(asked(context, decode(request).map_err(status::grpc)?)).await?;
                Ok(InParts::joined(collect(answer.into_inner()).await?).encode_to_vec())
            })
        }
        Kind::$kind(call)
    }};
}

/// All messages of a stream.
pub(super) async fn collect<T>(stream: impl Stream<Item = Result<T, Status>>) -> Result<Vec<T>, Status> {
    let mut stream = pin!(stream);
    let mut all = vec![];
    while let Some(message) = stream.next().await {
        all.push(message?);
    }
    Ok(all)
}

pub(super) fn join_trajectory(parts: Vec<v1::GetTrajectoryResponse>) -> v1::GetTrajectoryResponse {
    let map_version = parts.first().map(|p| p.map_version).unwrap_or_default();
    let next_page_token = parts.last().map(|p| p.next_page_token.clone()).unwrap_or_default();
    let poses = parts.into_iter().flat_map(|p| p.poses).collect();
    v1::GetTrajectoryResponse { map_version, poses, next_page_token }
}

pub(super) fn join_grid(parts: Vec<v1::GetOccupancyGridResponse>) -> v1::GetOccupancyGridResponse {
    let mut chunks = parts.into_iter().filter_map(|p| p.chunk);
    let Some(mut whole) = chunks.next() else { return v1::GetOccupancyGridResponse::default() };
    let mut cells = whole.cells.to_vec();
    chunks.for_each(|c| cells.extend_from_slice(&c.cells));
    whole.cells = cells.into();
    v1::GetOccupancyGridResponse { chunk: Some(whole) }
}

pub(super) fn join_cloud(parts: Vec<v1::GetCloudResponse>) -> v1::GetCloudResponse {
    let (mut head, mut clouds, mut draco) = (None, vec![], vec![]);
    for part in parts {
        draco.extend_from_slice(&part.draco);
        let Some(mut chunk) = part.chunk else { continue };
        clouds.extend(chunk.cloud.take());
        head.get_or_insert(chunk);
    }
    let cloud = geometry::joined(&clouds);
    v1::GetCloudResponse { chunk: head.map(|head| v1::CloudChunk { cloud: Some(cloud), ..head }), draco: draco.into() }
}

pub(super) fn join_download(parts: Vec<v1::DownloadCloudResponse>) -> v1::DownloadCloudResponse {
    let (mut head, mut data, mut points) = (None, vec![], vec![]);
    for part in parts {
        points.extend(part.points);
        if let Some(chunk) = part.chunk {
            data.extend_from_slice(&chunk.data);
            head = head.or(chunk.header);
        }
    }
    let chunk = head.map(|header| v1::FileChunk { header: Some(header), offset: 0, data: data.into() });
    let parts =
        points.drain(..).map(|chunk| v1::GetCloudResponse { chunk: Some(chunk), ..Default::default() }).collect();
    v1::DownloadCloudResponse { chunk, points: join_cloud(parts).chunk }
}

pub(super) use {call, joined, parts, tagged, unary};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chunks_join_in_order_and_keep_their_head() {
        let chunk = |offset, cells: &'static [u8], stamp: Option<v1::MapStamp>| v1::GetOccupancyGridResponse {
            chunk: Some(v1::OccupancyGridChunk { stamp, geometry: None, offset, cells: Bytes::from_static(cells) }),
        };
        let stamp = v1::MapStamp { map_version: 3, ..Default::default() };
        let whole = join_grid(vec![chunk(0, b"ab", Some(stamp.clone())), chunk(2, b"c", None)]).chunk.unwrap();
        assert_eq!((&whole.cells[..], whole.stamp), (&b"abc"[..], Some(stamp)));
        let cloud = |n: u32, colours: Option<&'static [u8]>| v1::GetCloudResponse {
            chunk: Some(v1::CloudChunk {
                total_points: (n == 1).then_some(3),
                cloud: Some(v1::PointCloud {
                    num_points: n,
                    positions: vec![n as u8; 12 * n as usize].into(),
                    colours: colours.map(Bytes::from_static),
                    ..Default::default()
                }),
                ..Default::default()
            }),
            ..Default::default()
        };
        let whole = join_cloud(vec![cloud(1, Some(b"rgb")), cloud(2, Some(b"rgbrgb"))]).chunk.unwrap();
        let points = whole.cloud.unwrap();
        assert_eq!((whole.total_points, points.num_points, points.positions.len()), (Some(3), 3, 36));
        assert_eq!(points.colours.unwrap().len(), 9);
        assert_eq!(points.normals, None);
    }
}
