//! The tasks of an RTIC 2 application, read from the sources of its binary.
//!
//! The application is the module with `#[rtic::app]`, in the binary's own file or in a module of it that is
//! another file; `use` may give the attribute another name. A task has its body there, or is declared in
//! an `extern "Rust"` block. Its priority is the written one, or RTIC's: 1 for a hardware task, 0 for a
//! software task, which then runs in place of `idle` and has no bound.

use std::path::{Path, PathBuf};

use schedulability::tasks::{App, Task, arguments, names};
use syn::spanned::Spanned;

use crate::comment::{self, Comment};
use crate::error::{Error, read};

/// An application with what its sources say beside its tasks.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Source {
    /// The file with the application's module.
    pub file: PathBuf,
    /// Its name in messages.
    pub shown: String,
    /// The tasks above priority 0.
    pub app: App,
    /// Software tasks of priority 0, which run in place of `idle`.
    pub in_idle: Vec<String>,
    /// What the comment above a task says, by task.
    pub comments: Vec<(String, Comment)>,
    /// Periods of delays that the software tasks write as literals, in microseconds, by task.
    pub delays: Vec<(String, u64)>,
    /// The rate of a SysTick monotonic, in Hz, if it stands in the sources as a literal.
    pub systick_hz: Option<u64>,
}

/// A file with the items of a module.
struct Module {
    file: PathBuf,
    /// Where the files of its modules are.
    folder: PathBuf,
    items: Vec<syn::Item>,
}

/// Reads the application of the binary whose first file is `root`. Messages show paths relative to `base`.
///
/// # Errors
/// A file cannot be read, is not Rust, or there is no application in them, or one that RTIC does not accept.
pub fn read_app(root: &Path, base: &Path) -> Result<Source, Error> {
    let folder = root.parent().unwrap_or(Path::new(".")).to_owned();
    let mut waiting = vec![Module {
        file: root.to_owned(),
        folder,
        items: parse(root, base)?,
    }];
    let mut systick_hz = None;
    let mut found = None;
    while let Some(module) = waiting.pop() {
        systick_hz = systick_hz.or_else(|| monotonic(&module.items));
        let uses = renames(&module.items);
        for item in &module.items {
            let syn::Item::Mod(inner) = item else {
                continue;
            };
            match inner.attrs.iter().find(|one| is_app(one, &uses)) {
                Some(attribute) if found.is_none() => {
                    let (_, items) = inner.content.as_ref().ok_or_else(|| {
                        Error::input(format!(
                            "{}: the module with #[app] is in another file: RTIC needs its tasks in this one",
                            at(&module.file, base, attribute.span())
                        ))
                    })?;
                    systick_hz = systick_hz.or_else(|| monotonic(items));
                    found = Some(application(&module.file, base, attribute, items)?);
                }
                Some(attribute) => {
                    return Err(Error::input(format!(
                        "{}: a second application; one binary has one",
                        at(&module.file, base, attribute.span())
                    )));
                }
                None => waiting.extend(of_module(&module, inner, base)?),
            }
        }
    }
    let source = found.ok_or_else(|| {
        Error::input(format!(
            "{}: no module with #[rtic::app] here or in a module of it: is this the binary of an RTIC 2 application?",
            short(root, base)
        ))
    })?;
    Ok(Source {
        systick_hz: source.systick_hz.or(systick_hz),
        ..source
    })
}

/// A path as messages show it.
#[must_use]
pub fn short(file: &Path, base: &Path) -> String {
    let short = file.strip_prefix(base).unwrap_or(file);
    short.display().to_string()
}

fn at(file: &Path, base: &Path, span: proc_macro2::Span) -> String {
    format!("{}:{}", short(file, base), span.start().line)
}

fn parse(file: &Path, base: &Path) -> Result<Vec<syn::Item>, Error> {
    let text = read(file)?;
    let parsed = syn::parse_file(&text).map_err(|error| {
        Error::input(format!(
            "{}: not Rust: {error}",
            at(file, base, error.span())
        ))
    })?;
    Ok(parsed.items)
}

