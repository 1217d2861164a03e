//! The view as cells of the terminal.

use ratatui::{
    Frame,
    layout::{Constraint, Layout, Rect},
    style::{Color, Style, Stylize},
    symbols::Marker,
    text::{Line, Span, Text},
    widgets::{
        Axis, Block, Chart, Clear, Dataset, GraphType, Padding, Paragraph, Wrap,
        canvas::{Canvas, Line as Stroke, Points},
    },
};
use twin::Twin;
use world::report::{LastCycle, Window, WindowContent, WindowKind};
use world::time::seconds;

use super::super::recording::NodeRecording;
use super::scene::{Course, Point, Scene};
use crate::monitor::{Class, Picture};

/// The smallest terminal that has room for everything.
const LEAST: (u16, u16) = (80, 24);

/// Time that the charts show, s.
const CHARTED: f64 = 60.0;

/// Least span of the charts and of the track, m and m/s.
const LEAST_ERROR: f64 = 0.05;
const LEAST_SPEED: f64 = 0.5;
const LEAST_ALONG: f64 = 5.0;

const GOOD: Style = Style::new().fg(Color::Green);
const BAD: Style = Style::new().fg(Color::Red);
const NOTE: Style = Style::new().fg(Color::Yellow);
const MUTED: Style = Style::new().fg(Color::DarkGray);

/// Draws everything.
pub(super) fn draw(frame: &mut Frame<'_>, scene: &Scene, twin: &Twin, nodes: &[NodeRecording]) {
    let area = frame.area();
    if area.width < LEAST.0 || area.height < LEAST.1 {
        let text = format!(
            "The terminal has {} columns and {} lines; the view of the run needs {} and {}. The run goes on; q ends it.",
            area.width, area.height, LEAST.0, LEAST.1
        );
        frame.render_widget(Paragraph::new(text).wrap(Wrap { trim: true }), area);
        return;
    }
    let [head, body, foot] = Layout::vertical([
        Constraint::Length(1),
        Constraint::Fill(1),
        Constraint::Length(1),
    ])
    .areas(area);
    frame.render_widget(headline(scene, twin), head);
    frame.render_widget(
        Line::styled(" q end   space pause   + - speed   ? help", MUTED),
        foot,
    );
    let course = scene.course(twin);
    let picture = scene.picture(twin);
    match &course {
        Some(course) => {
            let [left, right] =
                Layout::horizontal([Constraint::Fill(1), Constraint::Fill(1)]).areas(body);
            way(frame, left, course);
            state(frame, right, scene, twin, nodes, &picture);
        }
        None => state(frame, body, scene, twin, nodes, &picture),
    }
    if scene.help {
        help(frame, area);
    }
}

/// What runs, how far it is and how fast.
fn headline(scene: &Scene, twin: &Twin) -> Line<'static> {
    let subject = &scene.subject;
    let wanted = match scene.wanted {
        None => "as fast as it can".to_owned(),
        Some(1.0) => "real time".to_owned(),
        Some(speed) => format!("{speed} times real time"),
    };
    let measured = scene
        .speed
        .map_or_else(String::new, |speed| format!(", measured {speed:.2}"));
    let pace = if scene.paused {
        Span::styled(format!("paused; then {wanted}"), NOTE)
    } else {
        Span::from(format!("{wanted}{measured}"))
    };
    Line::from(vec![
        Span::from(format!(" {} {} ", subject.vehicle, subject.scenario.name)).bold(),
        Span::from(format!(
            "seed {}   {:.1} of {:.0} s   ",
            subject.seed,
            seconds(twin.now()),
            seconds(subject.end)
        )),
        pace,
    ])
}

/// The track, and below it the charts.
fn way(frame: &mut Frame<'_>, area: Rect, course: &Course) {
    let [above, error, speed] = Layout::vertical([
        Constraint::Fill(2),
        Constraint::Fill(1),
        Constraint::Fill(1),
    ])
    .areas(area);
    track(frame, above, course);
    let last = course.points.last();
    let title = format!(
        "{}: {:+.1} cm",
        course.error,
        last.map_or(0.0, |point| 100.0 * point.right)
    );
    let errors = |point: &Point| point.right;
    chart(frame, error, &title, course, errors, (LEAST_ERROR, true));
    let title = format!("speed: {:.2} m/s", last.map_or(0.0, |point| point.speed));
    let speeds = |point: &Point| point.speed;
    chart(frame, speed, &title, course, speeds, (LEAST_SPEED, false));
}

