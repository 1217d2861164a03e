//! `figures`: draws those figures of the thesis that show data from runs of the release images.

mod actuators;
mod bus;
mod drawn;
mod page;
mod rows;
mod takes;
mod track;

use std::{collections::BTreeSet, fmt::Write as _};

use serde::Serialize;
use world::report::{FolderError, OutputFolder};

use crate::{Failure, Workspace, cli};
use drawn::{Drawn, Number};
use takes::{Take, Takes};

/// Why the figures cannot be drawn.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The thesis has no such figure, or it shows no data.
    #[error(
        "there is no figure {number:?} with data: `cargo xtask figures --list` names those that there are"
    )]
    Unknown {
        /// What was asked for.
        number: String,
    },
    /// The output folder is wrong.
    #[error(transparent)]
    Folder(#[from] FolderError),
}

/// A figure of the thesis.
struct Figure {
    /// Its number.
    number: &'static str,
    /// What it shows, in a few words.
    title: &'static str,
    /// The runs that it is drawn from.
    takes: &'static [Take],
    /// Draws it.
    draw: fn(&Takes<'_>) -> Drawn,
}

impl Figure {
    /// The commands that make its runs.
    fn commands(&self) -> Vec<String> {
        self.takes.iter().map(|take| take.command()).collect()
    }
}

macro_rules! figure {
    ($number:literal, $title:literal, [$($take:expr),+], $draw:path) => {
        Figure {
            number: $number,
            title: $title,
            takes: &[$($take),+],
            draw: $draw,
        }
    };
}

/// The figures that show data. The others are drawings of machines, boards, models and messages.
const FIGURES: [Figure; 36] = {
    use Take::{
        Bus, Calibration, Estimation, Field, FieldFurrow, Five, FiveFurrow, Half, Loaded,
        LoadedFurrow, Lost, Model, One, OneFurrow, Poles, PolesFurrow, StepFurrow, StepP, StepPi,
    };
    [
        figure!(
            "2.17",
            "Distances to both rows, filtered",
            [Poles(1)],
            rows::filtered
        ),
        figure!(
            "2.19",
            "Step of the barriers, proportional law",
            [StepP, StepFurrow],
            rows::proportional
        ),
        figure!(
            "2.20",
            "Step of the barriers, law with an integral",
            [StepPi, StepFurrow],
            rows::integral
        ),
        figure!(
            "2.22",
            "Between poles, first drive",
            [Poles(1), PolesFurrow(1)],
            rows::poles_1
        ),
        figure!(
            "2.23",
            "Between poles, second drive",
            [Poles(2), PolesFurrow(2)],
            rows::poles_2
        ),
        figure!(
            "2.24",
            "Between poles, third drive",
            [Poles(3), PolesFurrow(3)],
            rows::poles_3
        ),
        figure!(
            "2.25",
            "In the field, first drive",
            [Field(1), FieldFurrow(1)],
            rows::field_1
        ),
        figure!(
            "2.26",
            "In the field, second drive",
            [Field(2), FieldFurrow(2)],
            rows::field_2
        ),
        figure!(
            "2.27",
            "In the field, third drive",
            [Field(3), FieldFurrow(3)],
            rows::field_3
        ),
        figure!(
            "5.18",
            "Steering angle and reading of the potentiometer",
            [Calibration],
            actuators::potentiometer
        ),
        figure!(
            "5.19",
            "Steering angle and command over time",
            [Calibration],
            actuators::movements
        ),
        figure!(
            "5.20",
            "Effort and steering rate, with the dead band",
            [Calibration],
            actuators::rates
        ),
        figure!(
            "6.21",
            "The basic period in the execution of tasks",
            [Bus],
            bus::tasks_of_cycles
        ),
        figure!(
            "6.22",
            "The longest task: a text for the display",
            [Bus],
            bus::longest_task
        ),
        figure!(
            "6.23",
            "From the receiver's line into the windows",
            [Bus],
            bus::receiver
        ),
        figure!(
            "6.27",
            "The byte stream to the display",
            [Bus],
            bus::display
        ),
        figure!(
            "6.29",
            "Handling of all frames of a basic period",
            [Bus],
            bus::handling
        ),
        figure!(
            "6.30",
            "The basic period of 100 ms",
            [Bus],
            bus::basic_period
        ),
        figure!(
            "6.31",
            "A basic period without a fix",
            [Lost],
            bus::without_fix
        ),
        figure!("6.32", "Windows of a millisecond", [Bus], bus::windows),
        figure!(
            "6.33",
            "Bus activity of one basic period",
            [Bus],
            bus::activity
        ),
        figure!("7.9", "Convergence of the model", [Model], track::model),
        figure!(
            "7.13",
            "Estimates from noisy measurements",
            [Estimation],
            track::estimation
        ),
        figure!("7.14", "Route of the track tests", [One], track::route),
        figure!(
            "7.15",
            "First test: states",
            [One, OneFurrow],
            track::first_states
        ),
        figure!(
            "7.16",
            "First test: way over ground",
            [One, OneFurrow],
            track::first_way
        ),
        figure!(
            "7.17",
            "First test: distribution of the cross-track error",
            [One, OneFurrow],
            track::first_distribution
        ),
        figure!(
            "7.18",
            "First test: cross-track error over time",
            [One, OneFurrow],
            track::first_error
        ),
        figure!(
            "7.19",
            "Less aggressive gains",
            [Half, One],
            track::half_gains
        ),
        figure!(
            "7.20",
            "Second test: way from an inconvenient start",
            [Five, FiveFurrow],
            track::second_way
        ),
        figure!(
            "7.21",
            "Second test: states",
            [Five, FiveFurrow],
            track::second_states
        ),
        figure!(
            "7.22",
            "Second test: cross-track error and its distribution",
            [Five, FiveFurrow],
            track::second_error
        ),
        figure!(
            "7.25",
            "Loaded: way over ground",
            [Loaded, LoadedFurrow],
            track::loaded_way
        ),
        figure!(
            "7.26",
            "Loaded: commands of the steering",
            [Loaded, LoadedFurrow],
            track::loaded_commands
        ),
        figure!(
            "7.27",
            "Loaded: cross-track error over time",
            [Loaded, LoadedFurrow],
            track::loaded_error
        ),
        figure!(
            "7.28",
            "Loaded: distribution of the cross-track error",
            [Loaded, LoadedFurrow],
            track::loaded_distribution
        ),
    ]
};

/// What `--json` and figures.json say of a figure.
#[derive(Serialize)]
struct Told<'f> {
    figure: &'static str,
    title: &'static str,
    commands: Vec<String>,
    /// None in a list.
    #[serde(skip_serializing_if = "Option::is_none")]
    numbers: Option<&'f [Number]>,
}

