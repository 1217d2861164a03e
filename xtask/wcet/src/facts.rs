//! Flow facts: which blocks and edges were reached, how often, and at which cost.

use std::collections::BTreeMap;

use super::cycles::Cycles;

/// The end of an edge of the control flow.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum To {
    /// A block of the same function.
    Block(usize),
    /// The caller.
    Return,
    /// Nowhere: the path ends.
    End,
}

/// A basic block of a function.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct BlockId {
    /// The function's address.
    pub function: u32,
    /// The block's number in the function's graph.
    pub block: usize,
}

/// An edge of the control flow.
pub(crate) type Edge = (BlockId, To);

/// Flow facts of one activation, for the integer program and for checks.
#[derive(Debug, Default, Clone)]
pub struct Facts {
    /// Most executions of each block that was reached.
    pub visits: BTreeMap<BlockId, u64>,
    /// Most cycles of one execution of a block, without its callees.
    pub costs: BTreeMap<BlockId, Cycles>,
    /// Most traversals of each edge.
    pub edges: BTreeMap<Edge, u64>,
    /// Cycles of an edge beyond its block.
    pub edge_costs: BTreeMap<Edge, Cycles>,
    /// Most calls of each callee from each block.
    pub calls: BTreeMap<(BlockId, u32), u64>,
    /// Most turns of a loop for each entry, by its header.
    pub turns: BTreeMap<BlockId, u64>,
    /// Most executions of a block in one activation, by annotations.
    pub most: BTreeMap<BlockId, u64>,
}

impl Facts {
    /// Adds the facts of a stretch that runs `times` times.
    pub(crate) fn add(&mut self, other: Self, times: u64) {
        for (block, visits) in other.visits {
            *self.visits.entry(block).or_default() += visits * times;
        }
        for (edge, count) in other.edges {
            *self.edges.entry(edge).or_default() += count * times;
        }
        for (call, count) in other.calls {
            *self.calls.entry(call).or_default() += count * times;
        }
        for (block, cost) in other.costs {
            self.add_cost(block, cost);
        }
        for (edge, cost) in other.edge_costs {
            self.add_edge_cost(edge, cost);
        }
        for (header, turns) in other.turns {
            self.add_turns(header, turns);
        }
    }

    /// Notes the cost of one execution of a block.
    pub(crate) fn add_cost(&mut self, block: BlockId, cost: Cycles) {
        let most = self.costs.entry(block).or_default();
        *most = most.max(cost);
    }

    /// Notes the cost of one traversal of an edge.
    pub(crate) fn add_edge_cost(&mut self, edge: Edge, cost: Cycles) {
        let most = self.edge_costs.entry(edge).or_default();
        *most = most.max(cost);
    }

    /// Notes the turns of one entry into the loop with this header.
    pub(crate) fn add_turns(&mut self, header: BlockId, turns: u64) {
        let most = self.turns.entry(header).or_default();
        *most = turns.max(*most);
    }
}