/// The module that `inner` is: its items here, or those of its file; none if the file is not there, as of a
/// module that a feature switches off.
fn of_module(outer: &Module, inner: &syn::ItemMod, base: &Path) -> Result<Option<Module>, Error> {
    let name = inner.ident.to_string();
    if let Some((_, items)) = &inner.content {
        return Ok(Some(Module {
            file: outer.file.clone(),
            folder: outer.folder.join(name),
            items: items.clone(),
        }));
    }
    let written = inner
        .attrs
        .iter()
        .find_map(|one| comment::text(one, "path"));
    let files = match written {
        Some(path) => {
            let beside = outer.file.parent().unwrap_or(Path::new("."));
            vec![beside.join(path)]
        }
        None => vec![
            outer.folder.join(format!("{name}.rs")),
            outer.folder.join(&name).join("mod.rs"),
        ],
    };
    let Some(file) = files.into_iter().find(|file| file.is_file()) else {
        return Ok(None);
    };
    let is_mod = file.file_name().is_some_and(|name| name == "mod.rs");
    let folder = if is_mod {
        file.parent().unwrap_or(Path::new(".")).to_owned()
    } else {
        outer.folder.join(name)
    };
    Ok(Some(Module {
        items: parse(&file, base)?,
        file,
        folder,
    }))
}

/// Paths by which `rtic::app` goes in a module: `rtic::app` itself, and what `use` makes of it.
fn renames(items: &[syn::Item]) -> Vec<Vec<String>> {
    let mut all = vec![vec!["rtic".to_owned(), "app".to_owned()]];
    for item in items {
        match item {
            syn::Item::Use(one) => of_use(&one.tree, &mut Vec::new(), &mut all),
            syn::Item::ExternCrate(one) if one.ident == "rtic" => {
                if let Some((_, name)) = &one.rename {
                    all.push(vec![name.to_string(), "app".to_owned()]);
                }
            }
            _ => {}
        }
    }
    all
}

fn of_use(tree: &syn::UseTree, before: &mut Vec<String>, all: &mut Vec<Vec<String>>) {
    let leaf = |before: &[String], name: String, named: String, all: &mut Vec<Vec<String>>| {
        let mut path = before.to_vec();
        if name != "self" {
            path.push(name);
        }
        let path: Vec<&str> = path.iter().map(String::as_str).collect();
        match path.as_slice() {
            ["rtic", "app"] => all.push(vec![named]),
            ["rtic"] => all.push(vec![named, "app".to_owned()]),
            _ => {}
        }
    };
    match tree {
        syn::UseTree::Path(path) => {
            before.push(path.ident.to_string());
            of_use(&path.tree, before, all);
            before.pop();
        }
        syn::UseTree::Group(group) => {
            for one in &group.items {
                of_use(one, before, all);
            }
        }
        syn::UseTree::Name(name) => {
            let name = name.ident.to_string();
            let named = if name == "self" {
                before.last().cloned().unwrap_or_default()
            } else {
                name.clone()
            };
            leaf(before, name, named, all);
        }
        syn::UseTree::Rename(rename) => {
            leaf(
                before,
                rename.ident.to_string(),
                rename.rename.to_string(),
                all,
            );
        }
        syn::UseTree::Glob(_) => {
            if before.as_slice() == ["rtic"] {
                all.push(vec!["app".to_owned()]);
            }
        }
    }
}

fn is_app(attribute: &syn::Attribute, uses: &[Vec<String>]) -> bool {
    let segments = attribute.path().segments.iter();
    let path: Vec<String> = segments.map(|segment| segment.ident.to_string()).collect();
    uses.contains(&path)
}

/// A task's function: attributes, signature and body, if that is here.
struct Function<'a> {
    attributes: &'a [syn::Attribute],
    signature: &'a syn::Signature,
    body: Option<&'a syn::Block>,
}

/// The functions of the application's module, those of `extern` blocks included.
fn functions(items: &[syn::Item]) -> impl Iterator<Item = Function<'_>> {
    items.iter().flat_map(|item| match item {
        syn::Item::Fn(function) => vec![Function {
            attributes: &function.attrs,
            signature: &function.sig,
            body: Some(&function.block),
        }],
        syn::Item::ForeignMod(block) => {
            let functions = block.items.iter().filter_map(|item| match item {
                syn::ForeignItem::Fn(function) => Some(Function {
                    attributes: &function.attrs,
                    signature: &function.sig,
                    body: None,
                }),
                _ => None,
            });
            functions.collect()
        }
        _ => Vec::new(),
    })
}

