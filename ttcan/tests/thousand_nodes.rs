//! Runs the example with a thousand nodes.

#[path = "../examples/thousand_nodes.rs"]
#[expect(unreachable_pub, reason = "a program of its own in `examples/`")]
mod example;

#[test]
fn a_thousand_nodes_keep_one_schedule() {
    example::main();
}
