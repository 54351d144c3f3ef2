//! Reading the picture that a source names.

use image::DynamicImage;
use smr_gpu::picture;

use super::source::Source;

/// Reads a PNG, JPEG, BMP or TIFF picture and turns it upright as its orientation says.
///
/// # Errors
/// What was expected and what came, without the picture's name.
pub(super) fn read(source: &Source) -> Result<DynamicImage, String> {
    let result = match source {
        Source::File(path) => picture::read(path),
        Source::Stdin => picture::read_from(std::io::stdin().lock()),
    };
    result.map_err(|e| e.to_string())
}
