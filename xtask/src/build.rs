//! `build`: release images of the nodes, their sizes, and what they must not do.

use std::{
    path::PathBuf,
    process::{Command, Stdio},
};

use serde_json::Value;

use parts::Sled;

use crate::{
    Failure, Node, Workspace, audit,
    cli::Build,
    size::{self, Usage},
    target::{self, Target},
};

/// A release image.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Image {
    /// The node it is for.
    pub node: Node,
    /// The ELF file.
    pub path: PathBuf,
}

/// Runs the command: the nodes named, or all.
///
/// # Errors
///
/// An image does not build, is larger than its board's budget, or may panic.
pub fn run(workspace: &Workspace, options: &Build) -> Result<(), Failure> {
    let nodes = match options.nodes.as_slice() {
        [] => &Node::ALL,
        nodes => nodes,
    };
    let Checked { sizes, complaints } = check(workspace, &images(workspace, nodes)?)?;
    if options.json {
        println!("{}", size::json(&sizes));
    } else {
        print!("{}", size::table(&sizes));
    }
    match complaints.as_slice() {
        [] => Ok(()),
        complaints => Err(Failure::Failed(complaints.join("; "))),
    }
}

/// What a look at images brought.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Checked {
    /// What each takes of its board.
    pub sizes: Vec<(Node, Usage)>,
    /// What stands against them, one sentence each.
    pub complaints: Vec<String>,
}

/// Measures and audits images.
///
/// # Errors
///
/// A file cannot be read or is not an image for its node's board.
pub fn check(workspace: &Workspace, images: &[Image]) -> Result<Checked, Failure> {
    let mut sizes = Vec::new();
    let mut complaints = Vec::new();
    for Image { node, path } in images {
        let mut usage = size::measure(path, node.board())?;
        let source = format!("firmware/vehicles/uagv/nodes/{}.rs", node.name());
        let app = audit::application(&workspace.root().join(source))?;
        let audit = audit::audit(path, &app)?;
        usage.deepest = audit.deepest;
        let of_node = |complaint| format!("{}: {complaint}", node.name());
        complaints.extend(audit.complaints.into_iter().map(of_node));
        sizes.push((*node, usage));
    }
    complaints.extend(size::excess(&sizes));
    Ok(Checked { sizes, complaints })
}

/// Builds the release images of these nodes, each once, in the nodes' own order.
///
/// # Errors
///
/// The target is missing, or an image does not build.
pub fn images(workspace: &Workspace, nodes: &[Node]) -> Result<Vec<Image>, Failure> {
    let target = target::ensure(workspace)?;
    let mut images = Vec::new();
    for board in Sled::ALL {
        let nodes: Vec<Node> = Node::ALL
            .into_iter()
            .filter(|node| node.board() == board && nodes.contains(node))
            .collect();
        if !nodes.is_empty() {
            let cargo = command(workspace, &target, board, &nodes);
            images.extend(finish(cargo, board, &nodes)?);
        }
    }
    Ok(images)
}

/// The cargo command that builds the images of one board.
pub fn command(workspace: &Workspace, target: &Target, board: &Sled, nodes: &[Node]) -> Command {
    let mut cargo = target.cargo(workspace, "build");
    cargo.args(["--release", "--package", "uagv"]);
    cargo.args(["--features", board.name]);
    for node in nodes {
        cargo.args(["--bin", node.name()]);
    }
    cargo
}

/// Runs a [`command`] that builds images of one board.
///
/// # Errors
///
/// It does not succeed.
pub(crate) fn finish(
    mut cargo: Command,
    board: &Sled,
    nodes: &[Node],
) -> Result<Vec<Image>, Failure> {
    let names: Vec<&str> = nodes.iter().map(|node| node.name()).collect();
    let names = names.join(", ");
    cargo.arg("--message-format=json-render-diagnostics");
    let output = cargo
        .stderr(Stdio::inherit())
        .output()
        .map_err(|error| Failure::Failed(format!("cargo cannot be run: {error}")))?;
    if !output.status.success() {
        return Err(Failure::Failed(format!(
            "{names} for {} did not build",
            board.name
        )));
    }
    let messages = String::from_utf8_lossy(&output.stdout);
    nodes
        .iter()
        .map(|&node| {
            let path = executable(&messages, node.name()).ok_or_else(|| {
                Failure::Failed(format!("cargo built no image for {}", node.name()))
            })?;
            Ok(Image { node, path })
        })
        .collect()
}

/// The executable of this name among cargo's messages, one JSON object a line.
pub(crate) fn executable(messages: &str, name: &str) -> Option<PathBuf> {
    messages
        .lines()
        .filter_map(|line| serde_json::from_str::<Value>(line).ok())
        .filter(|message| message["reason"] == "compiler-artifact")
        .filter(|message| message["target"]["name"] == name)
        .find_map(|message| message["executable"].as_str().map(PathBuf::from))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_executable_is_found_among_the_messages_of_cargo() {
        let messages = r#"
{"reason":"compiler-artifact","target":{"name":"gps"},"executable":null}
{"reason":"compiler-artifact","target":{"name":"drive"},"executable":"/t/drive"}
{"reason":"compiler-artifact","target":{"name":"gps"},"executable":"/t/gps"}
{"reason":"build-finished","success":true}
"#;
        assert_eq!(executable(messages, "gps"), Some(PathBuf::from("/t/gps")));
        assert_eq!(executable(messages, "steering"), None);
    }
}