/// The application in the module with `attribute`.
fn application(
    file: &Path,
    base: &Path,
    attribute: &syn::Attribute,
    items: &[syn::Item],
) -> Result<Source, Error> {
    let mut source = Source {
        file: file.to_owned(),
        shown: short(file, base),
        app: App {
            conditional: Vec::new(),
            tasks: Vec::new(),
            dispatchers: dispatchers(attribute),
            idle_locks: Vec::new(),
            timer: None,
        },
        in_idle: Vec::new(),
        comments: Vec::new(),
        delays: Vec::new(),
        systick_hz: None,
    };
    for function in functions(items) {
        for attribute in function.attributes {
            let arguments = arguments(attribute);
            if attribute.path().is_ident("idle") {
                source.app.idle_locks = names(arguments.get("shared")).0;
            }
            if attribute.path().is_ident("task") {
                add_task(&mut source, base, &function, attribute)?;
            }
        }
    }
    let mut priorities: Vec<u32> = source
        .app
        .tasks
        .iter()
        .filter(|task| task.binds.is_none())
        .map(|task| task.priority)
        .collect();
    priorities.sort_unstable();
    priorities.dedup();
    let (needed, given) = (priorities.len(), source.app.dispatchers.len());
    if needed > given {
        return Err(Error::input(format!(
            "{}: {needed} priorities of software tasks but {given} dispatchers",
            at(file, base, attribute.span())
        )));
    }
    Ok(source)
}

fn add_task(
    source: &mut Source,
    base: &Path,
    function: &Function<'_>,
    attribute: &syn::Attribute,
) -> Result<(), Error> {
    let arguments = arguments(attribute);
    let name = function.signature.ident.to_string();
    let place = at(&source.file, base, attribute.span());
    let binds = arguments.get("binds").map(ToString::to_string);
    let usual = u32::from(binds.is_some());
    let priority = match arguments.get("priority") {
        None => usual,
        Some(written) => written.to_string().parse().map_err(|_| {
            Error::input(format!(
                "{place}: the priority of task {name} is {written}: a number is accepted"
            ))
        })?,
    };
    let is_conditional = |one: &syn::Attribute| one.path().is_ident("cfg");
    if function.attributes.iter().any(is_conditional) {
        source.app.conditional.push(name.clone());
    }
    if let Some(found) = comment::of(function.attributes, &source.shown, &name)? {
        source.comments.push((name.clone(), found));
    }
    if let Some(body) = function.body {
        let delays = literal_delays(body);
        source
            .delays
            .extend(delays.into_iter().map(|us| (name.clone(), us)));
    }
    if priority == 0 {
        source.in_idle.push(name);
        return Ok(());
    }
    let (locks, reads) = names(arguments.get("shared"));
    source.app.tasks.push(Task {
        name,
        binds,
        priority,
        locks,
        reads,
        local: names(arguments.get("local")).0,
        line: attribute.span().start().line as u32,
    });
    Ok(())
}

/// The dispatchers, without the attributes that each may have.
fn dispatchers(attribute: &syn::Attribute) -> Vec<String> {
    use proc_macro2::{TokenStream, TokenTree};
    let arguments = arguments(attribute);
    let list = arguments.get("dispatchers").cloned().unwrap_or_default();
    let Some(TokenTree::Group(group)) = list.into_iter().next() else {
        return Vec::new();
    };
    let without = group.stream().into_iter().filter(|token| match token {
        TokenTree::Punct(mark) => mark.as_char() != '#',
        TokenTree::Group(_) => false,
        _ => true,
    });
    let group = proc_macro2::Group::new(proc_macro2::Delimiter::Bracket, without.collect());
    names(Some(&TokenStream::from(TokenTree::Group(group)))).0
}

