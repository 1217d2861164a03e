//! The tasks of an RTIC application, read from its source: their interrupts, priorities and
//! resources.
//!
//! RTIC has a default priority. Here a task without a written priority is an error.

use std::collections::BTreeMap;

use proc_macro2::{TokenStream, TokenTree};
use syn::spanned::Spanned;

/// The highest priority of a task. RTIC has one more, whose tasks `BASEPRI` cannot mask. The interrupt
/// that watches the supply of the F446 has it, also while the program starts.
const HIGHEST: u32 = 15;

/// A task of an application.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Task {
    /// Its name.
    pub name: String,
    /// The interrupt it is bound to; `None` for a software task.
    pub binds: Option<String>,
    /// Its priority; 1 is the lowest.
    pub priority: u32,
    /// Shared resources that it locks.
    pub locks: Vec<String>,
    /// Shared resources that it only reads and does not lock.
    pub reads: Vec<String>,
    /// Local resources.
    pub local: Vec<String>,
    /// Line of its attribute.
    pub line: u32,
}

/// An RTIC application.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct App {
    /// Tasks in source order.
    pub tasks: Vec<Task>,
    /// Interrupts that run the software tasks.
    pub dispatchers: Vec<String>,
    /// Names of the tasks with `#[cfg]`, which an image may not have.
    pub conditional: Vec<String>,
    /// Shared resources that `idle` locks.
    pub idle_locks: Vec<String>,
    /// The timer that wakes software tasks, if it is a task of the node without being in the source.
    pub timer: Option<Timer>,
}

/// A timer that wakes software tasks.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Timer {
    /// Its interrupt, which is also its name.
    pub interrupt: String,
    /// Its priority.
    pub priority: u32,
}

/// The interrupt of the timer that wakes software tasks. No source declares a task for it.
pub const TIMER: &str = "SysTick";

/// What is wrong with a source.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SourceError {
    /// The file is not valid Rust.
    #[error("{file}:{line}: not Rust: {what}")]
    NotRust {
        /// The file.
        file: String,
        /// Line of the error.
        line: u32,
        /// The parser's message.
        what: String,
    },
    /// The file has no RTIC application.
    #[error("{file}: no module with #[rtic::app]")]
    NoApp {
        /// The file.
        file: String,
    },
    /// A task has no written priority.
    #[error("{file}:{line}: task {task} does not say its priority: write `priority = N`")]
    NoPriority {
        /// The file.
        file: String,
        /// Line of its attribute.
        line: u32,
        /// The task.
        task: String,
    },
    /// A task has a priority that `BASEPRI` cannot mask.
    #[error(
        "{file}:{line}: task {task} has priority {priority}: {HIGHEST} is the highest, because no mask holds a higher one back"
    )]
    PriorityTooHigh {
        /// The file.
        file: String,
        /// Line of its attribute.
        line: u32,
        /// The task.
        task: String,
        /// Its priority.
        priority: u32,
    },
    /// There are fewer dispatchers than priorities of software tasks.
    #[error("{file}: {needed} priorities of software tasks but {given} dispatchers")]
    Dispatchers {
        /// The file.
        file: String,
        /// Priorities in use.
        needed: usize,
        /// Dispatchers named.
        given: usize,
    },
}

