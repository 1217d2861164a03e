//! The aims, met or missed, and the table.

use std::fmt::Write;

use serde::Serialize;

use super::{
    aggregate::Aggregate,
    case::{
        Case, FEWER_SIGN_CHANGES, FIT_CM, FIT_SECONDS, LARGEST_DEVIATION_CM, LARGEST_MEAN_CM,
        MOST_SWINGS, Settling,
    },
    measure::Figures,
};

/// The result of an experiment.
#[derive(Debug, Serialize)]
pub(super) struct Report {
    /// Its name.
    pub experiment: &'static str,
    /// First seed.
    pub first_seed: u64,
    /// Number of seeds.
    pub seeds: u64,
    /// Its cases.
    pub cases: Vec<CaseReport>,
}

/// The result of a case.
#[derive(Debug, Serialize)]
pub(super) struct CaseReport {
    /// Its name.
    pub case: &'static str,
    /// What it shows.
    pub summary: String,
    /// Mean cross-track error that the thesis reports.
    pub thesis_mean_cm: Option<f64>,
    /// Settling time that the thesis reports.
    pub thesis_settling_seconds: Option<f64>,
    /// Time of the shortest path under the steering limit.
    pub shortest_path_seconds: f64,
    /// The image that is flashed.
    pub furrow: Aggregate,
    /// The image with the thesis's law.
    pub plain: Aggregate,
    /// The aims of the flashed image, met or missed.
    pub aims: Vec<Aim>,
}

/// An aim of a case.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Aim {
    /// The figure.
    pub figure: &'static str,
    /// The measured value; `None` when there is none.
    pub value: Option<f64>,
    /// Whether it is an aim of the thesis's law, and not of Furrow's.
    pub plain: bool,
    /// The least accepted value.
    pub least: Option<f64>,
    /// The largest accepted value.
    pub limit: f64,
    /// Whether the aim is met.
    pub met: bool,
}

impl Aim {
    fn at_most(figure: &'static str, value: Option<f64>, limit: f64) -> Self {
        let met = value.is_some_and(|value| value <= limit);
        Self {
            figure,
            value,
            plain: false,
            least: None,
            limit,
            met,
        }
    }

    /// The thesis's law has the thesis's figure, give or take `tolerance`.
    fn as_in_the_thesis(
        figure: &'static str,
        value: Option<f64>,
        thesis: f64,
        tolerance: f64,
    ) -> Self {
        let (least, limit) = (thesis - tolerance, thesis + tolerance);
        Self {
            figure,
            value,
            plain: true,
            least: Some(least),
            limit,
            met: value.is_some_and(|value| (least..=limit).contains(&value)),
        }
    }

    /// What is accepted, and whether it was reached.
    fn verdict(&self, digits: usize) -> String {
        let verdict = if self.met { "met" } else { "MISSED" };
        let law = if self.plain { "plain law: " } else { "" };
        match self.least {
            None => format!("   {law}at most {:.digits$}: {verdict}", self.limit),
            Some(least) => format!(
                "   {law}{least:.digits$} to {:.digits$}: {verdict}",
                self.limit
            ),
        }
    }
}

/// Names of the figures that have aims, as in the table.
mod figure {
    pub(super) const ARRIVAL: &str = "about its mean, median";
    pub(super) const OWN_MEAN: &str = "mean error";
    pub(super) const SETTLING: &str = "settling, worst";
    pub(super) const MEAN: &str = "|mean error|";
    pub(super) const DEVIATION: &str = "deviation";
    pub(super) const SWINGS: &str = "swings, worst";
    pub(super) const SIGNS: &str = "sign changes";
    pub(super) const UNFINISHED: &str = "runs given up";
}

