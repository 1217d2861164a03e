//! Writes windows into the text of a network file.
//!
//! Only the values that change are replaced and only the statements that are
//! missing are added; every other byte of the file stays as it is.

use std::{fmt::Write, ops::Range};

use crate::network::{Network, SendType, Window, WindowKind};

/// The windows that a message is to have.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Assigned {
    /// Identifier of the message.
    pub id: u16,
    /// Period in milliseconds, for cyclic messages.
    pub period_ms: Option<u32>,
    /// Its windows, all of the same length and kind; the first one stands in
    /// `WindowStart` and so on, the others in `FurtherWindows`.
    pub windows: Vec<Window>,
}

/// A schedule for a network file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Assignment {
    /// Length of the basic cycle in microseconds.
    pub basic_cycle_us: u32,
    /// Number of basic cycles.
    pub basic_cycles: u8,
    /// The messages.
    pub messages: Vec<Assigned>,
}

impl Assignment {
    /// The schedule that a network has.
    pub fn of(network: &Network) -> Self {
        let messages = network.messages.iter().map(|message| Assigned {
            id: message.id,
            period_ms: match message.send_type {
                SendType::Cyclic { period_ms } => Some(period_ms),
                SendType::Event { .. } => None,
            },
            windows: message.windows().collect(),
        });
        Self {
            basic_cycle_us: network.basic_cycle_us,
            basic_cycles: network.basic_cycles,
            messages: messages.collect(),
        }
    }

    /// The text of a network file with this schedule.
    ///
    /// `text` must be one that [`Network::parse_unscheduled`] accepts.
    pub fn write(&self, text: &str) -> String {
        let mut editor = Editor::new(text);
        editor.set(None, "BasicCycle", self.basic_cycle_us.to_string());
        editor.set(None, "BasicCycles", self.basic_cycles.to_string());
        for message in &self.messages {
            let Some(first) = message.windows.first() else {
                continue;
            };
            let id = Some(message.id);
            if let Some(period) = message.period_ms {
                editor.set(id, "GenMsgCycleTime", period.to_string());
            }
            editor.set(id, "WindowKind", kind(first.kind).to_string());
            editor.set(id, "WindowStart", first.start_us.to_string());
            editor.set(id, "WindowLength", first.length_us.to_string());
            editor.set(id, "WindowRepeat", first.repeat.to_string());
            editor.set(id, "WindowOffset", first.offset.to_string());
            editor.set(id, "FurtherWindows", further(&message.windows));
        }
        editor.finish()
    }
}

/// Names of the kinds of windows, in the order of their numbers in the file.
const KINDS: [&str; 4] = ["None", "Reference", "Exclusive", "Arbitrating"];

fn kind(kind: WindowKind) -> usize {
    match kind {
        WindowKind::Reference => 1,
        WindowKind::Exclusive => 2,
        WindowKind::Arbitrating => 3,
    }
}

fn further(windows: &[Window]) -> String {
    let items = windows
        .iter()
        .skip(1)
        .map(|window| format!("{} {} {}", window.start_us, window.repeat, window.offset));
    format!("\"{}\"", items.collect::<Vec<_>>().join(", "))
}

/// Attributes that the file must define before it can use them: name, definition, default.
const DEFINITIONS: [(&str, &str, &str); 9] = [
    ("BasicCycle", "INT 1000 1000000", "0"),
    ("BasicCycles", "INT 1 64", "1"),
    ("GenMsgCycleTime", "INT 0 65535", "0"),
    (
        "WindowKind",
        "ENUM \"None\",\"Reference\",\"Exclusive\",\"Arbitrating\"",
        "\"None\"",
    ),
    ("WindowStart", "INT 0 1000000", "0"),
    ("WindowLength", "INT 0 1000000", "0"),
    ("WindowRepeat", "INT 1 64", "1"),
    ("WindowOffset", "INT 0 63", "0"),
    ("FurtherWindows", "STRING", "\"\""),
];

/// A token of the text: a word, a quoted string or a sign.
#[derive(Clone)]
struct Token {
    at: Range<usize>,
    /// True if only spaces and tabs separate it from the token before.
    same_line: bool,
}

/// A statement of an attribute: its definition, default or value.
struct Statement {
    keyword: &'static str,
    name: String,
    /// `BO_` and the identifier, for a message's value.
    message: Option<u16>,
    /// True if it belongs to something other than the network or a message.
    of_other: bool,
    value: Range<usize>,
    /// Its range in the text, semicolon included.
    whole: Range<usize>,
}

