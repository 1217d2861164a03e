//! The longest path as an integer linear program (implicit path enumeration,
//! Li and Malik 1995).
//!
//! One variable for each edge of each function that the abstract machine
//! reached; the flow into a block is the flow out of it, a function is entered
//! as often as it is called, a loop repeats at most its turns for each entry,
//! and no edge is taken more often than the abstract machine found possible.
//! The program knows totals only, so its answer is at least that of the
//! abstract machine's clock, except where a statement is annotated with how
//! often one activation runs it at most; what it adds is the path.

use std::collections::BTreeMap;

use microlp::{ComparisonOp, OptimizationDirection, Problem, Variable};

use super::analysis::{Analysis, Bound, Node, To};

/// The longest path.
#[derive(Debug, Clone)]
pub struct Longest {
    /// Its length under each timing model; exception entry and return are not
    /// in it.
    pub cycles: [u64; 2],
    /// Where it spends its time as flashed: cycles, executions, source line;
    /// the longest first.
    pub path: Vec<(u64, u64, String)>,
}

/// Solves the program for the task at `entry`; `None` if it has no bound or
/// the solver fails.
pub fn solve(analysis: &mut Analysis<'_>, bound: &Bound, entry: u32) -> Option<Longest> {
    if !bound.problems.is_empty() {
        return None;
    }
    let zero = length(analysis, bound, entry, 0)?.0;
    let (flash, counts) = length(analysis, bound, entry, 1)?;
    let mut lines: BTreeMap<String, (u64, u64)> = BTreeMap::new();
    for (node, count) in counts {
        let cost = bound.facts.costs.get(&node).copied().unwrap_or_default()[1];
        let graph = analysis.graph(node.function)?;
        let at = graph.blocks[node.block].start();
        let line = lines.entry(analysis.image().describe(at)).or_default();
        line.0 += cost * count;
        line.1 += count;
    }
    let mut path: Vec<(u64, u64, String)> = lines
        .into_iter()
        .map(|(place, (cycles, count))| (cycles, count, place))
        .collect();
    path.sort_by(|a, b| b.cmp(a));
    Some(Longest {
        cycles: [zero, flash],
        path,
    })
}

fn length(
    analysis: &mut Analysis<'_>,
    bound: &Bound,
    entry: u32,
    model: usize,
) -> Option<(u64, Vec<(Node, u64)>)> {
    let facts = &bound.facts;
    let mut problem = Problem::new(OptimizationDirection::Maximize);
    let mut edges: BTreeMap<(Node, To), Variable> = BTreeMap::new();
    for (&(node, to), &most) in &facts.edges {
        let block = facts.costs.get(&node).copied().unwrap_or_default()[model];
        let edge = facts
            .edge_costs
            .get(&(node, to))
            .copied()
            .unwrap_or_default()[model];
        // Costs of blocks lie on their ways out. The relaxation to real
        // numbers can only lengthen the path.
        let variable = problem.add_var((block + edge) as f64, (0.0, most as f64));
        edges.insert((node, to), variable);
    }
    let mut into: BTreeMap<Node, Vec<Variable>> = BTreeMap::new();
    let mut out: BTreeMap<Node, Vec<Variable>> = BTreeMap::new();
    for (&(node, to), &variable) in &edges {
        out.entry(node).or_default().push(variable);
        if let To::Block(block) = to {
            into.entry(Node { block, ..node })
                .or_default()
                .push(variable);
        }
    }
    // Calls enter the first block of the callee.
    let mut callers: BTreeMap<u32, Vec<Node>> = BTreeMap::new();
    for &(node, callee) in facts.calls.keys() {
        callers.entry(callee).or_default().push(node);
    }
    for &node in facts.visits.keys() {
        let mut terms: Vec<(Variable, f64)> = Vec::new();
        for variable in into.get(&node).into_iter().flatten() {
            add(&mut terms, *variable, 1.0);
        }
        for variable in out.get(&node).into_iter().flatten() {
            add(&mut terms, *variable, -1.0);
        }
        let mut source = 0.0;
        if node.block == 0 {
            if node.function == entry {
                source = 1.0;
            }
            for caller in callers.get(&node.function).into_iter().flatten() {
                for variable in out.get(caller).into_iter().flatten() {
                    add(&mut terms, *variable, 1.0);
                }
            }
        }
        // What flows out came in; a path may also end where it stands.
        problem.add_constraint(&terms, ComparisonOp::Ge, -source);
    }
    for (&header, &turns) in &facts.turns {
        let graph = analysis.graph(header.function)?;
        let Some(l) = graph.loops.iter().find(|l| l.header == header.block) else {
            continue;
        };
        let mut terms = Vec::new();
        for (&(node, to), &variable) in &edges {
            let To::Block(to) = to else { continue };
            if node.function != header.function || !l.blocks.contains(&to) {
                continue;
            }
            if !l.blocks.contains(&node.block) {
                add(&mut terms, variable, -(turns as f64));
            } else if to == header.block {
                add(&mut terms, variable, 1.0);
            }
        }
        let mut source = 0.0;
        if header.block == 0 {
            if header.function == entry {
                source = turns as f64;
            }
            for caller in callers.get(&header.function).into_iter().flatten() {
                for variable in out.get(caller).into_iter().flatten() {
                    add(&mut terms, *variable, -(turns as f64));
                }
            }
        }
        problem.add_constraint(&terms, ComparisonOp::Le, source);
    }
    for (&node, most) in &bound.facts.most {
        let terms: Vec<(Variable, f64)> = out
            .get(&node)
            .into_iter()
            .flatten()
            .map(|variable| (*variable, 1.0))
            .collect();
        problem.add_constraint(&terms, ComparisonOp::Le, *most as f64);
    }
    let solution = problem.solve().ok()?.into_solution().ok()?;
    let mut counts: BTreeMap<Node, f64> = BTreeMap::new();
    for ((node, _), variable) in &edges {
        *counts.entry(*node).or_default() += solution.var_value(*variable);
    }
    let counts = counts
        .into_iter()
        .map(|(node, count)| (node, count.round() as u64))
        .filter(|(_, count)| *count > 0)
        .collect();
    // Rounded up by more than the solver's tolerance.
    Some((
        (solution.objective() * 1.000_001 + 0.5).ceil() as u64,
        counts,
    ))
}

fn add(terms: &mut Vec<(Variable, f64)>, variable: Variable, by: f64) {
    match terms.iter_mut().find(|(other, _)| *other == variable) {
        Some((_, factor)) => *factor += by,
        None => terms.push((variable, by)),
    }
}
