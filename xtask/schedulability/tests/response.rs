//! Response-time analysis against published examples, the verified analyses
//! of the `response-time-analysis` crate and a discrete-event simulation.

mod processor;

use processor::{Behaviour, Locked, Origin, below};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use response_time_analysis::{arrival, demand, fixed_priority, time, wcet};
use schedulability::arrivals::Arrivals;
use schedulability::response::{
    CriticalSection, Task, Unbounded, all_meet, analyse, blocking, meets, response,
};
use schedulability::sensitivity::slack;

fn tasks(parameters: &[(u64, u64)]) -> Vec<Task> {
    parameters
        .iter()
        .enumerate()
        .map(|(index, &(cost, period))| Task {
            name: format!("t{}", index + 1),
            priority: (parameters.len() - index) as u32,
            cost,
            arrivals: Arrivals::every(period),
            deadline: period,
            jitter: 0,
            after: Vec::new(),
            coalesces: false,
            off_bus: false,
            blocking: 0,
            preemption: 0.into(),
        })
        .collect()
}

fn worst(tasks: &[Task]) -> Vec<u64> {
    (0..tasks.len())
        .map(|index| response(tasks, index).unwrap().worst)
        .collect()
}

#[test]
fn textbook_sets() {
    assert_eq!(worst(&tasks(&[(4, 16), (5, 40), (32, 80)])), [4, 9, 58]);
    assert_eq!(worst(&tasks(&[(3, 7), (3, 12), (5, 20)])), [3, 6, 20]);
    assert_eq!(
        worst(&tasks(&[(1, 4), (1, 5), (3, 9), (3, 18)])),
        [1, 2, 7, 18]
    );
}

#[test]
fn blocking_term() {
    let mut set = tasks(&[(3, 7), (3, 12), (5, 20)]);
    set[0].blocking = 2;
    set[1].blocking = 2;
    assert_eq!(worst(&set), [5, 11, 20]);
}

#[test]
fn deadline_missed_by_two() {
    let set = tasks(&[(10, 30), (10, 40), (12, 50)]);
    assert_eq!(response(&set, 2).unwrap().worst, 52);
    assert!(meets(&set, 0) && meets(&set, 1) && !meets(&set, 2));
    assert_eq!(slack(&set, 0, 1), None);
}

#[test]
fn deadlines_beyond_the_period() {
    let set = tasks(&[(26, 70), (62, 100)]);
    let response = response(&set, 1).unwrap();
    assert_eq!(response.worst, 118);
    assert_eq!(response.jobs, [114, 102, 116, 104, 118, 106, 94]);
}

#[test]
fn jitter_and_preemption_cost() {
    // A second job of t1 that is 6 late and a third one are in the window of t2.
    let mut set = tasks(&[(2, 10), (5, 100)]);
    assert_eq!(worst(&set), [2, 7]);
    set[0].jitter = 6;
    assert_eq!(worst(&set), [8, 9]);
    set[0].preemption = 1.into();
    assert_eq!(worst(&set), [8, 11]);
}

#[test]
fn a_job_may_be_so_late_that_the_next_one_comes_first() {
    // Released 39 after its nominal instant, just when the next one, which is 8 late, has begun.
    let mut set = tasks(&[(5, 30)]);
    set[0].jitter = 39;
    assert_eq!(worst(&set), [39 + 5 + 5]);
}

#[test]
fn overload_is_named() {
    let set = tasks(&[(5, 10), (6, 10)]);
    assert_eq!(
        response(&set, 1),
        Err(Unbounded::Overload { permille: 1100 })
    );
    let mut set = tasks(&[(1, 10), (1, 10)]);
    set[0].arrivals = Arrivals::every(0);
    assert_eq!(response(&set, 1), Err(Unbounded::ZeroPeriod));
}

#[test]
fn ceilings() {
    // Durations on Sa, Sb, Sc; ceilings t1, t1, t2.
    let held = [
        (4, [1, 2, 0]),
        (3, [0, 9, 3]),
        (2, [8, 7, 0]),
        (1, [6, 5, 4]),
    ];
    let ceilings = [4, 4, 3];
    let sections: Vec<CriticalSection> = held
        .iter()
        .flat_map(|&(holder, lengths)| {
            lengths
                .into_iter()
                .zip(ceilings)
                .map(move |(length, ceiling)| CriticalSection {
                    holder,
                    ceiling,
                    length,
                })
        })
        .collect();
    let bounds: Vec<u64> = [4, 3, 2, 1]
        .into_iter()
        .map(|priority| blocking(&sections, priority))
        .collect();
    assert_eq!(bounds, [9, 8, 6, 0]);
}

#[test]
fn slack_is_the_largest_that_fits() {
    let set = tasks(&[(4, 16), (5, 40), (32, 80)]);
    for index in 0..set.len() {
        let extra = slack(&set, index, 1).unwrap();
        let mut longer = set.clone();
        longer[index].cost += extra;
        assert!((0..3).all(|task| meets(&longer, task)));
        longer[index].cost += 1;
        assert!(!(0..3).all(|task| meets(&longer, task)));
    }
}

fn period(task: &Task) -> u64 {
    task.arrivals.single().unwrap()
}