impl<'f> Told<'f> {
    fn of(figure: &Figure, numbers: Option<&'f [Number]>) -> Self {
        Self {
            figure: figure.number,
            title: figure.title,
            commands: figure.commands(),
            numbers,
        }
    }
}

/// Runs the command.
///
/// # Errors
///
/// There is no such figure or the output folder is wrong (exit code 2); an image does not build or run.
pub fn run(workspace: &Workspace, options: &cli::Figures) -> Result<(), Failure> {
    let chosen = chosen(&options.only)?;
    if options.list {
        if options.json {
            print!(
                "{}",
                json(chosen.iter().map(|figure| Told::of(figure, None)))
            );
        } else {
            print!("{}", list(&chosen));
        }
        return Ok(());
    }
    let folder = match &options.out {
        Some(path) => Some(OutputFolder::create(path).map_err(Error::from)?),
        None => None,
    };
    let takes: BTreeSet<Take> = chosen
        .iter()
        .flat_map(|figure| figure.takes.iter().copied())
        .collect();
    let takes: Vec<Take> = takes.into_iter().collect();
    let ready = takes::ready(workspace, &takes)?;
    let takes = takes::make(&ready)?;
    let drawn: Vec<(&Figure, Drawn)> = chosen
        .into_iter()
        .map(|figure| {
            let Drawn { charts, numbers } = (figure.draw)(&takes);
            let numbers = numbers.into_iter().map(Number::rounded).collect();
            (figure, Drawn { charts, numbers })
        })
        .collect();
    let told = drawn.iter();
    let told = told.map(|(figure, drawn)| Told::of(figure, Some(drawn.numbers.as_slice())));
    let json = json(told);
    if let Some(mut folder) = folder {
        folder.replace_older(|name| name.starts_with("figure-") && name.ends_with(".svg"));
        let mut write = || -> Result<_, FolderError> {
            folder.write("figures.html", page::page(&drawn).as_bytes())?;
            folder.write("figures.json", json.as_bytes())?;
            for (name, picture) in page::pictures(&drawn) {
                folder.write(&name, picture.as_bytes())?;
            }
            Ok(())
        };
        write().map_err(Error::from)?;
        let path = folder.finish().map_err(Error::from)?;
        eprintln!(
            "Wrote figures.html, figures.json and a picture of each chart to {}.",
            path.display()
        );
    }
    if options.json {
        print!("{json}");
    } else {
        print!("{}", text(&drawn));
    }
    Ok(())
}

