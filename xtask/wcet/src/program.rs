//! The image under analysis and the control flow found in it so far.

use std::collections::{BTreeSet, HashMap};
use std::rc::Rc;

use super::annotation::Annotations;
use super::graph::{Graph, Returning, Targets};
use super::image::Image;
use super::software;

/// An image with its annotations and its control-flow graphs.
#[derive(Debug)]
pub(crate) struct Program<'a> {
    /// The image.
    pub image: &'a Image,
    /// Loop bounds in the sources.
    pub annotations: &'a Annotations,
    /// Loads that find zero.
    pub zeros: Rc<BTreeSet<u32>>,
    targets: Targets,
    returning: Returning,
    graphs: HashMap<u32, Rc<Graph>>,
}

impl<'a> Program<'a> {
    /// Without any known target of an indirect jump.
    #[must_use]
    pub(crate) fn new(image: &'a Image, annotations: &'a Annotations) -> Self {
        Self {
            image,
            annotations,
            zeros: Rc::new(software::finding_no_link(image)),
            targets: Targets::new(),
            returning: Returning::default(),
            graphs: HashMap::new(),
        }
    }

    /// The control flow of the function at `entry`, as far as it is known.
    pub(crate) fn graph(&mut self, entry: u32) -> Option<Rc<Graph>> {
        if let Some(graph) = self.graphs.get(&entry) {
            return Some(graph.clone());
        }
        let graph = Graph::build(self.image, entry, &self.targets, &mut self.returning).ok()?;
        let graph = Rc::new(graph);
        self.graphs.insert(entry, graph.clone());
        Some(graph)
    }

    /// Whether `target` is a known target of the indirect jump at `jump`.
    #[must_use]
    pub(crate) fn has_target(&self, jump: u32, target: u32) -> bool {
        let known = self.targets.get(&jump);
        known.is_some_and(|known| known.contains(&target))
    }

    /// Adds targets of indirect jumps. The graphs are built anew.
    pub(crate) fn add_targets(&mut self, found: Targets) {
        for (jump, targets) in found {
            self.targets.entry(jump).or_default().extend(targets);
        }
        self.graphs.clear();
    }

    /// The annotated bound of loop `number` of `graph`, and the place of the loop.
    #[must_use]
    pub(crate) fn annotation(&self, graph: &Graph, number: usize) -> Option<(String, u64)> {
        self.annotations.bound(self.image, graph, number)
    }
}
