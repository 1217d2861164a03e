//! From the text of a DBC file to a [`Network`].

use can_dbc::{
    AttributeDefinition, AttributeValue, Comment, Dbc, MessageId, NumericValue, ValueDescription,
};

use crate::{
    check::check,
    network::{Condition, Message, Network, Node, SendType, Value, ValueTable, Window, WindowKind},
    problem::{Problem, Problems},
    signal::{ByteOrder, Signal},
};

impl Network {
    /// Reads a network file and checks it.
    ///
    /// # Errors
    ///
    /// Everything that is wrong with the file: its syntax, or else each signal
    /// outside its message, each window that does not fit, and so on, by name
    /// and line.
    pub fn parse(text: &str) -> Result<Network, Problems> {
        Self::read(text, false)
    }

    /// Reads a network file whose windows are still to be found. Messages need no windows, and
    /// any that they have are not checked. A message without a kind of window gets the kind
    /// that suits its use.
    ///
    /// # Errors
    ///
    /// Everything else that is wrong with the file, as for [`Network::parse`].
    pub fn parse_unscheduled(text: &str) -> Result<Network, Problems> {
        Self::read(text, true)
    }

    fn read(text: &str, unscheduled: bool) -> Result<Network, Problems> {
        let dbc = Dbc::try_from(text).map_err(|error| {
            Problems(vec![Problem {
                line: None,
                what: format!("not a DBC file: {error}"),
            }])
        })?;
        let mut reader = Reader {
            dbc: &dbc,
            text,
            unscheduled,
            problems: Vec::new(),
        };
        let network = reader.network();
        let mut problems = reader.problems;
        if problems.is_empty() {
            problems = check(&network, unscheduled);
        }
        if problems.is_empty() {
            Ok(network)
        } else {
            Err(Problems(problems))
        }
    }
}

/// The attributes that are read. A file may also define its own, for other tools.
const ATTRIBUTES: [&str; 21] = [
    "After",
    "BasicCycle",
    "BasicCycles",
    "Baudrate",
    "Deadline",
    "FurtherWindows",
    "GenMsgCycleTime",
    "GenMsgDelayTime",
    "GenMsgSendType",
    "InsteadOf",
    "MasterRank",
    "Preparation",
    "SendCondition",
    "ShortestLength",
    "SyncUncertainty",
    "TransmitEnable",
    "WindowKind",
    "WindowLength",
    "WindowOffset",
    "WindowRepeat",
    "WindowStart",
];

struct Reader<'a> {
    dbc: &'a Dbc,
    text: &'a str,
    /// True if the windows are still to be found.
    unscheduled: bool,
    problems: Vec<Problem>,
}