struct Editor<'t> {
    text: &'t str,
    statements: Vec<Statement>,
    /// Where the statements that follow those of attributes begin.
    tail: usize,
    line_end: &'static str,
    replaced: Vec<(Range<usize>, String)>,
    definitions: String,
    defaults: String,
    /// New values, each with the position it goes to.
    values: Vec<(usize, String)>,
}

impl<'t> Editor<'t> {
    fn new(text: &'t str) -> Self {
        let tokens = tokens(text);
        let statements = statements(text, &tokens);
        // Statements that follow attributes in the format.
        let behind = |index: usize| {
            let word = &text[tokens[index].at.clone()];
            let followed = tokens.get(index + 1).is_some_and(|next| next.same_line);
            !tokens[index].same_line
                && followed
                && [
                    "VAL_",
                    "SIG_GROUP_",
                    "SIG_VALTYPE_",
                    "BA_DEF_REL_",
                    "BA_REL_",
                ]
                .contains(&word)
        };
        let tail = (0..tokens.len()).find(|index| behind(*index));
        Self {
            text,
            statements,
            tail: tail.map_or(text.len(), |index| line_start(text, tokens[index].at.start)),
            line_end: if text.contains("\r\n") { "\r\n" } else { "\n" },
            replaced: Vec::new(),
            definitions: String::new(),
            defaults: String::new(),
            values: Vec::new(),
        }
    }

    /// Sets an attribute of the network or of a message to a value.
    fn set(&mut self, message: Option<u16>, name: &str, value: String) {
        let of = |statement: &&Statement| {
            statement.keyword == "BA_"
                && statement.name == name
                && statement.message == message
                && !statement.of_other
        };
        if let Some(found) = self.statements.iter().find(of) {
            if !self.equal(&self.text[found.value.clone()], &value) {
                self.replaced.push((found.value.clone(), value));
            }
            return;
        }
        let default = self
            .statements
            .iter()
            .find(|found| found.keyword == "BA_DEF_DEF_" && found.name == name);
        match default {
            Some(default) if self.equal(&self.text[default.value.clone()], &value) => return,
            // A message without further windows does not need the attribute.
            None if value == "\"\"" => return,
            _ => {}
        }
        self.define(name, message.is_some());
        let statement = match message {
            Some(id) => format!("BA_ \"{name}\" BO_ {id} {value};{}", self.line_end),
            None => format!("BA_ \"{name}\" {value};{}", self.line_end),
        };
        let position = self.value_position(message);
        self.values.push((position, statement));
    }

    /// Whether two values mean the same; kinds of windows have numbers and names.
    fn equal(&self, one: &str, other: &str) -> bool {
        let plain = |value: &str| {
            let word = value.trim_matches('"');
            let kind = KINDS.iter().position(|kind| *kind == word);
            kind.map_or_else(|| word.to_owned(), |kind| kind.to_string())
        };
        plain(one) == plain(other)
    }

    fn define(&mut self, name: &str, of_message: bool) {
        let defined = |keyword: &str| {
            let same = |found: &&Statement| found.keyword == keyword && found.name == name;
            self.statements.iter().any(|found| same(&found))
        };
        let Some((_, kind, default)) = DEFINITIONS.iter().find(|known| known.0 == name) else {
            return;
        };
        let quoted = format!("\"{name}\"");
        let of = if of_message { "BO_ " } else { "" };
        let (is_defined, has_default) = (defined("BA_DEF_"), defined("BA_DEF_DEF_"));
        // Writing to a string cannot fail.
        if !is_defined && !self.definitions.contains(&quoted) {
            let _ = write!(
                self.definitions,
                "BA_DEF_ {of}{quoted} {kind};{}",
                self.line_end
            );
        }
        if !has_default && !self.defaults.contains(&quoted) {
            let _ = write!(
                self.defaults,
                "BA_DEF_DEF_ {quoted} {default};{}",
                self.line_end
            );
        }
    }

    /// Where to insert a value: after the message's other values, or else after all values.
    fn value_position(&self, message: Option<u16>) -> usize {
        let of_message = |found: &&Statement| {
            found.keyword == "BA_" && message.is_some() && found.message == message
        };
        match self.statements.iter().rfind(of_message) {
            Some(last) => self.line_after(last.whole.end),
            None => self.position("BA_"),
        }
    }