/// The smallest range with all values.
fn range(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(from, to), value| {
        (from.min(value), to.max(value))
    })
}

/// The way from above: the line leads to the right, and its right side is below it.
fn track(frame: &mut Frame<'_>, area: Rect, course: &Course) {
    let points = &course.points;
    let (from, to) = range(points.iter().map(|point| point.along));
    let to = to.max(from + LEAST_ALONG);
    let margin = 0.03 * (to - from);
    let (left, right) = range(points.iter().map(|point| point.right).chain([0.0]));
    let across = (right - left).max(0.2);
    let (left, right) = (left - 0.15 * across, right + 0.15 * across);
    let mut title = format!("track along the {}", course.what);
    if let Some(distances) = course.distances {
        let side = |distance: Option<f64>| {
            distance.map_or("nothing".to_owned(), |metres| format!("{metres:.2} m"))
        };
        title = format!(
            "{title}; beams {} | {}",
            side(distances[0]),
            side(distances[1])
        );
    }
    let size = format!("{:.1} m long, {:.2} m wide", to - from, right - left);
    let block = Block::bordered()
        .title(title)
        .title_bottom(Line::from(size).right_aligned());
    let way: Vec<(f64, f64)> = points
        .iter()
        .map(|point| (point.along, -point.right))
        .collect();
    let (begin, end) = course.line.unwrap_or((from - margin, to + margin));
    let canvas = Canvas::default()
        .block(block)
        .marker(Marker::Braille)
        .x_bounds([from - margin, to + margin])
        .y_bounds([-right, -left])
        .paint(|context| {
            context.draw(&Stroke::new(
                begin.max(from - margin),
                0.0,
                end.min(to + margin),
                0.0,
                Color::DarkGray,
            ));
            context.layer();
            context.draw(&Points {
                coords: &way,
                color: Color::Blue,
            });
            if let Some(last) = points.last() {
                let place = (last.along, -last.right);
                let sign = Line::styled(arrow(last.heading), Style::new().yellow().bold());
                context.print(place.0, place.1, sign);
            }
        });
    frame.render_widget(canvas, area);
}

/// The sign of a vehicle with that direction against the line, rad.
fn arrow(heading: f64) -> &'static str {
    let eighths = (heading / std::f64::consts::FRAC_PI_4).round() as i64;
    match eighths.rem_euclid(8) {
        0 => "▶",
        1 => "◢",
        2 => "▼",
        3 => "◣",
        4 => "◀",
        5 => "◤",
        6 => "▲",
        _ => "◥",
    }
}

/// A value over the last time; `least` is the smallest upper end of its axis, and whether the lower end is its
/// opposite.
fn chart(
    frame: &mut Frame<'_>,
    area: Rect,
    title: &str,
    course: &Course,
    value: impl Fn(&Point) -> f64,
    (least, both): (f64, bool),
) {
    let now = course.points.last().map_or(0.0, |point| point.at);
    let from = (now - CHARTED).max(0.0);
    let points = course.points.iter().filter(|point| point.at >= from);
    let values: Vec<(f64, f64)> = points.map(|point| (point.at, value(point))).collect();
    let (lowest, highest) = range(values.iter().map(|one| one.1));
    let top = highest.max(if both { -lowest } else { highest }).max(least);
    let bottom = if both { -top } else { lowest.min(0.0) };
    let label = |value: f64| format!("{value:.2}");
    let data = Dataset::default()
        .marker(Marker::Braille)
        .graph_type(GraphType::Line)
        .style(Color::Blue)
        .data(&values);
    let block = Block::bordered()
        .title(title.to_owned())
        .title_bottom(Line::from(format!("the last {:.0} s", now - from)).right_aligned());
    let chart = Chart::new(vec![data])
        .block(block)
        .x_axis(Axis::default().bounds([from, now.max(from + 1.0)]))
        .y_axis(
            Axis::default()
                .bounds([bottom, top])
                .labels([label(bottom), label(top)]),
        );
    frame.render_widget(chart, area);
}

