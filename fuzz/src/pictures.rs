//! Pictures: any bytes end with a picture within the limits, or with an error.

use smr_gpu::engine::shape::MAX_PIXELS;
use smr_gpu::picture::{self, Error};

/// Decodes the bytes, and a PNG once more with its checksums put right.
pub fn run(data: &[u8]) {
    decode(data);
    if let Some(repaired) = with_checksums(data) {
        decode(&repaired);
    }
}

fn decode(data: &[u8]) {
    match picture::decode(data) {
        Ok(picture) => {
            let (width, height) = (picture.width() as usize, picture.height() as usize);
            assert!(width > 0 && height > 0 && width * height <= MAX_PIXELS);
            assert!(picture.color().bytes_per_pixel() <= 4);
            let bytes = width * height * usize::from(picture.color().bytes_per_pixel());
            assert_eq!(picture.as_bytes().len(), bytes);
        }
        // It was caught, but should not have to be.
        Err(error @ Error::DecoderFailed { .. }) => panic!("{error}"),
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}

/// The PNG with right checksums, which no blind change keeps.
fn with_checksums(data: &[u8]) -> Option<Vec<u8>> {
    let mut repaired = data.to_vec();
    let mut at = data.starts_with(b"\x89PNG\r\n\x1a\n").then_some(8)?;
    while let Some(length) = data.get(at..).and_then(|rest| rest.first_chunk()) {
        let end = u32::from_be_bytes(*length) as usize + at + 8;
        let Some(chunk) = data.get(at + 4..end) else { break };
        let Some(sum) = repaired.get_mut(end..end + 4) else { break };
        sum.copy_from_slice(&checksum(chunk).to_be_bytes());
        at = end + 4;
    }
    Some(repaired)
}

/// PNG's CRC-32.
fn checksum(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |sum, byte| {
        (0..8).fold(
            sum ^ u32::from(*byte),
            |s, _| {
                if s & 1 == 1 { s >> 1 ^ 0xedb8_8320 } else { s >> 1 }
            },
        )
    })
}
