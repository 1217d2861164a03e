//! Loops, turn by turn or at the cost of the worst turn.

use std::rc::Rc;

use crate::bound::{End, Entry, Problem};
use crate::cycles::Cycles;
use crate::facts::BlockId;
use crate::graph::Graph;
use crate::invariant::Invariant;
use crate::program::Program;
use crate::runtime;
use crate::software;
use crate::state::State;

use super::run::{Exits, Run, Sections};

/// Turns of a loop without a given bound after which it counts as unbounded.
const MAX_TURNS: u64 = 2_048;
/// Instructions after which a loop with a given bound is no longer unrolled turn by turn. With a
/// problem, also those after which one without a given bound is not.
const STEPS_OF_LOOP: u64 = 6_000;
/// Instructions after which a loop without a given bound counts as unbounded.
const STEPS_OF_COUNTED_LOOP: u64 = 400_000;
/// After this many simulated instructions in total, loops with a known bound are no longer
/// unrolled turn by turn.
const STEPS_TURN_BY_TURN: u64 = 600_000;
/// Remaining turns of a loop with a known bound that are always run one by one.
const FEW_TURNS: u64 = 1;

/// The bound of a loop that need not be found by running it.
struct Given {
    /// The loop's place for one of an annotation, else what the loop is.
    what: String,
    turns: u64,
    annotated: bool,
}

impl Given {
    /// Whether the loop only repeats a store-exclusive.
    fn is_retry(&self) -> bool {
        !self.annotated && self.what == runtime::RETRY
    }
}

/// The last turn of a loop that was run, from one state at the header to the next.
struct LastTurn<'s> {
    before: &'s State,
    next: State,
}

impl Run<'_, '_> {
    /// The bound of a loop that is given and need not be found by running it, and what gives it.
    fn given_bound(&self, graph: &Graph, number: usize) -> Option<Given> {
        let image = self.program.image;
        let given = |what, turns, annotated| Given {
            what,
            turns,
            annotated,
        };
        self.program
            .annotation(graph, number)
            .map(|(place, turns)| given(place, turns, true))
            .or_else(|| {
                runtime::bound(image, graph, number)
                    .or_else(|| software::bound(image, graph, number))
                    .map(|(what, turns)| given(what.to_owned(), turns, false))
            })
            .or_else(|| {
                let bytes = self.frames.last().and_then(|frame| frame.bytes)?;
                let what = format!("{}, by its length", image.name(graph.entry));
                let turns = runtime::copying(graph, number, bytes);
                Some(given(what, turns, false))
            })
    }

    /// Notes that a given bound counts for the loop that is now in this state. In start-up and idle
    /// code it does so only while interrupts are masked.
    fn rely_on(&mut self, given: Option<&Given>, state: &State) {
        let Some(given) = given else { return };
        if self.kind == Entry::Program && state.outermost_section().is_none() {
            return;
        }
        let all = if given.annotated {
            &mut self.annotated
        } else {
            &mut self.summarised
        };
        let most = all.entry(given.what.clone()).or_default();
        *most = (*most).max(given.turns);
    }

    /// Runs a loop that is entered at block `start`, turn by turn until no path stays inside. If
    /// its bound is given and that takes many steps, the remaining turns are charged at the cost
    /// of the worst of them.
    pub(super) fn turns(
        &mut self,
        graph: &Rc<Graph>,
        number: usize,
        mut start: usize,
        state: State,
    ) -> Exits {
        let header = graph.loops[number].header;
        let given = self.given_bound(graph, number);
        let bound = given.as_ref().map(|given| given.turns);
        self.rely_on(given.as_ref(), &state);
        let begin = self.steps;
        let unrolled = if begin > STEPS_TURN_BY_TURN {
            0
        } else {
            STEPS_OF_LOOP
        };
        let mut all = Exits::new();
        let mut first = state;
        let mut turns = 0;
        loop {
            let (exits, back) = self.region(graph, Some(number), start, first.clone());
            self.add_exits(&mut all, exits);
            let Some(next) = back else { break };
            self.rely_on(given.as_ref(), &next);
            if given.as_ref().is_some_and(Given::is_retry) {
                let turn = next.cycles - first.cycles;
                self.retry = self.retry.max(turn.flashed);
            }
            let from_header = start == header;
            start = header;
            turns += 1;
            if bound.is_some_and(|bound| turns > bound) {
                break;
            }
            let remaining = match bound {
                // As few are run in fewer steps than it takes to find what holds in each of them.
                Some(bound) if bound - turns <= FEW_TURNS => None,
                Some(bound) => (self.steps > begin + unrolled).then_some(bound - turns),
                // Start-up and idle code may wait for hardware while no task is masked.
                None if self.kind == Entry::Program && next.outermost_section().is_none() => {
                    Some(0)
                }
                None if self.kind == Entry::Fault => Some(0),
                None => {
                    let stuck = from_header && first.same_machine(&next);
                    self.gives_up(graph, number, turns, begin, stuck)
                        .then_some(0)
                }
            };
            if let Some(remaining) = remaining.filter(|_| from_header) {
                let last = LastTurn {
                    before: &first,
                    next,
                };
                let resetting = last.next.resetting;
                let exits = self.remaining_turns(graph, number, last, remaining, bound);
                self.add_exits(&mut all, exits);
                turns += remaining;
                if all.is_empty() && self.kind == Entry::Fault {
                    self.end_in_loop(graph, number, resetting);
                }
                break;
            }
            first = next;
        }
        let id = BlockId {
            function: graph.entry,
            block: header,
        };
        let turns = bound.map_or(turns, |bound| turns.min(bound));
        self.facts.add_turns(id, turns);
        // Behind a bound that is too low nothing is followed, and nothing counts. A length that is given may rule paths
        // out that are not known to be impossible otherwise.
        let copies = runtime::length_register(self.program.image, graph.entry).is_some();
        let is_short = |given: &Given| given.annotated && !copies && self.kind != Entry::Fault;
        if let Some(given) = given.filter(|given| all.is_empty() && is_short(given)) {
            let at = self.place_of_loop(graph, number);
            let turns = given.turns;
            self.problems.insert(Problem::NotLeft { at, turns });
        }
        all
    }

