//! Recognises common TOML typing mistakes (decimal commas, curly quotes, Windows backslashes) and
//! suggests what to type.

/// Quotes that word processors and web pages use instead of plain ones.
const CURLY: [char; 13] = ['“', '”', '„', '‟', '‘', '’', '‚', '«', '»', '‹', '›', '″', '＂'];

/// Suggests a replacement for a line that is not TOML, as a clause; `None` if the mistake is not
/// recognised.
pub(crate) fn what_to_type(text: &str, at: usize) -> Option<String> {
    let start = text.get(..at)?.rfind('\n').map_or(0, |newline| newline + 1);
    let line = text.get(start..)?.lines().next()?.trim();
    corrected(line).map(|(why, line)| format!("{why}; write: {line}"))
}

/// Returns the section name if the line is a header in single brackets.
#[cfg(feature = "daemon")]
pub(crate) fn single_section(text: &str, at: usize) -> Option<&str> {
    let start = text.get(..at)?.rfind('\n').map_or(0, |newline| newline + 1);
    let line = without_remark(text.get(start..)?.lines().next()?).trim();
    let name = line.strip_prefix('[')?.strip_suffix(']')?.trim();
    name.split('.').all(|part| is_key(part.trim())).then_some(name)
}

/// Corrects decimal commas in an array that should have `wanted` numbers but has twice as many.
pub(crate) fn points_for_commas(text: &str, span: std::ops::Range<usize>, wanted: usize) -> Option<String> {
    let array = text.get(span)?.trim().strip_prefix('[')?.strip_suffix(']')?;
    let parts: Vec<&str> = array.split(',').map(str::trim).filter(|part| !part.is_empty()).collect();
    let is_whole = |part: &&str| part.trim_start_matches(['-', '+']).bytes().all(|b| b.is_ascii_digit());
    if wanted == 0 || parts.len() != 2 * wanted || !parts.iter().all(is_whole) {
        return None;
    }
    let numbers: Vec<String> = parts.chunks(2).map(|pair| format!("{}.{}", pair[0], pair[1])).collect();
    Some(format!("decimals have a point, not a comma; write: [{}]", numbers.join(", ")))
}

fn corrected(line: &str) -> Option<(&'static str, String)> {
    if line.contains(CURLY) {
        return Some(("text stands in plain quotes, not in curly ones", line.replace(CURLY, "\"")));
    }
    if let Some(header) = line.strip_prefix('[') {
        let (open, name) = header.strip_prefix('[').map_or(("[", header), |name| ("[[", name));
        let name = name.split(['#', ']']).next()?.trim();
        let close = if open == "[" { "]" } else { "]]" };
        let header = format!("{open}{name}{close}");
        let is_right = without_remark(line).trim() == header;
        return (!is_right).then_some(("a section's name stands in brackets", header));
    }
    let Some((key, value)) = line.split_once('=') else {
        let (key, value) = line.split_once(':').filter(|(key, _)| is_key(key.trim()))?;
        return Some(("a key and its value are joined by =", format!("{} = {}", key.trim(), value.trim())));
    };
    let (key, value) = (key.trim(), without_remark(value).trim());
    if key.is_empty() {
        return None;
    }
    let (why, value) = corrected_value(value)?;
    Some((why, format!("{key} = {value}")))
}

fn corrected_value(value: &str) -> Option<(&'static str, String)> {
    let quoted = |text: &str| format!("\"{}\"", text.trim_matches('"').replace('\\', "/"));
    if value.starts_with('"') {
        return match (value.contains('\\'), value.matches('"').count()) {
            (true, _) => Some(("a backslash in quotes begins a special character, and a path may have / on every system", quoted(value))),
            (false, 1) => Some(("the quote is not closed", format!("{value}\""))),
            _ => None,
        };
    }
    let number = |text: &str| text.parse::<f64>().ok().filter(|v| v.is_finite());
    if let Some((whole, part)) = value.split_once(',')
        && number(whole).is_some()
        && !part.is_empty()
        && part.bytes().all(|b| b.is_ascii_digit())
    {
        return Some(("decimals have a point, not a comma", format!("{whole}.{part}")));
    }
    if let Some(plain) = number(value) {
        let is_bare = value.ends_with('.') || value.trim_start_matches(['-', '+']).starts_with('.');
        return is_bare.then(|| ("a number has digits on both sides of its point", format!("{plain:?}")));
    }
    match value.to_ascii_lowercase().as_str() {
        _ if value == "true" || value == "false" => return None,
        "true" | "yes" | "on" => return Some(("a switch is true or false", "true".to_owned())),
        "false" | "no" | "off" => return Some(("a switch is true or false", "false".to_owned())),
        _ => {}
    }
    if let Some((above, below)) = value.split_once('/')
        && let (Some(above), Some(below)) = (number(above.trim()), number(below.trim()).filter(|v| *v != 0.0))
    {
        return Some(("a fraction is written as a decimal number", format!("{:?}", (1e6 * above / below).round() / 1e6)));
    }
    let digits = value.find(|c: char| !c.is_ascii_digit() && !".+-".contains(c)).unwrap_or(value.len());
    if let (Some(plain), Some(unit)) = (number(&value[..digits]), value.get(digits..).map(str::trim))
        && unit.chars().all(|c| c.is_alphabetic() || "°%\"'".contains(c))
    {
        return Some(("a number stands without its unit", plain.to_string()));
    }
    let is_text = value.starts_with(|c: char| c.is_alphabetic() || "/.~\\".contains(c));
    is_text.then(|| ("text stands in quotes", quoted(value)))
}

