//! A camera's buffers, its thread and the detector's: the newest frame is computed, older ones are dropped.
//!
//! ```sh
//! cargo run --release --example camera -- samples/mixed.png
//! ```
//!
//! The camera is a thread that shows the picture 41 times a second, a pixel further each time, as bytes in
//! YUYV, which most USB cameras give.

use std::error::Error;
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use smr_gpu::{CachingDetector, Config, Frame, GpuDetector, PixelFormat, Scale, picture};

const FRAMES: usize = 82;
const APART: Duration = Duration::from_micros(24_390);

/// The newest frame's bytes, or that there will be none.
#[derive(Default)]
struct Newest {
    slot: Mutex<(Option<Vec<u8>>, bool, usize)>,
    changed: Condvar,
}

impl Newest {
    fn put(&self, bytes: Vec<u8>) {
        let mut slot = self.slot.lock().unwrap_or_else(PoisonError::into_inner);
        slot.2 += usize::from(slot.0.replace(bytes).is_some());
        self.changed.notify_one();
    }

    fn end(&self) {
        self.slot.lock().unwrap_or_else(PoisonError::into_inner).1 = true;
        self.changed.notify_one();
    }

    fn take(&self) -> Option<Vec<u8>> {
        let mut slot = self.slot.lock().unwrap_or_else(PoisonError::into_inner);
        while slot.0.is_none() && !slot.1 {
            slot = self.changed.wait(slot).unwrap_or_else(PoisonError::into_inner);
        }
        slot.0.take()
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let file = std::env::args_os().nth(1).ok_or("expected a picture")?;
    let shown = picture::read(file)?.to_luma8();
    let (width, height) = (shown.width() / 2 * 2, shown.height());
    let detector = Arc::new(GpuDetector::new(Config::find("small")?)?);
    println!("{detector:?}");
    let newest = Newest::default();
    thread::scope(|scope| {
        scope.spawn(|| {
            for shift in 0..FRAMES as u32 {
                let luma = |x: u32, y: u32| shown.get_pixel((x + shift) % width, y).0[0];
                // Grey: both colour differences are 128. Luma goes from 16 to 235.
                let pixel = |x, y| [(16 + u32::from(luma(x, y)) * 219 / 255) as u8, 128];
                let row = |y| (0..width).flat_map(move |x| pixel(x, y));
                newest.put((0..height).flat_map(row).collect());
                thread::sleep(APART);
            }
            newest.end();
        });
        let mut camera = CachingDetector::new(detector);
        let mut computed = 0;
        while let Some(bytes) = newest.take() {
            let frame = Frame::new(bytes, width, height, PixelFormat::Yuyv);
            let found = camera.detect(frame.scale(Scale::stated(0.04)))?;
            computed += 1;
            println!("{} snaps in {:.1} ms", found.len(), found.wall.as_secs_f64() * 1e3);
        }
        let dropped = newest.slot.lock().unwrap_or_else(PoisonError::into_inner).2;
        println!("{computed} frames computed, {dropped} dropped");
        Ok(())
    })
}
