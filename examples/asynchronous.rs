//! Pictures in an async program: while one waits for the GPU, the next is made ready.
//!
//! ```sh
//! cargo run --release --example asynchronous -- samples/mixed.png samples/stud.png samples/hooks.png
//! ```

use std::error::Error;
use std::path::Path;

use futures::executor::block_on;
use futures::future::try_join_all;
use smr_gpu::{Config, Detections, GpuDetector, picture};

fn main() -> Result<(), Box<dyn Error>> {
    let files: Vec<_> = std::env::args_os().skip(1).collect();
    block_on(async {
        let detector = GpuDetector::new_async(Config::find("small")?).await?;
        let each = files.iter().map(|file| detect(&detector, Path::new(file)));
        for (file, found) in files.iter().zip(try_join_all(each).await?) {
            for snap in &found {
                let [x, y] = snap.center_mm;
                println!(
                    "{}: {} {:.2} at ({x:.2}, {y:.2}) mm",
                    file.display(),
                    snap.class,
                    snap.score
                );
            }
        }
        Ok(())
    })
}

async fn detect(detector: &GpuDetector, file: &Path) -> Result<Detections, Box<dyn Error>> {
    let picture = picture::read(file)?;
    Ok(detector.detect_async(&picture).await?)
}
