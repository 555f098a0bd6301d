//! Names that every format accepts: letters, digits and underscores, each used once.

use std::collections::HashSet;

/// Names that are already in use.
#[derive(Debug, Default)]
pub struct Identifiers(HashSet<String>);

/// Maximum length of an identifier before its number, characters. Longer names are cut: some
/// formats copy them into every reference.
const MAX_LENGTH: usize = 60;

impl Identifiers {
    /// Returns an identifier for a name that no earlier call returned.
    pub fn of(&mut self, name: &str) -> String {
        let mut base: String = name.chars().take(MAX_LENGTH).map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
        if base.chars().next().is_none_or(|first| first.is_ascii_digit()) {
            base.insert(0, '_');
        }
        let numbered = (2_u64..).map(|number| format!("{base}_{number}"));
        let free = std::iter::once(base.clone()).chain(numbered).find(|name| !self.0.contains(name));
        let free = free.unwrap_or(base);
        self.0.insert(free.clone());
        free
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_become_different_identifiers() {
        let mut identifiers = Identifiers::default();
        let named = ["backdrop", "back drop", "back-drop", "", "9", "Bühne", "\"\n"].map(|name| identifiers.of(name));
        assert_eq!(named, ["backdrop", "back_drop", "back_drop_2", "_", "_9", "B_hne", "__"]);
    }
}
