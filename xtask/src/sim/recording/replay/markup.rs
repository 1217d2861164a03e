//! The elements of the page; the script fills them.

use maud::{DOCTYPE, Markup, PreEscaped, html};
use world::report::{Summary, terminal};
use world::time::seconds;

use super::super::super::Finished;
use crate::page::head;

/// The page's own style, beside that of all pages.
const OWN_STYLE: &str = include_str!("page.css");
/// What plays the run.
const SCRIPT: &str = include_str!("page.js");

/// The page around the data.
pub(super) fn markup(
    title: &str,
    finished: &Finished<'_>,
    summary: &Summary,
    data: &str,
) -> String {
    let with = match summary.set.as_str() {
        "" => String::new(),
        set => format!("; with {}", set.replace(';', ", ")),
    };
    let about = format!(
        "{}{with}; seed {}, {} s simulated.",
        finished.scenario.summary,
        finished.seed,
        seconds(finished.outcome.duration)
    );
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            (head(title, OWN_STYLE))
            body data-state="loading" {
                a.skip href="#main" { "Skip to the run" }
                h1 { (title) }
                p { (about) }
                noscript { p.bad { "This page plays the run by a script, which your browser does not run." } }
                p #trouble .bad hidden {}
                (controls())
                main id="main" {
                    div.two {
                        figure #track-figure { figcaption { strong { "Track" } " seen from above; a click shows what is near, or all" }
                            canvas #track role="img" aria-label="Track" width="560" height="420" {} }
                        div {
                            h2 { "Now" }
                            dl #now .tiles {}
                            section #display-section aria-label="Display" hidden {
                                h2 { "Display" }
                                pre #display aria-label="Display of the operator" {}
                                p #lamps {}
                            }
                        }
                    }
                    figure { figcaption { strong { "Over time" } " the upright line is now; a click goes to another time" }
                        div #plots {} }
                    (cycle())
                    section aria-labelledby="texts-heading" {
                        h2 id="texts-heading" { "Logs and consoles" }
                        label { "Of " select #source {} }
                        pre #texts tabindex="0" aria-label="Lines up to now" {}
                    }
                    section aria-labelledby="report-heading" {
                        h2 id="report-heading" { "Report" }
                        div.scroll tabindex="0" role="region" aria-label="Report" { pre { (terminal(summary, None)) } }
                    }
                }
                script #data type="text/plain" { (PreEscaped(data)) }
                script { (PreEscaped(SCRIPT)) }
            }
        }
    };
    page.into_string()
}

/// Time and speed.
fn controls() -> Markup {
    html! {
        div.controls role="group" aria-label="Time" {
            button #play type="button" aria-keyshortcuts="Space" { "Play" }
            label { "Speed " select #speed {
                @for speed in ["0.001", "0.01", "0.1", "1", "2", "5", "10", "60"] {
                    option value=(speed) selected[speed == "1"] { (speed) " times" }
                }
            } }
            label.wide { span { "Time " output #clock { "0.000 s" } }
                input #time type="range" min="0" max="1" step="0.01" value="0";
            }
            label { "Jump to " select #events { option value="" { "an event" } } }
        }
        details.keys {
            summary { "Keys" }
            p {
                "Space plays and pauses. Left and right: 0.1 s, with Shift 1 s. Page up and down: a basic \
                 cycle. Home and End: begin and end. Plus and minus: zoom of the basic cycle, with Shift \
                 and left or right on the picture: its place."
            }
        }
    }
}

/// The basic cycle: bus, tasks and frames.
fn cycle() -> Markup {
    html! {
        section aria-labelledby="cycle-heading" {
            h2 id="cycle-heading" { "Basic cycle " output #cycle-name {} }
            div.controls role="group" aria-label="Basic cycle" {
                button #previous type="button" { "Previous" }
                button #next type="button" { "Next" }
                label { "Zoom " input #zoom type="range" min="0" max="12" step="0.5" value="0"; }
                label { "Place " input #place type="range" min="0" max="1" step="0.0005" value="0"; }
            }
            figure { figcaption { strong { "Bus and tasks" } " windows are framed; below the bus, what each node executes" }
                canvas #cycle role="img" tabindex="0" aria-label="Bus and tasks of the basic cycle" width="1120" height="300" {} }
            p #under aria-live="polite" {}
            div.scroll tabindex="0" role="region" aria-label="Frames of the basic cycle" {
                table #frames { caption { "Frames of this basic cycle" } thead { tr {
                    th scope="col" { "at (us)" } th.word scope="col" { "message" } th scope="col" { "id" }
                    th.word scope="col" { "sender" } th scope="col" { "after its window's begin (us)" }
                    th.word scope="col" { "data" } th.word scope="col" { "signals" }
                } } tbody {} }
            }
        }
    }
}