/// Delays of the form `delay(10.millis())` and `N.micros()`, `N.secs()` in an asynchronous body.
fn literal_delays(body: &syn::Block) -> Vec<u64> {
    use syn::visit::Visit;
    #[derive(Default)]
    struct Delays(Vec<u64>);
    impl<'ast> Visit<'ast> for Delays {
        fn visit_expr_call(&mut self, call: &'ast syn::ExprCall) {
            if let syn::Expr::Path(path) = &*call.func
                && path
                    .path
                    .segments
                    .last()
                    .is_some_and(|last| last.ident == "delay")
                && let Some(us) = call.args.first().and_then(duration_us)
            {
                self.0.push(us);
            }
            syn::visit::visit_expr_call(self, call);
        }
    }
    let mut delays = Delays::default();
    delays.visit_block(body);
    delays.0
}

fn duration_us(expression: &syn::Expr) -> Option<u64> {
    let syn::Expr::MethodCall(call) = expression else {
        return None;
    };
    let syn::Expr::Lit(literal) = &*call.receiver else {
        return None;
    };
    let syn::Lit::Int(number) = &literal.lit else {
        return None;
    };
    let factor = match call.method.to_string().as_str() {
        "micros" | "micros_at_least" => 1,
        "millis" | "millis_at_least" => 1000,
        "secs" | "secs_at_least" => 1_000_000,
        _ => return None,
    };
    number.base10_parse::<u64>().ok()?.checked_mul(factor)
}

/// The rate in `systick_monotonic!(Mono, RATE)`, if it is a literal; 1 kHz without one.
fn monotonic(items: &[syn::Item]) -> Option<u64> {
    items.iter().find_map(|item| {
        let syn::Item::Macro(one) = item else {
            return None;
        };
        let last = one.mac.path.segments.last()?;
        if last.ident != "systick_monotonic" {
            return None;
        }
        let text = one.mac.tokens.to_string().replace([' ', '_'], "");
        match text.split_once(',') {
            None => Some(1000),
            Some((_, rate)) => rate.trim_end_matches(',').parse().ok(),
        }
    })
}

impl Source {
    /// The priority of a monotonic's interrupt: directly below the hardware tasks, above all software tasks if
    /// that is no contradiction, and the highest without any hardware task (RTIC's
    /// `RTIC_ASYNC_MAX_LOGICAL_PRIO`).
    #[must_use]
    pub fn monotonic_priority(&self, priorities: u32) -> u32 {
        let tasks = || self.app.tasks.iter();
        let software = tasks().filter(|task| task.binds.is_none());
        let above = software.map(|task| task.priority).max().unwrap_or(0) + 1;
        let hardware = tasks().filter(|task| task.binds.is_some());
        let least = hardware.map(|task| task.priority).min();
        least.map_or(priorities, |least| {
            (least - 1).max(above).clamp(1, priorities)
        })
    }

    /// The line of a task's attribute.
    #[must_use]
    pub fn line(&self, task: &str) -> Option<u32> {
        let mut tasks = self.app.tasks.iter();
        tasks.find(|one| one.name == task).map(|one| one.line)
    }
}

#[cfg(test)]
mod tests {
    use super::{Source, read_app};
    use std::fs;

    fn read(files: &[(&str, &str)]) -> Result<Source, String> {
        let folder = tempfile::tempdir().unwrap();
        for (name, text) in files {
            let path = folder.path().join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        }
        let root = folder.path().join(files[0].0);
        read_app(&root, folder.path()).map_err(|error| error.to_string())
    }

    const APP: &str = r#"
#[rtic::app(device = pac, dispatchers = [#[allow(x)] A, B])]
mod app {
    systick_monotonic!(Mono, 1_000);
    #[idle(shared = [log])]
    fn idle(_: idle::Context) -> ! { loop {} }
    /// Blinks.
    /// deadline: every 10 ms, within 5 ms
    #[task(priority = 1, shared = [log])]
    async fn blink(_: blink::Context) { loop { Mono::delay(10.millis()).await; } }
    #[task]
    async fn background(_: background::Context) {}
    #[task(binds = UART, shared = [&config])]
    fn uart(_: uart::Context) {}
    extern "Rust" {
        #[cfg(feature = "fast")]
        #[task(binds = ADC, priority = 3)]
        fn sample(_: sample::Context);
    }
}
"#;

