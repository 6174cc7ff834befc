//! Kept clouds: decode, call, encode.

use super::super::maps::sha256_hex;
use super::super::{Answer, Api, Streamed, status, streamed};
use futures::{Stream, StreamExt};
use percept_service::toolbox::{Toolbox, suffix};
use percept_service::{Error, Limits, Result};
use percept_wire::convert::toolbox::{self as convert, files};
use percept_wire::convert::{geometry, maps, required};
use percept_wire::v1;
use std::pin::pin;
use std::sync::Arc;
use tonic::{Request, Response, Status, Streaming};

const RULE: &str = "ToolboxKeptCloudsService/*";

#[tonic::async_trait]
impl v1::toolbox_kept_clouds_service_server::ToolboxKeptCloudsService for Api {
    type ListCloudsStream = Streamed<v1::ListCloudsResponse>;
    type DownloadCloudStream = Streamed<v1::DownloadCloudResponse>;

    async fn upload_cloud(&self, r: Request<v1::UploadCloudRequest>) -> Answer<v1::UploadCloudResponse> {
        self.toolbox(RULE, r, upload_cloud).await
    }

    async fn upload_large_cloud(
        &self,
        r: Request<Streaming<v1::UploadLargeCloudRequest>>,
    ) -> Answer<v1::UploadLargeCloudResponse> {
        let caller = self.caller(&r)?;
        caller.may(RULE).map_err(status::grpc)?;
        let upload = received(r.into_inner(), caller.limits()).await?;
        let kept = caller.toolbox(RULE, vec![], move |t| upload_large_cloud(t, upload)).await;
        kept.map(Response::new).map_err(status::grpc)
    }

    async fn list_clouds(&self, r: Request<v1::ListCloudsRequest>) -> Answer<Self::ListCloudsStream> {
        self.toolbox_in_parts(RULE, r, |t, _| Ok(convert::kept_list_to(&t.list_kept()))).await
    }

    async fn download_cloud(&self, r: Request<v1::DownloadCloudRequest>) -> Answer<Self::DownloadCloudStream> {
        streamed(self.toolbox(RULE, r, download_cloud).await?.into_inner(), |part| part)
    }

    async fn drop_cloud(&self, r: Request<v1::DropCloudRequest>) -> Answer<v1::DropCloudResponse> {
        self.toolbox(RULE, r, drop_cloud).await
    }
}

fn upload_cloud(t: &Toolbox, r: v1::UploadCloudRequest) -> Result<v1::UploadCloudResponse> {
    use v1::cloud_source::Source;
    let (cloud, origin_m) = match r.cloud.as_ref().and_then(|s| s.source.as_ref()) {
        Some(Source::File(file)) => {
            let (cloud, origin_m) = files::decoded(Some(file), t.limits()).map_err(|e| e.within("cloud"))?;
            (Arc::new(cloud), origin_m)
        }
        _ => (convert::cloud(t, "cloud", r.cloud.as_ref())?, v1::Vector3::default()),
    };
    let kept = convert::kept_to(&t.keep(cloud, r.keep_s)?);
    Ok(v1::UploadCloudResponse { kept: Some(kept), origin_m: Some(origin_m) })
}

/// Parts of an upload, as they came.
#[derive(Default)]
struct Upload {
    points: Vec<v1::PointCloud>,
    file: Vec<u8>,
    format: i32,
    keep_s: Option<f64>,
}

/// Takes the parts of a large cloud, never more than the limit allows.
///
/// # Errors
/// `UPLOAD_TOO_LARGE`, `UPLOAD_MIXED`; `FIELD_MISSING` for a stream without a part.
async fn received(
    parts: impl Stream<Item = std::result::Result<v1::UploadLargeCloudRequest, Status>>,
    limits: &Limits,
) -> std::result::Result<Upload, Status> {
    use v1::upload_large_cloud_request::Part;
    let mut parts = pin!(parts);
    let (mut upload, mut size, mut first) = (Upload::default(), 0, true);
    while let Some(message) = parts.next().await {
        let message = message?;
        if std::mem::take(&mut first) {
            (upload.format, upload.keep_s) = (message.format, message.keep_s);
        }
        size += prost::Message::encoded_len(&message);
        if size > limits.max_upload_bytes {
            let limit = limits.max_upload_bytes;
            let words = format!("the upload has more than {limit} bytes, the limit; downsample the cloud");
            return Err(status::grpc(Error::exhausted("UPLOAD_TOO_LARGE", "", words)));
        }
        match required("part", message.part).map_err(status::grpc)? {
            Part::Points(points) => upload.points.push(points),
            Part::Data(data) => upload.file.extend_from_slice(&data),
        }
    }
    if first {
        required::<()>("part", None).map_err(status::grpc)?;
    }
    if !upload.points.is_empty() && !upload.file.is_empty() {
        let words = "the upload mixes points and data; send one kind";
        return Err(status::grpc(Error::invalid("UPLOAD_MIXED", "part", words)));
    }
    Ok(upload)
}

fn upload_large_cloud(t: &Toolbox, upload: Upload) -> Result<v1::UploadLargeCloudResponse> {
    let (cloud, origin_m) = if upload.points.is_empty() {
        let file = v1::CloudFile { data: upload.file.into(), format: upload.format };
        files::decoded(Some(&file), t.limits())?
    } else {
        let cloud = geometry::cloud(&geometry::joined(&upload.points), t.limits()).map_err(|e| e.within("points"))?;
        (cloud, v1::Vector3::default())
    };
    let kept = convert::kept_to(&t.keep(cloud, upload.keep_s)?);
    Ok(v1::UploadLargeCloudResponse { kept: Some(kept), origin_m: Some(origin_m) })
}

fn drop_cloud(t: &Toolbox, r: v1::DropCloudRequest) -> Result<v1::DropCloudResponse> {
    t.drop_kept(&r.handle)?;
    Ok(v1::DropCloudResponse {})
}

fn download_cloud(t: &Toolbox, r: v1::DownloadCloudRequest) -> Result<Vec<v1::DownloadCloudResponse>> {
    let cloud = t.kept("handle", &r.handle)?;
    let Some(format) = files::format("format", r.format)? else {
        let total = Some(cloud.len() as u64);
        let part = |(i, cloud)| v1::DownloadCloudResponse {
            chunk: None,
            points: Some(v1::CloudChunk {
                stamp: None,
                total_points: total.filter(|_| i == 0),
                cloud: Some(cloud),
                voxel_size_m: None,
            }),
        };
        return Ok(geometry::cloud_parts(&cloud).into_iter().enumerate().map(part).collect());
    };
    let data = files::encoded(&cloud, None, r.format)?.data;
    let header = v1::FileHeader {
        stamp: None,
        file_name: format!("{}.{}", r.handle, suffix(format)),
        media_type: "application/octet-stream".to_owned(),
        size_bytes: data.len() as u64,
        sha256: sha256_hex(&data),
    };
    let part = |chunk| v1::DownloadCloudResponse { chunk: Some(chunk), points: None };
    Ok(maps::chunks_of_file(&header, &data).into_iter().map(part).collect())
}