/// The figures that are asked for; all if none is.
fn chosen(only: &[String]) -> Result<Vec<&'static Figure>, Error> {
    let unknown = only
        .iter()
        .find(|number| !FIGURES.iter().any(|figure| figure.number == **number));
    if let Some(number) = unknown {
        return Err(Error::Unknown {
            number: number.clone(),
        });
    }
    let asked = |figure: &&Figure| only.is_empty() || only.iter().any(|one| one == figure.number);
    Ok(FIGURES.iter().filter(asked).collect())
}

/// The figures, one a line.
fn list(figures: &[&Figure]) -> String {
    let line = |figure: &&Figure| format!("{:<6}{}\n", figure.number, figure.title);
    figures.iter().map(line).collect()
}

/// What is told of figures, for programs.
fn json<'f>(told: impl Iterator<Item = Told<'f>>) -> String {
    let told: Vec<Told<'_>> = told.collect();
    let mut text = serde_json::to_string_pretty(&told).unwrap_or_default();
    text.push('\n');
    text
}

/// A number of so many decimals, or a dash.
fn cell(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
}

/// The numbers of all figures for people.
fn text(drawn: &[(&Figure, Drawn)]) -> String {
    let widths = drawn.iter().flat_map(|(_, drawn)| &drawn.numbers);
    let width = widths.map(|number| number.what.len()).max().unwrap_or(0);
    let mut text = format!(
        "{:<8}{:<width$}{:>10}{:>12}{:>10}\n",
        "figure", "", "thesis", "thesis law", "Furrow"
    );
    for (figure, drawn) in drawn {
        // Writing to a string cannot fail.
        if drawn.numbers.is_empty() {
            let _ = writeln!(text, "{:<8}{}", figure.number, figure.title);
        }
        for number in &drawn.numbers {
            let digits = number.digits;
            let _ = writeln!(
                text,
                "{:<8}{:<width$}{:>10}{:>12}{:>10} {}",
                figure.number,
                number.what,
                cell(number.thesis, digits),
                cell(number.plain, digits),
                cell(number.furrow, digits),
                number.unit,
            );
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_figure_with_data_is_there_once() {
        let numbers: BTreeSet<&str> = FIGURES.iter().map(|figure| figure.number).collect();
        assert_eq!(numbers.len(), FIGURES.len());
        let order = |number: &str| -> (u32, u32) {
            let (chapter, figure) = number.split_once('.').unwrap();
            (chapter.parse().unwrap(), figure.parse().unwrap())
        };
        assert!(FIGURES.is_sorted_by_key(|figure| order(figure.number)));
    }

    #[test]
    fn figures_are_chosen_by_number() {
        let numbers = |only: &[&str]| -> Vec<&str> {
            let only: Vec<String> = only.iter().map(|&one| one.to_owned()).collect();
            let chosen = chosen(&only).unwrap();
            chosen.iter().map(|figure| figure.number).collect()
        };
        assert_eq!(numbers(&["7.20", "2.17"]), ["2.17", "7.20"]);
        assert_eq!(numbers(&[]).len(), FIGURES.len());
        // A drawing of a machine.
        let error = chosen(&["5.2".to_owned()]).err().unwrap();
        assert!(error.to_string().contains("\"5.2\""), "{error}");
        assert_eq!(Failure::from(error).exit_code(), 2);
    }

    #[test]
    fn a_run_of_a_figure_can_be_made_by_hand() {
        assert_eq!(
            Take::Half.command(),
            "cargo xtask sim thesis-machine/half-gains --seconds 45 --out run"
        );
        assert_eq!(
            Take::Poles(2).command(),
            "cargo xtask sim thesis-2/poles --vehicle row-follower --set rover.law=thesis --set 'rover.cruise=0.8 m/s' \
             --seed 2 --seconds 15 --out run"
        );
    }
}
