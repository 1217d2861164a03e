//! Loop bounds written at the loop.
//!
//! A comment `// loop-bound: N` has a line of its own directly above a `for`, `while` or `loop`. It
//! says that the loop takes at most N turns for each entry. Above another statement it bounds each
//! loop that an iterator or a search in the statement makes.
//!
//! The bound may have a name, by `// loop-bound: NAME=N`: N turns always suffice, and whoever knows the image
//! may give fewer under the name ([`Annotations::with_bounds`]). So a loop of a library over an array of any
//! length up to N is bounded by the length that this image has.
//!
//! A comment `// at-most: N` above a statement says that one activation of a task runs the
//! statement at most N times in total, whatever the loops around it allow. Above a loop it says
//! that all its entries together take at most N turns.
//!
//! The analysis finds the loop in the image by the line tables. A machine loop is a source loop if
//! nearly all of its instructions were written or inlined there, no inner source loop holds as
//! many, and the branches that repeat or leave it belong to the loop itself, or to what an `.await` in it
//! polls. A machine loop that fits no source loop in this way has no bound, which is reported.
//!
//! A loop in a source that is not one's own is bounded by its name instead
//! too: the place that a message gives, or the name of its function.
//!
//! A comment costs nothing at run time, and unlike a marker in assembly it is possible in crates
//! that forbid unsafe code. Emulated runs check the annotations by counting
//! ([`watch`](super::watch)).

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::{Path, PathBuf};

use syn::spanned::Spanned;
use syn::visit::Visit;

use super::graph::{Block, Graph};
use super::image::{Image, Place};

/// The mark of a loop bound.
const MARK: &str = "// loop-bound:";
/// The mark of a limit for one activation.
const AT_MOST: &str = "// at-most:";

/// The answer for one machine loop: the loop's place or name, and its most turns.
type Found = Option<(String, u64)>;

/// At most 1/STRAYS of a loop's instructions may have line info outside the source loop.
const STRAYS: usize = 20;

/// The source loop of a machine loop.
struct Fit {
    place: Place,
    bound: Option<Turns>,
    most: Option<u64>,
    /// Whether all its instructions come from one line of the source loop.
    one_line: bool,
}

/// The bound that is written at a loop.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Turns {
    most: u64,
    /// The name under which fewer may be given.
    name: Option<String>,
}

impl Turns {
    /// The number or the name with a number that stands behind the mark.
    fn parse(word: &str) -> Option<Self> {
        let word = word.trim_end_matches([',', ';', ':', '.']);
        let (name, most) = match word.split_once('=') {
            Some((name, most)) => (
                Some(name.to_owned())
                    .filter(|name| !name.is_empty())?
                    .into(),
                most,
            ),
            None => (None, word),
        };
        Some(Self {
            most: most.parse().ok()?,
            name,
        })
    }
}

/// A loop of a source file.
#[derive(Debug, Clone, PartialEq, Eq)]
struct SourceLoop {
    first: u32,
    last: u32,
    bound: Option<Turns>,
    /// True for a statement that may contain a hidden loop, false for a loop.
    statement: bool,
    /// The most executions in one activation of a task.
    most: Option<u64>,
    /// Lines in it on which it waits, by `.await`.
    awaits: Vec<u32>,
    /// The first and the last lines of closures in it, which another function may run in a loop of its own.
    closures: Vec<(u32, u32)>,
}

/// Instructions of a machine loop beside those of an `.await` that make it the loop around the `.await`, not
/// one in what is polled there.
const BESIDE_AWAIT: usize = 2;

impl SourceLoop {
    fn holds(&self, line: u32) -> bool {
        (self.first..=self.last).contains(&line)
    }

    /// Whether one of the lines of an instruction is in this loop, which begins at `first`.
    fn is_in(&self, first: &Place, inlined: &[Place]) -> bool {
        let mut inlined = inlined.iter();
        inlined.any(|place| place.file == first.file && self.holds(place.line))
    }

    fn is_loop(&self) -> bool {
        !self.statement || self.bound.is_some()
    }

    /// Whether a line is the loop's own, or a closure's in it.
    fn is_own(&self, line: u32) -> bool {
        let mut closures = self.closures.iter();
        self.statement || !closures.any(|(first, last)| (first..=last).contains(&&line))
    }
}

