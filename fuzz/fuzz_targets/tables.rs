#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| smr_gpu_fuzz::tables::run(data));