    /// The position after the last statement of a keyword, or where its first one would be.
    fn position(&self, keyword: &str) -> usize {
        const ORDER: [&str; 3] = ["BA_DEF_", "BA_DEF_DEF_", "BA_"];
        let rank = |keyword: &str| ORDER.iter().position(|known| *known == keyword);
        let mut not_behind = self
            .statements
            .iter()
            .filter(|s| rank(s.keyword) <= rank(keyword));
        if let Some(last) = not_behind.next_back() {
            return self.line_after(last.whole.end);
        }
        match self.statements.first() {
            Some(first) => line_start(self.text, first.whole.start),
            None => self.tail,
        }
    }

    /// The beginning of the next line.
    fn line_after(&self, at: usize) -> usize {
        let rest = &self.text[at..];
        rest.find('\n').map_or(self.text.len(), |end| at + end + 1)
    }

    fn finish(mut self) -> String {
        let mut edits = std::mem::take(&mut self.replaced);
        let mut insert = |at: usize, what: String| {
            if !what.is_empty() {
                edits.push((at..at, what));
            }
        };
        insert(
            self.position("BA_DEF_"),
            std::mem::take(&mut self.definitions),
        );
        insert(
            self.position("BA_DEF_DEF_"),
            std::mem::take(&mut self.defaults),
        );
        for (at, what) in std::mem::take(&mut self.values) {
            insert(at, what);
        }
        // A stable sort: edits at the same position keep their order.
        edits.sort_by_key(|(range, _)| range.start);
        let mut out = String::with_capacity(self.text.len() + 64 * edits.len());
        let mut copied = 0;
        for (range, what) in edits {
            out.push_str(&self.text[copied..range.start]);
            let starts_line = range.is_empty() && !out.is_empty() && !out.ends_with('\n');
            if starts_line {
                out.push_str(self.line_end);
            }
            out.push_str(&what);
            copied = range.end;
        }
        out.push_str(&self.text[copied..]);
        out
    }
}

fn line_start(text: &str, at: usize) -> usize {
    text[..at].rfind('\n').map_or(0, |end| end + 1)
}

fn tokens(text: &str) -> Vec<Token> {
    let bytes = text.as_bytes();
    let mut tokens = Vec::new();
    let (mut at, mut same_line) = (0, false);
    while let Some(&byte) = bytes.get(at) {
        let start = at;
        match byte {
            b'\n' => {
                same_line = false;
                at += 1;
                continue;
            }
            _ if byte.is_ascii_whitespace() => {
                at += 1;
                continue;
            }
            b'"' => {
                at += 1;
                while at < bytes.len() && bytes[at] != b'"' {
                    // A quotation mark may be escaped.
                    let escaped = bytes[at] == b'\\' && bytes.get(at + 1) == Some(&b'"');
                    at += if escaped { 2 } else { 1 };
                }
                at = (at + 1).min(bytes.len());
            }
            b';' | b':' | b',' => at += 1,
            _ => {
                let ends = |byte: &u8| byte.is_ascii_whitespace() || b"\";:,".contains(byte);
                at += bytes[at..]
                    .iter()
                    .position(ends)
                    .unwrap_or(bytes.len() - at);
            }
        }
        tokens.push(Token {
            at: start..at,
            same_line,
        });
        same_line = true;
    }
    tokens
}

fn statements(text: &str, tokens: &[Token]) -> Vec<Statement> {
    let word = |index: usize| {
        tokens
            .get(index)
            .map_or("", |token| &text[token.at.clone()])
    };
    let mut statements = Vec::new();
    let mut index = 0;
    while index < tokens.len() {
        let begin = index;
        index += 1;
        let keyword = match word(begin) {
            "BA_" => "BA_",
            "BA_DEF_" => "BA_DEF_",
            "BA_DEF_DEF_" => "BA_DEF_DEF_",
            _ => continue,
        };
        let of = if keyword == "BA_DEF_" && !word(index).starts_with('"') {
            index += 1;
            word(index - 1)
        } else {
            ""
        };
        // The list of keywords at the beginning of the file contains them, too.
        if !word(index).starts_with('"') {
            continue;
        }
        let name = word(index).trim_matches('"').to_owned();
        let end = (index..tokens.len()).find(|at| word(*at) == ";");
        let Some(end) = end.filter(|end| *end > index + 1) else {
            continue;
        };
        let target = word(index + 1);
        let message = match target {
            "BO_" => word(index + 2).parse().ok(),
            _ => None,
        };
        statements.push(Statement {
            keyword,
            name,
            message,
            of_other: !of.is_empty() || ["BU_", "SG_", "EV_"].contains(&target),
            value: tokens[end - 1].at.clone(),
            whole: tokens[begin].at.start..tokens[end].at.end,
        });
        index = end + 1;
    }
    statements
}
