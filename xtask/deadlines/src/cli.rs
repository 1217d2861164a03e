//! The command line.

use std::ffi::OsString;
use std::io::{ErrorKind, IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::{Args, Parser, Subcommand, ValueEnum};

use schedulability::execution::{Execution, ExecutionError};
use schedulability::node::Observed;
use schedulability::report::{application, explain_as_flashed};
use schedulability::table::OutOfRange;
use wcet::annotation::Annotations;
use wcet::image::Image;

use crate::analysis::{self, Answer};
use crate::app::{self, Source};
#[cfg(feature = "emulator")]
use crate::emulated;
use crate::error::{Error, read, write};
use crate::init::{self, Handlers, OnPart};
use crate::model::{self, Model};
use crate::parts::{self, Clocks, PartFile};
use crate::project::{Binary, Choice};
use crate::table::{Row, Table};
use crate::{baseline, report, seen};

/// As cargo calls it.
#[derive(Debug, Parser)]
#[command(name = "cargo", bin_name = "cargo", version)]
enum Cargo {
    /// Prove that the tasks of an RTIC 2 application meet their deadlines
    Deadlines(Command),
}

#[derive(Debug, Args)]
#[command(
    version,
    args_conflicts_with_subcommands = true,
    after_help = "Exit code: 0 if every deadline holds, 1 if one is missed or not proven, 2 for wrong input.\n\n\
        Examples:\n  cargo deadlines init --part stm32f411 --core-hz 100000000\n  cargo deadlines\n  \
        cargo deadlines --explain control\n  cargo deadlines --run 10\n  cargo deadlines --json > slack.json\n  \
        cargo deadlines --baseline slack.json --loss 10 --format github"
)]
struct Command {
    #[command(subcommand)]
    what: Option<What>,
    #[command(flatten)]
    of: Of,
    #[command(flatten)]
    show: Show,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Write a first task table, with questions where a value cannot be found
    Init(Box<Of>),
    /// List the parts that the command knows
    Parts,
}

/// Which application, on which part.
#[derive(Debug, Clone, Args)]
struct Of {
    /// Manifest of the package
    #[arg(long, value_name = "PATH")]
    manifest_path: Option<PathBuf>,
    /// Package of a workspace
    #[arg(long, short, value_name = "NAME")]
    package: Option<String>,
    /// Binary, if there are several
    #[arg(long, value_name = "NAME", conflicts_with = "example")]
    bin: Option<String>,
    /// Example in place of a binary
    #[arg(long, value_name = "NAME")]
    example: Option<String>,
    /// Target of the compiler, if not the project's own
    #[arg(long, value_name = "TRIPLE")]
    target: Option<String>,
    /// Features to switch on
    #[arg(long, value_name = "FEATURES")]
    features: Option<String>,
    /// Leave the default features off
    #[arg(long)]
    no_default_features: bool,
    /// Image to analyse, in place of a build
    #[arg(long, value_name = "ELF")]
    image: Option<PathBuf>,
    /// Task table, if not deadlines-NAME.toml or deadlines.toml beside the manifest
    #[arg(long, value_name = "FILE")]
    table: Option<PathBuf>,
    /// Part, in place of that in the table: a name (see `cargo deadlines parts`) or a TOML file
    #[arg(long, value_name = "NAME|FILE")]
    part: Option<String>,
    /// Clock of the core in Hz, in place of that in the table
    #[arg(long, value_name = "HZ")]
    core_hz: Option<u32>,
}

/// How to show the answer.
#[derive(Debug, Clone, Args)]
struct Show {
    /// Show where the time of a task goes
    #[arg(long, value_name = "TASK")]
    explain: Option<String>,
    /// Write the report as JSON, which --baseline reads
    #[arg(long, conflicts_with_all = ["explain", "format"])]
    json: bool,
    /// Form of the report
    #[arg(long, value_enum, default_value_t)]
    format: Format,
    /// Write the report as a page
    #[arg(long, value_name = "FILE")]
    html: Option<PathBuf>,
    /// Fail when a task lost slack against this former --json
    #[arg(long, value_name = "FILE")]
    baseline: Option<PathBuf>,
    /// Slack that a task may lose against the baseline, in percent
    #[arg(long, value_name = "PERCENT", default_value_t = 0, requires = "baseline",
          value_parser = clap::value_parser!(u64).range(0..=100))]
    loss: u64,
    /// Observed cycles, lines `task,cycles`: fail when one exceeds its bound
    #[arg(long, value_name = "FILE")]
    seen: Option<PathBuf>,
    /// Run the image for so long on the emulated part: fail when it shows what the analysis excludes
    #[cfg(feature = "emulator")]
    #[arg(long, value_name = "SECONDS", conflicts_with = "seen",
          value_parser = clap::value_parser!(u64).range(1..=crate::emulated::LONGEST_S))]
    run: Option<u64>,
    /// Clock at the emulated part's input in Hz
    #[cfg(feature = "emulator")]
    #[arg(long, value_name = "HZ", requires = "run",
          value_parser = clap::value_parser!(u32).range(1_000_000..=50_000_000))]
    external_hz: Option<u32>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