/// A set of two to six tasks whose utilisation may exceed one.
fn random_set(random: &mut ChaCha8Rng) -> Vec<Task> {
    let count = 2 + below(random, 5);
    let parameters: Vec<(u64, u64)> = (0..count)
        .map(|_| {
            let period = 4 + below(random, 60);
            (1 + below(random, period.div_ceil(count)), period)
        })
        .collect();
    let mut set = tasks(&parameters);
    for task in &mut set {
        task.jitter = below(random, period(task) / 2);
    }
    set
}

#[test]
fn equal_to_the_verified_analysis() {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let mut bounded = 0;
    for _ in 0..1000 {
        let set = random_set(&mut random);
        let curves: Vec<arrival::Sporadic> = set
            .iter()
            .map(|task| {
                arrival::Sporadic::new(
                    time::Duration::from(period(task)),
                    time::Duration::from(task.jitter),
                )
            })
            .collect();
        let costs: Vec<wcet::Scalar> = set
            .iter()
            .map(|task| wcet::Scalar::new(time::Service::from(task.cost)))
            .collect();
        let bounds: Vec<demand::RBF<_, _>> = costs
            .iter()
            .zip(&curves)
            .map(|(cost, curve)| demand::RBF::new(curve, cost))
            .collect();
        for index in 0..set.len() {
            let theirs = fixed_priority::fully_preemptive::dedicated_uniproc_rta(
                &bounds[index],
                &bounds[..index],
                time::Duration::from(100_000),
            );
            match (response(&set, index), theirs) {
                (Ok(ours), Ok(theirs)) => {
                    // The crate measures a response from the job's release, this analysis from
                    // its nominal release. For the first job of the busy period they differ by
                    // the jitter. Later jobs are released at their nominal instants.
                    let from_release = ours
                        .jobs
                        .iter()
                        .enumerate()
                        .map(|(job, response)| match job {
                            0 => response - set[index].jitter,
                            _ => *response,
                        })
                        .max();
                    assert_eq!(from_release, Some(u64::from(theirs)), "{set:?}");
                    bounded += 1;
                }
                (Err(_), Err(_)) => {}
                (ours, theirs) => panic!("{ours:?} against {theirs:?} for {set:?}"),
            }
        }
    }
    assert!(bounded > 2000, "{bounded}");
}

/// Runs the set with releases at random legal instants. Returns the longest observed response of
/// each task. Every job holds the section of its priority from its first tick on.
fn simulate(set: &[Task], sections: &[CriticalSection], random: &mut ChaCha8Rng) -> Vec<u64> {
    let of_task = |task: &Task| {
        let own = sections.iter().filter(|s| s.holder == task.priority);
        let locked = own.map(|section| Locked {
            from: 0,
            to: section.length,
            ceiling: section.ceiling,
        });
        locked.collect()
    };
    // The idle code holds none.
    let locks = set.iter().map(of_task).chain([Vec::new()]);
    let behaviour = Behaviour {
        locks: locks.collect(),
        links: vec![Vec::new(); set.len()],
        lost: Vec::new(),
        off_bus: false,
        horizon: 1500,
    };
    let mut longest = vec![0; set.len()];
    for one in processor::run(set, &behaviour, random) {
        assert_eq!(one.origin, Origin::Stream(0));
        longest[one.task] = one.response.max(longest[one.task]);
    }
    longest
}

#[test]
fn simulation_never_exceeds_the_bound() {
    let mut random = ChaCha8Rng::seed_from_u64(2);
    let mut reached = 0;
    for _ in 0..300 {
        let mut set = random_set(&mut random);
        let top = set.len() as u32;
        let sections: Vec<CriticalSection> = set
            .iter()
            .filter(|task| task.cost > 1)
            .map(|task| CriticalSection {
                holder: task.priority,
                ceiling: task.priority
                    + below(&mut random, u64::from(top - task.priority) + 1) as u32,
                length: 1 + below(&mut random, task.cost),
            })
            .collect();
        for task in &mut set {
            task.blocking = blocking(&sections, task.priority);
        }
        let seen = simulate(&set, &sections, &mut random);
        for (index, longest) in seen.into_iter().enumerate() {
            if let Ok(bound) = response(&set, index) {
                assert!(
                    longest <= bound.worst,
                    "{longest} over {bound:?} for {index} of {set:?}"
                );
                reached += usize::from(longest == bound.worst);
            }
        }
    }
    // The bound is tight: simulations reach it.
    assert!(reached > 100, "{reached}");
}

#[test]
fn stopping_at_the_first_miss_changes_no_answer() {
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let mut met = 0;
    for _ in 0..500 {
        let mut set = random_set(&mut random);
        for task in &mut set {
            task.deadline = 1 + below(&mut random, 2 * task.deadline.max(1));
        }
        let each = analyse(&set);
        let meets = each
            .iter()
            .all(|result| result.as_ref().is_ok_and(|one| one.critical.meets()));
        assert_eq!(all_meet(&set), meets, "{set:?}");
        met += u32::from(meets);
    }
    assert!((50..450).contains(&met), "{met} of 500 meet");
}