impl App {
    /// Reads the application in `source`. `file` names it in error messages.
    ///
    /// # Errors
    /// See [`SourceError`].
    pub fn parse(file: &str, source: &str) -> Result<Self, SourceError> {
        let parsed = syn::parse_file(source).map_err(|error| SourceError::NotRust {
            file: file.to_owned(),
            line: error.span().start().line as u32,
            what: error.to_string(),
        })?;
        let module = parsed.items.iter().find_map(|item| match item {
            syn::Item::Mod(module) => {
                let attribute = module
                    .attrs
                    .iter()
                    .find(|a| a.path().segments.last().is_some_and(|s| s.ident == "app"))?;
                Some((attribute, module))
            }
            _ => None,
        });
        let Some((attribute, module)) = module else {
            return Err(SourceError::NoApp {
                file: file.to_owned(),
            });
        };
        let mut app = Self {
            tasks: Vec::new(),
            conditional: Vec::new(),
            dispatchers: names(arguments(attribute).get("dispatchers")).0,
            idle_locks: Vec::new(),
            timer: None,
        };
        let items = module.content.iter().flat_map(|(_, items)| items);
        // Software tasks may also be declared without a body.
        let functions = items.flat_map(|item| match item {
            syn::Item::Fn(function) => vec![(&function.attrs, &function.sig)],
            syn::Item::ForeignMod(block) => block
                .items
                .iter()
                .filter_map(|item| match item {
                    syn::ForeignItem::Fn(function) => Some((&function.attrs, &function.sig)),
                    _ => None,
                })
                .collect(),
            _ => Vec::new(),
        });
        for (attributes, signature) in functions {
            for attribute in attributes {
                let arguments = arguments(attribute);
                if attribute.path().is_ident("idle") {
                    app.idle_locks = names(arguments.get("shared")).0;
                }
                if !attribute.path().is_ident("task") {
                    continue;
                }
                let name = signature.ident.to_string();
                if attributes.iter().any(|one| one.path().is_ident("cfg")) {
                    app.conditional.push(name.clone());
                }
                let line = attribute.span().start().line as u32;
                let priority = priority(file, line, &name, arguments.get("priority"))?;
                let (locks, reads) = names(arguments.get("shared"));
                app.tasks.push(Task {
                    name,
                    binds: arguments.get("binds").map(ToString::to_string),
                    priority,
                    locks,
                    reads,
                    local: names(arguments.get("local")).0,
                    line,
                });
            }
        }
        let needed = app.software_priorities().len();
        if needed > app.dispatchers.len() {
            return Err(SourceError::Dispatchers {
                file: file.to_owned(),
                needed,
                given: app.dispatchers.len(),
            });
        }
        app.timer = app.has_timer().then(|| Timer {
            interrupt: TIMER.to_owned(),
            priority: app.timer_priority(),
        });
        Ok(app)
    }

    /// Removes the tasks that a condition switches off: those with `#[cfg]` that the image does not have.
    pub fn drop_absent(&mut self, image: &wcet::image::Image) {
        let default = image.symbol(wcet::image::DEFAULT_HANDLER);
        self.keep_present(|task| match &task.binds {
            Some(interrupt) => {
                let entry = image.symbol(interrupt);
                entry.is_some() && entry != default
            }
            None => {
                let executor = format!("__rtic_internal_{}_EXEC", task.name);
                image.symbols().any(|symbol| symbol.contains(&executor))
            }
        });
    }

    /// Removes the tasks with `#[cfg]` of which `has` says that they are not there.
    pub fn keep_present(&mut self, has: impl Fn(&Task) -> bool) {
        let conditional = &self.conditional;
        self.tasks
            .retain(|task| !conditional.contains(&task.name) || has(task));
    }

    /// Priorities of the software tasks that have a dispatcher, highest first.
    fn software_priorities(&self) -> Vec<u32> {
        let mut priorities: Vec<u32> = self
            .tasks
            .iter()
            .filter(|task| task.binds.is_none() && task.priority > 0)
            .map(|task| task.priority)
            .collect();
        priorities.sort_unstable_by(|a, b| b.cmp(a));
        priorities.dedup();
        priorities
    }

    /// The interrupt whose handler runs `task`: the one that it is bound to, or the dispatcher of
    /// its priority (RTIC assigns the last dispatcher to the highest priority).
    #[must_use]
    pub fn interrupt<'a>(&'a self, task: &'a Task) -> Option<&'a str> {
        if let Some(binds) = &task.binds {
            return Some(binds);
        }
        let rank = self
            .software_priorities()
            .iter()
            .position(|priority| *priority == task.priority)?;
        let index = self.dispatchers.len().checked_sub(1 + rank)?;
        Some(&self.dispatchers[index])
    }