/// A mark without a number, or without a loop or statement below it.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{place}: `// loop-bound:` or `// at-most:` must be followed by a whole number (`// loop-bound:` also by NAME=NUMBER) and stand directly above a loop or a statement"
)]
pub struct Misplaced {
    /// Its place.
    pub place: Place,
}

/// Source lines of the instructions of a machine loop. Each instruction has several if it was
/// inlined, the innermost first; line zero is left out.
struct LoopPlaces {
    /// Of every instruction that has a line.
    located: Vec<Vec<Place>>,
    /// Of instructions that the compiler generated in an inlined function: their only line is that
    /// of the caller, which need not be in the loop.
    generated: Vec<Vec<Place>>,
    /// Of the branches that repeat or leave the loop.
    deciding: Vec<Vec<Place>>,
}

impl LoopPlaces {
    fn new(image: &Image, graph: &Graph, number: usize) -> Self {
        let l = &graph.loops[number];
        let blocks = || l.blocks.iter().map(|block| &graph.blocks[*block]);
        let instructions = || blocks().flat_map(|block| &block.instructions);
        let is_generated = |address: &u32| {
            let innermost = image.places(*address).into_iter().next();
            innermost.is_some_and(|place| place.line == 0)
        };
        let repeats_or_leaves = |block: &&Block| {
            let mut next = block.successors.iter();
            next.any(|next| *next == l.header || !l.blocks.contains(next))
        };
        let addresses = || instructions().map(|instruction| instruction.address);
        Self {
            located: lines(image, addresses()),
            generated: lines(image, addresses().filter(is_generated)),
            deciding: lines(
                image,
                blocks()
                    .filter(repeats_or_leaves)
                    .map(|block| block.last().address),
            ),
        }
    }

    /// Whether nearly all instructions are in this source loop.
    fn fits(&self, place: &Place, s: &SourceLoop) -> bool {
        let outside = |all: &[Vec<Place>]| {
            let outside = all.iter().filter(|inlined| !s.is_in(place, inlined));
            outside.count()
        };
        let strays = outside(&self.located) - outside(&self.generated);
        strays <= 1 + self.located.len() / STRAYS
    }
}

/// The source lines of these instructions, without those that have none.
fn lines(image: &Image, addresses: impl Iterator<Item = u32>) -> Vec<Vec<Place>> {
    addresses
        .map(|address| {
            let places = image.places(address).into_iter();
            places.filter(|place| place.line != 0).collect()
        })
        .filter(|places: &Vec<Place>| !places.is_empty())
        .collect()
}

/// Loop bounds of all source files, each read when it is first needed.
#[derive(Debug, Default)]
pub struct Annotations {
    root: PathBuf,
    files: RefCell<HashMap<String, Vec<SourceLoop>>>,
    misplaced: RefCell<Vec<Misplaced>>,
    known: RefCell<HashMap<(u32, u32), Found>>,
    /// Most turns of loops by their names.
    named: BTreeMap<String, u64>,
    /// Those of these names that a loop has.
    used: RefCell<BTreeSet<String>>,
}

impl Annotations {
    /// For sources whose relative paths start at `root`.
    #[must_use]
    pub fn new(root: &Path) -> Self {
        Self {
            root: root.to_owned(),
            ..Self::default()
        }
    }

    /// The same with bounds of loops by their names. A name is the loop's place as messages have it, with its
    /// function in brackets or without, or the name of a function, for each loop in it.
    #[must_use]
    pub fn with_bounds(self, named: BTreeMap<String, u64>) -> Self {
        Self { named, ..self }
    }

    /// Names of bounds that no loop has which was asked for so far.
    #[must_use]
    pub fn unused(&self) -> Vec<String> {
        let used = self.used.borrow();
        let unused = self.named.keys().filter(|name| !used.contains(*name));
        unused.cloned().collect()
    }

    /// Misplaced marks in the files that were read so far.
    #[must_use]
    pub fn misplaced(&self) -> Vec<Misplaced> {
        self.misplaced.borrow().clone()
    }

