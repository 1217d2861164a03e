//! The figures as one page that loads nothing else, and as pictures.

use maud::{DOCTYPE, Markup, html};

use super::{
    Figure, cell,
    drawn::{Drawn, Number},
};
use crate::page::{self, chart};

/// Chapters of the thesis that have figures with data.
const CHAPTERS: [(&str, &str); 4] = [
    ("2.", "Between rows"),
    ("5.", "Calibration of the steering"),
    ("6.", "Tasks and bus"),
    ("7.", "Track tests"),
];

/// The page.
pub(super) fn page(drawn: &[(&Figure, Drawn)]) -> String {
    let title = "Figures of the thesis, from runs of the release images";
    let chapters = CHAPTERS.map(|(number, name)| {
        let own = drawn
            .iter()
            .filter(|(figure, _)| figure.number.starts_with(number))
            .collect::<Vec<_>>();
        (number, name, own)
    });
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            (page::head(title, ""))
            body {
                a.skip href="#main" { "Skip to the figures" }
                header {
                    h1 { (title) }
                    p {
                        "T. Troyer's thesis of 2017 has " (super::FIGURES.len()) " figures that show data, of which " (drawn.len()) " are "
                        "here. They are drawn from runs of the release images on the virtual vehicle, with the numbers that the "
                        "thesis gives beside those of its law and of Furrow's. Where its text has no number, none is made up."
                    }
                    p {
                        "The error of a track test stays about its mean when it no longer leaves the band of 5 cm about the mean of "
                        "its last 10 s. From then on it is in steady state here, while the report of `sim` counts from where the "
                        "error stays within 5 cm of the line: a law with an offset is there sooner."
                    }
                    nav aria-label="Figures" {
                        ul {
                            @for (figure, _) in drawn {
                                li { a href=(format!("#figure-{}", figure.number)) title=(figure.title) { (figure.number) } }
                            }
                        }
                    }
                }
                main id="main" {
                    @for (number, name, figures) in &chapters {
                        @if !figures.is_empty() {
                            h2 { "Chapter " (number.trim_end_matches('.')) ": " (name) }
                            @for (figure, drawn) in figures { (one(figure, drawn)) }
                        }
                    }
                }
            }
        }
    };
    page.into_string()
}

/// A figure.
fn one(figure: &Figure, drawn: &Drawn) -> Markup {
    let id = format!("figure-{}", figure.number);
    html! {
        section id=(id) aria-labelledby=(format!("{id}-heading")) {
            h3 id=(format!("{id}-heading")) { "Figure " (figure.number) ": " (figure.title) }
            @for chart in &drawn.charts { (chart) }
            @if !drawn.numbers.is_empty() { (table(figure, &drawn.numbers)) }
            details {
                summary { "Runs" }
                @for command in figure.commands() { p { code { (command) } } }
            }
        }
    }
}

/// The value of a column.
type Column = fn(&Number) -> Option<f64>;

/// A figure's numbers.
fn table(figure: &Figure, numbers: &[Number]) -> Markup {
    let columns: [(&str, Column); 3] = [
        ("thesis", |one| one.thesis),
        ("law of the thesis", |one| one.plain),
        ("Furrow", |one| one.furrow),
    ];
    let filled = |of: Column| numbers.iter().any(|one| of(one).is_some());
    let columns: Vec<_> = columns.into_iter().filter(|(_, of)| filled(*of)).collect();
    html! {
        table {
            caption { "Numbers of figure " (figure.number) }
            thead {
                tr { th.word scope="col" { "" }
                    @for (name, _) in &columns { th scope="col" { (name) } }
                    th.word scope="col" { "unit" } }
            }
            tbody {
                @for number in numbers {
                    tr {
                        th.word scope="row" { (number.what) }
                        @for (_, of) in &columns { td { (cell(of(number), number.digits)) } }
                        td.word { (number.unit) }
                    }
                }
            }
        }
    }
}

/// Each chart as a picture of its own, with the name of its file.
pub(super) fn pictures(drawn: &[(&Figure, Drawn)]) -> Vec<(String, String)> {
    let mut all = Vec::new();
    for (figure, drawn) in drawn {
        let several = drawn.charts.len() > 1;
        for (place, chart) in drawn.charts.iter().enumerate() {
            let part = if several {
                format!("-{}", place + 1)
            } else {
                String::new()
            };
            let name = format!("figure-{}{part}.svg", figure.number);
            let pictures = chart::pictures(&chart.0).into_iter();
            all.extend(pictures.map(|(_, picture)| (name.clone(), picture)));
        }
    }
    all
}