enum Format {
    /// Tables for a terminal
    #[default]
    Text,
    /// Annotations of GitHub Actions, after the tables
    Github,
    /// SARIF 2.1.0
    Sarif,
}

/// Runs the command with these arguments, the first one the program's name.
pub fn run(arguments: impl IntoIterator<Item = OsString>) -> ExitCode {
    let mut arguments: Vec<OsString> = arguments.into_iter().collect();
    // Called directly, without cargo.
    if arguments.get(1).is_none_or(|first| first != "deadlines") {
        arguments.insert(1.min(arguments.len()), "deadlines".into());
    }
    let Cargo::Deadlines(command) = Cargo::parse_from(arguments);
    let outcome = match &command.what {
        Some(What::Parts) => say(&parts::list()),
        Some(What::Init(of)) => write_table(of),
        None => analyse(&command.of, &command.show),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(error.exit_code())
        }
    }
}

/// Prints a text. A reader that has gone away wants no more of it.
fn say(text: &str) -> Result<(), Error> {
    let mut out = std::io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(Error::input(format!(
            "cannot write the report to standard output: {error}"
        ))),
        _ => Ok(()),
    }
}

/// Says on a terminal what is analysed, as cargo says what it compiles.
fn progress(task: &str) {
    if std::io::stderr().is_terminal() {
        eprintln!("   Analysing {task}");
    }
}

impl Of {
    fn choice(&self) -> Choice {
        Choice {
            manifest_path: self.manifest_path.clone(),
            package: self.package.clone(),
            bin: self.bin.clone(),
            example: self.example.clone(),
            target: self.target.clone(),
            features: self.features.clone(),
            no_default_features: self.no_default_features,
        }
    }

    /// The image, given or built, and its file.
    fn image(&self, binary: &Binary) -> Result<(PathBuf, Image), Error> {
        let path = match &self.image {
            Some(path) => path.clone(),
            None => binary.build(&self.choice())?,
        };
        let image = Image::read(&path).map_err(Error::input)?;
        let has_lines = image
            .functions()
            .any(|(at, _)| !image.places(at).is_empty());
        if !has_lines {
            return Err(Error::input(format!(
                "the image {} is stripped: its symbols and line tables say where tasks, loops and locks are, so leave \
                 out `strip` and set `debug = 2` in its profile",
                path.display()
            )));
        }
        Ok((path, image.relative_to(&binary.root)))
    }

    fn table(&self, binary: &Binary) -> PathBuf {
        self.table.clone().unwrap_or_else(|| binary.table())
    }
}

/// A task table with the part that it names.
struct Tables {
    table: Table,
    /// Its name in messages.
    file: String,
    part: PartFile,
    clocks: Clocks,
}

impl Tables {
    fn read(of: &Of, binary: &Binary) -> Result<Self, Error> {
        let path = of.table(binary);
        let file = app::short(&path, &binary.root);
        let table = if path.is_file() || of.table.is_some() {
            Table::parse(&read(&path)?, &file)?
        } else {
            Table::default()
        };
        let is_there = path.is_file();
        let lacks = |key: &str, option: &str| {
            let how = if is_there {
                format!("{file} has no `{key}`")
            } else {
                format!("there is no {file}")
            };
            Error::input(format!(
                "{how}: `cargo deadlines init` writes it, or `{option}` says it on the command line"
            ))
        };
        let here = Path::new(".");
        let (name, folder) = match (&of.part, &table.part) {
            (Some(name), _) => (name, here),
            (None, Some(name)) => (name, path.parent().unwrap_or(here)),
            (None, None) => return Err(lacks("part", "--part")),
        };
        let part = parts::find(name, folder)?;
        part.core()?;
        let core_hz = of.core_hz.or(table.core_hz);
        let clocks = Clocks {
            core_hz: core_hz.ok_or_else(|| lacks("core_hz", "--core-hz"))?,
            bus_hz: table.bus_hz,
            fast_bus_hz: table.fast_bus_hz,
            flash_waits: table.flash_waits,
            flash_accelerator: table.flash_accelerator,
        };
        Ok(Self {
            table,
            file,
            part,
            clocks,
        })
    }
}

