//! Escapes external text for display in a terminal.
//!
//! Names of cameras and files, and anything from a network, may hold control characters. A terminal
//! obeys them: it sets its title, moves its cursor, or shows a line that was never written.
//! Bidirectional controls and invisible characters make one name look like another. All of these
//! are written as JSON escapes (`\u001b`), so that a line of JSON keeps its meaning.

use std::borrow::Cow;

/// Escapes every character that is not plainly visible, including line ends, so that the text stays
/// on one line.
pub fn printable(text: &str) -> Cow<'_, str> {
    escaped(text, |c| !stands_for_itself(c))
}

/// Like [`printable`], but keeps the line ends of a multi-line text.
pub fn printable_lines(text: &str) -> Cow<'_, str> {
    escaped(text, |c| c != '\n' && !stands_for_itself(c))
}

/// Whether a character is shown as itself: false for control characters (C0, DEL, C1), line
/// separators, bidirectional controls and invisible characters.
pub fn stands_for_itself(c: char) -> bool {
    !(c.is_control()
        || matches!(c, '\u{ad}' | '\u{61c}' | '\u{180e}' | '\u{200b}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}')
        || matches!(c, '\u{2060}'..='\u{206f}' | '\u{feff}' | '\u{fff9}'..='\u{fffb}' | '\u{e0000}'..='\u{e007f}'))
}

fn escaped(text: &str, must_be_escaped: impl Fn(char) -> bool) -> Cow<'_, str> {
    if !text.chars().any(&must_be_escaped) {
        return Cow::Borrowed(text);
    }
    let mut plain = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        match c {
            c if !must_be_escaped(c) => plain.push(c),
            '\n' => plain.push_str("\\n"),
            '\r' => plain.push_str("\\r"),
            '\t' => plain.push_str("\\t"),
            // JSON writes characters beyond 16 bits as a surrogate pair.
            c => plain.extend(c.encode_utf16(&mut [0; 2]).iter().map(|unit| format!("\\u{unit:04x}"))),
        }
    }
    Cow::Owned(plain)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn terminal_control_characters_are_escaped() {
        for (raw, wanted) in [
            ("\x1b]0;owned\x07", "\\u001b]0;owned\\u0007"),
            ("\u{9b}2J\u{7f}", "\\u009b2J\\u007f"),
            ("a\nstagepose: good\r\t", "a\\nstagepose: good\\r\\t"),
            ("gpj.\u{202e}png\u{2066}\u{200f}", "gpj.\\u202epng\\u2066\\u200f"),
            ("\u{e0041}", "\\udb40\\udc41"),
            ("Bühne 3 \\ 舞台 😀", "Bühne 3 \\ 舞台 😀"),
        ] {
            assert_eq!(printable(raw), wanted);
        }
        assert!(matches!(printable("plain"), Cow::Borrowed("plain")));
        assert_eq!(printable_lines("a\nb\x1b\n"), "a\nb\\u001b\n");
    }

    #[test]
    fn json_stays_json() {
        let name = "a\u{9b}b\u{202e}c\u{e0041}\x1b\n";
        let line = serde_json::json!({ "name": name }).to_string();
        let plain = printable(&line);
        assert!(plain.chars().all(stands_for_itself), "{plain}");
        let read: serde_json::Value = serde_json::from_str(&plain).unwrap();
        assert_eq!(read["name"], name);
    }
}
