//! Loop bounds written at the loop.
//!
//! A comment `// loop-bound: N` on a line of its own, directly above a `for`,
//! `while` or `loop`, says that one entry into the loop takes at most N turns;
//! above another statement, that of each loop which an iterator or a search in
//! it makes. `// at-most: N` above a statement says that one activation of a
//! task runs it at most N times in all, whatever the loops around it allow; above
//! a loop, that all its entries together take at most N turns.
//! The analysis finds the loop again through the image's line tables: a machine
//! loop is that source loop when nearly all of its instructions were written
//! there or inlined from there, no inner source loop holds as many, and the
//! branches that repeat or leave it are the loop's own. A machine loop that
//! fits no source loop so closely has no bound, which is reported.
//!
//! A comment costs nothing and is possible in crates that forbid unsafe code,
//! which a marker in assembly would not be; that it is right is checked when
//! the code runs, by counting.

use std::cell::RefCell;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

use syn::spanned::Spanned;
use syn::visit::Visit;

use super::graph::Graph;
use super::image::{Image, Place};

/// The mark that begins the bound of a loop.
const MARK: &str = "// loop-bound:";
/// The mark that begins the most times a statement runs in one activation.
const AT_MOST: &str = "// at-most:";

/// The answer for one machine loop.
type Found = Option<(Place, u64)>;

/// One of so many located instructions of a machine loop may come from
/// somewhere else.
const STRAYS: usize = 20;

/// The source loop of a machine loop.
struct Fit {
    place: Place,
    bound: Option<u64>,
    most: Option<u64>,
    /// Everything comes from one line of it.
    one_line: bool,
}

/// A loop of a source file.
#[derive(Debug, Clone, PartialEq, Eq)]
struct SourceLoop {
    first: u32,
    last: u32,
    bound: Option<u64>,
    /// A statement that hides a loop, not a loop.
    statement: bool,
    /// How often it is run in one activation of a task, at most.
    most: Option<u64>,
}

impl SourceLoop {
    fn holds(&self, line: u32) -> bool {
        (self.first..=self.last).contains(&line)
    }

    fn is_loop(&self) -> bool {
        !self.statement || self.bound.is_some()
    }
}

/// A mark that no loop follows or that has no number.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{place}: `// loop-bound:` or `// at-most:` must be followed by a whole number and stand directly above a loop or a statement"
)]
pub struct Misplaced {
    /// Where it stands.
    pub place: Place,
}

/// Loop bounds of all source files, read when they are first asked for.
#[derive(Debug, Default)]
pub struct Annotations {
    root: PathBuf,
    files: RefCell<HashMap<String, Vec<SourceLoop>>>,
    misplaced: RefCell<Vec<Misplaced>>,
    known: RefCell<HashMap<(u32, u32), Found>>,
}

impl Annotations {
    /// Annotations of sources whose relative paths start from `root`.
    #[must_use]
    pub fn new(root: &Path) -> Self {
        Self {
            root: root.to_owned(),
            ..Self::default()
        }
    }

    /// Marks that say nothing, among the files read so far.
    #[must_use]
    pub fn misplaced(&self) -> Vec<Misplaced> {
        self.misplaced.borrow().clone()
    }

    /// The annotated bound of loop `number` of `graph`, with the place of the
    /// source loop.
    #[must_use]
    pub fn bound(&self, image: &Image, graph: &Graph, number: usize) -> Option<(Place, u64)> {
        let at = graph.blocks[graph.loops[number].header].start();
        let key = (graph.entry, at);
        if let Some(known) = self.known.borrow().get(&key) {
            return known.clone();
        }
        let found = self.find(image, graph, number);
        self.known.borrow_mut().insert(key, found.clone());
        found
    }