    /// Whether a loop without a given bound counts as unbounded after `turns` turns, `stuck` if
    /// the last one changed nothing. In a task this is reported; the analysis then goes on after
    /// the loop, to find further problems.
    fn gives_up(
        &mut self,
        graph: &Graph,
        number: usize,
        turns: u64,
        begin: u64,
        stuck: bool,
    ) -> bool {
        let at = graph.blocks[graph.loops[number].header].start();
        let steps = self.steps - begin;
        let long = turns > MAX_TURNS || steps > STEPS_OF_COUNTED_LOOP;
        if !stuck && !long && !self.endless.contains(&at) {
            // Behind a problem a long loop is left early, for the sake of time. It may well have a bound.
            return !self.problems.is_empty() && steps > STEPS_OF_LOOP;
        }
        self.endless.insert(at);
        if self.kind != Entry::Program {
            let at = self.place_of_loop(graph, number);
            let Program {
                image, annotations, ..
            } = &self.program;
            let problem = match annotations.absent(image, graph, number) {
                Some(file) => Problem::LoopWithoutSource { at, file },
                None => Problem::LoopWithoutBound(at),
            };
            self.problems.insert(problem);
        }
        true
    }

    /// Reports a loop of start-up or idle code whose turns are not counted, if `turn`, the state
    /// in which any of them begins, has interrupts masked.
    fn report_masked(&mut self, graph: &Graph, number: usize, turn: &State) {
        let Some(section) = turn.outermost_section() else {
            return;
        };
        let since = self.describe(section.at);
        let at = self.place_of_loop(graph, number);
        self.problems.insert(Problem::MaskedLoop { at, since });
    }

    /// Notes that a loop is never left, after a request for a reset or without one.
    fn end_in_loop(&mut self, graph: &Graph, number: usize, resetting: bool) {
        let end = if resetting {
            End::Reset
        } else {
            End::Loop(self.place_of_loop(graph, number))
        };
        self.ends.insert(end);
    }

    /// The source line of a loop, or else the place of its first instruction.
    fn place_of_loop(&self, graph: &Graph, number: usize) -> String {
        let Program {
            image, annotations, ..
        } = &self.program;
        annotations.place(image, graph, number)
    }

    fn add_exits(&mut self, all: &mut Exits, exits: Exits) {
        for (to, state) in exits {
            self.add_exit(all, to, state);
        }
    }

    /// Runs one turn that stands for every further turn of a loop, and charges `remaining` of
    /// them.
    fn remaining_turns(
        &mut self,
        graph: &Rc<Graph>,
        number: usize,
        last: LastTurn<'_>,
        remaining: u64,
        bound: Option<u64>,
    ) -> Exits {
        let header = graph.loops[number].header;
        // Without a bound there may be any number of turns, although none of them is charged.
        let reach = bound.map_or(u64::MAX, |_| remaining);
        let symbols = &mut self.executor.symbols;
        let mut invariant = Invariant::guess(last.before, last.next, reach, symbols);
        loop {
            let first = invariant.state().clone();
            let facts = std::mem::take(&mut self.facts);
            let sections = std::mem::take(&mut self.sections);
            let ended = std::mem::take(&mut self.ended);
            let (exits, back) = self.region(graph, Some(number), header, first.clone());
            let turn_facts = std::mem::replace(&mut self.facts, facts);
            let turn_sections = std::mem::replace(&mut self.sections, sections);
            let turn_ended = std::mem::replace(&mut self.ended, ended);
            if let Some(back) = &back
                && !self.exhausted()
                && !invariant.holds(
                    back,
                    self.timings.flashed.reads(),
                    &mut self.executor.symbols,
                )
            {
                continue;
            }
            if bound.is_none() && self.kind == Entry::Program {
                self.report_masked(graph, number, &first);
            }
            let turn = back.map_or(Cycles::ZERO, |back| back.cycles - first.cycles);
            let extra = turn * remaining;
            self.facts.add(turn_facts, remaining + 1);
            self.add_turn_sections(turn_sections, &first, extra);
            if turn_ended != Cycles::ZERO {
                self.end_path(turn_ended + extra);
            }
            return exits
                .into_iter()
                .map(|(to, state)| (to, later(state, &first, extra)))
                .collect();
        }
    }

    /// Records the critical sections that ended in a turn. One that was running before the turn
    /// also lasts through the `extra` time of the turns that are not run.
    fn add_turn_sections(&mut self, turn: Sections, first: &State, extra: Cycles) {
        for ((level, at), cycles) in turn {
            let was_running = first.masked.iter().any(|section| section.level == level);
            let extra = if was_running { extra } else { Cycles::ZERO };
            let most = self.sections.entry((level, at)).or_default();
            *most = most.max(cycles + extra);
        }
    }
}

/// `state` after the `extra` time of the turns that are not run. It also counts for the critical
/// sections that were running before the turn that began with `first`.
fn later(mut state: State, first: &State, extra: Cycles) -> State {
    state.cycles += extra;
    for section in &mut state.masked {
        let mut before = first.masked.iter();
        if before.any(|known| known.level == section.level) {
            section.cycles += extra;
        }
    }
    state
}
