//! `include/smr_gpu.h` is what cbindgen makes of `src/lib.rs`. With SMR_UPDATE set it is written anew.

use std::path::Path;

#[test]
fn the_header_is_up_to_date() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let config = cbindgen::Config::from_file(root.join("cbindgen.toml")).expect("cbindgen.toml");
    let made = cbindgen::Builder::new().with_config(config).with_src(root.join("src/lib.rs")).generate();
    let mut header = Vec::new();
    made.expect("a header").write(&mut header);
    let file = root.join("include/smr_gpu.h");
    if std::env::var_os("SMR_UPDATE").is_some() {
        std::fs::write(&file, &header).expect("writes");
    }
    assert_eq!(std::fs::read(&file).expect("a header"), header, "SMR_UPDATE=1 cargo test writes it");
}
