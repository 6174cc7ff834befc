//! Where data live, read from a text: a path, `file://`, `memory://` or `s3://`.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use object_store::aws::AmazonS3Builder;
use object_store::memory::InMemory;
use object_store::path::Path;
use object_store::prefix::PrefixStore;
use object_store::{ClientOptions, ObjectStore, RetryConfig};

use crate::error::{StoreError, shortened};

/// Where the data live.
#[derive(Debug, Clone)]
pub enum Location {
    /// A local directory; made if it is not there.
    Directory(PathBuf),
    /// Any object store whose create (`PutMode::Create`) is atomic; the fence rests on it.
    Objects(Arc<dyn ObjectStore>),
    /// The same over a network: always shared, and tried at the first opening whether its create is atomic.
    Bucket(Arc<dyn ObjectStore>),
}

/// What an `s3://` location needs beside its name. Credentials come from the environment (`AWS_ACCESS_KEY_ID`,
/// `AWS_SECRET_ACCESS_KEY`, `AWS_SESSION_TOKEN`), a web identity, or the instance or container that this runs on.
#[derive(Debug, Clone, Default)]
pub struct S3Options {
    /// Address of a service other than Amazon's, e.g. `https://s3.site.example:9000`; the bucket becomes the first
    /// part of the path. Default: `AWS_ENDPOINT_URL`, else Amazon's.
    pub endpoint: Option<String>,
    /// Default: `AWS_REGION`, else `us-east-1`.
    pub region: Option<String>,
    /// Permits an endpoint without TLS.
    pub allow_http: bool,
}

impl Location {
    /// Reads a location: a path, `file:///path`, `memory://`, or `s3://bucket/prefix`.
    ///
    /// # Errors
    /// [`StoreError::InvalidLocation`].
    pub fn parse(text: &str, s3: &S3Options) -> Result<Self, StoreError> {
        let invalid = |requirement| StoreError::InvalidLocation { text: shortened(text), requirement };
        let Some((scheme, rest)) = text.split_once("://") else {
            return if text.is_empty() { Err(invalid("not empty")) } else { Ok(Self::Directory(text.into())) };
        };
        match scheme {
            "file" if rest.starts_with('/') => Ok(Self::Directory(rest.into())),
            "file" => Err(invalid("of the form file:///absolute/path")),
            "memory" if rest.is_empty() => Ok(Self::Objects(Arc::new(InMemory::new()))),
            "memory" => Err(invalid("just memory://")),
            "s3" => bucket(rest, s3).map_err(|()| invalid("of the form s3://bucket/prefix, with a reachable endpoint")),
            _ => Err(invalid("a path, file:///path, s3://bucket/prefix or memory://")),
        }
    }
}

fn bucket(rest: &str, options: &S3Options) -> Result<Location, ()> {
    let (name, prefix) = rest.split_once('/').unwrap_or((rest, ""));
    let prefix = Path::parse(prefix).map_err(|_| ())?;
    if name.is_empty() {
        return Err(());
    }
    // The first to come decides for the whole process; it is ring everywhere here.
    let _ = rustls::crypto::ring::default_provider().install_default();
    let client =
        ClientOptions::default().with_connect_timeout(Duration::from_secs(5)).with_timeout(Duration::from_secs(30));
    // SlateDB and the callers try again by themselves, and a lease does not wait for three minutes.
    let retry = RetryConfig { max_retries: 3, retry_timeout: Duration::from_secs(20), ..RetryConfig::default() };
    let mut builder = AmazonS3Builder::from_env().with_bucket_name(name).with_client_options(client).with_retry(retry);
    if let Some(endpoint) = &options.endpoint {
        builder = builder.with_endpoint(endpoint).with_virtual_hosted_style_request(false);
    }
    if let Some(region) = &options.region {
        builder = builder.with_region(region);
    }
    let objects = builder.with_allow_http(options.allow_http).build().map_err(|error| {
        tracing::error!(%error, "cannot use this S3 location");
    })?;
    Ok(Location::Bucket(Arc::new(PrefixStore::new(objects, prefix))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn locations_are_told_apart() {
        let s3 =
            S3Options { endpoint: Some("http://127.0.0.1:9".to_owned()), allow_http: true, ..S3Options::default() };
        let parse = |text: &str| Location::parse(text, &s3);
        assert!(matches!(parse("data"), Ok(Location::Directory(path)) if path.as_os_str() == "data"));
        assert!(matches!(parse("file:///var/lib/x y"), Ok(Location::Directory(path)) if path.is_absolute()));
        assert!(matches!(parse("memory://"), Ok(Location::Objects(_))));
        for bucket in ["s3://robots", "s3://robots/", "s3://robots/site/7"] {
            assert!(matches!(parse(bucket), Ok(Location::Bucket(_))), "{bucket}");
        }
        for bad in ["", "file://data", "memory://x", "s3://", "s3:///x", "s3://robots/a//b", "ftp://x", "gs://x"] {
            let error = parse(bad).unwrap_err();
            assert!(matches!(error, StoreError::InvalidLocation { .. }), "{bad}: {error}");
        }
    }
}
