//! What is wrong, with the place in the source that an annotation goes to.

use crate::analysis::Answer;

/// One thing that is wrong.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finding {
    /// What kind: `deadline`, `bound`, `stack` or `slack`.
    pub rule: &'static str,
    /// What is wrong, in one sentence.
    pub message: String,
    /// The source file, relative to the repository.
    pub file: String,
    /// The line, from one.
    pub line: u32,
}

/// Everything that is wrong with an application: deadlines, bounds, the stack, and `losses` of slack, each
/// with its task. `file` is its source, relative to the repository.
#[must_use]
pub fn findings(answer: &Answer, losses: &[(String, String)], file: &str) -> Vec<Finding> {
    let node = &answer.node;
    let finding = |rule, line: Option<u32>, message: String| Finding {
        rule,
        message,
        file: file.to_owned(),
        line: line.unwrap_or(1),
    };
    let mut all = Vec::new();
    for task in &node.tasks {
        let rule = if task.is_bounded() {
            "deadline"
        } else {
            "bound"
        };
        let line = answer.line(&task.name);
        all.extend(task.miss(&node.name).map(|miss| finding(rule, line, miss)));
    }
    for problem in &node.idle_problems {
        let what = format!("start-up and idle: {problem}");
        all.push(finding("bound", None, what));
    }
    if node.stack > node.stack_size {
        let what = format!(
            "the stack may take {} bytes of {}",
            node.stack, node.stack_size
        );
        all.push(finding("stack", None, what));
    }
    let losses = losses.iter();
    all.extend(losses.map(|(task, what)| finding("slack", answer.line(task), what.clone())));
    all
}
