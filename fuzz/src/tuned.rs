//! What `tune` keeps: any bytes end with a choice of kernels that is written as it is read, or with an error.

use smr_gpu::engine::tuned::Tuned;

/// Reads the bytes.
pub fn run(data: &[u8]) {
    let tuned = match Tuned::parse(data) {
        Ok(tuned) => tuned,
        Err(message) => return assert!(!message.is_empty()),
    };
    let again = Tuned::parse(tuned.to_json().as_bytes()).expect("what was written");
    assert_eq!(again, tuned);
    assert_eq!(again.kernels.digest(), tuned.kernels.digest());
    assert_eq!(again.beside(tuned.clone()), tuned);
    let name = tuned.place.file_name();
    let fits = |c: char| c.is_ascii_alphanumeric() || c == '-';
    assert!(name.strip_suffix(".json").is_some_and(|stem| stem.chars().all(fits)), "{name}");
}