    /// The annotated bound of loop `number` of `graph`, with the place of the
    /// source loop, or the name by which it is bounded.
    #[must_use]
    pub fn bound(&self, image: &Image, graph: &Graph, number: usize) -> Option<(String, u64)> {
        let at = graph.blocks[graph.loops[number].header].start();
        let key = (graph.entry, at);
        if let Some(known) = self.known.borrow().get(&key) {
            return known.clone();
        }
        let annotated = self.find(image, graph, number);
        let found = annotated
            .map(|(place, turns)| self.tighten(&place, turns))
            .or_else(|| self.by_name(image, graph, number));
        self.known.borrow_mut().insert(key, found.clone());
        found
    }

    /// The bound written at the loop at `place`, or the lower one that is given under its name.
    fn tighten(&self, place: &Place, turns: Turns) -> (String, u64) {
        let given = turns.name.and_then(|name| {
            let given = *self.named.get(&name)?;
            self.used.borrow_mut().insert(name.clone());
            (given <= turns.most).then_some((name, given))
        });
        given.unwrap_or_else(|| (place.to_string(), turns.most))
    }

    /// The bound that is given to a loop by one of its names.
    fn by_name(&self, image: &Image, graph: &Graph, number: usize) -> Found {
        if self.named.is_empty() {
            return None;
        }
        let place = self.place(image, graph, number);
        let without = place.split_once(" (").map(|(place, _)| place.to_owned());
        let at = graph.blocks[graph.loops[number].header].start();
        let names = [Some(place), without, Some(image.name(at))];
        let mut names = names.into_iter().flatten();
        let name = names.find(|name| self.named.contains_key(name))?;
        let turns = self.named[&name];
        self.used.borrow_mut().insert(name.clone());
        Some((name, turns))
    }

    /// The place of a loop as messages have it: that of the source loop, or else of its first instruction.
    #[must_use]
    pub fn place(&self, image: &Image, graph: &Graph, number: usize) -> String {
        let at = graph.blocks[graph.loops[number].header].start();
        match self.source_loop(image, graph, number) {
            Some(place) => format!("{place} ({})", image.name(at)),
            None => image.describe(at),
        }
    }

    /// The source of loop `number` if it is not where the image says, so that nothing written in it was read. Of the
    /// toolchain's sources, which are seldom there, none counts.
    pub(crate) fn absent(&self, image: &Image, graph: &Graph, number: usize) -> Option<String> {
        let at = graph.blocks[graph.loops[number].header].start();
        let mut places = image.places(at).into_iter();
        let own = places.find(|place| !place.file.starts_with("/rustc/"))?;
        let is_there = self.root.join(&own.file).is_file();
        (!is_there).then_some(own.file)
    }

    fn find(&self, image: &Image, graph: &Graph, number: usize) -> Option<(Place, Turns)> {
        let found = self.innermost(image, graph, number)?;
        // An inner machine loop may come from a function that is inlined into the same source
        // loop (a copy, the search of an iterator). Its only line in the source loop is that of
        // the call. A source loop that the compiler split in two has several lines.
        let mut outer = graph.loops[number].parent;
        while let Some(parent) = outer {
            if found.one_line
                && self
                    .innermost(image, graph, parent)
                    .is_some_and(|other| other.place == found.place)
            {
                return None;
            }
            outer = graph.loops[parent].parent;
        }
        let bound = found.bound?;
        match &self.merged(image, graph, number)[..] {
            [] | [_] => Some((found.place, bound)),
            merged => {
                // Each turn of the outer one has those of the inner one, begins it and leaves it.
                let mut each = merged.iter().map(|bound| Some(bound.as_ref()?.most + 2));
                let most = each.try_fold(1_u64, |all, most| all.checked_mul(most?))?;
                Some((found.place, Turns { most, name: None }))
            }
        }
    }

