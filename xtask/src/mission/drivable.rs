//! A plan as the vehicle drives it.

use control::{
    controller::Settings,
    dubins::Pose,
    fence::{Point, Room as _},
    mission::{
        End, Fault, Join, Leg, Legs, MissionSettings, Planner, Purpose, Step, Summary, Violation,
        Yard, check,
    },
    position::Position,
    turn::TurnError,
};
use firmware::mission::Head;
use mission::{
    curve::{self, Chain},
    drive,
    plan::{self, Plan},
};
use vehicle_model::{Vehicle, description, manifest};

/// Words of the flash that a mission may have.
pub(super) const ROOM: usize = 32 * 1024;

/// The legs of a plan in the terms of the vehicle's firmware.
#[derive(Clone, Debug)]
pub(crate) struct Drivable {
    /// The curve of each leg of the plan.
    pub chains: Vec<Chain>,
    /// The leg of the plan that each leg of the firmware belongs to.
    of: Vec<usize>,
    legs: Vec<Leg<f32>>,
    fence: Vec<Point<f32>>,
    /// Corners of the obstacles; each ends with its first corner again.
    obstacles: Vec<Point<f32>>,
    end: End,
    /// Where a leg continues the one before with a kink: its number, the kink in rad, and the place.
    kinks: Vec<(usize, f64, mission::place::Local)>,
}

/// Kinks of this and more are told, rad.
const KINK: f64 = 0.05;

/// The kinks between legs that continue each other.
fn kinks(plan: &Plan) -> Vec<(usize, f64, mission::place::Local)> {
    let pairs = plan.legs.windows(2).enumerate();
    let kinks = pairs.filter_map(|(index, pair)| {
        let (before, after) = (pair[0].shape.points(), pair[1].shape.points());
        let ([.., a, b], [c, d, ..]) = (&before[..], &after[..]) else {
            return None;
        };
        let kink = control::scalar::wrap_angle(c.bearing(*d) - a.bearing(*b));
        let same = pair[0].reverse == pair[1].reverse;
        let told = pair[1].join == plan::Join::Continue && same && kink.abs() >= KINK;
        told.then_some((index + 1, kink, *c))
    });
    kinks.collect()
}

/// What a mission may ask of a vehicle.
///
/// # Errors
/// Why the vehicle has no missions.
pub(crate) fn settings(vehicle: &Vehicle) -> Result<MissionSettings<f32>, String> {
    let without = || {
        format!(
            "vehicle {:?} has no missions: [mission] in its vehicle.toml is needed",
            vehicle.name()
        )
    };
    let manifest = vehicle.manifest();
    let own = manifest.mission.as_ref().ok_or_else(without)?;
    let machine = manifest.machine.as_ref().ok_or_else(without)?;
    let description = description(vehicle).ok_or_else(without)?;
    let controller = Settings::<f32>::for_vehicle(&description).map_err(|why| why.to_string())?;
    Ok(design_of(own, machine).settings(&controller))
}

/// What the vehicle brings to its missions.
fn design_of(
    mission: &manifest::Mission,
    machine: &manifest::Machine,
) -> firmware::mission::Design {
    firmware::mission::Design {
        turn_speed: mission.turn_speed.get() as f32,
        reserve: mission.reserve.get() as f32,
        half_width: mission.width.get() as f32 * 0.5,
        ahead: mission.ahead.get() as f32,
        behind: mission.behind.get() as f32,
        clearance: mission.clearance.get() as f32,
        aside: mission.aside.get() as f32,
        acceleration: machine.limits.acceleration.get() as f32,
    }
}

fn point(at: mission::place::Local) -> Point<f32> {
    Point {
        north: at.north as f32,
        east: at.east as f32,
    }
}

/// A pose in a sentence.
fn place(at: Pose<f32>) -> mission::place::Local {
    mission::place::Local::new(at.north.into(), at.east.into())
}

/// Why a leg is too far away for the vehicle's single precision.
fn too_far(leg: usize, driven: &Leg<f32>) -> String {
    let ends = [driven.start, driven.end()].map(place);
    let far =
        |at: &mission::place::Local| at.north.abs().max(at.east.abs()) > control::mission::REACH;
    match ends.iter().find(|at| far(at)) {
        Some(at) => format!(
            "leg {leg}: {at} is too far: a vehicle takes up to {} m north, south, east and west of the origin",
            control::mission::REACH
        ),
        None => format!(
            "leg {leg}: its curve has wound to a heading of {:.0} rad, up to 100 rad are accepted: divide it",
            driven.start.heading
        ),
    }
}

/// Corners of an obstacle, with the first one again at the end.
fn closed(obstacle: &[mission::place::Local]) -> impl Iterator<Item = Point<f32>> {
    obstacle.iter().chain(obstacle.first()).copied().map(point)
}

