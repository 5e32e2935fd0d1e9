#![no_main]
libfuzzer_sys::fuzz_target!(|data: &[u8]| nbv_fuzz::snapshot::snapshot(data));
