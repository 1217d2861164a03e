//! Values in place of those of a manifest, as `--set KEY=VALUE` names them.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::fmt;

use toml::{Table, Value};

use crate::manifest::Protocol;

/// What separates two overrides in an environment variable.
const SEPARATOR: char = ';';

/// The key of the bus's protocol.
const PROTOCOL: &str = "bus.protocol";

/// A value in place of the manifest's.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Override {
    key: String,
    value: String,
}

impl Override {
    /// Reads `KEY=VALUE`. The key has its tables in front of it (`rover.law`); a number names an entry of
    /// a list, counted from 0 (`node.0.board`).
    ///
    /// # Errors
    /// A clause that says what is accepted.
    pub fn parse(text: &str) -> Result<Self, String> {
        let wrong = |what: &str| {
            Err(format!(
                "{what}: a key of the manifest, = and its value are accepted, as in rover.law=thesis"
            ))
        };
        let Some((key, value)) = text.split_once('=') else {
            return wrong("it has no =");
        };
        let (key, value) = (key.trim(), value.trim());
        let of_key = |c: char| c.is_ascii_alphanumeric() || "_-".contains(c);
        let mut parts = key.split('.');
        if !parts.all(|part| !part.is_empty() && part.chars().all(of_key)) {
            return wrong(&format!("{key:?} is no key"));
        }
        if value.is_empty() {
            return wrong("it has no value");
        }
        if value.contains(SEPARATOR) || value.chars().any(char::is_control) {
            return wrong(&format!(
                "the value has a {SEPARATOR} or a control character"
            ));
        }
        Ok(Self {
            key: key.into(),
            value: value.into(),
        })
    }

    /// The value as TOML. Where the manifest has a quantity, a number alone takes its unit.
    fn toml(&self, before: Option<&Value>) -> Value {
        let text = format!("value = {}", self.value);
        let read = text.parse::<Table>().ok();
        let read = read.and_then(|mut table| table.remove("value"));
        match (before, read) {
            (Some(Value::String(before)), Some(Value::Integer(_) | Value::Float(_))) => {
                let unit = before.split_once(' ').map(|(_, unit)| format!(" {unit}"));
                Value::String(self.value.clone() + &unit.unwrap_or_default())
            }
            (_, Some(value)) => value,
            (_, None) => Value::String(self.value.clone()),
        }
    }

    /// Puts the value into a manifest.
    fn apply(&self, manifest: &mut Table) -> Result<(), String> {
        let no_table = |of: &str| format!("{of} is no table");
        let mut parts: Vec<&str> = self.key.split('.').collect();
        let last = parts.pop().unwrap_or_default();
        let mut path = String::new();
        let mut place: Option<&mut Value> = None;
        for part in parts {
            let inner = match place {
                None => manifest.entry(part).or_insert_with(empty),
                Some(Value::Table(table)) => table.entry(part).or_insert_with(empty),
                Some(Value::Array(list)) => entry(list, part, &path)?,
                Some(_) => return Err(no_table(&path)),
            };
            path = if path.is_empty() {
                part.into()
            } else {
                format!("{path}.{part}")
            };
            place = Some(inner);
        }
        let table = match place {
            None => manifest,
            Some(Value::Table(table)) => table,
            Some(Value::Array(list)) => {
                let slot = entry(list, last, &path)?;
                *slot = self.toml(Some(slot));
                return Ok(());
            }
            Some(_) => return Err(no_table(&path)),
        };
        let value = self.toml(table.get(last));
        table.insert(last.into(), value);
        Ok(())
    }
}

impl fmt::Display for Override {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}={}", self.key, self.value)
    }
}

fn empty() -> Value {
    Value::Table(Table::new())
}

/// The entry of a list that a part of a key names.
fn entry<'v>(list: &'v mut [Value], part: &str, path: &str) -> Result<&'v mut Value, String> {
    let length = list.len();
    let place = part.parse::<usize>().ok();
    place
        .and_then(|place| list.get_mut(place))
        .ok_or_else(|| format!("{path} has no entry {part}: it has {length}, counted from 0"))
}

/// Values in place of those of a manifest, one for a key.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Overrides(BTreeMap<String, String>);

