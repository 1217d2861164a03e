//! The names of the interfaces in a log.

/// Most interfaces of one log.
const MOST: usize = 64;
/// Longest name of an interface, in bytes. Linux allows 15.
const LONGEST: usize = 32;

/// The names, each once.
#[derive(Clone, Debug, Default)]
pub(super) struct Channels {
    names: Vec<String>,
    /// The channel of the last line, which is most likely that of the next one.
    last: usize,
}

impl Channels {
    /// The names in the order in which they came.
    pub(super) fn names(&self) -> &[String] {
        &self.names
    }

    /// The index of a name; `None` if it is too long or not text that can be shown, or there are too
    /// many names.
    pub(super) fn index(&mut self, name: &[u8]) -> Option<u8> {
        let is = |known: &String| known.as_bytes() == name;
        if !self.names.get(self.last).is_some_and(is) {
            self.last = match self.names.iter().position(is) {
                Some(index) => index,
                None if self.names.len() < MOST && name.len() <= LONGEST => {
                    let name = std::str::from_utf8(name).ok()?;
                    if name.chars().any(char::is_control) {
                        return None;
                    }
                    self.names.push(name.to_owned());
                    self.names.len() - 1
                }
                None => return None,
            };
        }
        u8::try_from(self.last).ok()
    }
}
