//! The longest path as an integer linear program (implicit path enumeration, Li and Malik
//! 1995).
//!
//! There is one variable for each edge that the abstract machine reached, in each function. The
//! flow into a block is the flow out of it. A function is entered as often as it is called. A
//! loop repeats at most its turns for each entry. No edge is taken more often than the abstract
//! machine found possible.
//!
//! The program knows totals only, so its solution is usually not below the abstract machine's
//! clock. It is below it where an annotation limits how often one activation runs a statement.
//! In any case it shows the path.

use std::collections::BTreeMap;

use microlp::{ComparisonOp, OptimizationDirection, Problem, Variable};

use super::bound::Bound;
use super::cycles::{Cycles, Model};
use super::facts::{BlockId, Edge, Facts, To};
use super::graph::Loop;
use super::program::Program;

/// A source line on the longest path.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Line {
    /// Cycles that the path spends there, as flashed.
    pub cycles: u64,
    /// How often it is executed.
    pub times: u64,
    /// Where it is.
    pub place: String,
}

/// The longest path.
#[derive(Debug, Clone)]
pub struct Longest {
    /// Its length, without exception entry and exit.
    pub cycles: Cycles,
    /// Its source lines, the costliest first.
    pub path: Vec<Line>,
}

/// Finds the longest path of the code at `entry`; `None` if its bound has problems or the solver
/// fails.
pub(crate) fn solve(program: &mut Program<'_>, bound: &Bound, entry: u32) -> Option<Longest> {
    if !bound.problems.is_empty() {
        return None;
    }
    let zero_wait = length(program, &bound.facts, entry, Model::ZeroWait)?;
    let flashed = length(program, &bound.facts, entry, Model::Flashed)?;
    let mut lines: BTreeMap<String, (u64, u64)> = BTreeMap::new();
    for ((id, to), count) in flashed.counts {
        let block = bound.facts.costs.get(&id).copied().unwrap_or_default();
        let edge = bound.facts.edge_costs.get(&(id, to));
        let cost = block + edge.copied().unwrap_or_default();
        let graph = program.graph(id.function)?;
        let at = graph.blocks[id.block].start();
        let (cycles, times) = lines.entry(program.image.describe(at)).or_default();
        *cycles += cost.flashed * count;
        *times += count;
    }
    let mut path: Vec<Line> = lines
        .into_iter()
        .map(|(place, (cycles, times))| Line {
            cycles,
            times,
            place,
        })
        .collect();
    path.sort_by(|a, b| b.cmp(a));
    Some(Longest {
        cycles: Cycles {
            zero_wait: zero_wait.cycles,
            flashed: flashed.cycles,
        },
        path,
    })
}

/// The solution under one timing model.
struct Solution {
    cycles: u64,
    /// How often each edge is taken.
    counts: Vec<(Edge, u64)>,
}

fn length(program: &mut Program<'_>, facts: &Facts, entry: u32, model: Model) -> Option<Solution> {
    let mut flow = Flow::new(facts, entry, model);
    flow.conserve();
    for (&header, &turns) in &facts.turns {
        let graph = program.graph(header.function)?;
        let mut loops = graph.loops.iter();
        if let Some(l) = loops.find(|l| l.header == header.block) {
            flow.limit_turns(header, l, turns);
        }
    }
    for (&id, &most) in &facts.most {
        flow.limit_executions(id, most);
    }
    flow.solve()
}

/// The integer program while it is built.
struct Flow<'f> {
    facts: &'f Facts,
    entry: u32,
    problem: Problem,
    edges: BTreeMap<Edge, Variable>,
    /// Edges into and out of each block.
    into: BTreeMap<BlockId, Vec<Variable>>,
    out: BTreeMap<BlockId, Vec<Variable>>,
    /// Blocks that call each function.
    callers: BTreeMap<u32, Vec<BlockId>>,
}

