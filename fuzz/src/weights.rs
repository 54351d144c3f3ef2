//! Weight files: any bytes end with a network, or with an error.

use std::path::Path;

use smr_gpu::model::{Network, Thresholds, Weights};

/// Reads the bytes and builds their network.
pub fn run(data: &[u8]) {
    let Ok(weights) = Weights::from_bytes(Path::new("bytes"), data) else { return };
    let config = weights.config();
    for side in [1, config.picture_size, u32::MAX] {
        let mm = config.mm_per_pixel_of(side);
        assert!(mm >= 0.0, "{mm} mm a pixel of a picture of {side} pixels");
    }
    let thresholds = Thresholds { score: 0.5, iou: 0.5, max_detections: 100, class_mask: !1 };
    // These files hold no whole network: it tells which tensor is missing.
    if let Err(error) = Network::new(weights, thresholds) {
        assert!(!error.to_string().is_empty());
    }
}