    /// The bounds of the source loops that a machine loop is made of: the compiler may let an inner and an outer one begin
    /// with the same instruction. Those that have a machine loop of their own are none of them.
    fn merged(&self, image: &Image, graph: &Graph, number: usize) -> Vec<Option<Turns>> {
        let l = &graph.loops[number];
        let repeating: Vec<&Block> = l
            .blocks
            .iter()
            .map(|block| &graph.blocks[*block])
            .filter(|block| block.successors.contains(&l.header))
            .collect();
        let mut merged: Vec<(Place, Option<Turns>)> = Vec::new();
        if repeating.len() > 1 {
            for block in repeating {
                // The outer one may be repeated from within the inner one, by its label.
                let places = image.places(block.last().address);
                let mut around = places.iter().map(|place| self.around(place));
                let innermost = around.find(|all| !all.is_empty());
                for found in innermost.into_iter().flatten() {
                    if merged.iter().all(|(place, _)| *place != found.0) {
                        merged.push(found);
                    }
                }
            }
        }
        if merged.len() > 1 {
            let others = (0..graph.loops.len()).filter(|other| {
                let header = graph.loops[*other].header;
                *other != number
                    && (l.blocks.contains(&header)
                        || graph.loops[*other].blocks.contains(&l.header))
            });
            for other in others {
                if let Some(fit) = self.innermost(image, graph, other) {
                    merged.retain(|(place, _)| *place != fit.place);
                }
            }
        }
        merged.into_iter().map(|(_, bound)| bound).collect()
    }

    /// The loops of the sources that hold a place, and their bounds.
    fn around(&self, place: &Place) -> Vec<(Place, Option<Turns>)> {
        let at = |line| Place {
            file: place.file.clone(),
            line,
        };
        self.with_file(&place.file, |loops| {
            let around = loops.iter().filter(|s| !s.statement && s.holds(place.line));
            around.map(|s| (at(s.first), s.bound.clone())).collect()
        })
    }

    /// The source loop that a machine loop belongs to, if one is found.
    #[must_use]
    pub fn source_loop(&self, image: &Image, graph: &Graph, number: usize) -> Option<Place> {
        Some(self.innermost(image, graph, number)?.place)
    }

    /// The innermost source loop that a machine loop belongs to.
    ///
    /// Nearly every located instruction of the machine loop must be in it; the compiler shares some
    /// instructions with the code before or after the loop. Most branches that repeat or leave the
    /// machine loop must be in it too, unless no inner machine loop fits as well.
    fn innermost(&self, image: &Image, graph: &Graph, number: usize) -> Option<Fit> {
        let places = LoopPlaces::new(image, graph, number);
        let (place, s) = self.candidates(&places).into_iter().find(|(place, s)| {
            let decided = places.deciding.iter();
            let decided = decided.filter(|inlined| s.is_in(place, inlined)).count();
            let decides = 2 * decided >= places.deciding.len();
            places.fits(place, s) && (decides || !self.fits_inner(image, graph, number, place))
        })?;
        let lines = places.located.iter().filter_map(|inlined| {
            let mut outermost = inlined.iter().rev();
            outermost.find(|p| p.file == place.file && s.holds(p.line))
        });
        // The branches that repeat or leave the loop must be written at the loop itself. If they
        // are in a function that the loop's body calls, the machine loop is one of that function. What
        // an `.await` polls is such a function, but leaves and repeats the loop around the `.await`.
        let beside = |line: u32| lines.clone().filter(|p| p.line != line).count();
        let waits = |line: u32| s.awaits.contains(&line) && beside(line) >= BESIDE_AWAIT;
        let own = places.deciding.iter().any(|inlined| {
            inlined.iter().enumerate().any(|(depth, p)| {
                let own = depth == 0 && s.is_own(p.line) || p.line == s.first || s.statement;
                let here = p.file == place.file && s.holds(p.line);
                here && (own || waits(p.line))
            })
        });
        let mut all = lines.clone();
        let first = all.next();
        let one_line = all.all(|line| Some(line) == first);
        own.then_some(Fit {
            place,
            bound: s.bound.clone(),
            most: s.most,
            one_line,
        })
    }

