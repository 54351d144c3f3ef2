//! Annotations: any bytes end with a set of labelled pictures, or with an error.

use std::path::Component;

use smr_gpu::evaluation::coco;

/// Reads the bytes, and checks what the reader promises.
pub fn run(data: &[u8]) {
    let Ok(set) = coco::parse(data) else { return };
    for picture in &set.pictures {
        let is_inside = |c| matches!(c, Component::Normal(_) | Component::CurDir);
        assert!(picture.file.components().all(is_inside), "{:?} leads out", picture.file);
        assert!(picture.labels.iter().all(|l| l.category < set.categories.len()));
        let (width, height) = picture.size.unwrap_or((100, 100));
        // An error or not, but no panic.
        let _ = picture.check_size(width, height);
    }
}