fn is_key(text: &str) -> bool {
    !text.is_empty() && text.chars().all(|c| c.is_ascii_alphanumeric() || "_-.".contains(c))
}

/// Strips a trailing # comment that is not in quotes.
fn without_remark(value: &str) -> &str {
    let mut is_quoted = false;
    let end = value.char_indices().find(|(_, c)| {
        is_quoted ^= *c == '"';
        *c == '#' && !is_quoted
    });
    end.map_or(value, |(at, _)| &value[..at])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn typing_slips_get_the_corrected_line() {
        for (line, wanted) in [
            ("fov_deg = 50,5", "fov_deg = 50.5"),
            ("x = -0,25 # metres", "x = -0.25"),
            ("calibration = “cam.toml”", "calibration = \"cam.toml\""),
            ("calibration = „cam.toml“", "calibration = \"cam.toml\""),
            ("calibration = «cam.toml»", "calibration = \"cam.toml\""),
            ("calibration = \"C:\\Users\\max\\cam.toml\"", "calibration = \"C:/Users/max/cam.toml\""),
            ("calibration = C:\\cam.toml", "calibration = \"C:/cam.toml\""),
            ("calibration = cam.toml", "calibration = \"cam.toml\""),
            ("calibration = \"cam.toml", "calibration = \"cam.toml\""),
            ("fov_deg: 60", "fov_deg = 60"),
            ("fov_deg = 60 deg", "fov_deg = 60"),
            ("fov_deg = 60°", "fov_deg = 60"),
            ("exposure_s = .5", "exposure_s = 0.5"),
            ("exposure_s = 1.", "exposure_s = 1.0"),
            ("exposure_s = 1/50", "exposure_s = 0.02"),
            ("enabled = True", "enabled = true"),
            ("enabled = off", "enabled = false"),
            ("[camera", "[camera]"),
            ("[[output]", "[[output]]"),
        ] {
            let said = what_to_type(&format!("# a\n  {line}\nnext = 1\n"), 5).unwrap();
            assert!(said.ends_with(&format!("; write: {wanted}")), "{line}: {said}");
        }
        for line in [
            "[camera]",
            "[camera] # again",
            "nonsense",
            "a = \"b\" \"c\"",
            "a = }",
            "= 3",
            "",
            "a = 3",
            "a = 2.5",
            "a = true",
            "a = [1, 2]",
        ] {
            assert_eq!(what_to_type(line, 0), None, "{line}");
        }
        assert_eq!((what_to_type("a", 9), what_to_type("ä = 1", 1)), (None, None));
    }

    #[test]
    fn an_array_of_twice_the_length_means_decimal_commas() {
        let of = |text: &str, wanted| points_for_commas(text, 0..text.len(), wanted);
        assert!(of("[0,4, 0,22]", 2).unwrap().ends_with("write: [0.4, 0.22]"));
        assert!(of("[-1,5, 0,0, 2,25]", 3).unwrap().ends_with("write: [-1.5, 0.0, 2.25]"));
        for (text, wanted) in [("[1, 2, 3]", 2), ("[1.5, 2, 3, 4]", 2), ("[1, 2]", 2), ("[a, b]", 1), ("3", 1), ("[]", 0)] {
            assert_eq!(of(text, wanted), None, "{text}");
        }
    }
}
