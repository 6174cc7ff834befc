//! Clouds as text.
#![no_main]
use percept_formats::{Limits, xyz};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    if let Ok((cloud, origin)) = xyz::decode(bytes, &Limits::default()) {
        assert!(cloud.positions.len() <= bytes.len());
        cloud.validate().unwrap();
        let again = xyz::encode(&cloud, origin).unwrap();
        assert_eq!(xyz::decode(&again, &Limits::default()).unwrap().0.len(), cloud.len());
    }
});