/// Display, nodes, bus and events.
fn state(
    frame: &mut Frame<'_>,
    area: Rect,
    scene: &Scene,
    twin: &Twin,
    recordings: &[NodeRecording],
    picture: &Picture,
) {
    let screen = twin.world().screens().last();
    let screen: Vec<&str> = screen.map_or(Vec::new(), |screen| screen.text.lines().collect());
    let rows = u16::try_from(screen.len()).unwrap_or(0);
    let shown = if rows == 0 { 0 } else { rows + 1 };
    let nodes = u16::try_from(picture.nodes.len()).unwrap_or(0) + 2;
    let bus = u16::try_from(scene.windows().len()).unwrap_or(0) + 2;
    let [display, list, bus, events] = Layout::vertical([
        Constraint::Length(shown),
        Constraint::Length(nodes),
        Constraint::Max(bus),
        Constraint::Min(4),
    ])
    .areas(area);
    if rows > 0 {
        let (lamps, text) = screen.split_last().unwrap_or((&"", &[]));
        let mode = picture.mode.as_deref().unwrap_or("no mode yet");
        let block = Block::bordered()
            .title(format!("display: {mode}"))
            .title_bottom(Line::from(format!("lamps {lamps}")).right_aligned());
        let text = Text::from(text.join("\n"));
        frame.render_widget(Paragraph::new(text).block(block), display);
    }
    frame.render_widget(node_list(twin, picture), list);
    let (cycle, errors) = scene.cycle(twin);
    bus_view(
        frame,
        bus,
        scene.windows(),
        cycle.as_ref(),
        (errors, picture),
    );
    let all = scene.events(twin, recordings);
    let room = usize::from(events.height.saturating_sub(2));
    let last = all.iter().skip(all.len().saturating_sub(room));
    let lines = last.map(|event| {
        let style = if event.bad { NOTE } else { Style::new() };
        Line::styled(format!("{:7.2} {}", event.at, event.text), style)
    });
    let lines = Paragraph::new(lines.collect::<Vec<_>>());
    frame.render_widget(lines.block(Block::bordered().title("events")), events);
}

/// The nodes with their classes and counters.
fn node_list(twin: &Twin, picture: &Picture) -> Paragraph<'static> {
    let lines = picture.nodes.iter().zip(twin.nodes()).map(|(state, node)| {
        let style = match state.class {
            Class::Present => GOOD,
            Class::Unheard | Class::Quiet => MUTED,
            Class::Dead | Class::Lost | Class::Babbling => BAD,
        };
        let mut changes = twin.world().efforts().iter().rev();
        let effort = changes.find(|change| change.node == node);
        let effort = effort.map_or(String::new(), |change| format!("{:+.2}", change.effort));
        let resets = twin.node(node).resets().len().saturating_sub(1);
        let resets = match resets {
            0 => String::new(),
            1 => "1 reset".to_owned(),
            many => format!("{many} resets"),
        };
        let word = if twin.node(node).is_held() {
            "in reset"
        } else {
            state.class.word()
        };
        Line::from(vec![
            Span::from(format!("{:<11}", state.node)),
            Span::styled(format!("{word:<10}"), style),
            Span::from(format!("{:>6} {effort:>5} {resets}", state.frames)),
        ])
    });
    let block = Block::bordered().title("nodes: class, frames, motor");
    Paragraph::new(lines.collect::<Vec<_>>()).block(block)
}

