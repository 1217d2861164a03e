//! Response times of jobs of a time table: known answers.

use schedulability::arrivals::{Arrivals, Job, JobId, Kind, Sporadic, Timetable};
use schedulability::response::{Task, Unbounded, analyse, response};
use schedulability::sensitivity::slack;

const CYCLE: u64 = 200;

fn job(label: &str, earliest: u64, latest: u64, deadline: Option<u64>) -> Job {
    Job {
        id: None,
        cause: None,
        label: label.to_owned(),
        earliest,
        latest,
        transmits: deadline.is_some(),
        deadline,
    }
}

fn table(jobs: Vec<Job>) -> Arrivals {
    Arrivals {
        timed: vec![Timetable {
            cycle: CYCLE,
            spacing: 0,
            burst: 0,
            kind: Kind::Any,
            cost: None,
            jobs,
        }],
        ..Arrivals::default()
    }
}

fn task(name: &str, priority: u32, cost: u64, arrivals: Arrivals) -> Task {
    Task {
        name: name.to_owned(),
        priority,
        cost,
        arrivals,
        deadline: 100,
        jitter: 0,
        after: Vec::new(),
        coalesces: false,
        off_bus: false,
        blocking: 0,
        preemption: 0.into(),
    }
}

/// A receive task whose frames end between the window edges, and the window timer.
fn bus() -> Vec<Task> {
    vec![
        task(
            "receive",
            2,
            20,
            table(vec![job("a", 30, 60, None), job("b", 130, 160, None)]),
        ),
        task(
            "timer",
            2,
            10,
            table(vec![
                job("own", 100, 100, Some(12)),
                job("end", 190, 190, None),
            ]),
        ),
    ]
}

#[test]
fn a_job_that_has_completed_or_is_not_yet_released_does_not_delay() {
    let set = bus();
    // Without the table any release may coincide with any other.
    assert_eq!(response(&set, 1).unwrap().worst, 30);
    let results = analyse(&set);
    let timer = results[1].as_ref().unwrap();
    assert_eq!(timer.worst, 10);
    assert_eq!(timer.critical.job.as_deref(), Some("own"));
    assert_eq!((timer.critical.response, timer.critical.deadline), (10, 12));
    assert_eq!(results[0].as_ref().unwrap().worst, 20);
    // The edge "own" has two ticks of slack, and no other job has less.
    assert_eq!(slack(&set, 1, 1), Some(2));
}

#[test]
fn a_frame_that_may_end_too_late_delays_the_edge() {
    let mut set = bus();
    set[0].arrivals = table(vec![job("a", 30, 81, None)]);
    let timer = &analyse(&set)[1];
    let critical = &timer.as_ref().unwrap().critical;
    // The job of the frame that ends at 81 takes until 101, so it delays the edge by one tick.
    assert_eq!((critical.response, critical.meets()), (11, true));
    let delays = critical.delayed_by.iter();
    let delays: Vec<_> = delays.map(|delay| (delay.task, delay.jobs)).collect();
    assert_eq!(delays, [(0, 1)]);
}

#[test]
fn one_pending_bit_is_one_more_run() {
    let edges = [90, 92, 94, 100].map(|at| job("edge", at, at, None));
    let mut set = vec![task("timer", 2, 10, table(edges.to_vec()))];
    let worst = |set: &[Task]| analyse(set)[0].as_ref().unwrap().worst;
    // The last of four jobs that run one after another.
    assert_eq!(worst(&set), 30);
    set[0].coalesces = true;
    assert_eq!(worst(&set), 20);
}

#[test]
fn a_task_that_runs_off_the_bus_does_not_delay_a_transmission() {
    let mut set = bus();
    set.push(task("error", 2, 7, Arrivals::every(1000)));
    let of = |set: &[Task]| analyse(set)[1].as_ref().unwrap().critical.response;
    assert_eq!(of(&set), 17);
    set[2].off_bus = true;
    assert_eq!(of(&set), 10);
    // The edge that sends nothing waits for it nevertheless. The job of the second frame has
    // completed by then, even if the error delays it.
    assert_eq!(analyse(&set)[1].as_ref().unwrap().worst, 17);
}

#[test]
fn the_cause_of_a_release_is_its_jitter() {
    let mut set = bus();
    set.push(task("step", 1, 5, table(vec![job("mark", 100, 100, None)])));
    set[2].after = vec![1];
    let results = analyse(&set);
    let step = results[2].as_ref().unwrap();
    // Ten of the timer, and its own five.
    assert_eq!((step.critical.jitter, step.worst), (10, 15));
    set[1].arrivals = Arrivals::every(10);
    set[1].cost = 11;
    assert_eq!(analyse(&set)[2], Err(Unbounded::Cause));
}

/// Worst response times of all tasks.
fn worst(set: &[Task]) -> Vec<u64> {
    let all = analyse(set).into_iter();
    all.map(|one| one.unwrap().worst).collect()
}

