//! The fuzz targets over their corpus and 10 000 changed copies each, from a fixed seed: what
//! `cargo fuzz` does for hours, in seconds and without nightly. With `SMR_GPU_FUZZ_SECONDS=600` each goes
//! on for so long, with other changes.

use std::path::Path;
use std::time::{Duration, Instant};

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

#[path = "../fuzz/src/lib.rs"]
mod targets;

const CHANGED: usize = 10_000;
/// Of frames' sequences, of which each frame runs a network.
const CHANGED_STREAMS: usize = 100;

#[test]
fn pictures() {
    over("pictures", targets::pictures::run);
}

#[test]
fn weights() {
    over("weights", targets::weights::run);
}

#[test]
fn annotations() {
    over("annotations", targets::annotations::run);
}

#[test]
fn sensors() {
    over("sensors", targets::sensors::run);
}

#[test]
fn tables() {
    over("tables", targets::tables::run);
}

#[test]
fn tuned() {
    over("tuned", targets::tuned::run);
}

#[test]
fn streams() {
    over_changes("streams", CHANGED_STREAMS, targets::streams::run);
}

#[test]
fn ops() {
    over("ops", targets::ops::run);
}

/// A seed's first byte is its operation's place in `OPS`.
#[test]
fn every_operation_has_a_seed() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus/ops");
    let seeds: Vec<u8> = std::fs::read_dir(folder)
        .expect("a corpus")
        .map(|entry| std::fs::read(entry.expect("an entry").path()).expect("a file")[0])
        .collect();
    let without =
        smr_gpu::engine::ops::OPS.iter().zip(0..).filter(|(_, place)| !seeds.contains(place));
    assert_eq!(without.map(|(entry, _)| entry.name).collect::<Vec<_>>(), [""; 0]);
}

/// Runs a target on each file of its corpus and on changed copies of them.
fn over(target: &str, run: fn(&[u8])) {
    over_changes(target, CHANGED, run);
}

/// [`over`] with so many changed copies.
fn over_changes(target: &str, changes: usize, run: fn(&[u8])) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus").join(target);
    let entries = std::fs::read_dir(&folder).expect("a corpus");
    let mut files: Vec<_> = entries.map(|e| e.expect("an entry").path()).collect();
    files.sort();
    let corpus: Vec<Vec<u8>> =
        files.iter().map(|file| std::fs::read(file).expect("a file")).collect();
    assert!(!corpus.is_empty(), "{}: expected files", folder.display());
    let mut slowest = Duration::ZERO;
    let mut timed = |name: &str, bytes: &[u8]| {
        let start = Instant::now();
        if let Err(panic) = std::panic::catch_unwind(|| run(bytes)) {
            let file = std::env::temp_dir().join(format!("smr-gpu-fuzz-{target}"));
            std::fs::write(&file, bytes).expect("written");
            eprintln!("{target}: {name} is kept in {}", file.display());
            std::panic::resume_unwind(panic);
        }
        slowest = slowest.max(start.elapsed());
    };
    for (file, bytes) in files.iter().zip(&corpus) {
        timed(&file.display().to_string(), bytes);
    }
    let seconds = std::env::var("SMR_GPU_FUZZ_SECONDS").ok();
    let seconds: Option<u64> = seconds.map(|text| text.parse().expect("a number of seconds"));
    let (start, limit) = (Instant::now(), seconds.map(Duration::from_secs));
    let mut rng = Pcg64Mcg::seed_from_u64(seconds.unwrap_or(6));
    let mut done = 0;
    while limit.map_or(done < changes, |limit| start.elapsed() < limit) {
        timed(&format!("change {done}"), &changed(&corpus, &mut rng));
        done += 1;
    }
    println!("{target}: {} files, {done} changes, slowest {slowest:.1?}", files.len());
}

/// A copy of one of the files with some changes.
fn changed(corpus: &[Vec<u8>], rng: &mut Pcg64Mcg) -> Vec<u8> {
    let mut bytes = corpus[rng.random_range(0..corpus.len())].clone();
    for _ in 0..rng.random_range(1..=4) {
        let length = bytes.len();
        if length == 0 {
            break;
        }
        let at = rng.random_range(0..length);
        let end = rng.random_range(at..=length).min(at + 64);
        match rng.random_range(0..8) {
            0 | 1 => bytes[at] ^= 1 << rng.random_range(0..8),
            2 => bytes[at] = rng.random(),
            3 => {
                // A number at the edge of its type, in either order.
                let width = [1, 2, 4, 8][rng.random_range(0..4)].min(length - at);
                let edge = [0, 1, 2, 3, 1 << 63, u64::MAX, u64::MAX >> 1][rng.random_range(0..7)];
                let mut number = edge.to_be_bytes()[8 - width..].to_vec();
                if edge > u64::from(u8::MAX) {
                    number = edge.to_be_bytes()[..width].to_vec();
                }
                if rng.random() {
                    number.reverse();
                }
                bytes[at..at + width].copy_from_slice(&number);
            }
            4 => bytes.truncate(at),
            5 => drop(bytes.drain(at..end)),
            6 => {
                let again = bytes[at..end].to_vec();
                bytes.splice(at..at, again);
            }
            _ => {
                let other = &corpus[rng.random_range(0..corpus.len())];
                let from = rng.random_range(0..=other.len());
                bytes.truncate(at);
                bytes.extend_from_slice(&other[from..]);
            }
        }
    }
    bytes
}