impl Drivable {
    /// The legs of a plan.
    ///
    /// # Errors
    /// The leg that no curve can be fitted to, or that the plan is wrong.
    pub(crate) fn of(plan: &Plan) -> Result<Self, String> {
        plan.check().map_err(|problem| problem.to_string())?;
        let chains = curve::legs(plan, &curve::Options::default())
            .map_err(|(leg, why)| format!("leg {}: {why}", leg + 1))?;
        let pieces = drive::pieces(plan, &chains);
        let leg = |piece: &drive::Piece| Leg {
            start: Pose {
                north: piece.start.place.north as f32,
                east: piece.start.place.east as f32,
                heading: piece.start.heading as f32,
            },
            curvature: piece.curvature as f32,
            sharpness: piece.sharpness as f32,
            length: piece.length as f32,
            speed: piece.speed as f32,
            reverse: piece.reverse,
            outputs: piece.outputs,
            join: match piece.next {
                plan::Join::Continue => Join::Continue,
                plan::Join::Turn => Join::Turn,
            },
        };
        Ok(Self {
            of: pieces.iter().map(|piece| piece.leg).collect(),
            legs: pieces.iter().map(leg).collect(),
            fence: plan.fence.iter().copied().map(point).collect(),
            obstacles: plan
                .obstacles
                .iter()
                .flat_map(|obstacle| closed(obstacle))
                .collect(),
            end: match plan.end {
                plan::End::Stop => End::Stop,
                plan::End::Repeat => End::Repeat,
            },
            kinks: kinks(plan),
            chains,
        })
    }

    /// The leg of the plan that a leg of the firmware belongs to.
    pub(crate) fn leg_of(&self, number: usize) -> usize {
        self.of.get(number).map_or(number, |leg| *leg)
    }

