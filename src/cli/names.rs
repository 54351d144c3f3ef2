//! Names of files, which need not be text.

use std::ffi::OsStr;
use std::fmt::Write;

use base64::Engine;
use base64::prelude::BASE64_STANDARD;

/// A name as text. In one that is no Unicode what is none comes as `\xNN`, and a backslash doubled: two such
/// names do not become one.
pub(super) fn shown(name: &OsStr) -> String {
    if let Some(name) = name.to_str() {
        return name.to_owned();
    }
    let mut text = String::new();
    for chunk in name.as_encoded_bytes().utf8_chunks() {
        text += &chunk.valid().replace('\\', "\\\\");
        for byte in chunk.invalid() {
            // Writing to a string does not fail.
            let _ = write!(text, "\\x{byte:02x}");
        }
    }
    text
}

/// For `--json`, the bytes of a name that is no Unicode, in base64: on Windows, where names are of 16-bit
/// units, those, little end first. `None` for all other names.
pub(super) fn base64(name: &OsStr) -> Option<String> {
    if name.to_str().is_some() {
        return None;
    }
    #[cfg(windows)]
    let bytes: Vec<u8> =
        std::os::windows::ffi::OsStrExt::encode_wide(name).flat_map(u16::to_le_bytes).collect();
    #[cfg(not(windows))]
    let bytes = name.as_encoded_bytes();
    Some(BASE64_STANDARD.encode(bytes))
}

#[cfg(all(test, unix))]
mod tests {
    use std::os::unix::ffi::OsStrExt;

    use super::*;

    #[test]
    fn names_that_are_no_unicode_stay_apart() {
        let of = |bytes| {
            let name = OsStr::from_bytes(bytes);
            (shown(name), base64(name))
        };
        assert_eq!(of(b"a\\b.png"), ("a\\b.png".into(), None));
        assert_eq!(of(b"a\xff.png"), ("a\\xff.png".into(), Some("Yf8ucG5n".into())));
        assert_eq!(of(b"a\xfe.png"), ("a\\xfe.png".into(), Some("Yf4ucG5n".into())));
        assert_eq!(of(b"\\xff\xff").0, "\\\\xff\\xff");
        // A letter that is cut off.
        assert_eq!(of(b"\xc3\xbc\xc3").0, "ü\\xc3");
    }
}