impl Reader<'_> {
    fn problem(&mut self, line: Option<usize>, what: String) {
        self.problems.push(Problem { line, what });
    }

    /// The first line that begins with these words, white space aside.
    fn line(&self, words: &[&str]) -> Option<usize> {
        self.line_after(0, words)
    }

    fn line_after(&self, after: usize, words: &[&str]) -> Option<usize> {
        self.text
            .lines()
            .enumerate()
            .skip(after)
            .find(|(_, line)| {
                let mut found = line.split([' ', '\t', ':', ';']).filter(|w| !w.is_empty());
                words.iter().all(|word| found.next() == Some(word))
            })
            .map(|(index, _)| index + 1)
    }

    fn network(&mut self) -> Network {
        self.attributes();
        let value_tables = self.value_tables();
        let nodes = self.nodes();
        let mut messages: Vec<Message> = Vec::new();
        for message in &self.dbc.messages {
            if let Some(message) = self.message(message, &value_tables) {
                messages.push(message);
            }
        }
        messages.sort_by_key(|message| (message.window, message.id));
        let comment = self.dbc.comments.iter().find_map(|comment| match comment {
            Comment::Plain { comment } => Some(comment.clone()),
            _ => None,
        });
        Network {
            comment: comment.unwrap_or_default(),
            bit_rate: self.network_number("Baudrate"),
            basic_cycle_us: self.planned_number("BasicCycle"),
            basic_cycles: self.planned_number("BasicCycles"),
            sync_uncertainty_us: self.network_number("SyncUncertainty"),
            transmit_enable_bits: self.network_number("TransmitEnable"),
            nodes,
            messages,
            value_tables,
        }
    }

    /// A number that belongs to the schedule; the default value while there is none.
    fn planned_number<T: TryFrom<i64> + Default>(&mut self, name: &str) -> T {
        if self.unscheduled {
            T::default()
        } else {
            self.network_number(name)
        }
    }

    fn network_number<T: TryFrom<i64> + Default>(&mut self, name: &str) -> T {
        let quoted = format!("\"{name}\"");
        let value = self
            .dbc
            .attribute_values_database
            .iter()
            .find(|attribute| attribute.name == name)
            .map(|attribute| attribute.value.clone())
            .or_else(|| self.dbc.attribute_default(name).cloned());
        let line = self.line(&["BA_", &quoted]);
        self.number(name, "the network", value, line)
    }

    fn number<T: TryFrom<i64> + Default>(
        &mut self,
        name: &str,
        of: &str,
        value: Option<AttributeValue>,
        line: Option<usize>,
    ) -> T {
        let Some(value) = value else {
            self.problem(line, format!("{of} lacks the attribute {name}"));
            return T::default();
        };
        integer(&value)
            .and_then(|value| T::try_from(value).ok())
            .unwrap_or_else(|| {
                self.problem(
                    line,
                    format!(
                        "{name} of {of} is {}, not a whole number in range",
                        text_of(&value)
                    ),
                );
                T::default()
            })
    }

    fn nodes(&mut self) -> Vec<Node> {
        let mut nodes = Vec::new();
        for node in &self.dbc.nodes {
            let name = node.0.clone();
            let value = self
                .dbc
                .attribute_values_node
                .iter()
                .find(|attribute| attribute.name == "MasterRank" && attribute.node_name == name)
                .map(|attribute| attribute.value.clone())
                .or_else(|| self.dbc.attribute_default("MasterRank").cloned())
                .unwrap_or(AttributeValue::Int(-1));
            let line = self.line(&["BA_", "\"MasterRank\"", "BU_", &name]);
            let rank: i64 = self.number("MasterRank", &format!("node {name}"), Some(value), line);
            if !(-1..=7).contains(&rank) {
                self.problem(
                    line,
                    format!("node {name} has the master rank {rank}: 0 to 7, or -1 for none"),
                );
            }
            let comment = self.dbc.comments.iter().find_map(|comment| match comment {
                Comment::Node { name: of, comment } if *of == name => Some(comment.clone()),
                _ => None,
            });
            nodes.push(Node {
                name,
                comment: comment.unwrap_or_default(),
                master_rank: u8::try_from(rank).ok(),
            });
        }
        nodes
    }

    fn value_tables(&mut self) -> Vec<ValueTable> {
        self.dbc
            .value_tables
            .iter()
            .map(|table| ValueTable {
                name: table.name.clone(),
                values: values(&table.descriptions),
            })
            .collect()
    }

    fn message(&mut self, message: &can_dbc::Message, tables: &[ValueTable]) -> Option<Message> {
        let name = &message.name;
        let raw = message.id.raw().to_string();
        let line = self.line(&["BO_", &raw]);
        let MessageId::Standard(id) = message.id else {
            self.problem(
                line,
                format!(
                    "message {name} has an extended identifier: only 11-bit ones are supported"
                ),
            );
            return None;
        };
        let of = format!("message {name} ({id})");
        let Some(sender) = message.transmitter.clone().filter(|s| s != "Vector__XXX") else {
            self.problem(line, format!("{of} has no sender"));
            return None;
        };
        let Some(length) = u8::try_from(message.size).ok().filter(|size| *size <= 8) else {
            self.problem(
                line,
                format!("{of} has {} data bytes: 0 to 8 fit a frame", message.size),
            );
            return None;
        };
        let shortest = self.shortest(message, length);
        let send_type = self.send_type(message);
        let condition = match self.word(message, "SendCondition", &["Always", "WhileFixed"]) {
            Some("WhileFixed") => Condition::WhileFixed,
            _ => Condition::Always,
        };
        let deadline_us = match self.dbc.resolved_message_attribute(message.id, "Deadline") {
            Some(_) => Some(self.message_number(message.id, name, "Deadline")).filter(|us| *us > 0),
            None => None,
        };
        let Some(kind) = self.window_kind(message, send_type) else {
            let what = format!(
                "{of} has no window: set WindowKind to Reference, Exclusive or Arbitrating"
            );
            self.problem(line, what);
            return None;
        };
        let (window, further) = self.windows(message, kind);
        let after = self.after(message);
        let instead_of = self.instead_of(message);
        let retry_late = self.word(message, "RetryLate", &["No", "Yes"]) == Some("Yes");
        let mut signals = Vec::new();
        for signal in &message.signals {
            signals.extend(self.signal(message, signal, tables, line));
        }
        Some(Message {
            id,
            name: name.clone(),
            comment: self
                .dbc
                .message_comment(message.id)
                .unwrap_or_default()
                .into(),
            length,
            shortest,
            sender,
            send_type,
            condition,
            deadline_us,
            window,
            further,
            preparation_us: match after.is_empty() {
                true => 0,
                false => self.message_number(message.id, name, "Preparation"),
            },
            after,
            retry_late,
            instead_of,
            signals,
            line,
        })
    }

    /// Fewest data bytes of a message of `length` bytes.
    fn shortest(&mut self, message: &can_dbc::Message, length: u8) -> u8 {
        const NAME: &str = "ShortestLength";
        let value = self.dbc.resolved_message_attribute(message.id, NAME);
        let Some(value) = value.cloned() else {
            return length;
        };
        match integer(&value).map(u8::try_from) {
            _ if integer(&value) == Some(-1) => length,
            Some(Ok(shortest)) if shortest <= length => shortest,
            _ => {
                self.attribute(
                    message,
                    NAME,
                    &text_of(&value),
                    &format!("0 to {length} data bytes, or -1 for all of them, are accepted"),
                );
                length
            }
        }
    }

    /// Reports the value of a message's attribute that is not accepted.
    fn attribute(&mut self, message: &can_dbc::Message, name: &str, value: &str, accepted: &str) {
        let raw = message.id.raw().to_string();
        let line = self
            .line(&["BA_", &format!("\"{name}\""), "BO_", &raw])
            .or_else(|| self.line(&["BA_DEF_DEF_", &format!("\"{name}\"")]));
        let of = &message.name;
        self.problem(
            line,
            format!("{name} of message {of} ({raw}) is {value}: {accepted}"),
        );
    }

    /// Looks for attributes that neither this reader nor the file knows, and for those of messages
    /// and nodes that are not there.
    fn attributes(&mut self) {
        let dbc = self.dbc;
        let known = |name: &str| {
            ATTRIBUTES.contains(&name)
                || dbc.attribute_definitions.iter().any(|definition| {
                    let (AttributeDefinition::Message(of, _)
                    | AttributeDefinition::Node(of, _)
                    | AttributeDefinition::Signal(of, _)
                    | AttributeDefinition::EnvironmentVariable(of, _)
                    | AttributeDefinition::Plain(of, _)) = definition;
                    of == name
                })
        };
        let of_network = dbc.attribute_values_database.iter();
        let of_nodes = dbc.attribute_values_node.iter();
        let of_messages = dbc.attribute_values_message.iter();
        let names = of_network
            .map(|value| &value.name)
            .chain(of_nodes.clone().map(|value| &value.name))
            .chain(of_messages.clone().map(|value| &value.name));
        for name in names.filter(|name| !known(name)) {
            let line = self.line(&["BA_", &format!("\"{name}\"")]);
            let what = format!("there is no attribute {name}: one with a BA_DEF_ is accepted");
            self.problem(line, what);
        }
        for value in of_nodes {
            let node = &value.node_name;
            if !dbc.nodes.iter().any(|other| other.0 == *node) {
                let line = self.line(&["BA_", &format!("\"{}\"", value.name), "BU_", node]);
                let what = format!("{} of node {node}: there is no such node", value.name);
                self.problem(line, what);
            }
        }
        for value in of_messages {
            let raw = value.message_id.raw().to_string();
            if !dbc.messages.iter().any(|of| of.id == value.message_id) {
                let line = self.line(&["BA_", &format!("\"{}\"", value.name), "BO_", &raw]);
                let what = format!("{} of message {raw}: there is no such message", value.name);
                self.problem(line, what);
            }
        }
    }

    fn send_type(&mut self, message: &can_dbc::Message) -> SendType {
        let name = &message.name;
        match self.word(message, "GenMsgSendType", &["Cyclic", "Event"]) {
            Some("Event") => SendType::Event {
                interval_ms: self.message_number(message.id, name, "GenMsgDelayTime"),
            },
            _ => SendType::Cyclic {
                period_ms: self.message_number(message.id, name, "GenMsgCycleTime"),
            },
        }
    }

    /// Name of the message in whose place a message is sent.
    fn instead_of(&mut self, message: &can_dbc::Message) -> Option<String> {
        match self.dbc.resolved_message_attribute(message.id, "InsteadOf") {
            Some(AttributeValue::String(name)) => {
                Some(name.clone()).filter(|name| !name.is_empty())
            }
            Some(other) => {
                let accepted = "the name of a message in quotation marks is accepted";
                let text = text_of(other);
                self.attribute(message, "InsteadOf", &text, accepted);
                None
            }
            None => None,
        }
    }

    /// Names of the messages that a message's sender needs first.
    fn after(&mut self, message: &can_dbc::Message) -> Vec<String> {
        let dbc = self.dbc;
        match dbc.resolved_message_attribute(message.id, "After") {
            Some(AttributeValue::String(names)) => names
                .split([' ', ','])
                .filter(|name| !name.is_empty())
                .map(str::to_owned)
                .collect(),
            Some(other) => {
                let accepted = "the names of messages in quotation marks are accepted";
                self.attribute(message, "After", &text_of(other), accepted);
                Vec::new()
            }
            None => Vec::new(),
        }
    }

    /// The kind of a message's window. If the windows are still to be found, a message without
    /// a kind gets one from its use.
    fn window_kind(
        &mut self,
        message: &can_dbc::Message,
        send_type: SendType,
    ) -> Option<WindowKind> {
        const KINDS: [&str; 4] = ["None", "Reference", "Exclusive", "Arbitrating"];
        match self.word(message, "WindowKind", &KINDS) {
            Some("Reference") => Some(WindowKind::Reference),
            Some("Exclusive") => Some(WindowKind::Exclusive),
            Some("Arbitrating") => Some(WindowKind::Arbitrating),
            _ if self.unscheduled && self.begins_cycles(message) => Some(WindowKind::Reference),
            _ if self.unscheduled => Some(match send_type {
                SendType::Cyclic { .. } => WindowKind::Exclusive,
                SendType::Event { .. } => WindowKind::Arbitrating,
            }),
            _ => None,
        }
    }

    /// The first window of a message, and the further ones.
    fn windows(&mut self, message: &can_dbc::Message, kind: WindowKind) -> (Window, Vec<Window>) {
        if self.unscheduled {
            return (Window::of_kind(kind), Vec::new());
        }
        let name = &message.name;
        let window = Window {
            start_us: self.message_number(message.id, name, "WindowStart"),
            length_us: self.message_number(message.id, name, "WindowLength"),
            repeat: self.message_number(message.id, name, "WindowRepeat"),
            offset: self.message_number(message.id, name, "WindowOffset"),
            kind,
        };
        (window, self.further(message, window))
    }

    /// Whether its sender may be a time master and it has the signals of a reference message.
    fn begins_cycles(&self, message: &can_dbc::Message) -> bool {
        let master = message.transmitter.as_ref().is_some_and(|sender| {
            let values = &self.dbc.attribute_values_node;
            values.iter().any(|attribute| {
                attribute.name == "MasterRank"
                    && attribute.node_name == *sender
                    && integer(&attribute.value).is_some_and(|rank| rank >= 0)
            })
        });
        let has = |name: &str| message.signals.iter().any(|signal| signal.name == name);
        master && has("CycleCount") && has("Discontinuity") && has("NextIsGap")
    }

    /// The windows that `FurtherWindows` adds to the first one.
    fn further(&mut self, message: &can_dbc::Message, first: Window) -> Vec<Window> {
        const NAME: &str = "FurtherWindows";
        let Some(value) = self.dbc.resolved_message_attribute(message.id, NAME) else {
            return Vec::new();
        };
        let text = match value {
            AttributeValue::String(text) => text.clone(),
            other => text_of(other),
        };
        let windows: Option<Vec<Window>> = text
            .split(',')
            .filter(|item| !item.trim().is_empty())
            .map(|item| further_window(item, first))
            .collect();
        windows.unwrap_or_else(|| {
            let raw = message.id.raw().to_string();
            let line = self.line(&["BA_", "\"FurtherWindows\"", "BO_", &raw]);
            let what = format!(
                "{NAME} of message {} ({raw}) is \"{text}\": \"start repeat offset\" is accepted, several with commas between them",
                message.name
            );
            self.problem(line, what);
            Vec::new()
        })
    }

    fn message_number<T: TryFrom<i64> + Default>(
        &mut self,
        id: MessageId,
        message: &str,
        name: &str,
    ) -> T {
        let value = self.dbc.resolved_message_attribute(id, name).cloned();
        let raw = id.raw().to_string();
        let line = self.line(&["BA_", &format!("\"{name}\""), "BO_", &raw]);
        let of = format!("message {message} ({raw})");
        self.number(name, &of, value, line)
    }

    /// An attribute of an enumeration type, given by number or by word; `None` if it is not
    /// given, or after a problem.
    fn word<'w>(
        &mut self,
        message: &can_dbc::Message,
        name: &str,
        words: &[&'w str],
    ) -> Option<&'w str> {
        let dbc = self.dbc;
        let value = dbc.resolved_message_attribute(message.id, name)?;
        let word = match value {
            AttributeValue::String(word) => words.iter().find(|w| *w == word),
            number => integer(number)
                .and_then(|index| usize::try_from(index).ok())
                .and_then(|index| words.get(index)),
        };
        if word.is_none() {
            let accepted = format!(
                "{} are accepted, or their numbers from 0 on",
                words.join(", ")
            );
            self.attribute(message, name, &text_of(value), &accepted);
        }
        word.copied()
    }

    fn signal(
        &mut self,
        message: &can_dbc::Message,
        signal: &can_dbc::Signal,
        tables: &[ValueTable],
        message_line: Option<usize>,
    ) -> Option<Signal> {
        let line = self.line_after(message_line.unwrap_or(0), &["SG_", &signal.name]);
        let of = format!("signal {} of message {}", signal.name, message.name);
        if signal.multiplexer_indicator != can_dbc::MultiplexIndicator::Plain {
            self.problem(line, format!("{of} is multiplexed: that is not supported"));
            return None;
        }
        let size = u8::try_from(signal.size)
            .ok()
            .filter(|s| (1..=64).contains(s));
        let start = u16::try_from(signal.start_bit).ok().filter(|s| *s < 64);
        let (Some(size), Some(start_bit)) = (size, start) else {
            self.problem(
                line,
                format!(
                    "{of} has {} bits from bit {}: 64 bits fit",
                    signal.size, signal.start_bit
                ),
            );
            return None;
        };
        let described =
            self.dbc
                .value_descriptions
                .iter()
                .find_map(|description| match description {
                    ValueDescription::Signal {
                        message_id,
                        name,
                        value_descriptions,
                    } if *message_id == message.id && *name == signal.name => {
                        Some(values(value_descriptions))
                    }
                    _ => None,
                });
        let values = match described {
            None => None,
            Some(described) => {
                let table = tables.iter().find(|table| table.values == described);
                if table.is_none() {
                    self.problem(
                        self.line(&["VAL_", &message.id.raw().to_string(), &signal.name]),
                        format!("the values of {of} equal no VAL_TABLE_: give them a named one"),
                    );
                }
                table.map(|table| table.name.clone())
            }
        };
        let comment = self.dbc.signal_comment(message.id, &signal.name);
        Some(Signal {
            name: signal.name.clone(),
            comment: comment.unwrap_or_default().into(),
            start_bit,
            size,
            byte_order: match signal.byte_order {
                can_dbc::ByteOrder::LittleEndian => ByteOrder::Little,
                can_dbc::ByteOrder::BigEndian => ByteOrder::Big,
            },
            signed: signal.value_type == can_dbc::ValueType::Signed,
            factor: signal.factor,
            offset: signal.offset,
            min: float(&signal.min),
            max: float(&signal.max),
            unit: signal.unit.clone(),
            receivers: signal.receivers.clone(),
            values,
            line,
        })
    }
}

