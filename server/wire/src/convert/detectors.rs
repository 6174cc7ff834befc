//! Learned detectors: specifications in, what there is out.

use super::{required, unknown_enum};
use crate::v1;
use percept_inference::{ChannelOrder, DetectorSpec, Fit, InputSpec, OutputLayout};
use percept_service::{DetectorInfo, DetectorOrigin, Error, Result, reason};

/// What is known of a model, as it was sent. Its bounds are checked by whoever loads the model.
///
/// # Errors
/// `FIELD_MISSING`, `ENUM_UNKNOWN`; `SIZE_MISMATCH` for a mean or deviation that is not of three channels.
pub fn spec(spec: Option<v1::DetectorSpec>) -> Result<DetectorSpec> {
    let sent = required("spec", spec)?;
    let layout = layout(sent.layout)?;
    let labels: Vec<&str> = sent.labels.iter().map(String::as_str).collect();
    let usual = DetectorSpec::new(&sent.name, &labels, layout);
    Ok(DetectorSpec {
        score_threshold: sent.score_threshold.unwrap_or(usual.score_threshold),
        iou_threshold: sent.iou_threshold.unwrap_or(usual.iou_threshold),
        input: sent.image_input.map(|input| image_input(&input)).transpose()?,
        ..usual
    })
}

fn layout(value: i32) -> Result<OutputLayout> {
    use v1::DetectorLayout as L;
    match L::try_from(value) {
        Ok(L::FastestDet) => Ok(OutputLayout::FastestDet),
        Ok(L::YoloV8) => Ok(OutputLayout::YoloV8),
        Ok(L::BoxesScores) => Ok(OutputLayout::BoxesScores),
        Ok(L::Unspecified) | Err(_) => Err(unknown_enum("spec.layout", value)),
    }
}

const fn layout_to(layout: OutputLayout) -> v1::DetectorLayout {
    match layout {
        OutputLayout::FastestDet => v1::DetectorLayout::FastestDet,
        OutputLayout::YoloV8 => v1::DetectorLayout::YoloV8,
        OutputLayout::BoxesScores => v1::DetectorLayout::BoxesScores,
    }
}

fn image_input(sent: &v1::ImageInput) -> Result<InputSpec> {
    let usual = InputSpec::default();
    let channel_order = match v1::ChannelOrder::try_from(sent.channel_order) {
        Ok(v1::ChannelOrder::Unspecified | v1::ChannelOrder::Rgb) => ChannelOrder::Rgb,
        Ok(v1::ChannelOrder::Bgr) => ChannelOrder::Bgr,
        Err(_) => return Err(unknown_enum("spec.image_input.channel_order", sent.channel_order)),
    };
    let fit = match v1::ImageFit::try_from(sent.fit) {
        Ok(v1::ImageFit::Unspecified | v1::ImageFit::Stretch) => Fit::Stretch,
        Ok(v1::ImageFit::Letterbox) => Fit::Letterbox,
        Err(_) => return Err(unknown_enum("spec.image_input.fit", sent.fit)),
    };
    let three = |field: &str, values: &[f64], usual: [f64; 3]| match *values {
        [] => Ok(usual),
        [a, b, c] => Ok([a, b, c]),
        _ => {
            let field = format!("spec.image_input.{field}");
            let words = format!("{field} has {} numbers; send three, one a channel, or none", values.len());
            Err(Error::invalid(reason::SIZE_MISMATCH, field, words))
        }
    };
    Ok(InputSpec {
        channel_order,
        fit,
        scale: sent.scale.unwrap_or(usual.scale),
        mean: three("mean", &sent.mean, usual.mean)?,
        std: three("std", &sent.std, usual.std)?,
    })
}

fn image_input_to(input: &InputSpec) -> v1::ImageInput {
    let channel_order = match input.channel_order {
        ChannelOrder::Rgb => v1::ChannelOrder::Rgb,
        ChannelOrder::Bgr => v1::ChannelOrder::Bgr,
    };
    let fit = match input.fit {
        Fit::Stretch => v1::ImageFit::Stretch,
        Fit::Letterbox => v1::ImageFit::Letterbox,
    };
    v1::ImageInput {
        channel_order: channel_order.into(),
        fit: fit.into(),
        scale: Some(input.scale),
        mean: input.mean.to_vec(),
        std: input.std.to_vec(),
    }
}