    /// What the firmware drives.
    pub(crate) fn mission(&self) -> Legs<'_, f32> {
        Legs {
            origin: Position::new(0, 0),
            legs: &self.legs,
            fence: &self.fence,
            obstacles: &self.obstacles,
            end: self.end,
        }
    }

    /// The pose `before` metres before the first leg, straight on to it; m and rad.
    pub(crate) fn begin(&self, before: f64) -> Option<Pose<f64>> {
        let first = self.legs.first()?.start;
        let (north, east, heading) = (
            f64::from(first.north),
            f64::from(first.east),
            f64::from(first.heading),
        );
        Some(Pose {
            north: north - before * heading.cos(),
            east: east - before * heading.sin(),
            heading,
        })
    }

    /// Number of lines, arcs and clothoids.
    pub(crate) fn pieces(&self) -> usize {
        self.legs.len()
    }

    /// Checks that a vehicle can drive it, as the vehicle itself does.
    ///
    /// # Errors
    /// A clause that names the first leg at fault, and why.
    pub(crate) fn check(&self, settings: &MissionSettings<f32>) -> Result<Summary<f32>, String> {
        self.judge(settings, "a leg that ends earlier leaves more room")
    }

    /// The same for a mission that is made from a drawing.
    ///
    /// # Errors
    /// A clause that names the first leg at fault, why, and which option may help.
    pub(crate) fn check_new(
        &self,
        settings: &MissionSettings<f32>,
    ) -> Result<Summary<f32>, String> {
        self.judge(
            settings,
            "a wider headland (--headland), or a leg that ends earlier, leaves more room",
        )
    }

    /// Checks it; `wider` says what leaves more room where there is too little.
    fn judge(&self, settings: &MissionSettings<f32>, wider: &str) -> Result<Summary<f32>, String> {
        let words = self.words();
        // The vehicle reads the record, whose speeds are rounded.
        let judged = match Head::parse(&words) {
            Some(head) => check(&head.of(&words), settings),
            None => check(&self.mission(), settings),
        };
        judged.map_err(|violation| match violation {
            Violation::Leg { number, fault } => self.cause(number, fault, settings, wider),
            other => other.to_string(),
        })
    }

    /// Largest curvature of legs and turns, 1/m, in size.
    pub(crate) fn largest_curvature(&self, settings: &MissionSettings<f32>) -> f32 {
        let mission = self.mission();
        let mut planner = Planner::new(*settings);
        let mut most = 0.0_f32;
        let mut legs = 0;
        // One that repeats has no end: the first leg comes again.
        while legs <= self.legs.len() {
            match planner.step(&mission) {
                Step::Working => {}
                Step::Done | Step::NoTurn { .. } => break,
                Step::Piece(piece) => {
                    let segment = &piece.segment;
                    for along in [0.0, segment.length] {
                        most = most.max(segment.curvature_at(along).abs());
                    }
                    legs += usize::from(piece.purpose == Purpose::Leg);
                }
            }
        }
        most
    }

    /// What is wrong with a leg of the firmware, where, and what helps.
    fn cause(
        &self,
        number: usize,
        fault: Fault,
        settings: &MissionSettings<f32>,
        wider: &str,
    ) -> String {
        let index = self.of.get(number).map_or(number, |leg| *leg);
        let leg = index + 1;
        let Some(driven) = self.legs.get(number) else {
            return format!("leg {leg}: {fault}");
        };
        let bent = matches!(
            fault,
            Fault::Curvature | Fault::Sharpness | Fault::JoinHeading | Fault::JoinCurvature
        );
        let kink = self.kinks.iter();
        let mut kink = kink.filter(|(after, ..)| bent && (index..=index + 1).contains(after));
        if let Some((after, kink, at)) = kink.next() {
            return format!(
                "leg {}: it continues leg {after} with a kink of {:.0} deg at {at}, which the steering cannot follow; \
                 join = \"turn\" lets the vehicle turn there",
                after + 1,
                kink.to_degrees().abs()
            );
        }
        match fault {
            Fault::TooFar => too_far(leg, driven),
            Fault::Curvature => {
                let end = driven.curvature + driven.sharpness * driven.length;
                let (along, curvature) = if end.abs() > driven.curvature.abs() {
                    (driven.length, end)
                } else {
                    (0.0, driven.curvature)
                };
                format!(
                    "leg {leg}: its curvature is {:.3} 1/m at {}, and the vehicle takes up to {:.3} 1/m",
                    curvature.abs(),
                    place(driven.part().pose(driven.start, along)),
                    settings.curvature
                )
            }
            Fault::Sharpness => format!(
                "leg {leg}: {fault} can follow, by {:.3} 1/m on each metre from {} to {}, and the vehicle takes up to {:.3} 1/m at \
                 its slowest; points that bend more gently are accepted",
                driven.sharpness.abs(),
                place(driven.start),
                place(driven.end()),
                settings.steering_rate / (settings.slowest * settings.wheelbase)
            ),
            Fault::Speed => format!(
                "leg {leg}: its speed is {} m/s, and {:.2} to {} m/s is accepted: the receiver tells no heading of a slower \
                 vehicle",
                driven.speed,
                // Rounded up, so that the number itself is accepted.
                (settings.slowest * 100.0).ceil() / 100.0,
                settings.top_speed
            ),
            Fault::Outside | Fault::Obstacle => {
                let at = self.first_refused(driven, settings);
                let at = at.map_or_else(String::new, |(along, at)| {
                    format!(", {along:.1} m along its line or curve, at {}", place(at))
                });
                format!("leg {leg}: {fault}{at}; {wider}")
            }
            Fault::Turn(TurnError::NoRoom) => {
                let next = self.legs.get(number + 1).or(self.legs.first());
                let to = next.map_or_else(String::new, |next| format!(" to {}", place(next.start)));
                format!(
                    "leg {leg}: there is no turn to the next leg, from {}{to}, that keeps the vehicle inside the fence and \
                     off the obstacles; {wider}",
                    place(driven.end())
                )
            }
            fault => format!("leg {leg}: {fault}"),
        }
    }

    /// The first place of a leg at which the vehicle may not be, and how far along the leg it is, m.
    fn first_refused(
        &self,
        leg: &Leg<f32>,
        settings: &MissionSettings<f32>,
    ) -> Option<(f32, Pose<f32>)> {
        let mission = self.mission();
        let yard = Yard::of(&mission, settings);
        let steps = (leg.length / settings.turn.spacing).ceil() as usize;
        let along = (0..=steps).map(|step| (step as f32 * settings.turn.spacing).min(leg.length));
        let mut poses = along.map(|along| (along, leg.part().pose(leg.start, along)));
        poses.find(|(_, at)| !yard.allows(at))
    }

    /// The words of its record; none if it is too long for one.
    fn words(&self) -> Vec<u32> {
        let mission = self.mission();
        let words = firmware::mission::words(&mission);
        words.into_iter().flatten().collect()
    }

    /// The record for the flash.
    ///
    /// # Errors
    /// It is too long.
    pub(crate) fn record(&self) -> Result<Vec<u8>, String> {
        let words = self.words();
        if words.is_empty() || words.len() > ROOM {
            return Err(format!(
                "it has {} lines, arcs and clothoids, {} corners of a fence and {} of obstacles: a record has room for \
                 {}, {} and {}",
                self.legs.len(),
                self.fence.len(),
                self.obstacles.len(),
                control::mission::LEGS,
                control::fence::CORNERS,
                control::fence::OBSTACLE_CORNERS
            ));
        }
        Ok(words.into_iter().flat_map(u32::to_le_bytes).collect())
    }
}
