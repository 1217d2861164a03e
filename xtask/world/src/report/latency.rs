//! A picture of latencies under a growing load, with their bounds.

use super::plot::{Anchor, Canvas, Panel, Span, colour};

/// Latencies of one way to do something, over the load.
#[derive(Clone, Debug, PartialEq)]
pub struct LatencySeries {
    /// Its name in the legend.
    pub name: String,
    /// In the order of the loads.
    pub bars: Vec<LatencyBar>,
}

/// Latencies under one load, microseconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LatencyBar {
    /// The load, percent.
    pub load: f64,
    /// The smallest one, their mean and the largest; `None` if there is none.
    pub seen: Option<[f64; 3]>,
    /// Their bound; `None` without one.
    pub bound: Option<f64>,
}

/// Colours of the series, in order.
const COLOURS: [&str; 3] = [colour::ORANGE, colour::BLUE, colour::GREEN];

const SIZE: (f64, f64) = (900.0, 520.0);

/// A bar from the smallest to the largest latency for each load and series, a dot at the mean, a dash at
/// the bound. Latencies and bounds above `most` microseconds are cut off there and marked by a number.
#[must_use]
pub fn latency_svg(title: &str, series: &[LatencySeries], most: f64) -> String {
    let mut canvas = Canvas::new(SIZE.0, SIZE.1);
    canvas.title(40.0, 34.0, title);
    let loads = series.iter().flat_map(|one| &one.bars).map(|bar| bar.load);
    let loads = Span::of(loads).unwrap_or(Span { from: 0.0, to: 1.0 });
    let panel = Panel {
        left: 80.0,
        top: 90.0,
        width: SIZE.0 - 120.0,
        height: SIZE.1 - 150.0,
        x: loads.padded(0.0, 10.0),
        y: Span {
            from: 0.0,
            to: most,
        },
        down: false,
    };
    panel.axes(&mut canvas, "foreign load, % of the bus", "latency, us");
    let middle = (series.len() as f64 - 1.0) / 2.0;
    let legend = (SIZE.0 - 120.0) / series.len().max(1) as f64;
    for (place, one) in series.iter().enumerate() {
        let colour = COLOURS[place % COLOURS.len()];
        let x = panel.left + legend * place as f64;
        canvas.rectangle(x, 56.0, 12.0, 12.0, colour, 0.5);
        canvas.text(x + 18.0, 66.0, 12.0, Anchor::Start, colour::INK, &one.name);
        for bar in &one.bars {
            let x = panel.x(bar.load) + 26.0 * (place as f64 - middle);
            draw(&mut canvas, &panel, bar, x, colour);
        }
    }
    panel.frame(&mut canvas);
    let key = "bar: smallest to largest, dot: mean, dash: bound";
    canvas.text(SIZE.0 - 40.0, 34.0, 12.0, Anchor::End, colour::MUTED, key);
    canvas.finish(
        title,
        "Latencies as bars over the foreign load, with their bounds.",
    )
}

fn draw(canvas: &mut Canvas, panel: &Panel, bar: &LatencyBar, x: f64, colour: &str) {
    let most = panel.y.to;
    let cut = |canvas: &mut Canvas, value: f64| {
        let text = format!("{value:.0}");
        let top = panel.top + 12.0;
        canvas.text(x, top, 10.0, Anchor::Middle, colour, &text);
    };
    if let Some([least, mean, largest]) = bar.seen {
        let (top, bottom) = (panel.y(largest.min(most)), panel.y(least.min(most)));
        canvas.rectangle(x - 8.0, top, 16.0, (bottom - top).max(1.0), colour, 0.5);
        canvas.disc(x, panel.y(mean.min(most)), 3.0, colour);
        if largest > most {
            cut(canvas, largest);
        }
    }
    match bar.bound {
        Some(bound) if bound <= most => {
            let y = panel.y(bound);
            canvas.line((x - 11.0, y), (x + 11.0, y), colour, 3.0, "");
        }
        Some(bound) => cut(canvas, bound),
        None => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bars_dots_and_bounds_are_drawn() {
        let bar = |load, seen, bound| LatencyBar { load, seen, bound };
        let series = [
            LatencySeries {
                name: "event-triggered".into(),
                bars: vec![
                    bar(0.0, Some([700.0, 710.0, 720.0]), Some(2361.0)),
                    bar(80.0, Some([700.0, 1500.0, 6100.0]), None),
                ],
            },
            LatencySeries {
                name: "time-triggered <5 ms>".into(),
                bars: vec![bar(0.0, None, Some(1933.0))],
            },
        ];
        let svg = latency_svg("Sample to pulse", &series, 5000.0);
        assert_eq!(svg.matches("<circle").count(), 2);
        // The largest latency does not fit, so its number stands there.
        assert!(svg.contains(">6100</text>"), "{svg}");
        assert_eq!(svg.matches(r#"stroke-width="3""#).count(), 2);
        assert!(svg.contains("time-triggered &lt;5 ms&gt;"));
    }
}
