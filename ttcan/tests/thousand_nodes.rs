//! A thousand nodes: the example, as a test.

#[path = "../examples/thousand_nodes.rs"]
mod example;

#[test]
fn a_thousand_nodes_keep_one_schedule() {
    example::main();
}