/// The bytes that the image leaves for its stack.
fn stack(tables: &Tables, image: &Image) -> Result<u32, Error> {
    let Tables {
        table, file, part, ..
    } = tables;
    if let Some(bytes) = table.stack_bytes {
        let areas = part.ram.areas.iter();
        let most = areas
            .map(|(first, last)| u64::from(last - first) + 1)
            .sum::<u64>();
        let checked = OutOfRange::check("stack_bytes", bytes.into(), 1, most);
        checked.map_err(|number| {
            let title = &part.title;
            Error::input(format!("{file}: {number} for the {title}, by its RAM"))
        })?;
        return Ok(bytes);
    }
    let unknown = || {
        Error::input(
            "the image does not say where its stack is (symbol `_stack_start`): write `stack_bytes` in the \
             task table",
        )
    };
    let top = image.symbol("_stack_start").ok_or_else(unknown)?;
    let ends = ["_stack_end", "__sheap", "__ebss"];
    let below = ends.iter().filter_map(|name| image.symbol(name));
    let ram = part.ram.areas.iter();
    let begin = ram.filter(|(first, last)| *first < top && top <= last.saturating_add(1));
    let lowest = begin.map(|(first, _)| *first);
    let bottom = below
        .filter(|at| *at < top)
        .chain(lowest)
        .max()
        .ok_or_else(unknown)?;
    Ok(top - bottom)
}

/// Wraps up what the analysis needs.
struct Prepared {
    binary: Binary,
    source: Source,
    tables: Tables,
    /// The image's file.
    #[cfg_attr(not(feature = "emulator"), expect(dead_code))]
    path: PathBuf,
    image: Image,
    model: Model,
}

fn prepare(of: &Of) -> Result<Prepared, Error> {
    let binary = Binary::find(&of.choice())?;
    let mut source = app::read_app(&binary.source, &binary.root)?;
    let mut tables = Tables::read(of, &binary)?;
    // Wrong input is reported before a build that takes time.
    let part = tables.part.on(&tables.clocks)?;
    let (path, image) = of.image(&binary)?;
    source.app.drop_absent(&image);
    tables.table = model::with_comments(&source, &tables.table, &tables.file)?;
    check_rows(&tables, &source, &image)?;
    let stack = stack(&tables, &image)?;
    let file = &tables.file;
    let model = model::build(&binary.name, &source, &tables.table, &part, stack, file)?;
    Ok(Prepared {
        binary,
        source,
        tables,
        path,
        image,
        model,
    })
}

fn analyse(of: &Of, show: &Show) -> Result<(), Error> {
    let prepared = prepare(of)?;
    let Prepared {
        binary,
        source,
        tables,
        image,
        model,
        ..
    } = &prepared;
    let tasks = &model.node.tasks;
    if let Some(task) = &show.explain
        && !tasks.iter().any(|one| one.name == *task)
    {
        let known: Vec<&str> = tasks.iter().map(|one| one.name.as_str()).collect();
        return Err(Error::input(format!(
            "there is no task {task}: there are {}",
            known.join(", ")
        )));
    }
    let mut observed: Option<Observed> = match &show.seen {
        Some(path) => Some(seen::read(
            &read(path)?,
            &path.display().to_string(),
            model,
        )?),
        None => None,
    };
    let former = match &show.baseline {
        Some(path) => Some((read(path)?, path.display().to_string())),
        None => None,
    };
    #[cfg(feature = "emulator")]
    let planned = planned(show, tables)?;
    let execution = analysis::execution(model, image, &binary.root, &tables.file, &progress)?;
    #[cfg(feature = "emulator")]
    let ran = planned
        .map(|planned| emulated(&planned, &prepared, &execution))
        .transpose()?;
    #[cfg(not(feature = "emulator"))]
    let ran: Option<(Observed, String)> = None;
    let mut sentence = None;
    if let Some((seen, of_run)) = ran {
        observed = Some(seen);
        sentence = Some(of_run);
    }
    let mut answer = analysis::answer(
        source,
        model,
        &execution,
        &tables.part,
        observed.as_ref(),
        &tables.file,
    )?;
    answer.assumptions.extend(sentence);
    let losses = match former {
        Some((text, file)) => baseline::losses(&answer.node, &text, &file, show.loss)?,
        None => Vec::new(),
    };
    print(&answer, &losses, show, binary)
}