/// The windows of the last basic cycle, each in a line where there is room, else side by side.
fn bus_view(
    frame: &mut Frame<'_>,
    area: Rect,
    windows: &[Window],
    cycle: Option<&LastCycle>,
    (errors, picture): (usize, &Picture),
) {
    let load = format!("load {:.0} %", picture.load_percent);
    let mut bottom = vec![Span::from(load)];
    if errors > 0 {
        let frames = if errors == 1 { "frame" } else { "frames" };
        bottom.push(Span::styled(format!(", {errors} error {frames}"), BAD));
    }
    if !picture.foreign.is_empty() {
        let frames: u64 = picture.foreign.values().sum();
        bottom.push(Span::styled(format!(", {frames} foreign"), NOTE));
    }
    let block = Block::bordered().title_bottom(Line::from(bottom).right_aligned());
    let has_schedule = windows
        .iter()
        .any(|window| window.kind == WindowKind::Reference);
    let (block, cells) = match cycle {
        Some(cycle) => {
            let title = format!("basic cycle {}: windows", cycle.count);
            (block.title(title), cycle_cells(windows, cycle))
        }
        None if has_schedule => (block.title("no reference on the bus"), Vec::new()),
        None => (
            block.title("messages in the last second"),
            message_cells(picture),
        ),
    };
    let inner = block.inner(area);
    frame.render_widget(block, area);
    if usize::from(inner.height) >= cells.len() {
        let lines = cells.into_iter().map(|cell| cell.line());
        frame.render_widget(Paragraph::new(lines.collect::<Vec<_>>()), inner);
        return;
    }
    let columns = usize::from((inner.width / Cell::SHORT).max(1));
    // Where room is short, windows in which nothing was due are left out.
    let cells: Vec<Cell> = cells.into_iter().filter(|cell| cell.sign != "-").collect();
    let lines: Vec<Line> = cells
        .chunks(columns)
        .map(|row| Line::from(row.iter().map(Cell::short).collect::<Vec<_>>()))
        .collect();
    frame.render_widget(Paragraph::new(lines), inner);
}

/// A message and what came of it.
struct Cell {
    id: u16,
    message: String,
    sender: String,
    what: String,
    /// The same in at most five letters.
    sign: &'static str,
    style: Style,
}

impl Cell {
    /// Columns of the short form.
    const SHORT: u16 = 9;

    fn line(&self) -> Line<'static> {
        Line::from(vec![
            Span::from(format!(
                "{:>4} {:<16.16} {:<11.11}",
                self.id, self.message, self.sender
            )),
            Span::styled(self.what.clone(), self.style),
        ])
    }

    fn short(&self) -> Span<'static> {
        Span::styled(format!("{:>4} {:<4}", self.id, self.sign), self.style)
    }
}

fn cycle_cells(windows: &[Window], cycle: &LastCycle) -> Vec<Cell> {
    let cells = cycle.windows.iter().filter_map(|&(place, content)| {
        let window = windows.get(place)?;
        let (what, sign, style) = match content {
            WindowContent::Frame(_) if window.kind == WindowKind::Reference => {
                ("leads".to_owned(), "ok", GOOD)
            }
            WindowContent::Frame(behind) => (format!("{behind:+.1} us"), "ok", GOOD),
            WindowContent::Destroyed => ("destroyed".to_owned(), "err", BAD),
            WindowContent::Missed => ("missed".to_owned(), "miss", BAD),
            WindowContent::Empty => ("-".to_owned(), "-", MUTED),
        };
        Some(Cell {
            id: window.id,
            message: window.message.clone(),
            sender: window.sender.clone(),
            what,
            sign,
            style,
        })
    });
    cells.collect()
}

/// Without a schedule: how often each message comes.
fn message_cells(picture: &Picture) -> Vec<Cell> {
    let cells = picture.messages.iter().map(|message| Cell {
        id: message.id,
        message: message.message.clone(),
        sender: message.sender.clone(),
        what: format!("{:.0} a second", message.per_second),
        sign: if message.per_second > 0.0 { "ok" } else { "-" },
        style: if message.per_second > 0.0 {
            GOOD
        } else {
            MUTED
        },
    });
    cells.collect()
}

/// What the view shows and which keys there are.
fn help(frame: &mut Frame<'_>, area: Rect) {
    let text = "\
q, Esc           end the run here, with its report
Ctrl-C           interrupt it, without one
space            pause, go on
+  -             faster, slower
?                this help; Esc closes it

track   the way from above: the line leads to the
        right, what is right of it is below
nodes   frames so far; effort of the motor, -1 to 1
bus     the windows of the last basic cycle: start
        behind the window's begin; ok, miss(ed), err
        (destroyed), - (nothing was due)

The run itself is the same with and without this view.";
    let size = (60, 16);
    let [line] = Layout::vertical([Constraint::Length(size.1)])
        .flex(ratatui::layout::Flex::Center)
        .areas(area);
    let [middle] = Layout::horizontal([Constraint::Length(size.0)])
        .flex(ratatui::layout::Flex::Center)
        .areas(line);
    frame.render_widget(Clear, middle);
    let block = Block::bordered()
        .title("help")
        .padding(Padding::horizontal(1));
    frame.render_widget(Paragraph::new(text).block(block), middle);
}