    fn find(&self, image: &Image, graph: &Graph, number: usize) -> Option<(Place, u64)> {
        let found = self.innermost(image, graph, number)?;
        // An inner machine loop inlined into the same source loop (a copy, an
        // iterator's search) is another loop. It has one line of it, that of
        // the call; a source loop that was split in two has several.
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
        Some((found.place, found.bound?))
    }

    /// The source loop that a machine loop is, where one is found.
    #[must_use]
    pub fn source_loop(&self, image: &Image, graph: &Graph, number: usize) -> Option<Place> {
        Some(self.innermost(image, graph, number)?.place)
    }

    /// The innermost source loop that a machine loop belongs to: nearly every
    /// located instruction (the compiler shares some with what comes before
    /// or after), and most branches that repeat or leave it unless no loop
    /// inside fits as well.
    fn innermost(&self, image: &Image, graph: &Graph, number: usize) -> Option<Fit> {
        let l = &graph.loops[number];
        let locate = |address: u32| -> Vec<Place> {
            let places = image.places(address).into_iter();
            places.filter(|place| place.line != 0).collect()
        };
        let located: Vec<Vec<Place>> = l
            .blocks
            .iter()
            .flat_map(|block| &graph.blocks[*block].instructions)
            .map(|instruction| locate(instruction.address))
            .filter(|places| !places.is_empty())
            .collect();
        // What the compiler made up in a function that it put here has a line
        // of the caller only, which need not be the loop's.
        let made_up = l
            .blocks
            .iter()
            .flat_map(|block| &graph.blocks[*block].instructions)
            .map(|instruction| image.places(instruction.address))
            .filter(|places| places.first().is_some_and(|place| place.line == 0))
            .map(|places| places.into_iter().filter(|place| place.line != 0).collect())
            .filter(|places: &Vec<Place>| !places.is_empty())
            .collect::<Vec<_>>();
        let deciding: Vec<Vec<Place>> = l
            .blocks
            .iter()
            .map(|block| &graph.blocks[*block])
            .filter(|block| {
                let mut next = block.successors.iter();
                next.any(|next| *next == l.header || !l.blocks.contains(next))
            })
            .map(|block| locate(block.last().address))
            .filter(|places| !places.is_empty())
            .collect();
        let mut candidates: Vec<(Place, SourceLoop)> = Vec::new();
        for place in located.iter().chain(&deciding).flatten() {
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
        // The one inlined deepest is the innermost; of several in one function
        // the shortest.
        candidates.sort_by_cached_key(|(place, s)| {
            let depth = |places: &Vec<Place>| {
                let mut inwards = places.iter().rev();
                inwards.position(|p| p.file == place.file && s.holds(p.line))
            };
            let deepest = located.iter().filter_map(depth).max();
            (std::cmp::Reverse(deepest), s.last - s.first, place.clone())
        });
        let holds = |place: &Place, s: &SourceLoop, places: &[Place]| {
            let mut places = places.iter();
            places.any(|p| p.file == place.file && s.holds(p.line))
        };
        let (place, s) = candidates.into_iter().find(|(place, s)| {
            let strays = located
                .iter()
                .filter(|places| !holds(place, s, places))
                .count();
            let excused = made_up
                .iter()
                .filter(|places| !holds(place, s, places))
                .count();
            let strays = strays - excused;
            let decided = deciding
                .iter()
                .filter(|places| holds(place, s, places))
                .count();
            let inner = || {
                (0..graph.loops.len()).any(|other| {
                    let header = graph.loops[other].header;
                    header != l.header
                        && l.blocks.contains(&header)
                        && self
                            .innermost(image, graph, other)
                            .is_some_and(|fit| fit.place == *place)
                })
            };
            strays <= 1 + located.len() / STRAYS && (2 * decided >= deciding.len() || !inner())
        })?;
        // What repeats or leaves the loop must be written at the loop itself,
        // not in something called from its body: else it is a loop of that.
        let own = deciding.iter().any(|places| {
            places.iter().enumerate().any(|(depth, p)| {
                let own = depth == 0 || p.line == s.first || s.statement;
                own && p.file == place.file && s.holds(p.line)
            })
        });
        let mut lines = located.iter().filter_map(|places| {
            let mut outermost = places.iter().rev();
            outermost.find(|p| p.file == place.file && s.holds(p.line))
        });
        let first = lines.next();
        let one_line = lines.all(|line| Some(line) == first);
        own.then_some(Fit {
            place,
            bound: s.bound,
            most: s.most,
            one_line,
        })
    }

    /// How often a block is run in one activation of a task at most, by the
    /// statement it was made from: every located instruction comes from it, and
    /// no loop of the statement repeats the block. With the statement's place.
    #[must_use]
    pub fn at_most(&self, image: &Image, graph: &Graph, number: usize) -> Option<(Place, u64)> {
        let locate = |block: usize| -> Vec<Vec<Place>> {
            let instructions = graph.blocks[block].instructions.iter();
            instructions
                .map(|instruction| image.places(instruction.address))
                .map(|places| places.into_iter().filter(|p| p.line != 0).collect())
                .filter(|places: &Vec<Place>| !places.is_empty())
                .collect()
        };
        // Above a loop the mark is about its turns: executions of its header.
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
            located.iter().all(|places| {
                let mut places = places.iter();
                places.any(|p| p.file == place.file && s.holds(p.line))
            })
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
    let marks = |mark: &str| -> HashMap<u32, Option<u64>> {
        source
            .lines()
            .enumerate()
            .filter_map(|(index, line)| {
                let rest = line.trim().strip_prefix(mark)?;
                let number = rest
                    .split_whitespace()
                    .next()
                    .and_then(|word| word.trim_end_matches([',', ';', ':', '.']).parse().ok());
                Some((index as u32 + 1, number))
            })
            .collect()
    };
    let (mut bounds, mut mosts) = (marks(MARK), marks(AT_MOST));
    let mut finder = Finder { loops: Vec::new() };
    if let Ok(parsed) = syn::parse_file(source) {
        finder.visit_file(&parsed);
    }
    // Other comments may stand between the mark and what it is about.
    let lines: Vec<&str> = source.lines().collect();
    let take = |marks: &mut HashMap<u32, Option<u64>>, first: u32| {
        let mut above = first - 1;
        while above > 0 && lines[above as usize - 1].trim().starts_with("//") {
            if let Some(number) = marks.get(&above).copied().flatten() {
                marks.remove(&above);
                return Some(number);
            }
            above -= 1;
        }
        None
    };
    for found in &mut finder.loops {
        found.bound = take(&mut bounds, found.first);
        found.most = take(&mut mosts, found.first);
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
        });
    }
}

impl<'ast> Visit<'ast> for Finder {
    fn visit_stmt(&mut self, node: &'ast syn::Stmt) {
        use syn::Expr::{ForLoop, Loop, While};
        let is_loop = matches!(node, syn::Stmt::Expr(ForLoop(_) | Loop(_) | While(_), _));
        // A loop is noted as such when it is visited; a statement has its own
        // entry, which an `at-most` above a loop needs as well.
        if !is_loop {
            self.add(node.span());
            if let Some(added) = self.loops.last_mut() {
                added.statement = true;
            }
        }
        syn::visit::visit_stmt(self, node);
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
    use super::{SourceLoop, parse};

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
                    bound: Some(12),
                    statement: false,
                    most: None
                },
                SourceLoop {
                    first: 5,
                    last: 5,
                    bound: None,
                    statement: false,
                    most: None
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
                bound: Some(7),
                statement: true,
                most: None
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
            .map(|l| (l.first, l.bound, l.most, l.statement))
            .collect();
        assert_eq!(
            found,
            [(3, None, Some(2), true), (6, Some(9), Some(20), false)]
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
            "f.rs:2: `// loop-bound:` or `// at-most:` must be followed by a whole number and stand directly above a loop or a statement"
        );
    }
}
