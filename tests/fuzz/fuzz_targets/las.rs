//! LAS and LAZ clouds. The unpacking library's own assertions are caught by the decoder, so they may fire here, too.
#![no_main]
use percept_formats::{Limits, las};

libfuzzer_sys::fuzz_target!(
    init: std::panic::set_hook(Box::new(|_| ())),
    |bytes: &[u8]| {
        let limits = Limits { max_points: 10_000, ..Limits::default() };
        if let Ok((cloud, origin)) = las::decode(bytes, &limits) {
            cloud.validate().unwrap();
            let _ = las::encode(&cloud, origin, false);
            let _ = las::encode(&cloud, origin, true);
        }
    }
);
