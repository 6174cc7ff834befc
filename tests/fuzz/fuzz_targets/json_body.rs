//! JSON bodies as they come through REST: the first byte chooses the message.
#![no_main]
use percept_service::Limits;
use percept_wire::{convert::sensors, json, v1};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let Some((choice, body)) = bytes.split_first() else { return };
    let Ok(value) = serde_json::from_slice::<serde_json::Value>(body) else { return };
    if choice % 2 == 0 {
        if let Ok(message) = json::from_json::<v1::SensorMessage>("SensorMessage", value) {
            let _ = sensors::frame(&message, &Limits::default());
        }
    } else if let Ok(message) = json::from_json::<v1::CreateSessionRequest>("CreateSessionRequest", value) {
        assert!(json::to_json("CreateSessionRequest", &message).is_ok());
    }
});