    /// Ceiling of each locked resource: the highest priority of its users.
    #[must_use]
    pub fn ceilings(&self) -> BTreeMap<String, u32> {
        let mut ceilings = BTreeMap::new();
        let idle = self.idle_locks.iter().map(|resource| (resource, 0));
        let tasks = self
            .tasks
            .iter()
            .flat_map(|task| task.locks.iter().map(move |r| (r, task.priority)));
        for (resource, priority) in idle.chain(tasks) {
            let ceiling = ceilings.entry(resource.clone()).or_insert(0);
            *ceiling = priority.max(*ceiling);
        }
        ceilings
    }

    /// Whether a timer wakes software tasks: there are software tasks, and no task is bound to the
    /// timer's interrupt.
    fn has_timer(&self) -> bool {
        let mut bound = self.tasks.iter().filter_map(|task| task.binds.as_deref());
        !self.software_priorities().is_empty() && bound.all(|interrupt| interrupt != TIMER)
    }

    /// Priority of the timer that wakes software tasks: above all of them, and directly below the
    /// hardware tasks if there is a priority between (RTIC's `RTIC_ASYNC_MAX_LOGICAL_PRIO`).
    fn timer_priority(&self) -> u32 {
        let software = self.software_priorities().first().copied().unwrap_or(0);
        let hardware = self
            .tasks
            .iter()
            .filter(|task| task.binds.is_some())
            .map(|task| task.priority)
            .min();
        hardware
            .map_or(0, |least| least.saturating_sub(1))
            .max(software + 1)
    }
}

/// The `key = value` pairs of an attribute.
#[must_use]
pub fn arguments(attribute: &syn::Attribute) -> BTreeMap<String, TokenStream> {
    let mut pairs = BTreeMap::new();
    let syn::Meta::List(list) = &attribute.meta else {
        return pairs;
    };
    let mut key: Option<String> = None;
    let mut value: Option<TokenStream> = None;
    for token in list.tokens.clone() {
        match (&token, &mut value) {
            (TokenTree::Punct(mark), _) if mark.as_char() == ',' => {
                if let (Some(key), Some(value)) = (key.take(), value.take()) {
                    pairs.insert(key, value);
                }
            }
            (TokenTree::Punct(mark), None) if mark.as_char() == '=' => {
                value = Some(TokenStream::new());
            }
            (TokenTree::Ident(ident), None) => key = Some(ident.to_string()),
            (_, Some(value)) => value.extend([token.clone()]),
            _ => {}
        }
    }
    if let (Some(key), Some(value)) = (key, value) {
        pairs.insert(key, value);
    }
    pairs
}

/// The written priority of a task.
fn priority(
    file: &str,
    line: u32,
    task: &str,
    written: Option<&TokenStream>,
) -> Result<u32, SourceError> {
    let priority = written.and_then(|tokens| tokens.to_string().parse().ok());
    let (file, task) = (file.to_owned(), task.to_owned());
    match priority {
        None => Err(SourceError::NoPriority { file, line, task }),
        Some(priority) if priority > HIGHEST => Err(SourceError::PriorityTooHigh {
            file,
            line,
            task,
            priority,
        }),
        Some(priority) => Ok(priority),
    }
}

/// The names in a bracketed list: first those without, then those with `&`. Types and initial
/// values of local resources are skipped.
#[must_use]
pub fn names(list: Option<&TokenStream>) -> (Vec<String>, Vec<String>) {
    let (mut plain, mut borrowed) = (Vec::new(), Vec::new());
    let Some(TokenTree::Group(group)) = list.and_then(|l| l.clone().into_iter().next()) else {
        return (plain, borrowed);
    };
    let mut start = true;
    let mut by_reference = false;
    let mut depth = 0i32;
    for token in group.stream() {
        match token {
            TokenTree::Punct(mark) => match mark.as_char() {
                ',' if depth <= 0 => {
                    start = true;
                    by_reference = false;
                }
                '&' if start => by_reference = true,
                '<' => depth += 1,
                '>' => depth -= 1,
                _ => {}
            },
            TokenTree::Ident(ident) if start => {
                start = false;
                if by_reference {
                    borrowed.push(ident.to_string());
                } else {
                    plain.push(ident.to_string());
                }
            }
            _ => {}
        }
    }
    (plain, borrowed)
}