/// The run that was asked for.
#[cfg(feature = "emulator")]
fn planned(show: &Show, tables: &Tables) -> Result<Option<emulated::Run>, Error> {
    let Some(seconds) = show.run else {
        return Ok(None);
    };
    let on = tables.part.emulated.ok_or_else(|| {
        Error::input(format!(
            "--run: the {} is not emulated: accepted are parts whose file has `emulated`, as {}",
            tables.part.title,
            parts::emulated().join(", ")
        ))
    })?;
    Ok(Some(emulated::Run {
        on,
        seconds,
        external_hz: show.external_hz,
        core_hz: tables.clocks.core_hz,
    }))
}

/// Runs the image: what was seen, and a sentence about the run.
#[cfg(feature = "emulator")]
fn emulated(
    run: &emulated::Run,
    prepared: &Prepared,
    execution: &Execution,
) -> Result<(Observed, String), Error> {
    let path = &prepared.path;
    let elf = std::fs::read(path)
        .map_err(|error| Error::input(format!("cannot read {}: {error}", path.display())))?;
    let last = std::cell::Cell::new(None);
    let told = |second: u64| {
        if last.replace(Some(second)) != Some(second) {
            progress(&format!("a run, {second} of {} s", run.seconds));
        }
    };
    let (image, model) = (&prepared.image, &prepared.model);
    let shown = emulated::run(run, &elf, image, model, execution, &told)?;
    Ok((shown.observed, shown.sentence))
}

/// Shows the answer, and fails if it is not good.
fn print(
    answer: &Answer,
    losses: &[(String, String)],
    show: &Show,
    binary: &Binary,
) -> Result<(), Error> {
    let node = &answer.node;
    if let Some(path) = &show.html {
        write(path, &application::html(node, &answer.assumptions))?;
    }
    let findings = || report::findings(answer, losses, &in_repository(binary, &answer.source));
    // The last line of the tables agrees with the exit code.
    let text = || {
        let lost = losses
            .iter()
            .map(|(_, what)| format!("slack is lost: {what}\n"));
        application::text(node, &answer.assumptions) + &lost.collect::<String>()
    };
    let explained = show.explain.as_ref();
    let explained = explained.and_then(|name| node.tasks.iter().find(|one| one.name == *name));
    say(&match (show.json, explained, show.format) {
        (true, ..) => format!("{:#}\n", report::json(answer)),
        (false, Some(task), _) => explain_as_flashed(node, task),
        (false, None, Format::Sarif) => format!("{:#}\n", report::sarif(&findings())),
        (false, None, Format::Github) => text() + &report::github(&findings()),
        (false, None, Format::Text) => text(),
    })?;
    let loss = losses.first().map(|(_, what)| what.clone());
    match answer
        .first_miss()
        .map(|miss| format!("not schedulable: {miss}"))
        .or(loss)
    {
        None => Ok(()),
        Some(what) => Err(Error::Missed(what)),
    }
}

/// A path of the workspace as the repository around it has it.
fn in_repository(binary: &Binary, file: &str) -> String {
    let repository = binary
        .root
        .ancestors()
        .find(|folder| folder.join(".git").exists());
    let inside = repository.and_then(|folder| binary.root.strip_prefix(folder).ok());
    let path = inside.map_or_else(|| PathBuf::from(file), |inside| inside.join(file));
    path.display().to_string().replace('\\', "/")
}

/// Writes a first table.
fn write_table(of: &Of) -> Result<(), Error> {
    let binary = Binary::find(&of.choice())?;
    let path = of.table.clone().unwrap_or_else(|| binary.new_table());
    if path.exists() {
        return Err(Error::input(format!(
            "{} exists, and is not overwritten: remove it, or name another file by --table",
            app::short(&path, &binary.root)
        )));
    }
    let mut source = app::read_app(&binary.source, &binary.root)?;
    let part = of
        .part
        .as_deref()
        .map(|name| parts::find(name, Path::new(".")))
        .transpose()?;
    let (_, image) = of.image(&binary)?;
    source.app.drop_absent(&image);
    let text = first_table(of, &binary, &source, part.as_ref(), &image)?;
    write(&path, &text)?;
    let questions = text.matches(" = \"?\"").count();
    say(&format!(
        "Wrote {} with {questions} questions: answer them in place of \"?\", then run `cargo deadlines`.\n",
        app::short(&path, &binary.root)
    ))
}