    /// Source loops that hold an instruction of a machine loop, the innermost first. Of several, the
    /// one that is inlined deepest is the innermost; of several in one function, the shortest.
    fn candidates(&self, places: &LoopPlaces) -> Vec<(Place, SourceLoop)> {
        let mut candidates: Vec<(Place, SourceLoop)> = Vec::new();
        for place in places.located.iter().chain(&places.deciding).flatten() {
            self.with_file(&place.file, |loops| {
                for s in loops.iter().filter(|s| s.is_loop() && s.holds(place.line)) {
                    let first = Place {
                        file: place.file.clone(),
                        line: s.first,
                    };
                    if !candidates.iter().any(|(known, _)| *known == first) {
                        candidates.push((first, s.clone()));
                    }
                }
            });
        }
        candidates.sort_by_cached_key(|(place, s)| {
            let depth = |inlined: &Vec<Place>| {
                let mut inwards = inlined.iter().rev();
                inwards.position(|p| p.file == place.file && s.holds(p.line))
            };
            let deepest = places.located.iter().filter_map(depth).max();
            (std::cmp::Reverse(deepest), s.last - s.first, place.clone())
        });
        candidates
    }

    /// Whether a machine loop inside this one belongs to the source loop at `place`.
    fn fits_inner(&self, image: &Image, graph: &Graph, number: usize, place: &Place) -> bool {
        let outer = &graph.loops[number];
        (0..graph.loops.len()).any(|other| {
            let header = graph.loops[other].header;
            header != outer.header
                && outer.blocks.contains(&header)
                && self
                    .innermost(image, graph, other)
                    .is_some_and(|fit| fit.place == *place)
        })
    }

    /// The most executions of a block in one activation of a task, by the annotation of its
    /// statement, and the place of the statement.
    ///
    /// Every located instruction of the block must come from the statement, and no loop of the
    /// statement may repeat the block.
    #[must_use]
    pub fn at_most(&self, image: &Image, graph: &Graph, number: usize) -> Option<(Place, u64)> {
        let locate = |block: usize| {
            let instructions = graph.blocks[block].instructions.iter();
            lines(image, instructions.map(|instruction| instruction.address))
        };
        // Above a loop the mark limits its turns, which are the executions of its header.
        let of_loop = graph
            .loops
            .iter()
            .position(|l| l.header == number)
            .and_then(|l| self.innermost(image, graph, l))
            .and_then(|fit| Some((fit.place, fit.most?)));
        if of_loop.is_some() {
            return of_loop;
        }
        let located = locate(number);
        let mut candidates: Vec<(Place, SourceLoop)> = Vec::new();
        for place in located.first()? {
            self.with_file(&place.file, |loops| {
                let marked = loops.iter().filter(|s| s.statement && s.most.is_some());
                for s in marked.filter(|s| s.holds(place.line)) {
                    let first = Place {
                        file: place.file.clone(),
                        line: s.first,
                    };
                    candidates.push((first, s.clone()));
                }
            });
        }
        let holds = |place: &Place, s: &SourceLoop, located: &[Vec<Place>]| {
            located.iter().all(|inlined| s.is_in(place, inlined))
        };
        candidates
            .into_iter()
            .filter(|(place, s)| {
                let repeated = graph.innermost[number].is_some_and(|l| {
                    let mut blocks = graph.loops[l].blocks.iter();
                    blocks.all(|block| holds(place, s, &locate(*block)))
                });
                !repeated && holds(place, s, &located)
            })
            .filter_map(|(place, s)| Some((place, s.most?)))
            .min_by_key(|(_, most)| *most)
    }

    fn with_file<T>(&self, file: &str, ask: impl FnOnce(&[SourceLoop]) -> T) -> T {
        let mut files = self.files.borrow_mut();
        let loops = files.entry(file.to_owned()).or_insert_with(|| {
            let source = std::fs::read_to_string(self.root.join(file)).unwrap_or_default();
            let (loops, misplaced) = parse(file, &source);
            self.misplaced.borrow_mut().extend(misplaced);
            loops
        });
        ask(loops)
    }
}