impl Overrides {
    /// Reads what [`Overrides::environment`] makes.
    ///
    /// # Errors
    /// One of them is wrong, or a key stands twice.
    pub fn parse(text: &str) -> Result<Self, String> {
        let parts = text.split(SEPARATOR).filter(|part| !part.trim().is_empty());
        let all =
            parts.map(|part| Override::parse(part).map_err(|error| format!("{part:?}: {error}")));
        Self::each_once(all.collect::<Result<Vec<_>, _>>()?)
    }

    /// Those of a list that has each key once.
    ///
    /// # Errors
    /// A clause that names both values of a key that stands twice.
    pub fn each_once(all: impl IntoIterator<Item = Override>) -> Result<Self, String> {
        let mut values = BTreeMap::new();
        for Override { key, value } in all {
            match values.entry(key) {
                Entry::Vacant(entry) => entry.insert(value),
                Entry::Occupied(entry) => {
                    return Err(format!(
                        "{key} is given twice, as {} and as {value}: one value of a key is accepted",
                        entry.get(),
                        key = entry.key(),
                    ));
                }
            };
        }
        Ok(Self(values))
    }

    /// The same, and a protocol of the bus.
    #[must_use]
    pub fn on(mut self, protocol: Protocol) -> Self {
        self.0.insert(PROTOCOL.into(), protocol.name().into());
        self
    }

    /// These and others, which count where both name a key.
    #[must_use]
    pub fn and(mut self, others: Self) -> Self {
        self.0.extend(others.0);
        self
    }

    /// Whether they say which protocol the bus has.
    #[must_use]
    pub fn name_protocol(&self) -> bool {
        self.0.contains_key(PROTOCOL)
    }

    /// A key that both these and others have.
    #[must_use]
    pub fn shared_key(&self, others: &Self) -> Option<&str> {
        let mut keys = self.0.keys();
        let shared = keys.find(|key| others.0.contains_key(*key));
        shared.map(String::as_str)
    }

    /// One of these of which others have no value for the same key.
    #[must_use]
    pub fn missing_in(&self, others: &Self) -> Option<Override> {
        self.iter().find(|one| !others.0.contains_key(&one.key))
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Each as `KEY=VALUE`, in the order of the keys.
    #[must_use]
    pub fn texts(&self) -> Vec<String> {
        self.iter().map(|one| one.to_string()).collect()
    }

    /// As the value of an environment variable.
    #[must_use]
    pub fn environment(&self) -> String {
        self.texts().join(";")
    }

    /// As the end of a folder's name. Others have other names.
    #[must_use]
    pub fn folder_name(&self) -> String {
        const LONGEST: usize = 80;
        let text = self.texts().join(",");
        let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || "_-.,=".contains(c);
        if text.len() <= LONGEST && text.chars().all(plain) {
            return text;
        }
        let safe = text.chars().map(|c| if plain(c) { c } else { '-' });
        let safe: String = safe.take(LONGEST).collect();
        format!("{safe}+{:016x}", fnv1a(text.as_bytes()))
    }

    fn iter(&self) -> impl Iterator<Item = Override> {
        self.0.iter().map(|(key, value)| Override {
            key: key.clone(),
            value: value.clone(),
        })
    }

    /// Puts them into a manifest.
    ///
    /// # Errors
    /// One of them leads nowhere; the clause names it.
    pub(crate) fn apply(&self, manifest: &mut Table) -> Result<(), String> {
        self.iter().try_for_each(|one| {
            one.apply(manifest)
                .map_err(|error| format!("{one}: {error}"))
        })
    }
}

/// Of two values for one key the later one counts; [`Overrides::each_once`] refuses them.
impl FromIterator<Override> for Overrides {
    fn from_iter<I: IntoIterator<Item = Override>>(all: I) -> Self {
        Self(all.into_iter().map(|one| (one.key, one.value)).collect())
    }
}

impl fmt::Display for Overrides {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (place, one) in self.iter().enumerate() {
            let before = if place == 0 { "" } else { ", " };
            write!(f, "{before}{one}")?;
        }
        Ok(())
    }
}

/// FNV-1a, 64 bits: the same on every machine and in every build.
fn fnv1a(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xCBF2_9CE4_8422_2325, |hash, byte| {
        (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01B3)
    })
}
