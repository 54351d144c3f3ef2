//! Names as people may see them: a file or a class can be called anything.

use std::fmt::{Display, Write};

/// The text in one line that leaves the terminal as it is: characters that control it, that end a
/// line or turn the direction of writing are escaped as in Rust.
pub(super) fn printable(text: impl Display) -> String {
    let text = text.to_string();
    let mut shown = String::with_capacity(text.len());
    for c in text.chars() {
        match c.is_control() || is_invisible_order(c) {
            // Writing to a string does not fail.
            true => drop(write!(shown, "{}", c.escape_default())),
            false => shown.push(c),
        }
    }
    shown
}

/// Line and paragraph separators, and what turns the direction of writing.
fn is_invisible_order(c: char) -> bool {
    matches!(c, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_steers_a_terminal_is_escaped() {
        let name = "a\nb\u{1b}[31m\r\t\u{7f}\u{9b}\u{202e}gnp.x\u{2066}\u{2028}.png";
        let shown = r"a\nb\u{1b}[31m\r\t\u{7f}\u{9b}\u{202e}gnp.x\u{2066}\u{2028}.png";
        assert_eq!(printable(name), shown);
        // Once is enough, and twice no harm.
        assert_eq!(printable(shown), shown);
    }

    #[test]
    fn other_names_stay() {
        let name = r"C:\Bilder\Prüfung 指 🤖 №1 → {x} 'y' (µm).png";
        assert_eq!(printable(name), name);
    }
}
