#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| smr_gpu_fuzz::tuned::run(data));