/// A further window from its start, repeat factor and offset.
fn further_window(text: &str, first: Window) -> Option<Window> {
    let mut words = text.split_whitespace();
    let window = Window {
        start_us: words.next()?.parse().ok()?,
        repeat: words.next()?.parse().ok()?,
        offset: words.next()?.parse().ok()?,
        ..first
    };
    words.next().is_none().then_some(window)
}

fn values(descriptions: &[can_dbc::ValDescription]) -> Vec<Value> {
    let mut values: Vec<Value> = descriptions
        .iter()
        .map(|value| Value {
            raw: value.id,
            name: value.description.clone(),
        })
        .collect();
    values.sort_by_key(|value| value.raw);
    values
}

fn integer(value: &AttributeValue) -> Option<i64> {
    match value {
        AttributeValue::Uint(value) => i64::try_from(*value).ok(),
        AttributeValue::Int(value) => Some(*value),
        AttributeValue::Double(value) if value.fract() == 0.0 => Some(*value as i64),
        _ => None,
    }
}

fn text_of(value: &AttributeValue) -> String {
    match value {
        AttributeValue::Uint(value) => value.to_string(),
        AttributeValue::Int(value) => value.to_string(),
        AttributeValue::Double(value) => value.to_string(),
        AttributeValue::String(value) => format!("\"{value}\""),
    }
}

fn float(value: &NumericValue) -> f64 {
    match value {
        NumericValue::Uint(value) => *value as f64,
        NumericValue::Int(value) => *value as f64,
        NumericValue::Double(value) => *value,
    }
}
