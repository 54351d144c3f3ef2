//! Finds the snaps in one picture: `cargo run --release --example detect -- picture.png`

use std::error::Error;

use smr_gpu::{Config, GpuDetector, picture};

fn main() -> Result<(), Box<dyn Error>> {
    let file = std::env::args().nth(1).ok_or("expected a picture's file name")?;
    // Built once: it opens the GPU, compiles the shaders and uploads the weights.
    let detector = GpuDetector::new(Config::find("large")?)?;

    let found = detector.detect(&picture::read(file)?)?;
    for snap in &found {
        let [x, y] = snap.center_mm;
        println!("{} at {x:+.2} mm, {y:+.2} mm, score {:.2}", snap.class, snap.score);
    }
    for stage in &found.stages {
        println!("{:>10.2?}  {}", stage.time, stage.stage);
    }
    println!("{:>10.2?}  in all, on {}", found.wall, detector.adapter());
    Ok(())
}
