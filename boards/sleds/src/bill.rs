//! Bills of materials.

use crate::{Error, table};

/// What has to be bought of one part.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Item {
    /// Reference designators of the components.
    pub references: Vec<String>,
    /// How many there are.
    pub quantity: String,
    /// Value of the components.
    pub value: String,
    /// Maker.
    pub maker: String,
    /// The maker's part number.
    pub number: String,
}

/// Reads a bill of materials.
///
/// # Errors
/// The text of `file` is no such table.
pub fn parse(file: &str, text: &str) -> Result<Vec<Item>, Error> {
    let names = [
        "Reference",
        "Quantity",
        "Value",
        "Manufacturer",
        "MPN",
        "Description",
    ];
    let lines = table(file, text, names)?;
    let item = |[references, quantity, value, maker, number, _]: [String; 6]| Item {
        references: references.split_whitespace().map(String::from).collect(),
        quantity,
        value,
        maker,
        number,
    };
    Ok(lines.into_iter().map(item).collect())
}
