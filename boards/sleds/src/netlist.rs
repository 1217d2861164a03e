//! Netlists in the form that KiCad writes and reads (`export`, version E).

use lexpr::Value;

use crate::Error;

/// A netlist.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Netlist {
    /// What it is the netlist of.
    pub title: String,
    /// In the order of the file.
    pub components: Vec<Component>,
    /// In the order of the file.
    pub nets: Vec<Net>,
}

/// A component.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Component {
    /// Reference designator, such as `R2`.
    pub reference: String,
    /// Value, such as `120`; for a terminal block the connector of [`parts::Sled`].
    pub value: String,
    /// What it is for.
    pub description: String,
    /// Whether it has to be bought: it is in the bill of materials.
    pub in_bill: bool,
    /// Whether it is drawn on the right.
    pub on_right: bool,
}

/// A net.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Net {
    /// Name.
    pub name: String,
    /// What it joins.
    pub nodes: Vec<Node>,
}

/// A pin that a net joins.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Node {
    /// Reference designator of the component.
    pub component: String,
    /// Number of its pin.
    pub pin: String,
    /// Name of its pin; empty if it has none.
    pub function: String,
    /// Whether the pin is left open on purpose.
    pub open: bool,
}

impl Netlist {
    /// Reads a netlist.
    ///
    /// # Errors
    /// The text of `file` is no netlist.
    pub fn parse(file: &str, text: &str) -> Result<Self, Error> {
        let root = lexpr::from_str(text).map_err(|error| Error::Syntax {
            file: file.into(),
            error,
        })?;
        let reader = Reader { file };
        let design = reader.child(&root, "design")?;
        let block = reader.child(reader.child(design, "sheet")?, "title_block")?;
        let components = children(reader.child(&root, "components")?, "comp");
        let nets = children(reader.child(&root, "nets")?, "net");
        Ok(Self {
            title: reader.text(block, "title")?,
            components: components
                .map(|value| reader.component(value))
                .collect::<Result<_, _>>()?,
            nets: nets
                .map(|value| reader.net(value))
                .collect::<Result<_, _>>()?,
        })
    }

    /// The component with this reference designator.
    #[must_use]
    pub fn component(&self, reference: &str) -> Option<&Component> {
        let mut components = self.components.iter();
        components.find(|component| component.reference == reference)
    }

    /// The net of a pin.
    #[must_use]
    pub fn net_of(&self, component: &str, pin: &str) -> Option<&Net> {
        let mut nets = self.nets.iter();
        nets.find(|net| net.has(component, pin))
    }

    /// The pins of a component, in the order of their numbers, with their nets.
    #[must_use]
    pub fn pins_of(&self, component: &str) -> Vec<(&Node, &Net)> {
        let mut pins: Vec<(&Node, &Net)> = self
            .nets
            .iter()
            .flat_map(|net| net.nodes.iter().map(move |node| (node, net)))
            .filter(|(node, _)| node.component == component)
            .collect();
        pins.sort_by_key(|(node, _)| (node.pin.parse::<u32>().ok(), &node.pin));
        pins
    }

    /// The names of the nets that the pins of a component are on, in the order of the pins.
    #[must_use]
    pub fn ends(&self, component: &str) -> Vec<&str> {
        let pins = self.pins_of(component);
        pins.iter().map(|(_, net)| net.name.as_str()).collect()
    }
}

impl Net {
    /// Whether it joins this pin.
    #[must_use]
    pub fn has(&self, component: &str, pin: &str) -> bool {
        let mut nodes = self.nodes.iter();
        nodes.any(|node| node.component == component && node.pin == pin)
    }

    /// Whether it is a supply or ground.
    #[must_use]
    pub fn is_supply(&self) -> bool {
        self.name == "GND"
            || self
                .name
                .rsplit(':')
                .next()
                .unwrap_or_default()
                .starts_with('+')
    }

    /// Whether it is a pin left open on purpose.
    #[must_use]
    pub fn is_open(&self) -> bool {
        matches!(self.nodes.as_slice(), [node] if node.open)
    }
}

/// Takes values out of s-expressions.
struct Reader<'a> {
    file: &'a str,
}

impl Reader<'_> {
    fn child<'v>(&self, value: &'v Value, name: &'static str) -> Result<&'v Value, Error> {
        children(value, name)
            .next()
            .ok_or_else(|| self.missing(value, name))
    }

    fn text(&self, value: &Value, name: &'static str) -> Result<String, Error> {
        let child = self.child(value, name)?;
        let text = elements(child).nth(1).and_then(Value::as_str);
        text.map(str::to_owned)
            .ok_or_else(|| self.missing(value, name))
    }

    fn missing(&self, value: &Value, what: &'static str) -> Error {
        let mut place = value.to_string();
        if let Some((end, _)) = place.char_indices().nth(60) {
            place.truncate(end);
        }
        Error::Missing {
            file: self.file.into(),
            what,
            place,
        }
    }

    fn component(&self, value: &Value) -> Result<Component, Error> {
        let has = |name: &str| {
            let mut properties = children(value, "property");
            properties.any(|property| self.text(property, "name").is_ok_and(|found| found == name))
        };
        Ok(Component {
            reference: self.text(value, "ref")?,
            value: self.text(value, "value")?,
            description: self.text(self.child(value, "libsource")?, "description")?,
            in_bill: !has("exclude_from_bom"),
            on_right: has("Drawn"),
        })
    }

    fn net(&self, value: &Value) -> Result<Net, Error> {
        Ok(Net {
            name: self.text(value, "name")?,
            nodes: children(value, "node")
                .map(|node| self.node(node))
                .collect::<Result<_, _>>()?,
        })
    }

    fn node(&self, value: &Value) -> Result<Node, Error> {
        Ok(Node {
            component: self.text(value, "ref")?,
            pin: self.text(value, "pin")?,
            function: self.text(value, "pinfunction").unwrap_or_default(),
            open: self.text(value, "pintype")? == "no_connect",
        })
    }
}

/// The elements of a list.
fn elements(value: &Value) -> impl Iterator<Item = &Value> {
    value.list_iter().into_iter().flatten()
}

/// The lists in a list that begin with this name.
fn children<'v>(value: &'v Value, name: &'static str) -> impl Iterator<Item = &'v Value> {
    let named =
        move |child: &&Value| elements(child).next().and_then(Value::as_symbol) == Some(name);
    elements(value).filter(named)
}