impl<'f> Flow<'f> {
    /// With a variable for each edge, whose factor is the cost of the edge and its block. The
    /// relaxation to real numbers can only lengthen the path.
    fn new(facts: &'f Facts, entry: u32, model: Model) -> Self {
        let mut flow = Self {
            facts,
            entry,
            problem: Problem::new(OptimizationDirection::Maximize),
            edges: BTreeMap::new(),
            into: BTreeMap::new(),
            out: BTreeMap::new(),
            callers: BTreeMap::new(),
        };
        for (&(id, to), &most) in &facts.edges {
            let block = facts.costs.get(&id).copied().unwrap_or_default();
            let edge = facts.edge_costs.get(&(id, to)).copied().unwrap_or_default();
            let cost = (block + edge)[model] as f64;
            let variable = flow.problem.add_var(cost, (0.0, most as f64));
            flow.edges.insert((id, to), variable);
            flow.out.entry(id).or_default().push(variable);
            if let To::Block(block) = to {
                let next = BlockId { block, ..id };
                flow.into.entry(next).or_default().push(variable);
            }
        }
        for &(id, callee) in facts.calls.keys() {
            flow.callers.entry(callee).or_default().push(id);
        }
        flow
    }

    /// The edges out of `id`.
    fn out(&self, id: BlockId) -> impl Iterator<Item = Variable> + '_ {
        self.out.get(&id).into_iter().flatten().copied()
    }

    /// How often the function of `id` is entered, if `id` is its first block: variables that
    /// count its calls, and a constant for the task's entry.
    fn entries(&self, id: BlockId) -> (Vec<Variable>, f64) {
        if id.block != 0 {
            return (Vec::new(), 0.0);
        }
        let callers = self.callers.get(&id.function).into_iter().flatten();
        let calls = callers.flat_map(|caller| self.out(*caller)).collect();
        (calls, if id.function == self.entry { 1.0 } else { 0.0 })
    }

    /// The flow out of a block is at most the flow into it. It may be less, as a path may end in
    /// the block.
    fn conserve(&mut self) {
        for &id in self.facts.visits.keys() {
            let mut sum = Sum::default();
            sum.add(self.into.get(&id).into_iter().flatten().copied(), 1.0);
            sum.add(self.out(id), -1.0);
            let (calls, source) = self.entries(id);
            sum.add(calls, 1.0);
            self.problem
                .add_constraint(sum.0, ComparisonOp::Ge, -source);
        }
    }

    /// The edges from inside a loop to its header are taken at most `turns` times for each entry
    /// into the loop.
    fn limit_turns(&mut self, header: BlockId, l: &Loop, turns: u64) {
        let turns = turns as f64;
        let mut sum = Sum::default();
        for (&(id, to), &variable) in &self.edges {
            let To::Block(to) = to else { continue };
            if id.function != header.function || !l.blocks.contains(&to) {
                continue;
            }
            if !l.blocks.contains(&id.block) {
                sum.add([variable], -turns);
            } else if to == header.block {
                sum.add([variable], 1.0);
            }
        }
        let (calls, source) = self.entries(header);
        sum.add(calls, -turns);
        self.problem
            .add_constraint(sum.0, ComparisonOp::Le, source * turns);
    }

    /// A block is executed at most `most` times.
    fn limit_executions(&mut self, id: BlockId, most: u64) {
        let mut sum = Sum::default();
        sum.add(self.out(id), 1.0);
        self.problem
            .add_constraint(sum.0, ComparisonOp::Le, most as f64);
    }

    fn solve(self) -> Option<Solution> {
        let solution = self.problem.solve().ok()?.into_solution().ok()?;
        let edges = self.edges.iter();
        let counts = edges
            .map(|(edge, variable)| (*edge, solution.var_value(*variable).round() as u64))
            .filter(|(_, count)| *count > 0)
            .collect();
        // Rounded up by more than the solver's tolerance.
        let cycles = (solution.objective() * 1.000_001 + 0.5).ceil() as u64;
        Some(Solution { cycles, counts })
    }
}

/// A sum of variables with factors. Each variable occurs once.
#[derive(Default)]
struct Sum(Vec<(Variable, f64)>);

impl Sum {
    fn add(&mut self, variables: impl IntoIterator<Item = Variable>, by: f64) {
        for variable in variables {
            match self.0.iter_mut().find(|(other, _)| *other == variable) {
                Some((_, factor)) => *factor += by,
                None => self.0.push((variable, by)),
            }
        }
    }
}
