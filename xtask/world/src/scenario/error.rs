//! Formats every error of a scenario as one sentence.

use core::fmt;

use vehicle_model::text::{line, phrase};

/// Why a scenario cannot be used. Displays as one sentence.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ScenarioError {
    sentence: String,
}

impl fmt::Display for ScenarioError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.sentence)
    }
}

impl core::error::Error for ScenarioError {}

impl ScenarioError {
    /// `names` are the vehicle's scenarios outside folders, and those in folders that may be meant; `inside` are those in
    /// folders; `others` the vehicles that have one of this name.
    pub(super) fn unknown(
        name: &str,
        vehicle: &str,
        names: &[String],
        inside: &[String],
        others: &[String],
    ) -> Self {
        let choice = match names {
            [] => format!("vehicle {vehicle:?} has none of its own, name"),
            names => format!("name one of {} or", names.join(", ")),
        };
        let more = match inside {
            [] => String::new(),
            inside => format!("; in folders it has {}", inside.join(", ")),
        };
        let elsewhere = match others {
            [] => String::new(),
            others => format!("; --vehicle {} has one", others.join(" or ")),
        };
        Self {
            sentence: format!(
                "there is no scenario {name:?} of vehicle {vehicle:?}: {choice} the path of a TOML \
                 file{more}{elsewhere}"
            ),
        }
    }

    pub(super) fn unreadable(path: &str, error: &std::io::Error) -> Self {
        let why = match error.kind() {
            std::io::ErrorKind::NotFound => "there is no such file".to_owned(),
            std::io::ErrorKind::PermissionDenied => "permission denied".to_owned(),
            std::io::ErrorKind::InvalidData => "it is not text in UTF-8".to_owned(),
            std::io::ErrorKind::IsADirectory => "it is a folder".to_owned(),
            _ => error.to_string(),
        };
        Self {
            sentence: format!("scenario {path} cannot be read: {why}"),
        }
    }

    pub(super) fn syntax(place: &str, text: &str, error: &toml::de::Error) -> Self {
        let line = line(text, error.span().map_or(0, |span| span.start));
        Self {
            sentence: format!(
                "scenario {place}, line {line}, is not TOML: {}",
                phrase(error.message())
            ),
        }
    }

    pub(super) fn field(
        place: &str,
        text: &str,
        error: &serde_path_to_error::Error<toml::de::Error>,
    ) -> Self {
        let path = error.path().to_string();
        let inner = error.inner();
        let line = line(text, inner.span().map_or(0, |span| span.start));
        let message = phrase(inner.message());
        let sentence = if path == "." || path == "?" {
            format!("scenario {place}, line {line}: {message}")
        } else {
            format!("scenario {place}, line {line}, {path}: {message}")
        };
        Self { sentence }
    }

    pub(super) fn value(place: &str, problem: &str) -> Self {
        Self {
            sentence: format!("scenario {place}, {problem}"),
        }
    }
}
