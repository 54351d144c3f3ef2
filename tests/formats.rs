//! JPEGs and TIFFs of many kinds against an independent decoder's pixels: equal, or refused by
//! name.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::path::Path;

use flate2::read::ZlibDecoder;
use image::RgbImage;
use smr_gpu::picture::{Error, decode};

/// Most levels from the expected pixels. Both decoders round an exact transform; a sample half-way
/// between two levels goes up here and to the even one there. That is a level of luma, and of
/// chroma, which counts 1.77 times in blue.
const MAX_LEVELS: u8 = 2;

struct Stored {
    name: String,
    bytes: Vec<u8>,
    /// The expected pixels; none for a file to refuse.
    pixels: Option<RgbImage>,
}

/// What `tests/fixtures/pictures.py` wrote.
fn stored() -> Vec<Stored> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures");
    let sheet = image::open(folder.join("pictures.png")).expect("the pixels").into_rgb8();
    let mut bytes = Vec::new();
    let file = File::open(folder.join("pictures.bin")).expect("the files");
    ZlibDecoder::new(file).read_to_end(&mut bytes).expect("the files");
    let mut rest = &bytes[..];
    let mut found = Vec::new();
    while !rest.is_empty() {
        let end = rest.iter().position(|b| *b == b'\n').expect("a line");
        let line = str::from_utf8(&rest[..end]).expect("a line");
        let [name, numbers @ ..] = &line.split(' ').collect::<Vec<_>>()[..] else {
            panic!("{line}")
        };
        let numbers = numbers.iter().map(|n| n.parse().expect("a number")).collect::<Vec<i64>>();
        let [width, height, top, length] = numbers[..] else { panic!("{line}") };
        let (bytes, behind) = rest[end + 1..].split_at(length as usize);
        let pixels = u32::try_from(top).ok().map(|top| {
            image::imageops::crop_imm(&sheet, 0, top, width as u32, height as u32).to_image()
        });
        found.push(Stored { name: (*name).into(), bytes: bytes.into(), pixels });
        rest = behind;
    }
    found
}

#[test]
fn every_file_gives_the_pixels_of_other_decoders_or_is_refused() {
    let (mut equal, mut refused, mut wrong) = (BTreeMap::new(), BTreeMap::new(), Vec::new());
    for Stored { name, bytes, pixels } in stored() {
        let format = name.split('/').next().expect("a format").to_owned();
        match (decode(&bytes), pixels) {
            (Ok(picture), Some(expected)) => {
                let picture = picture.into_rgb8();
                let levels = picture.iter().zip(expected.iter()).map(|(a, b)| a.abs_diff(*b)).max();
                if picture.dimensions() != expected.dimensions() || levels > Some(MAX_LEVELS) {
                    wrong.push(format!("{name}: {levels:?} levels off"));
                }
                *equal.entry((format, levels)).or_insert(0) += 1;
            }
            (Err(Error::Unsupported { .. }), None) => *refused.entry(format).or_insert(0) += 1,
            (got, _) => wrong.push(format!("{name}: {:?}", got.map(|p| p.color()))),
        }
    }
    println!("equal, by levels: {equal:?}; refused: {refused:?}");
    assert!(wrong.is_empty(), "{} wrong:\n{}", wrong.len(), wrong.join("\n"));
    let total = |format: &str| equal.iter().filter(|((f, _), _)| f == format).map(|(_, n)| n).sum();
    assert_eq!((total("jpeg"), total("tiff")), (1529, 722));
    assert_eq!((refused["jpeg"], refused["tiff"]), (5, 8));
}