fn parse(file: &str, source: &str) -> (Vec<SourceLoop>, Vec<Misplaced>) {
    let marks = |mark: &str| -> HashMap<u32, Option<Turns>> {
        let lines = source.lines().enumerate();
        lines
            .filter_map(|(index, line)| {
                let rest = line.trim().strip_prefix(mark)?;
                let turns = rest.split_whitespace().next().and_then(Turns::parse);
                Some((index as u32 + 1, turns))
            })
            .collect()
    };
    let (mut bounds, mut mosts) = (marks(MARK), marks(AT_MOST));
    for most in mosts.values_mut() {
        most.take_if(|most| most.name.is_some());
    }
    let mut finder = Finder { loops: Vec::new() };
    if let Ok(parsed) = syn::parse_file(source) {
        finder.visit_file(&parsed);
    }
    // Other comments may be between the mark and its loop or statement.
    let lines: Vec<&str> = source.lines().collect();
    let take = |marks: &mut HashMap<u32, Option<Turns>>, first: u32| {
        let mut above = first - 1;
        while above > 0 && lines[above as usize - 1].trim().starts_with("//") {
            if let Some(turns) = marks.get(&above).cloned().flatten() {
                marks.remove(&above);
                return Some(turns);
            }
            above -= 1;
        }
        None
    };
    for found in &mut finder.loops {
        found.bound = take(&mut bounds, found.first);
        found.most = take(&mut mosts, found.first).map(|turns| turns.most);
    }
    finder
        .loops
        .retain(|found| !found.statement || found.bound.is_some() || found.most.is_some());
    let misplaced = bounds
        .keys()
        .chain(mosts.keys())
        .map(|&line| Misplaced {
            place: Place {
                file: file.to_owned(),
                line,
            },
        })
        .collect();
    (finder.loops, misplaced)
}

struct Finder {
    loops: Vec<SourceLoop>,
}

impl Finder {
    fn add(&mut self, span: proc_macro2::Span) {
        self.loops.push(SourceLoop {
            first: span.start().line as u32,
            last: span.end().line as u32,
            bound: None,
            statement: false,
            most: None,
            awaits: Vec::new(),
            closures: Vec::new(),
        });
    }

    /// The innermost of the loops so far that holds a line and is no statement.
    fn around(&mut self, line: u32) -> Option<&mut SourceLoop> {
        let mut around = self.loops.iter_mut().rev();
        around.find(|one| !one.statement && one.holds(line))
    }
}

impl<'ast> Visit<'ast> for Finder {
    fn visit_stmt(&mut self, node: &'ast syn::Stmt) {
        use syn::Expr::{ForLoop, Loop, While};
        let is_loop = matches!(node, syn::Stmt::Expr(ForLoop(_) | Loop(_) | While(_), _));
        // A loop is added when its expression is visited.
        if !is_loop {
            self.add(node.span());
            if let Some(added) = self.loops.last_mut() {
                added.statement = true;
            }
        }
        syn::visit::visit_stmt(self, node);
    }

    fn visit_expr_await(&mut self, node: &'ast syn::ExprAwait) {
        let line = node.await_token.span().start().line as u32;
        if let Some(innermost) = self.around(line) {
            innermost.awaits.push(line);
        }
        syn::visit::visit_expr_await(self, node);
    }

    fn visit_expr_closure(&mut self, node: &'ast syn::ExprClosure) {
        let span = node.span();
        let (first, last) = (span.start().line as u32, span.end().line as u32);
        if let Some(innermost) = self.around(first).filter(|_| first < last) {
            innermost.closures.push((first, last));
        }
        syn::visit::visit_expr_closure(self, node);
    }

    fn visit_expr_for_loop(&mut self, node: &'ast syn::ExprForLoop) {
        self.add(node.span());
        syn::visit::visit_expr_for_loop(self, node);
    }

    fn visit_expr_while(&mut self, node: &'ast syn::ExprWhile) {
        self.add(node.span());
        syn::visit::visit_expr_while(self, node);
    }

