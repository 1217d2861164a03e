//! Response times of jobs of a time table, against a simulation.

mod simulation;

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use schedulability::arrivals::{Arrivals, Job, Kind, Sporadic, Timetable};
use schedulability::response::{CriticalSection, Task, Unbounded, analyse, blocking, response};
use schedulability::sensitivity::slack;

const CYCLE: u64 = 200;

fn job(label: &str, earliest: u64, latest: u64, deadline: Option<u64>) -> Job {
    Job {
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
            begun_at: Vec::new(),
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
        after: None,
        coalesces: false,
        off_bus: false,
        blocking: 0,
        preemption: 0,
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
    assert_eq!(critical.delayed_by, [(0, 1)]);
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
    set[2].after = Some(1);
    let results = analyse(&set);
    let step = results[2].as_ref().unwrap();
    // Ten of the timer, and its own five.
    assert_eq!((step.critical.jitter, step.worst), (10, 15));
    set[1].arrivals = Arrivals::every(10);
    set[1].cost = 11;
    assert_eq!(analyse(&set)[2], Err(Unbounded::Cause));
}

fn below(random: &mut ChaCha8Rng, bound: u64) -> u64 {
    random.next_u64() % bound
}

fn random_set(random: &mut ChaCha8Rng) -> Vec<Task> {
    let count = 2 + below(random, 4) as usize;
    let mut set: Vec<Task> = (0..count)
        .map(|index| {
            let priority = 1 + below(random, count as u64) as u32;
            let cost = 1 + below(random, 12);
            let timed = |random: &mut ChaCha8Rng| {
                let jobs = 1 + below(random, 3);
                let lighter = (below(random, 2) == 0).then(|| 1 + below(random, cost));
                let jobs = (0..jobs).map(|_| {
                    let earliest = below(random, CYCLE);
                    job("", earliest, earliest + below(random, 40), None)
                });
                Timetable {
                    cycle: CYCLE,
                    spacing: 0,
                    burst: 0,
                    kind: Kind::Any,
                    cost: lighter,
                    begun_at: Vec::new(),
                    jobs: jobs.collect(),
                }
            };
            let every = 60 + below(random, 100);
            let arrivals = match below(random, 4) {
                0 => Arrivals::every(every),
                1 => Arrivals {
                    sporadic: vec![Sporadic {
                        period: 15 + every / 8,
                        jitter: 0,
                        limit: Some((3, CYCLE)),
                    }],
                    ..Arrivals::default()
                },
                2 => Arrivals {
                    sporadic: vec![Sporadic::every(every)],
                    timed: vec![timed(random)],
                    ..Arrivals::default()
                },
                _ => Arrivals {
                    timed: vec![timed(random), timed(random)],
                    ..Arrivals::default()
                },
            };
            let jitter = if below(random, 3) == 0 {
                below(random, 10)
            } else {
                0
            };
            Task {
                jitter,
                ..task(&index.to_string(), priority, cost, arrivals)
            }
        })
        .collect();
    let sections = sections(&set);
    for task in &mut set {
        task.blocking = blocking(&sections, task.priority);
    }
    set
}

/// Every task holds a lock with the ceiling of the next priority for half its time.
fn sections(set: &[Task]) -> Vec<CriticalSection> {
    set.iter()
        .filter(|task| task.cost > 2)
        .map(|task| CriticalSection {
            holder: task.priority,
            ceiling: task.priority + 1,
            length: task.cost / 2,
        })
        .collect()
}

fn releases(task: usize, of: &Task, random: &mut ChaCha8Rng, horizon: u64) -> Vec<simulation::Job> {
    let mut instants = Vec::new();
    for stream in &of.arrivals.sporadic {
        let mut at = below(random, 5);
        let mut recent: Vec<u64> = Vec::new();
        while at < horizon {
            instants.push((at, of.cost));
            recent.push(at);
            at += stream.period + below(random, 4) / 3;
            if let Some((jobs, span)) = stream.limit
                && let Some(first) = recent.len().checked_sub(jobs as usize)
            {
                at = at.max(recent[first] + span);
            }
        }
    }
    for table in &of.arrivals.timed {
        for cycle in 0..horizon / table.cycle {
            for job in &table.jobs {
                let late = match below(random, 3) {
                    0 => 0,
                    1 => job.latest - job.earliest,
                    _ => below(random, job.latest - job.earliest + 1),
                };
                let at = cycle * table.cycle + job.earliest + late;
                instants.push((at, table.cost.unwrap_or(of.cost)));
            }
        }
    }
    instants
        .into_iter()
        .map(|(arrival, cost)| simulation::Job {
            task,
            arrival,
            release: arrival + [0, of.jitter][below(random, 2) as usize],
            cost,
            priority: of.priority,
        })
        .collect()
}

#[test]
fn simulation_never_exceeds_the_bound() {
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let (mut reached, mut compared, mut sharpened) = (0, 0, 0);
    for _ in 0..1000 {
        let set = random_set(&mut random);
        let bounds = analyse(&set);
        let horizon = 6 * CYCLE;
        let jobs: Vec<simulation::Job> = set
            .iter()
            .enumerate()
            .flat_map(|(index, of)| releases(index, of, &mut random, horizon))
            .collect();
        let seen = simulation::longest(&jobs, &sections(&set), set.len(), horizon);
        for (index, longest) in seen.into_iter().enumerate() {
            if let Ok(bound) = &bounds[index] {
                assert!(
                    longest <= bound.worst,
                    "{longest} over {bound:?} for {index} of {set:#?}"
                );
                compared += 1;
                reached += usize::from(longest == bound.worst);
                let plain = response(&set, index).map(|plain| plain.worst);
                sharpened += usize::from(plain.is_ok_and(|plain| bound.worst < plain));
            }
        }
    }
    assert!(compared > 2000, "{compared}");
    assert!(reached > 100, "{reached}");
    assert!(sharpened > 100, "{sharpened}");
}