    #[test]
    fn an_application_is_read_with_the_priorities_that_rtic_gives() {
        let source = read(&[("src/main.rs", APP)]).unwrap();
        let tasks = source.app.tasks.iter();
        let tasks: Vec<_> = tasks
            .map(|task| (task.name.as_str(), task.priority))
            .collect();
        assert_eq!(tasks, [("blink", 1), ("uart", 1), ("sample", 3)]);
        assert_eq!(source.in_idle, ["background"]);
        assert_eq!(source.app.dispatchers, ["A", "B"]);
        assert_eq!(source.app.interrupt(&source.app.tasks[0]), Some("B"));
        assert_eq!(source.app.conditional, ["sample"]);
        assert_eq!(source.app.idle_locks, ["log"]);
        assert_eq!(source.delays, [("blink".to_owned(), 10_000)]);
        assert_eq!(source.systick_hz, Some(1000));
        assert_eq!(source.comments[0].1.row.deadline_us, Some(5000));
        assert_eq!(source.shown, "src/main.rs");
        // Below `uart` there is no priority, so it is above the software task.
        assert_eq!(source.monotonic_priority(16), 2);
    }

    #[test]
    fn the_application_may_be_in_another_file_and_have_another_name() {
        let renamed = APP.replace("#[rtic::app(", "#[entry(");
        let uses = "use rtic::{app as entry, Mutex};\n";
        for (main, file) in [
            ("mod firmware;", "src/firmware.rs"),
            ("mod firmware;", "src/firmware/mod.rs"),
            ("#[path = \"other.rs\"] mod firmware;", "src/other.rs"),
            ("mod outer { mod firmware; }", "src/outer/firmware.rs"),
        ] {
            let text = format!("{uses}{renamed}");
            let source = read(&[("src/main.rs", main), (file, &text)]).unwrap();
            assert_eq!((source.shown.as_str(), source.app.tasks.len()), (file, 3));
        }
        for (uses, attribute) in [
            ("use rtic as r;", "#[r::app("),
            ("use rtic::app;", "#[app("),
            ("use rtic::{self as r};", "#[r::app("),
            ("extern crate rtic as r;", "#[r::app("),
        ] {
            let text = format!("{uses}{}", APP.replace("#[rtic::app(", attribute));
            assert!(read(&[("main.rs", &text)]).is_ok(), "{uses}");
        }
    }

    #[test]
    fn what_is_no_application_has_its_sentence() {
        let none = read(&[("main.rs", "#[other::app] mod app {}")]).unwrap_err();
        assert_eq!(
            none,
            "main.rs: no module with #[rtic::app] here or in a module of it: is this the binary of an RTIC 2 \
             application?"
        );
        let few = read(&[("main.rs", &APP.replace("[#[allow(x)] A, B]", "[]"))]).unwrap_err();
        assert_eq!(
            few,
            "main.rs:2: 1 priorities of software tasks but 0 dispatchers"
        );
        let name = read(&[("main.rs", &APP.replace("priority = 3", "priority = HIGH"))]);
        assert_eq!(
            name.unwrap_err(),
            "main.rs:17: the priority of task sample is HIGH: a number is accepted"
        );
        let rust = read(&[("main.rs", "fn (")]).unwrap_err();
        assert!(rust.starts_with("main.rs:1: not Rust: "), "{rust}");
        let two = read(&[(
            "main.rs",
            &format!("{APP}{}", APP.replace("mod app", "mod other")),
        )]);
        assert!(
            two.unwrap_err()
                .ends_with(": a second application; one binary has one")
        );
    }

    #[test]
    fn the_monotonic_is_where_rtic_puts_it() {
        let with = |hardware: &str| {
            let text = APP
                .replace("#[task(binds = UART, shared", hardware)
                .replace("priority = 1, shared = [log]", "priority = 2");
            read(&[("main.rs", &text)]).unwrap().monotonic_priority(16)
        };
        assert_eq!(with("#[task(binds = UART, priority = 7, shared"), 3);
        let source = read(&[("main.rs", "#[rtic::app(device = d)] mod app {}")]).unwrap();
        assert_eq!(source.monotonic_priority(8), 8);
    }
}