fn first_table(
    of: &Of,
    binary: &Binary,
    source: &Source,
    part: Option<&PartFile>,
    image: &Image,
) -> Result<String, Error> {
    // Who pends whom does not depend on the part, so any will do for a first look.
    let usual = parts::find("stm32f1", Path::new("."))?;
    let looked = part.unwrap_or(&usual);
    let on = looked.on(&Clocks {
        core_hz: looked.reset_hz,
        ..Clocks::default()
    })?;
    let handlers = foreign(source, image);
    let mut table = trial_table(source, &handlers);
    let folder = &binary.root;
    let trial = |table: &Table| -> Result<_, Error> {
        let model = model::build(&binary.name, source, table, &on, 1, "the table")?;
        let annotations = Annotations::new(folder);
        let execution = Execution::of(&model.node, &model.table, image, &annotations, &progress);
        Ok((model, execution))
    };
    let (mut model, mut execution) = trial(&table)?;
    // The image says which priority a handler has. Each turn corrects one of them.
    for _ in &handlers {
        let Err(ExecutionError::Priority {
            task,
            given: Some(given),
            ..
        }) = &execution
        else {
            break;
        };
        match table.task.get_mut(task).filter(|_| handlers.contains(task)) {
            Some(row) => row.priority = Some(*given),
            None => break,
        }
        (model, execution) = trial(&table)?;
    }
    // A program that the analysis refuses is still worth a table: the analysis itself says why.
    let execution = execution.ok();
    let is_known = part.is_some() && execution.is_some();
    let priority = |name: &String| {
        let row = table.task.get(name)?;
        let usual = source.monotonic_priority(on.priorities());
        is_known.then(|| row.priority.unwrap_or(usual))
    };
    let handlers: Handlers = handlers
        .iter()
        .map(|name| (name.clone(), priority(name)))
        .collect();
    let on_part = OnPart {
        name: of.part.as_deref(),
        file: part,
        core_hz: of.core_hz,
    };
    Ok(init::table(
        source,
        &handlers,
        &model.node,
        execution.as_ref(),
        &on_part,
    ))
}

/// A table in which each task and each of these handlers has a row.
fn trial_table(source: &Source, handlers: &[String]) -> Table {
    let row = Row {
        every_us: vec![1_000_000],
        deadline_us: Some(1_000_000),
        ..Row::default()
    };
    let tasks = source.app.tasks.iter().map(|task| &task.name);
    let rows = tasks
        .chain(handlers)
        .map(|name| (name.clone(), row.clone()));
    Table {
        task: rows.collect(),
        ..Table::default()
    }
}

/// Checks that each row is of a task, or of a handler in the image.
fn check_rows(tables: &Tables, source: &Source, image: &Image) -> Result<(), Error> {
    let tasks = source.app.tasks.iter().map(|task| task.name.as_str());
    let tasks: Vec<&str> = tasks
        .chain(source.in_idle.iter().map(String::as_str))
        .collect();
    let vectors = image.vectors();
    let is_handler = |name: &str| {
        let at = image.symbol(name);
        at.is_some_and(|at| vectors.values().any(|entry| *entry == at))
    };
    let mut rows = tables.table.task.keys();
    let surplus = rows.find(|name| !tasks.contains(&name.as_str()) && !is_handler(name));
    let Some(surplus) = surplus else {
        return Ok(());
    };
    let handlers = foreign(source, image);
    let handlers = if handlers.is_empty() {
        String::new()
    } else {
        format!(
            ", and the other handlers of the image {}",
            handlers.join(", ")
        )
    };
    Err(Error::input(format!(
        "{}: [task.{surplus}] is a row of no task: the tasks of {} are {}{handlers}",
        tables.file,
        source.shown,
        tasks.join(", ")
    )))
}

/// The handlers of interrupts in the image that are neither a task's nor a dispatcher's nor the default one.
fn foreign(source: &Source, image: &Image) -> Vec<String> {
    let mut known: Vec<&str> = source.app.dispatchers.iter().map(String::as_str).collect();
    known.extend(
        source
            .app
            .tasks
            .iter()
            .filter_map(|task| task.binds.as_deref()),
    );
    let default = image.symbol(wcet::image::DEFAULT_HANDLER);
    let mut names = Vec::new();
    for (number, entry) in image.vectors() {
        if number <= wcet::image::LAST_FAULT || Some(entry) == default {
            continue;
        }
        let mut symbols: Vec<&str> = image.symbols_at(entry).collect();
        if symbols.iter().any(|symbol| known.contains(symbol)) {
            continue;
        }
        symbols.retain(|symbol| !symbol.starts_with("_Z") && !symbol.starts_with("_R"));
        names.extend(symbols.first().map(|symbol| (*symbol).to_owned()));
    }
    names.dedup();
    names
}
