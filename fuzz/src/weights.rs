//! Weight files: any bytes end with a network, or with an error.

use std::path::Path;

use smr_gpu::smr::{Network, Wanted, Weights};

/// Reads the bytes and builds their network.
pub fn run(data: &[u8]) {
    let Ok(weights) = Weights::from_bytes(Path::new("bytes"), data) else { return };
    let size = weights.config().paper_size();
    assert!(size.is_multiple_of(32) && size > 0, "{size} pixels for the paper's gel");
    // These files hold no whole network: it tells which tensor is missing.
    if let Err(error) = Network::new(weights, [32; 2], Wanted::ALL) {
        assert!(!error.to_string().is_empty());
    }
}
