//! The page on a node of one's own quotes the sources as they are.

use std::fs;
use std::path::Path;

/// The blocks of code of `HOWTO.md` that begin with this line.
fn blocks<'a>(page: &'a str, first: &'a str) -> impl Iterator<Item = &'a str> {
    let begun = page.split(first).skip(1);
    begun.filter_map(|rest| rest.split("\n```").next())
}

#[track_caller]
fn quotes(page: &str, first: &str, source: &str, indent: &str) {
    let text = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(source));
    let text = text.expect("the source is there");
    let mut found = 0;
    for block in blocks(page, first) {
        for line in block.lines().filter(|line| !line.trim().is_empty()) {
            let line = format!("\n{indent}{line}\n");
            assert!(text.contains(&line), "{source} has no line {line:?}");
        }
        found += 1;
    }
    assert_eq!(found, 1, "one block of {source}");
}

#[test]
fn what_the_page_quotes_is_in_the_sources() {
    let page = include_str!("../HOWTO.md");
    quotes(page, "```rust,ignore\n", "examples/async_nodes.rs", "");
    // The packaged crate is without the boards.
    if Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../boards/can-node")
        .exists()
    {
        let first = "    let stamp = cx.shared.timer.now();\n";
        quotes(page, first, "../boards/can-node/src/main.rs", "    ");
    }
}
