//! A small service: a picture's file in, one line of JSON out.
//!
//! ```sh
//! cargo run --release --example service -- 127.0.0.1:7878 &
//! nc -N 127.0.0.1 7878 < samples/mixed.png
//! ```
//!
//! Each connection has a thread; all share one detector, which computes as many pictures at a time as
//! `Config::in_flight` says.

use std::error::Error;
use std::io::Write;
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::Arc;
use std::thread;
use std::time::Duration;

use smr_gpu::{Config, GpuDetector, picture};

/// Longest wait for a client.
const PATIENCE: Duration = Duration::from_secs(10);

fn main() -> Result<(), Box<dyn Error>> {
    let address = std::env::args().nth(1).ok_or("expected ADDRESS:PORT")?;
    let detector = Arc::new(GpuDetector::new(Config::find("small")?)?);
    let listener = TcpListener::bind(&address)?;
    println!("{detector:?} at {}", listener.local_addr()?);
    for stream in listener.incoming() {
        let (stream, detector) = (stream?, detector.clone());
        thread::spawn(move || {
            let answer = answer(&detector, &stream)
                .unwrap_or_else(|e| serde_json::json!({ "error": e.to_string() }).to_string());
            // A client that went away needs no answer.
            let _ = writeln!(&stream, "{answer}").and_then(|()| stream.shutdown(Shutdown::Both));
        });
    }
    Ok(())
}

fn answer(detector: &GpuDetector, stream: &TcpStream) -> Result<String, Box<dyn Error>> {
    stream.set_read_timeout(Some(PATIENCE))?;
    stream.set_write_timeout(Some(PATIENCE))?;
    let picture = picture::read_from(stream)?;
    Ok(serde_json::to_string(&detector.detect(&picture)?)?)
}
