//! Sensor messages as they come through gRPC and zenoh.
#![no_main]
use percept_service::Limits;
use percept_wire::{convert::sensors, v1};
use prost::Message;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let limits = Limits { max_image_pixels: 1 << 20, max_cloud_points: 1 << 16, ..Limits::default() };
    if let Ok(message) = v1::SensorMessage::decode(bytes) {
        // What is accepted can be sent on, and is accepted again.
        if let Ok(incoming) = sensors::frame(&message, &limits) {
            let again = sensors::frame_to(&incoming.session, incoming.sequence, &incoming.frame);
            assert!(sensors::frame(&again, &limits).is_ok());
        }
    }
});