#[test]
fn a_job_is_no_cause_of_what_another_one_at_the_same_instant_brings_about() {
    let mut edge = job("edge", 100, 100, None);
    edge.id = Some(JobId(7));
    let mut attempt = job("attempt", 101, 105, None);
    attempt.cause = edge.id;
    let mut set = vec![
        task("edges", 1, 5, table(vec![edge])),
        task("attempts", 1, 10, table(vec![attempt])),
        task("marks", 1, 15, table(vec![job("mark", 100, 100, None)])),
    ];
    // The edge first, then the attempt that it causes, then the mark.
    assert_eq!(worst(&set)[2], 30);
    // The edge waits for the mark, and not for its own attempt.
    assert_eq!(worst(&set)[0], 20);
    // At a higher priority, the attempt preempts its cause once this has started.
    set[1].priority = 2;
    assert_eq!(worst(&set)[0], 30);
}

#[test]
fn of_the_releases_that_the_spacing_allows_one_is_the_job_itself_only_once_it_is_released() {
    let mut releases = table(vec![job("first", 0, 0, None), job("second", 0, 10, None)]);
    releases.timed[0].spacing = 10;
    // The second one is released at 10, while the first one runs until 30.
    assert_eq!(worst(&[task("t", 1, 30, releases)]), [50]);
    // The same without a table of its own: three at 0, 10 and 20, the first one behind the other
    // task.
    let burst = Sporadic {
        limit: Some((3, CYCLE)),
        ..Sporadic::every(10)
    };
    let burst = Arrivals {
        sporadic: vec![burst],
        ..Arrivals::default()
    };
    let other = task("other", 1, 1, table(vec![job("edge", 0, 0, None)]));
    assert_eq!(worst(&[task("burst", 1, 30, burst), other])[0], 71);
}

#[test]
fn of_releases_that_keep_a_distance_the_longest_ones_count() {
    let mut both = table(vec![job("short", 0, 199, None)]);
    both.timed[0].cost = Some(1);
    both.sporadic = vec![Sporadic::every(1000)];
    both.apart = 50;
    let own = task("own", 1, 4, table(vec![job("edge", 0, 0, None)]));
    // There is room for one of the others, and that one may be a whole one.
    assert_eq!(worst(&[own, task("both", 1, 8, both)])[0], 12);
}

#[test]
fn a_late_end_of_one_window_delays_the_edge_of_the_next() {
    let edge = |at: u64, number| Job {
        id: Some(JobId(number)),
        ..job("edge", at, at, None)
    };
    let attempt = |from, to, number| Job {
        cause: Some(JobId(number)),
        ..job("attempt", from, to, None)
    };
    let edges = table(vec![edge(0, 1), edge(100, 2)]);
    let attempts = table(vec![attempt(10, 105, 1), attempt(110, 170, 2)]);
    let set = vec![
        task("edges", 1, 10, edges),
        task("attempts", 1, 20, attempts),
    ];
    let edges = analyse(&set)[0].clone().unwrap();
    let responses: Vec<u64> = edges.by_job.iter().map(|job| job.response).collect();
    // At 0 everything has ended; at 100 the attempt in the first window may end at the same time.
    assert_eq!(responses, [10, 30]);
}

#[test]
fn a_cause_at_the_end_of_the_cycle_reaches_into_the_next() {
    let mut late = table(vec![job("late", 190, 210, None)]).timed;
    late[0].cost = Some(50);
    let cause = Arrivals {
        timed: [late, table(vec![job("other", 100, 100, None)]).timed].concat(),
        ..Arrivals::default()
    };
    let mut set = vec![
        task("cause", 2, 60, cause),
        task("caused", 1, 5, table(vec![job("caused", 0, 90, None)])),
    ];
    set[0].arrivals.timed[1].cost = Some(10);
    set[1].after = vec![0];
    let caused = analyse(&set)[1].clone().unwrap();
    assert_eq!(caused.critical.jitter, 50);
}

#[test]
fn tables_of_different_cycles_meet_in_any_way() {
    let mut often = table(vec![job("often", 110, 110, None)]);
    often.timed[0].cycle = CYCLE / 2;
    let set = vec![
        task("seldom", 2, 20, table(vec![job("seldom", 10, 10, None)])),
        task("often", 1, 5, often),
    ];
    // It is released at 10, too.
    assert_eq!(worst(&set)[1], 25);
}

#[test]
fn of_several_causes_the_latest_counts() {
    let mut set = vec![
        task("quick", 3, 5, Arrivals::every(200)),
        task("slow", 3, 20, Arrivals::every(200)),
        task("caused", 1, 5, Arrivals::every(200)),
    ];
    set[2].after = vec![0, 1];
    assert_eq!(analyse(&set)[2].clone().unwrap().critical.jitter, 25);
}

#[test]
fn tasks_of_one_priority_may_release_each_other_in_any_order_of_the_list() {
    let caused = |at: usize| Task {
        after: vec![at],
        ..task("caused", 1, 5, Arrivals::every(100))
    };
    let cause = task("cause", 1, 10, Arrivals::every(100));
    assert_eq!(worst(&[cause.clone(), caused(0)]), [15, 30]);
    assert_eq!(worst(&[caused(1), cause]), [30, 15]);
    // What is late by its own lateness has no bound.
    let same = caused(0);
    assert_eq!(analyse(&[same]), [Err(Unbounded::Diverges)]);
}
