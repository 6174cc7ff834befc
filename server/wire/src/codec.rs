//! Reads gRPC messages that do not swell too far; see [`crate::expansion`].

use crate::expansion;
use percept_service::reason;
use prost::{Message, Name};
use std::collections::HashMap;
use std::marker::PhantomData;
use tonic::codec::{BufferSettings, Codec, DecodeBuf, Decoder};
use tonic::{Code, Status};
use tonic_prost::{ProstCodec, ProstDecoder, ProstEncoder};
use tonic_types::{ErrorDetails, StatusExt};

/// Domain of our reasons in `google.rpc.ErrorInfo`.
pub const DOMAIN: &str = "percept";

/// As prost's codec, but for what would take far more memory than it has bytes.
#[derive(Debug, Clone)]
pub struct BoundedCodec<E, D>(PhantomData<(E, D)>);

impl<E, D> Default for BoundedCodec<E, D> {
    fn default() -> Self {
        Self(PhantomData)
    }
}

impl<E, D> Codec for BoundedCodec<E, D>
where
    E: Message + Send + 'static,
    D: Message + Name + Default + Send + 'static,
{
    type Encode = E;
    type Decode = D;
    type Encoder = ProstEncoder<E>;
    type Decoder = BoundedDecoder<D>;

    fn encoder(&mut self) -> Self::Encoder {
        ProstCodec::<E, D>::raw_encoder(BufferSettings::default())
    }

    fn decoder(&mut self) -> Self::Decoder {
        BoundedDecoder(ProstCodec::<E, D>::raw_decoder(BufferSettings::default()))
    }
}

/// The reading half.
#[derive(Debug, Clone)]
pub struct BoundedDecoder<D>(ProstDecoder<D>);

impl<D: Message + Name + Default> Decoder for BoundedDecoder<D> {
    type Item = D;
    type Error = Status;

    fn decode(&mut self, buffer: &mut DecodeBuf<'_>) -> Result<Option<D>, Status> {
        // All of the message: the transport hands out whole ones only.
        expansion::check(&D::full_name(), bytes::Buf::chunk(buffer)).map_err(|error| {
            let details = ErrorDetails::with_error_info(reason::MESSAGE_EXPANDS, DOMAIN, HashMap::new());
            Status::with_error_details(Code::InvalidArgument, error.message, details)
        })?;
        self.0.decode(buffer)
    }
}
