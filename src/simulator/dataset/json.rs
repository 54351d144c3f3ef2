//! The JSON of a data set: numbers of ten digits, errors that name the file.

use std::io;
use std::path::Path;

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::ser::{CompactFormatter, Formatter};

use super::super::Error;
use crate::files;

/// Longest file that an earlier run left to be read, in bytes: a label has some thousands.
pub(super) const MAX_JSON: u64 = 1 << 24;

pub(super) fn write_json(path: &Path, value: &impl Serialize) -> Result<(), Error> {
    let text = serde_json::to_vec(value).map_err(|e| Error::io(path)(e.into()))?;
    Ok(files::write(path, &text)?)
}

/// [`write_json`] with ten digits of each number, less than anything there is known to.
pub(super) fn write_rounded(path: &Path, value: &impl Serialize) -> Result<(), Error> {
    Ok(files::write(path, &rounded_json(value).map_err(|e| Error::io(path)(e.into()))?)?)
}

fn rounded_json(value: &impl Serialize) -> serde_json::Result<Vec<u8>> {
    let mut text = Vec::new();
    value.serialize(&mut serde_json::Serializer::with_formatter(&mut text, Digits))?;
    Ok(text)
}

/// Ten digits: how transforms and the system's functions round beyond them depends on the machine, on whether it
/// fuses multiply-adds for one.
struct Digits;

impl Formatter for Digits {
    fn write_f64<W: ?Sized + io::Write>(&mut self, writer: &mut W, value: f64) -> io::Result<()> {
        let value = format!("{value:.9e}").parse().unwrap_or(value);
        CompactFormatter.write_f64(writer, value)
    }
}

pub(super) fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T, Error> {
    parse(path, &files::read(path, MAX_JSON).map_err(Error::io(path))?)
}

pub(super) fn parse<T: DeserializeOwned>(path: &Path, text: &[u8]) -> Result<T, Error> {
    serde_json::from_slice(text).map_err(|e| Error::Content {
        path: path.to_owned(),
        expected: "what an earlier run wrote".to_owned(),
        found: e.to_string(),
    })
}

#[cfg(test)]
mod tests {
    use super::super::super::label::Label;
    use super::*;

    /// With and without fused multiply-adds a sum may differ in its last bits.
    #[test]
    fn labels_do_not_have_the_last_bits_of_their_numbers() {
        let area = 1234.5678;
        let written = |area_px: f64| {
            let label = Label {
                kind: "A".to_owned(),
                pixel_box: [0.1 + 0.2, 1e-12, 640.0, area_px / 10.0],
                area_px,
                yaw_deg: Some(area_px / 100.0),
                depth_mm: 1.0 / 3.0,
                center_mm: [-area_px, 0.0],
                whole: true,
                visible: 1.0,
                slots: None,
                hole_mm: None,
                wall: false,
                on_side: false,
            };
            String::from_utf8(rounded_json(&label).expect("JSON")).expect("text")
        };
        let text = written(area);
        assert!(text.contains("[0.3,1e-12,640.0,123.45678],\"area_px\":1234.5678,"), "{text}");
        assert!(
            text.contains("\"depth_mm\":0.3333333333,\"center_mm\":[-1234.5678,0.0]"),
            "{text}"
        );
        let fused = f64::from_bits(area.to_bits() + 3);
        assert_ne!(fused, area);
        assert_eq!(written(fused), text);
    }
}