impl CaseReport {
    /// Judges the runs of a case.
    pub(super) fn new(
        case: &Case,
        summary: &str,
        shortest_path_seconds: f64,
        furrow: &[Figures],
        plain: &[Figures],
    ) -> Self {
        let (furrow, plain) = (Aggregate::of(furrow), Aggregate::of(plain));
        let soonest = match case.settling {
            Settling::Within(seconds) => seconds,
            Settling::Shortest(times) => times * shortest_path_seconds,
        };
        let unfinished = (furrow.runs - furrow.complete) as f64;
        let mut signs = Aim::at_most(
            figure::SIGNS,
            Some(furrow.sign_changes_per_second),
            plain.sign_changes_per_second / FEWER_SIGN_CHANGES,
        );
        // Strictly fewer: if neither law changed the sign, nothing would be shown.
        signs.met = furrow.sign_changes_per_second < signs.limit;
        let mut aims = vec![
            Aim::at_most(figure::SETTLING, furrow.settling_worst_seconds, soonest),
            Aim::at_most(figure::MEAN, Some(furrow.mean_cm.abs()), LARGEST_MEAN_CM),
            Aim::at_most(
                figure::DEVIATION,
                Some(furrow.deviation_cm),
                LARGEST_DEVIATION_CM,
            ),
            Aim::at_most(
                figure::SWINGS,
                Some(furrow.swings_worst as f64),
                MOST_SWINGS as f64,
            ),
            signs,
            Aim::at_most(figure::UNFINISHED, Some(unfinished), 0.0),
        ];
        if let Some(mean) = case.thesis_mean_cm.filter(|_| case.fitted) {
            let found = Some(plain.mean_cm);
            aims.push(Aim::as_in_the_thesis(figure::OWN_MEAN, found, mean, FIT_CM));
        }
        if let Some(settling) = case.thesis_settling_seconds.filter(|_| case.fitted) {
            let found = plain.arrival_median_seconds;
            aims.push(Aim::as_in_the_thesis(
                figure::ARRIVAL,
                found,
                settling,
                FIT_SECONDS,
            ));
        }
        Self {
            case: case.name,
            summary: summary.to_owned(),
            thesis_mean_cm: case.thesis_mean_cm,
            thesis_settling_seconds: case.thesis_settling_seconds,
            shortest_path_seconds,
            furrow,
            plain,
            aims,
        }
    }

    fn missed(&self) -> impl Iterator<Item = String> + '_ {
        let missed = self.aims.iter().filter(|aim| !aim.met);
        missed.map(|aim| format!("{} ({})", aim.figure, self.case))
    }
}

impl Report {
    /// The aims that were missed, each with its case.
    pub(super) fn missed(&self) -> Vec<String> {
        self.cases.iter().flat_map(CaseReport::missed).collect()
    }

    /// The report for programs.
    pub(super) fn json(&self) -> String {
        let mut text = serde_json::to_string_pretty(self).unwrap_or_default();
        text.push('\n');
        text
    }

    /// The report for people.
    pub(super) fn text(&self) -> String {
        let last = self.first_seed + (self.seeds - 1);
        let mut text = format!(
            "{}: seeds {} to {last}, each with Furrow and with the thesis's plain law\n",
            self.experiment, self.first_seed
        );
        for case in &self.cases {
            let _ = writeln!(
                text,
                "\n{}: {}; shortest path {:.1} s\n  {:<27}{:>10}{:>12}{:>10}   aim",
                case.case,
                case.summary,
                case.shortest_path_seconds,
                "",
                "thesis",
                "plain law",
                "Furrow"
            );
            for row in rows(case) {
                let _ = writeln!(text, "  {row}");
            }
        }
        text
    }
}

/// A number of one unit, or a dash.
fn cell(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
}

/// The lines of a case's table.
fn rows(case: &CaseReport) -> Vec<String> {
    let line = |name: &str, thesis: Option<f64>, part: fn(&Aggregate) -> Option<f64>, digits| {
        let aim = case.aims.iter().find(|aim| name.starts_with(aim.figure));
        let aim = aim.map_or_else(String::new, |aim| aim.verdict(digits));
        format!(
            "{name:<27}{:>10}{:>12}{:>10}{aim}",
            cell(thesis, digits),
            cell(part(&case.plain), digits),
            cell(part(&case.furrow), digits),
        )
    };
    let count = |value: usize| Some(value as f64);
    let thesis_mean = case.thesis_mean_cm;
    let mut rows = vec![
        line(
            "settling, median (s)",
            None,
            |a| a.settling_median_seconds,
            1,
        ),
        line("settling, worst (s)", None, |a| a.settling_worst_seconds, 1),
        line(
            "about its mean, median (s)",
            case.thesis_settling_seconds,
            |a| a.arrival_median_seconds,
            1,
        ),
        line(
            "|mean error| (cm)",
            thesis_mean.map(f64::abs),
            |a| Some(a.mean_cm.abs()),
            2,
        ),
        line("mean error (cm)", thesis_mean, |a| Some(a.mean_cm), 2),
        line("mean, worst run (cm)", None, |a| Some(a.mean_worst_cm), 2),
        line("deviation (cm)", None, |a| Some(a.deviation_cm), 2),
        line(
            "worst run's dev. (cm)",
            None,
            |a| Some(a.deviation_worst_cm),
            2,
        ),
        line(
            "overshoot, worst (cm)",
            None,
            |a| Some(a.overshoot_worst_cm),
            1,
        ),
        line(
            "sign changes (1/s)",
            None,
            |a| Some(a.sign_changes_per_second),
            3,
        ),
    ];
    let whole = |name: &str, part: fn(&Aggregate) -> usize| {
        let aim = case.aims.iter().find(|aim| name == aim.figure);
        let aim = aim.map_or_else(String::new, |aim| aim.verdict(0));
        format!(
            "{name:<27}{:>10}{:>12}{:>10}{aim}",
            "-",
            cell(count(part(&case.plain)), 0),
            cell(count(part(&case.furrow)), 0),
        )
    };
    rows.push(whole(figure::SWINGS, |a| a.swings_worst));
    rows.push(whole("runs settled", |a| a.settled));
    rows.push(whole(figure::UNFINISHED, |a| a.runs - a.complete));
    rows
}

