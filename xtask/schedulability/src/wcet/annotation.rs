//! Loop bounds written at the loop.
//!
//! A comment `// loop-bound: N` on a line of its own, directly above a `for`,
//! `while` or `loop`, says that one entry into the loop takes at most N turns.
//! The analysis finds the loop again through the image's line tables: a machine
//! loop is that source loop when every one of its instructions was written
//! there or inlined from there, no inner source loop holds all of them, and
//! the branch that repeats or leaves it is the loop's own. A machine loop that
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

/// The mark that begins an annotation.
const MARK: &str = "// loop-bound:";

/// The answer for one machine loop.
type Found = Option<(Place, u64)>;

/// A loop of a source file.
#[derive(Debug, Clone, PartialEq, Eq)]
struct SourceLoop {
    first: u32,
    last: u32,
    bound: Option<u64>,
}

impl SourceLoop {
    fn holds(&self, line: u32) -> bool {
        (self.first..=self.last).contains(&line)
    }
}

/// A mark that no loop follows or that has no number.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{place}: `// loop-bound:` must be followed by a whole number and stand directly above a loop"
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
        let (place, bound) = self.innermost(image, graph, number)?;
        // An inner machine loop inlined into the same source loop (a copy, an
        // iterator's search) is another loop.
        let mut outer = graph.loops[number].parent;
        while let Some(parent) = outer {
            if self
                .innermost(image, graph, parent)
                .is_some_and(|(other, _)| other == place)
            {
                return None;
            }
            outer = graph.loops[parent].parent;
        }
        Some((place, bound?))
    }

    /// The source loop that a machine loop is, where one is found.
    #[must_use]
    pub fn source_loop(&self, image: &Image, graph: &Graph, number: usize) -> Option<Place> {
        let (place, _) = self.innermost(image, graph, number)?;
        Some(place)
    }

    /// The innermost source loop that every located instruction of a machine
    /// loop belongs to, and its bound. Code of another place would mean that
    /// the machine loop is an outer one.
    fn innermost(
        &self,
        image: &Image,
        graph: &Graph,
        number: usize,
    ) -> Option<(Place, Option<u64>)> {
        let l = &graph.loops[number];
        let located: Vec<Vec<Place>> = l
            .blocks
            .iter()
            .flat_map(|block| &graph.blocks[*block].instructions)
            .map(|instruction| image.places(instruction.address))
            .map(|places| places.into_iter().filter(|p| p.line != 0).collect())
            .filter(|places: &Vec<Place>| !places.is_empty())
            .collect();
        let mut candidates: Vec<(Place, SourceLoop)> = Vec::new();
        for place in located.first()? {
            self.with_file(&place.file, |loops| {
                for s in loops.iter().filter(|s| s.holds(place.line)) {
                    let first = Place {
                        file: place.file.clone(),
                        line: s.first,
                    };
                    candidates.push((first, s.clone()));
                }
            });
        }
        candidates.sort_by_key(|(_, s)| s.last - s.first);
        let (place, s) = candidates.into_iter().find(|(place, s)| {
            located.iter().all(|places| {
                places
                    .iter()
                    .any(|p| p.file == place.file && s.holds(p.line))
            })
        })?;
        // What repeats or leaves the loop must be written at the loop itself,
        // not in something called from its body: else it is a loop of that.
        let own = l.blocks.iter().any(|block| {
            let block = &graph.blocks[*block];
            let decides = block
                .successors
                .iter()
                .any(|next| *next == l.header || !l.blocks.contains(next));
            decides
                && image
                    .places(block.last().address)
                    .iter()
                    .enumerate()
                    .any(|(depth, p)| {
                        p.file == place.file && s.holds(p.line) && (depth == 0 || p.line == s.first)
                    })
        });
        own.then_some((place, s.bound))
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
    let mut marks: HashMap<u32, Option<u64>> = source
        .lines()
        .enumerate()
        .filter_map(|(index, line)| {
            let rest = line.trim().strip_prefix(MARK)?;
            let number = rest
                .split_whitespace()
                .next()
                .and_then(|word| word.trim_end_matches([',', ';', ':', '.']).parse().ok());
            Some((index as u32 + 1, number))
        })
        .collect();
    let mut finder = Finder { loops: Vec::new() };
    if let Ok(parsed) = syn::parse_file(source) {
        finder.visit_file(&parsed);
    }
    // Other comments may stand between the mark and its loop.
    let lines: Vec<&str> = source.lines().collect();
    for found in &mut finder.loops {
        let mut above = found.first - 1;
        while above > 0 {
            if let Some(bound) = marks.get(&above).copied().flatten() {
                found.bound = Some(bound);
                marks.remove(&above);
                break;
            }
            if !lines[above as usize - 1].trim().starts_with("//") {
                break;
            }
            above -= 1;
        }
    }
    let misplaced = marks
        .keys()
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
        });
    }
}

impl<'ast> Visit<'ast> for Finder {
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
                    bound: Some(12)
                },
                SourceLoop {
                    first: 5,
                    last: 5,
                    bound: None
                }
            ]
        );
        assert!(misplaced.is_empty());
    }

    #[test]
    fn a_mark_without_loop_or_number_is_reported() {
        let source = "fn f() {\n    // loop-bound: 3\n    let x = 1;\n    // loop-bound: many\n    loop {}\n}\n";
        let (_, mut misplaced) = parse("f.rs", source);
        misplaced.sort_by_key(|m| m.place.line);
        let lines: Vec<u32> = misplaced.iter().map(|m| m.place.line).collect();
        assert_eq!(lines, [2, 4]);
        assert_eq!(
            misplaced[0].to_string(),
            "f.rs:2: `// loop-bound:` must be followed by a whole number and stand directly above a loop"
        );
    }
}