/// A detector as a message.
pub fn detector_to(info: &DetectorInfo) -> v1::DetectorInfo {
    let (origin, uploaded_by, create_time_ns) = match &info.origin {
        DetectorOrigin::Folder => (v1::DetectorOrigin::Folder, String::new(), 0),
        DetectorOrigin::Upload { by, at_ns } => (v1::DetectorOrigin::Upload, by.clone(), *at_ns),
    };
    let spec = &info.spec;
    v1::DetectorInfo {
        spec: Some(v1::DetectorSpec {
            name: spec.name.clone(),
            layout: layout_to(spec.layout).into(),
            labels: spec.labels.clone(),
            score_threshold: Some(spec.score_threshold),
            iou_threshold: Some(spec.iou_threshold),
            image_input: Some(image_input_to(&spec.input())),
        }),
        size_bytes: info.num_bytes as u64,
        sha256: info.sha256.clone(),
        input_shape: info.input_shape.iter().map(|side| *side as u32).collect(),
        multiply_adds: info.multiply_adds,
        origin: origin.into(),
        uploaded_by,
        create_time_ns,
    }
}

/// Detectors as a message.
pub fn detectors_to(all: &[DetectorInfo]) -> v1::ListDetectorsResponse {
    v1::ListDetectorsResponse { detectors: all.iter().map(detector_to).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sent() -> v1::DetectorSpec {
        v1::DetectorSpec {
            name: "cars".to_owned(),
            layout: v1::DetectorLayout::YoloV8.into(),
            labels: vec!["car".to_owned()],
            ..Default::default()
        }
    }

    #[test]
    fn what_is_not_said_is_as_usual_and_what_is_said_comes_back() {
        let read = spec(Some(sent())).unwrap();
        assert_eq!(read, DetectorSpec::new("cars", &["car"], OutputLayout::YoloV8));
        let input = InputSpec { channel_order: ChannelOrder::Bgr, fit: Fit::Letterbox, scale: 0.5, ..read.input() };
        let input = InputSpec { mean: [1.0, 2.0, 3.0], std: [4.0, 5.0, 6.0], ..input };
        let whole = DetectorSpec { score_threshold: 0.0, iou_threshold: 1.0, input: Some(input), ..read };
        let info = DetectorInfo {
            spec: whole.clone(),
            num_bytes: 7,
            sha256: "ab".to_owned(),
            input_shape: vec![1, 3, 4, 5],
            multiply_adds: 9,
            origin: DetectorOrigin::Upload { by: "ana".to_owned(), at_ns: 3 },
        };
        let told = detector_to(&info);
        assert_eq!((told.size_bytes, told.uploaded_by.as_str(), told.create_time_ns), (7, "ana", 3));
        assert_eq!(told.input_shape, [1, 3, 4, 5]);
        assert_eq!(spec(told.spec).unwrap(), whole);
    }

    #[test]
    fn what_is_wrong_is_named_by_its_field() {
        let refused = |change: fn(&mut v1::DetectorSpec)| {
            let mut wrong = sent();
            change(&mut wrong);
            let e = spec(Some(wrong)).unwrap_err();
            (e.reason, e.field)
        };
        assert_eq!(spec(None).unwrap_err().reason, "FIELD_MISSING");
        assert_eq!(refused(|s| s.layout = 0), ("ENUM_UNKNOWN", "spec.layout".to_owned()));
        let input = |s: &mut v1::DetectorSpec| s.image_input.get_or_insert_default().fit = 9;
        assert_eq!(refused(input), ("ENUM_UNKNOWN", "spec.image_input.fit".to_owned()));
        let mean = |s: &mut v1::DetectorSpec| s.image_input.get_or_insert_default().mean = vec![1.0];
        assert_eq!(refused(mean), ("SIZE_MISMATCH", "spec.image_input.mean".to_owned()));
    }
}