    fn visit_expr_loop(&mut self, node: &'ast syn::ExprLoop) {
        self.add(node.span());
        syn::visit::visit_expr_loop(self, node);
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::{Annotations, Place, SourceLoop, Turns, parse};

    fn turns(most: u64) -> Turns {
        Turns { most, name: None }
    }

    #[test]
    fn a_mark_belongs_to_the_loop_below() {
        let source = "fn f() {\n    // loop-bound: 12 one turn for each window\n    // and nothing else\n    while x() {\n        for i in y {}\n    }\n}\n";
        let (loops, misplaced) = parse("f.rs", source);
        assert_eq!(
            loops,
            [
                SourceLoop {
                    first: 4,
                    last: 6,
                    bound: Some(turns(12)),
                    statement: false,
                    most: None,
                    awaits: Vec::new(),
                    closures: Vec::new()
                },
                SourceLoop {
                    first: 5,
                    last: 5,
                    bound: None,
                    statement: false,
                    most: None,
                    awaits: Vec::new(),
                    closures: Vec::new()
                }
            ]
        );
        assert!(misplaced.is_empty());
    }

    #[test]
    fn a_mark_may_stand_above_a_search() {
        let source = "fn f() {\n    let a = 1;\n    // loop-bound: 7\n    let b = y\n        .iter()\n        .position(|z| z == a);\n}\n";
        let (loops, misplaced) = parse("f.rs", source);
        assert_eq!(
            loops,
            [SourceLoop {
                first: 4,
                last: 6,
                bound: Some(turns(7)),
                statement: true,
                most: None,
                awaits: Vec::new(),
                closures: Vec::new()
            }]
        );
        assert!(misplaced.is_empty());
    }

    #[test]
    fn a_statement_and_a_loop_may_say_how_often_they_run() {
        let source = "fn f() {\n    // at-most: 2 in one activation\n    g();\n    // loop-bound: 9\n    // at-most: 20\n    while x() {}\n}\n";
        let (loops, misplaced) = parse("f.rs", source);
        let found: Vec<_> = loops
            .iter()
            .map(|l| (l.first, l.bound.clone(), l.most, l.statement))
            .collect();
        assert_eq!(
            found,
            [
                (3, None, Some(2), true),
                (6, Some(turns(9)), Some(20), false)
            ]
        );
        assert!(misplaced.is_empty());
    }

    #[test]
    fn a_mark_without_loop_or_number_is_reported() {
        let source = "fn f() {\n    // loop-bound: 3\n\n    let x = 1;\n    // loop-bound: many\n    loop {}\n}\n";
        let (_, mut misplaced) = parse("f.rs", source);
        misplaced.sort_by_key(|m| m.place.line);
        let lines: Vec<u32> = misplaced.iter().map(|m| m.place.line).collect();
        assert_eq!(lines, [2, 5]);
        assert_eq!(
            misplaced[0].to_string(),
            "f.rs:2: `// loop-bound:` or `// at-most:` must be followed by a whole number (`// loop-bound:` also by NAME=NUMBER) and stand directly above a loop or a statement"
        );
    }

    #[test]
    fn a_bound_may_have_a_name() {
        let source = "fn f() {\n    // loop-bound: senders=32. One turn each.\n    loop {}\n    // loop-bound: =3\n    loop {}\n    // at-most: senders=3\n    g();\n}\n";
        let (loops, misplaced) = parse("f.rs", source);
        let bound = Turns {
            most: 32,
            name: Some("senders".to_owned()),
        };
        assert_eq!(loops[0].bound, Some(bound.clone()));
        let mut lines: Vec<u32> = misplaced.iter().map(|m| m.place.line).collect();
        lines.sort_unstable();
        assert_eq!(lines, [4, 6]);

        let place = Place {
            file: "f.rs".to_owned(),
            line: 3,
        };
        let given = |turns| {
            let named = BTreeMap::from([("senders".to_owned(), turns)]);
            Annotations::default().with_bounds(named)
        };
        let fewer = given(4);
        let tightened = fewer.tighten(&place, bound.clone());
        assert_eq!(tightened, ("senders".to_owned(), 4));
        assert!(fewer.unused().is_empty());
        let more = given(33).tighten(&place, bound.clone());
        assert_eq!(more, ("f.rs:3".to_owned(), 32), "the mark is always true");
        let none = Annotations::default().tighten(&place, bound);
        assert_eq!(none, ("f.rs:3".to_owned(), 32));
    }

    #[test]
    fn a_loop_knows_where_it_waits() {
        let source = "async fn f() {\n    loop {\n        step();\n        delay(1)\n            .await;\n        for i in y {\n            x.await;\n        }\n    }\n}\n";
        let (loops, _) = parse("f.rs", source);
        let awaits = loops
            .iter()
            .map(|found| (found.first, found.awaits.clone()));
        assert_eq!(awaits.collect::<Vec<_>>(), [(2, vec![5]), (6, vec![7])]);
    }
}