#[cfg(test)]
mod tests {
    use super::{
        super::{aggregate::tests::run, case::ALL},
        *,
    };

    fn report(case: usize, settling: f64, offset: f64, changes: usize) -> CaseReport {
        let furrow = [run(Some(settling), [offset - 1.0, offset + 1.0], changes)];
        let plain = [run(None, [4.0, 8.0], 100)];
        CaseReport::new(&ALL[0].cases[case], "a test", 10.0, &furrow, &plain)
    }

    fn missed(report: &CaseReport) -> Vec<&str> {
        let missed = report.aims.iter().filter(|aim| !aim.met);
        missed.map(|aim| aim.figure).collect()
    }

    #[test]
    fn aims_are_met_up_to_their_limits() {
        assert!(missed(&report(0, 6.0, -0.5, 9)).is_empty());
        assert!(missed(&report(1, 11.5, 0.5, 9)).is_empty());
    }

    #[test]
    fn each_missed_aim_is_named() {
        assert_eq!(missed(&report(0, 6.1, 0.0, 0)), [figure::SETTLING]);
        assert_eq!(missed(&report(1, 11.6, 0.0, 0)), [figure::SETTLING]);
        assert_eq!(missed(&report(0, 5.0, -0.6, 0)), [figure::MEAN]);
        // The plain law changes sign 5 times a second.
        assert_eq!(missed(&report(0, 5.0, 0.0, 10)), [figure::SIGNS]);
        let mut bad = run(None, [-2.0, 2.0], 0);
        bad.swings = 2;
        bad.complete = false;
        let report = CaseReport::new(&ALL[0].cases[0], "a test", 10.0, &[bad.clone()], &[bad]);
        assert_eq!(
            missed(&report),
            [
                figure::SETTLING,
                figure::DEVIATION,
                figure::SWINGS,
                figure::SIGNS,
                figure::UNFINISHED
            ]
        );
    }

    #[test]
    fn a_fitted_machine_shall_have_the_figures_of_the_thesis() {
        let [.., fitted] = ALL else { panic!("none") };
        let case = &fitted.cases[0];
        let furrow = [run(Some(5.0), [-1.0, 1.0], 0)];
        let judged = |mean: f64, arrival: f64| {
            let mut plain = run(Some(12.0), [mean - 1.0, mean + 1.0], 100);
            plain.arrival = Some(arrival);
            CaseReport::new(case, "a test", 10.0, &furrow, &[plain])
        };
        assert!(missed(&judged(-2.0, 16.9)).is_empty());
        assert_eq!(missed(&judged(-1.6, 13.0)), [figure::OWN_MEAN]);
        assert_eq!(missed(&judged(-3.7, 12.9)), [figure::ARRIVAL]);
        let report = Report {
            experiment: "thesis-machine",
            first_seed: 1,
            seeds: 1,
            cases: vec![judged(-1.6, 13.0)],
        };
        let text = report.text();
        assert!(
            text.contains("-1.60      0.00   plain law: -3.70 to -1.70: MISSED"),
            "{text}"
        );
        assert!(text.contains("plain law: 13.0 to 17.0: met"), "{text}");
    }

    #[test]
    fn the_text_shows_thesis_plain_law_and_furrow_side_by_side() {
        let report = Report {
            experiment: "thesis-7",
            first_seed: 3,
            seeds: 2,
            cases: vec![report(0, 6.25, 0.2, 9)],
        };
        let text = report.text();
        assert!(text.contains("seeds 3 to 4"), "{text}");
        let row = |name: &str| -> Vec<String> {
            let line = text.lines().find(|line| line.trim().starts_with(name));
            let words = line.unwrap().split_whitespace();
            words.map(String::from).collect()
        };
        assert_eq!(
            row("settling, worst").join(" "),
            "settling, worst (s) - - 6.2 at most 6.0: MISSED"
        );
        assert_eq!(
            row("mean error").join(" "),
            "mean error (cm) -2.70 6.00 0.20"
        );
        assert_eq!(
            row("sign changes").join(" "),
            "sign changes (1/s) - 5.000 0.450 at most 0.500: met"
        );
        assert_eq!(
            report.missed(),
            [format!("{} (one-metre-off)", figure::SETTLING)]
        );
        assert!(report.json().contains("\"seeds\": 2"));
    }
}
