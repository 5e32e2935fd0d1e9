#![no_main]
libfuzzer_sys::fuzz_target!(|data: &[u8]| nbv_fuzz::scene_entry::truth(data));
