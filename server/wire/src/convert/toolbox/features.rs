//! Features of images: parameters of requests, and answers.

use crate::convert::unknown_enum;
use crate::v1;
use bytes::Bytes;
use percept_perception::features2d::{
    Descriptors, FeatureMatch, Features, Keypoint, MatchParams, OrbParams, SiftParams,
};
use percept_service::toolbox::FeatureMethod;
use percept_service::{Error, Result};

const BINARY_BYTES: usize = 32;
const NUMBER_BYTES: usize = 128;

/// How features are found.
///
/// # Errors
/// `ENUM_UNKNOWN`, `OUT_OF_RANGE` naming `fast_threshold`.
pub fn method(r: &v1::ExtractFeaturesRequest) -> Result<FeatureMethod> {
    use v1::FeatureMethod as M;
    match M::try_from(r.method) {
        Ok(M::Unspecified | M::Orb) => {
            let mut params = OrbParams::default();
            lay_over!(params, r: max_features, num_levels, scale_factor);
            if let Some(value) = r.fast_threshold {
                let words = format!("fast_threshold is {value}; it must be within 1 to 254");
                params.fast_threshold =
                    u8::try_from(value).map_err(|_| Error::invalid("OUT_OF_RANGE", "fast_threshold", words))?;
            }
            Ok(FeatureMethod::Orb(params))
        }
        Ok(M::Sift) => {
            let mut params = SiftParams { root: r.root, ..SiftParams::default() };
            lay_over!(params, r: max_features, contrast_threshold, edge_threshold);
            Ok(FeatureMethod::Sift(params))
        }
        Err(_) => Err(unknown_enum("method", r.method)),
    }
}

/// Features as a message.
pub fn features_to(f: &Features) -> v1::ExtractFeaturesResponse {
    let floats = |of: fn(&Keypoint) -> f32| -> Bytes {
        f.keypoints.iter().flat_map(|k| of(k).to_le_bytes()).collect::<Vec<u8>>().into()
    };
    let points: Vec<u8> = f.keypoints.iter().flat_map(|k| [k.u, k.v]).flat_map(f32::to_le_bytes).collect();
    let octaves: Vec<u8> = f.keypoints.iter().flat_map(|k| k.octave.to_le_bytes()).collect();
    let (descriptors, size): (Vec<u8>, usize) = match &f.descriptors {
        Descriptors::Binary(d) => (d.iter().flatten().flat_map(|word| word.to_le_bytes()).collect(), BINARY_BYTES),
        Descriptors::Bytes(d) => (d.as_flattened().to_vec(), NUMBER_BYTES),
    };
    v1::ExtractFeaturesResponse {
        points: points.into(),
        sizes_px: floats(|k| k.size_px),
        angles_rad: floats(|k| k.angle_rad),
        responses: floats(|k| k.response),
        octaves: octaves.into(),
        descriptors: descriptors.into(),
        descriptor_bytes: size as u32,
    }
}

/// Descriptors of a request, query and train.
///
/// # Errors
/// `SIZE_MISMATCH`, `OUT_OF_RANGE` naming `descriptor_bytes`.
pub fn descriptors(r: &v1::MatchFeaturesRequest) -> Result<(Descriptors, Descriptors)> {
    let read = |field: &'static str, data: &Bytes| match r.descriptor_bytes as usize {
        BINARY_BYTES => {
            let (rows, rest) = data.as_chunks::<BINARY_BYTES>();
            let word =
                |b: &[u8; BINARY_BYTES], i: usize| u64::from_le_bytes(std::array::from_fn(|byte| b[8 * i + byte]));
            whole(field, rest)?;
            Ok(Descriptors::Binary(rows.iter().map(|b| std::array::from_fn(|i| word(b, i))).collect()))
        }
        NUMBER_BYTES => {
            let (rows, rest) = data.as_chunks::<NUMBER_BYTES>();
            whole(field, rest)?;
            Ok(Descriptors::Bytes(rows.to_vec()))
        }
        other => {
            let words = format!("descriptor_bytes is {other}; it must be 32 (bits) or 128 (numbers)");
            Err(Error::invalid("OUT_OF_RANGE", "descriptor_bytes", words))
        }
    };
    Ok((read("query", &r.query)?, read("train", &r.train)?))
}

fn whole(field: &'static str, rest: &[u8]) -> Result<()> {
    if rest.is_empty() {
        return Ok(());
    }
    let words = format!("{field} ends with {} bytes of a descriptor; send whole ones", rest.len());
    Err(Error::invalid("SIZE_MISMATCH", field, words))
}

/// How matches are decided.
pub fn match_params(r: &v1::MatchFeaturesRequest) -> MatchParams {
    let mut params = MatchParams { mutual: r.mutual, max_distance: r.max_distance, ..MatchParams::default() };
    lay_over!(params, r: ratio);
    params
}

/// Matches as a message.
pub fn matches_to(all: &[FeatureMatch]) -> v1::MatchFeaturesResponse {
    let pairs: Vec<u8> = all.iter().flat_map(|m| [m.query_index, m.train_index]).flat_map(u32::to_le_bytes).collect();
    let distances: Vec<u8> = all.iter().flat_map(|m| m.distance.to_le_bytes()).collect();
    v1::MatchFeaturesResponse { pairs: pairs.into(), distances: distances.into() }
}
