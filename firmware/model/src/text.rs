//! Places in the text of a TOML file, for error messages.

/// The line of a byte offset, counted from 1.
#[must_use]
pub fn line(text: &str, offset: usize) -> usize {
    let before = text.bytes().take(offset);
    before.filter(|byte| *byte == b'\n').count() + 1
}

/// The key on the line of a byte offset, if the line gives a key a value.
#[must_use]
pub fn key(text: &str, offset: usize) -> Option<&str> {
    let line = text.lines().nth(line(text, offset) - 1)?;
    let (key, _) = line.split_once('=')?;
    let key = key.trim();
    let is_key = |c: char| c.is_ascii_alphanumeric() || "_-.\"".contains(c);
    (!key.is_empty() && key.chars().all(is_key)).then_some(key)
}

/// A parser's message as one phrase.
#[must_use]
pub fn phrase(message: &str) -> String {
    message.trim().trim_end_matches('.').replace('\n', ", ")
}