#[cfg(test)]
mod tests {
    use super::{App, SourceError};

    const SOURCE: &str = r#"
#[rtic::app(device = pac, peripherals = true, dispatchers = [EXTI2, EXTI3])]
mod app {
    #[shared]
    struct Shared { link: u8, pilot: u8 }
    #[idle(shared = [pilot])]
    fn idle(_: idle::Context) -> ! { loop {} }
    #[task(binds = CAN1_RX0, priority = 6, shared = [&clock, link])]
    fn can_rx(cx: can_rx::Context) {}
    #[task(binds = TIM4, priority = 2, shared = [link, pilot], local = [tick, map: Map<u8, u16> = Map::new(), screen])]
    fn display(cx: display::Context) {}
    #[task(priority = 2, shared = [link])]
    async fn housekeeping(cx: housekeeping::Context) {}
    #[task(priority = 1, shared = [pilot])]
    async fn console(cx: console::Context) {}
}
"#;

    #[test]
    fn a_task_that_is_switched_off_is_dropped() {
        let source = "#[rtic::app(device = pac)] mod app {\n#[task(binds = A, priority = 1)] fn one(_: one::Context) {}\n\
                      #[cfg(more)] #[task(binds = B, priority = 2)] fn two(_: two::Context) {}\n}";
        let mut app = App::parse("app.rs", source).unwrap();
        let names =
            |app: &App| -> Vec<String> { app.tasks.iter().map(|task| task.name.clone()).collect() };
        app.keep_present(|_| true);
        assert_eq!(names(&app), ["one", "two"]);
        // Only what has a condition may be absent.
        app.keep_present(|_| false);
        assert_eq!(names(&app), ["one"]);
    }

    #[test]
    fn an_application_is_read() {
        let app = App::parse("app.rs", SOURCE).unwrap();
        let names: Vec<&str> = app.tasks.iter().map(|task| task.name.as_str()).collect();
        assert_eq!(names, ["can_rx", "display", "housekeeping", "console"]);
        assert_eq!(app.tasks[0].binds.as_deref(), Some("CAN1_RX0"));
        assert_eq!(app.tasks[0].locks, ["link"]);
        assert_eq!(app.tasks[0].reads, ["clock"]);
        assert_eq!(app.tasks[1].local, ["tick", "map", "screen"]);
        let interrupts: Vec<&str> = app
            .tasks
            .iter()
            .map(|task| app.interrupt(task).unwrap())
            .collect();
        assert_eq!(interrupts, ["CAN1_RX0", "TIM4", "EXTI3", "EXTI2"]);
        assert_eq!(app.ceilings()["link"], 6);
        assert_eq!(app.ceilings()["pilot"], 2);
        assert_eq!(app.timer_priority(), 3);
    }

    #[test]
    fn a_priority_that_no_mask_holds_back_is_refused() {
        let source = SOURCE.replace("priority = 6", "priority = 16");
        let error = App::parse("app.rs", &source).unwrap_err();
        assert_eq!(
            error.to_string(),
            "app.rs:8: task can_rx has priority 16: 15 is the highest, because no mask holds a \
             higher one back"
        );
    }

    #[test]
    fn a_priority_must_be_written() {
        let source = SOURCE.replace("priority = 1, ", "");
        let error = App::parse("app.rs", &source).unwrap_err();
        assert_eq!(
            error,
            SourceError::NoPriority {
                file: "app.rs".to_owned(),
                line: 14,
                task: "console".to_owned()
            }
        );
        assert_eq!(
            error.to_string(),
            "app.rs:14: task console does not say its priority: write `priority = N`"
        );
    }

    #[test]
    fn software_priorities_need_dispatchers() {
        let source = SOURCE.replace("[EXTI2, EXTI3]", "[EXTI2]");
        assert_eq!(
            App::parse("app.rs", &source).unwrap_err().to_string(),
            "app.rs: 2 priorities of software tasks but 1 dispatchers"
        );
    }
}
