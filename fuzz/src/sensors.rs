//! Sensor files: any bytes end with a sensor whose every value is in its range, or with an error.

use smr_gpu::engine::shape::MAX_PIXELS;
use smr_gpu::{Sensor, files};

/// Reads the bytes, and checks what the reader promises.
pub fn run(data: &[u8]) {
    let Ok(text) = files::text(data) else { return };
    let sensor = match Sensor::parse(text) {
        Ok(sensor) => sensor,
        Err(error) => return assert!(!error.to_string().is_empty()),
    };
    sensor.check().expect("it was checked");
    let [width, height] = sensor.frame.unwrap_or([1, 1]).map(|side| side as usize);
    assert!(width > 0 && height > 0 && width * height <= MAX_PIXELS);
    if let Some(gel) = sensor.gel {
        let [right, bottom] = [gel.x + gel.width, gel.y + gel.height].map(|side| side as usize);
        assert!(right <= width && bottom <= height, "{gel:?} of {width} × {height}");
    }
    let again = serde_json::to_string(&sensor).expect("JSON");
    assert_eq!(Sensor::parse(&again).expect("a sensor").frame, sensor.frame);
}
