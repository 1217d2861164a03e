//! The rows that a row follower drives through, as a scenario describes them.

use core::f64::consts::FRAC_PI_2;

use serde::Deserialize;
use vehicle_model::manifest::CropRows;

use super::check::{above, between, within};
use crate::rover::{self, Mount};
use crate::rows::PIECE;
use crate::units::{Angle, Density, Length, Ratio};

/// The rows: table `[row]`.
///
/// A row is a chain of sections. Stations count along its middle, from 0 at the beginning of the
/// first section.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Row {
    /// The sections, one behind the other; at least one.
    pub section: Vec<Section>,
    /// Stretches without plants or barrier.
    pub gap: Vec<Gap>,
    /// Stretches where leaves overhang the row.
    pub leaves: Vec<Leaves>,
    /// Single weeds.
    pub weed: Vec<Weed>,
    /// Stretches with weeds at random places.
    pub weeds: Vec<Weeds>,
    /// Bends, in order. The row is straight elsewhere, and nowhere turned by more than 90 deg from its
    /// beginning.
    pub bend: Vec<Bend>,
    /// Where a rover stands at the start.
    pub start: RowStart,
    /// Where the row of a machine is.
    pub place: RowPlace,
}

/// Where the row of a machine begins, against its line.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RowPlace {
    /// How far along the line, 0 to 20 km. Default 0 m.
    pub along: Length,
    /// How far its middle is to the right of the line there, up to 5 m. Default 0 m.
    pub right: Length,
    /// Its direction against that of the line, to the right, -10 to 10 deg. Default 0 deg.
    pub heading: Angle,
}

/// What stands at a row's sides.
#[derive(Copy, Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// Smooth barriers.
    Barriers,
    /// Poles of PVC in a hall.
    Poles,
    /// Stalks in a field.
    Stalks,
}

/// A part of a row. The numbers of the thesis are in its sections 2.2.6.1 and 2.2.7; the others are
/// inferred.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Section {
    /// What stands at its sides.
    pub kind: Kind,
    /// Length, above 0 to 20 km; all sections together are not longer.
    pub length: Length,
    /// Distance between the two sides, up to 5 m; at least the robot's width and a plant's diameter, with
    /// 2 cm on either side. Default: `rows.width` of the vehicle's manifest; without a vehicle 76.2 cm
    /// (30 inches).
    pub width: Option<Length>,
    /// Distance of two plants, 2 cm to 2 m, larger than a plant. Default 20.32 cm (8 inches).
    pub spacing: Option<Length>,
    /// Diameter of a plant, 4 mm to 20 cm. Default 4.2 cm for poles (nominal 1 1/4 inch pipe), for
    /// stalks `rows.stalk` of the vehicle's manifest; without a vehicle 2.2 cm.
    pub diameter: Option<Length>,
    /// Standard deviation of the diameter, 0 to 5 cm. Default 0 for poles, 3 mm for stalks.
    pub diameter_scatter: Option<Length>,
    /// Standard deviation of a plant's place along the row, 0 to 20 cm. Default 1 cm for poles, 3 cm
    /// for stalks.
    pub along: Option<Length>,
    /// Standard deviation of a plant's place across the row, 0 to 20 cm. Default 5 mm for poles, 1.5 cm
    /// for stalks.
    pub across: Option<Length>,
    /// Share of the plants that are missing, 0 to 100 %. Default 0 %.
    #[serde(default)]
    pub missing: Ratio,
    /// Rows behind the first on either side, 0 to 5, one width apart. A beam that passes between two
    /// plants meets them. Default 0 for poles, 2 for stalks.
    pub behind: Option<u32>,
}

impl Section {
    /// Distance between the two sides.
    #[must_use]
    pub fn width(&self) -> Length {
        self.width.unwrap_or(Length::new(0.762))
    }

    fn choose(&self, given: Option<Length>, poles: f64, stalks: f64) -> f64 {
        given.map_or_else(
            || match self.kind {
                Kind::Poles => poles,
                Kind::Stalks | Kind::Barriers => stalks,
            },
            Length::get,
        )
    }

    /// Distance of two plants, metres.
    #[must_use]
    pub fn spacing(&self) -> f64 {
        self.choose(self.spacing, 0.2032, 0.2032)
    }

    /// Diameter of a plant, metres.
    #[must_use]
    pub fn diameter(&self) -> f64 {
        self.choose(self.diameter, 0.042, 0.022)
    }

    /// Standard deviation of the diameter, metres.
    #[must_use]
    pub fn diameter_scatter(&self) -> f64 {
        self.choose(self.diameter_scatter, 0.0, 0.003)
    }

    /// Standard deviation of a plant's place along the row, metres.
    #[must_use]
    pub fn along(&self) -> f64 {
        self.choose(self.along, 0.01, 0.03)
    }

    /// Standard deviation of a plant's place across the row, metres.
    #[must_use]
    pub fn across(&self) -> f64 {
        self.choose(self.across, 0.005, 0.015)
    }

    /// What plants take of the width, metres: their diameter, and nothing beside smooth barriers.
    fn thickness(&self) -> f64 {
        match self.kind {
            Kind::Barriers => 0.0,
            Kind::Poles | Kind::Stalks => self.diameter(),
        }
    }

    /// How many plants it has, missing ones too, or pieces of barriers.
    fn things(&self) -> f64 {
        let length = self.length.get();
        match self.kind {
            Kind::Barriers => 2.0 * (length / PIECE + 1.0),
            Kind::Poles | Kind::Stalks => {
                2.0 * f64::from(self.behind() + 1) * (length / self.spacing() + 1.0)
            }
        }
    }

    /// Rows behind the first on either side.
    #[must_use]
    pub fn behind(&self) -> u32 {
        self.behind.unwrap_or(match self.kind {
            Kind::Stalks => 2,
            Kind::Poles | Kind::Barriers => 0,
        })
    }
}

/// A side of the row, or both.
#[derive(Copy, Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Side {
    /// The left side.
    Left,
    /// The right side.
    Right,
    /// Both sides.
    #[default]
    Both,
}

impl Side {
    /// Whether it is `side` or both.
    #[must_use]
    pub fn includes(self, side: Self) -> bool {
        self == Self::Both || self == side
    }
}

/// A stretch without plants or barrier in the innermost row.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gap {
    /// On which side. Default both.
    #[serde(default)]
    pub side: Side,
    /// Station at which it begins, within the row.
    pub from: Length,
    /// Station at which it ends, within the row.
    pub to: Length,
}

impl Gap {
    /// Whether `station`, metres, is in it.
    #[must_use]
    pub fn includes(&self, station: f64) -> bool {
        (self.from.get()..self.to.get()).contains(&station)
    }
}

/// A stretch where leaves hang into the robot's way at the height of its sensors.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Leaves {
    /// On which side. Default both.
    #[serde(default)]
    pub side: Side,
    /// Station at which they begin, within the row.
    pub from: Length,
    /// Station at which they end, within the row.
    pub to: Length,
    /// Leaves in a metre of one side, 0 to 100 /m.
    pub density: Density,
    /// How far they hang into the row, 0 to its width. Default 25 cm.
    #[serde(default = "reach")]
    pub reach: Length,
    /// Longest cut of a leaf at the height of the beam; the shortest is half as long. 1 cm to 1 m.
    /// Default 12 cm.
    #[serde(default = "leaf")]
    pub length: Length,
}

fn reach() -> Length {
    Length::new(0.25)
}

fn leaf() -> Length {
    Length::new(0.12)
}

/// A weed.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Weed {
    /// Its station, within the row.
    pub at: Length,
    /// How far it stands to the right of the middle, within the row. Default 0 m.
    #[serde(default)]
    pub right: Length,
    /// Diameter, 4 mm to 1 m.
    pub diameter: Length,
}

/// A stretch with weeds at random places between the two sides.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Weeds {
    /// Station at which they begin, within the row.
    pub from: Length,
    /// Station at which they end, within the row.
    pub to: Length,
    /// Weeds in a metre of the row, 0 to 20 /m.
    pub density: Density,
    /// Mean diameter, 4 mm to 1 m; single weeds have half of it to one and a half times as much.
    pub diameter: Length,
}

/// The direction of a bend.
#[derive(Copy, Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Turn {
    /// To the left.
    Left,
    /// To the right.
    Right,
}

/// An arc in the row.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Bend {
    /// Station at which it begins, within the row.
    pub from: Length,
    /// Station at which it ends, within the row.
    pub to: Length,
    /// Radius of the middle, 2 m to 10 km, and large enough for the rows inside.
    pub radius: Length,
    /// Its direction.
    pub turn: Turn,
}

/// Where the robot's middle stands at the start.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RowStart {
    /// Station, -20 m to the end of the row. Default 0 m.
    pub station: Length,
    /// How far to the right of the middle, up to 5 m; within the row, the robot stands between the two
    /// sides. Default 0 m.
    pub right: Length,
    /// Heading against that of the row, to the right, -15 to 15 deg: an operator puts the robot down
    /// along its row, and its estimator begins with that. Default 0 deg.
    pub heading: Angle,
}

/// The measures of a robot that limit the rows in which it can drive.
#[derive(Copy, Clone, Debug, PartialEq)]
pub struct Limits {
    /// Length of the robot, metres.
    pub length: f64,
    /// Width of the robot, metres.
    pub width: f64,
    /// How far a sensor is mounted beside the middle, metres.
    pub sensor_beside: f64,
    /// Angle of its beam against straight ahead, radians.
    pub beam: f64,
    /// The longest distance that the sensor measures, metres.
    pub range: f64,
}

impl Limits {
    /// Those of a robot whose sensors are mounted like `mount`.
    #[must_use]
    pub fn of(robot: &rover::Parameters, mount: &Mount) -> Self {
        Self {
            length: robot.length,
            width: robot.width,
            sensor_beside: mount.right.abs(),
            beam: mount.yaw.abs(),
            range: crate::distance::FARTHEST,
        }
    }
}

/// The longest row, metres.
const LONGEST: f64 = 20_000.0;

/// Most plants, leaves, weeds and pieces of barriers in a row. They stand there in a few seconds.
const MOST_THINGS: f64 = 1e6;

/// Most tables of one kind.
const MOST_TABLES: usize = 1000;

/// Least room on either side of the robot in the middle of its row, metres.
const ROOM: f64 = 0.02;

/// Largest angle between robot and row at the start, degrees. From 20 degrees on the estimator of the
/// virtual row follower finds its place too late, and it touches plants.
const LARGEST_TURN: f64 = 15.0;

type Outcome = Result<(), String>;

/// A length in whole tenths of a millimetre: a sum has further digits that mean nothing.
fn rounded(metres: f64) -> Length {
    Length::new((metres * 1e4).round() / 1e4)
}

fn lengths(least: f64, most: f64) -> super::check::Range<crate::units::LengthKind> {
    between(Length::new(least), Length::new(most))
}

impl Row {
    /// Gives the sections that say nothing about it the width and the stalks of a manifest's rows.
    pub(super) fn complete(&mut self, rows: &CropRows) {
        for section in &mut self.section {
            section.width.get_or_insert(rows.width);
            if section.kind == Kind::Stalks {
                section.diameter.get_or_insert(rows.stalk);
            }
        }
    }

    /// The sections, each with the stations at which it begins and ends, metres.
    pub fn stations(&self) -> impl Iterator<Item = (&Section, f64, f64)> {
        self.section.iter().scan(0.0, |end, section| {
            let from = *end;
            *end += section.length.get();
            Some((section, from, *end))
        })
    }

    /// Length of the row, metres.
    #[must_use]
    pub fn length(&self) -> f64 {
        self.stations().last().map_or(0.0, |(.., to)| to)
    }

    /// Distance between the two sides at a station, metres; before the row that of its beginning,
    /// behind it that of its end.
    #[must_use]
    pub fn width_at(&self, station: f64) -> f64 {
        let section = self.section_at(station);
        section.map_or(0.0, |section| section.width().get())
    }

    /// The section at a station; before the row its first one, behind it its last one.
    fn section_at(&self, station: f64) -> Option<&Section> {
        let begun = self.stations().take_while(|(_, from, _)| *from <= station);
        let section = begun.last().map(|(section, ..)| section);
        section.or(self.section.first())
    }

    /// Checks what a file says about the row.
    ///
    /// # Errors
    /// The first mistake as a phrase that begins with the field, such as `row.gap[0].to: ...`.
    pub fn check(&self, limits: &Limits) -> Result<(), String> {
        if self.section.is_empty() {
            return Err("row.section: a row needs at least one section".into());
        }
        self.few_tables()?;
        for (i, section) in self.section.iter().enumerate() {
            section.check(&format!("row.section[{i}]"), limits)?;
        }
        let length = self.length();
        if length > LONGEST {
            return Err(format!(
                "row.section: all sections together are {} long, a row has at most {}",
                Length::new(length),
                Length::new(LONGEST)
            ));
        }
        for (i, gap) in self.gap.iter().enumerate() {
            self.stretch(&format!("row.gap[{i}]"), gap.from, gap.to)?;
        }
        self.barrier_gaps()?;
        for (i, leaves) in self.leaves.iter().enumerate() {
            self.check_leaves(&format!("row.leaves[{i}]"), leaves)?;
        }
        self.check_weeds()?;
        self.few_things()?;
        self.check_bends()?;
        self.check_start(limits)
    }

    fn few_tables(&self) -> Outcome {
        let counts = [
            ("section", self.section.len()),
            ("gap", self.gap.len()),
            ("leaves", self.leaves.len()),
            ("weed", self.weed.len()),
            ("weeds", self.weeds.len()),
            ("bend", self.bend.len()),
        ];
        match counts.iter().find(|(_, count)| *count > MOST_TABLES) {
            Some((table, count)) => Err(format!(
                "row.{table}: there are {count} of these tables, a row takes {MOST_TABLES}"
            )),
            None => Ok(()),
        }
    }

    /// Checks that the row is made in a short time.
    fn few_things(&self) -> Outcome {
        let sections = self.section.iter().map(Section::things);
        let leaves = self.leaves.iter().map(|leaves| {
            let sides = if leaves.side == Side::Both { 2.0 } else { 1.0 };
            sides * leaves.density.get() * (leaves.to.get() - leaves.from.get())
        });
        let weeds = self.weeds.iter();
        let weeds = weeds.map(|weeds| weeds.density.get() * (weeds.to.get() - weeds.from.get()));
        let sections = sections.enumerate().map(|one| ("section", one));
        let leaves = leaves.enumerate().map(|one| ("leaves", one));
        let weeds = weeds.enumerate().map(|one| ("weeds", one));
        let mut all = self.weed.len() as f64;
        for (table, (i, count)) in sections.chain(leaves).chain(weeds) {
            all += count;
            if all > MOST_THINGS {
                return Err(format!(
                    "row.{table}[{i}]: with it there are about {all:.0} plants, leaves, weeds and pieces \
                     of barriers, a row takes {MOST_THINGS:.0}"
                ));
            }
        }
        Ok(())
    }

    /// Checks that a stretch lies within the row and ends after its beginning.
    fn stretch(&self, field: &str, from: Length, to: Length) -> Outcome {
        let length = self.length();
        within(&format!("{field}.from"), from, lengths(0.0, length))?;
        within(&format!("{field}.to"), to, lengths(0.0, length))?;
        if to <= from {
            return Err(format!(
                "{field}.to: {to} is not behind the beginning at {from}"
            ));
        }
        Ok(())
    }

    /// Gaps of barriers are cut out of their pieces.
    fn barrier_gaps(&self) -> Outcome {
        let least = Length::new(PIECE);
        for (i, gap) in self.gap.iter().enumerate() {
            let mut barriers = self
                .stations()
                .filter(|(section, ..)| section.kind == Kind::Barriers);
            let cuts = barriers.any(|(_, from, to)| gap.from.get() < to && gap.to.get() > from);
            if cuts && gap.to.get() - gap.from.get() < least.get() {
                return Err(format!(
                    "row.gap[{i}]: a gap of a barrier is at least {least} long"
                ));
            }
        }
        Ok(())
    }

    fn check_leaves(&self, field: &str, leaves: &Leaves) -> Outcome {
        self.stretch(field, leaves.from, leaves.to)?;
        let densities = between(Density::new(0.0), Density::new(100.0));
        within(&format!("{field}.density"), leaves.density, densities)?;
        let mut widths = self.stations().map(|(section, ..)| section.width().get());
        let narrowest = widths.by_ref().fold(f64::INFINITY, f64::min);
        within(
            &format!("{field}.reach"),
            leaves.reach,
            lengths(0.0, narrowest),
        )?;
        within(
            &format!("{field}.length"),
            leaves.length,
            lengths(0.01, 1.0),
        )
    }

    fn check_weeds(&self) -> Outcome {
        for (i, weed) in self.weed.iter().enumerate() {
            let field = format!("row.weed[{i}]");
            within(&format!("{field}.at"), weed.at, lengths(0.0, self.length()))?;
            let half = self.width_at(weed.at.get()) / 2.0;
            within(&format!("{field}.right"), weed.right, lengths(-half, half))?;
            within(
                &format!("{field}.diameter"),
                weed.diameter,
                lengths(0.004, 1.0),
            )?;
        }
        for (i, weeds) in self.weeds.iter().enumerate() {
            let field = format!("row.weeds[{i}]");
            self.stretch(&field, weeds.from, weeds.to)?;
            let densities = between(Density::new(0.0), Density::new(20.0));
            within(&format!("{field}.density"), weeds.density, densities)?;
            within(
                &format!("{field}.diameter"),
                weeds.diameter,
                lengths(0.004, 1.0),
            )?;
        }
        Ok(())
    }

    fn check_bends(&self) -> Outcome {
        // The outermost row on the inner side of a bend must be on this side of its centre.
        let breadths = self
            .section
            .iter()
            .map(|section| section.width().get() * (0.5 + f64::from(section.behind())));
        let broadest = breadths.fold(0.0, f64::max);
        let mut end = Length::new(0.0);
        let mut heading = 0.0;
        for (i, bend) in self.bend.iter().enumerate() {
            let field = format!("row.bend[{i}]");
            self.stretch(&field, bend.from, bend.to)?;
            within(
                &format!("{field}.radius"),
                bend.radius,
                lengths(2.0, 10_000.0),
            )?;
            if bend.radius.get() <= broadest {
                return Err(format!(
                    "{field}.radius: {} has no room for the rows inside, which reach {} far",
                    bend.radius,
                    Length::new(broadest)
                ));
            }
            if bend.from < end {
                return Err(format!(
                    "{field}.from: {} is before the end of the bend before, at {end}",
                    bend.from
                ));
            }
            end = bend.to;
            let turned = (bend.to.get() - bend.from.get()) / bend.radius.get();
            heading += match bend.turn {
                Turn::Left => -turned,
                Turn::Right => turned,
            };
            // A row that never turns back cannot cross itself.
            if heading.abs() > FRAC_PI_2 {
                return Err(format!(
                    "{field}: the row has turned by {:.0} deg at its end, beyond 90 deg it could \
                     cross itself",
                    heading.abs().to_degrees()
                ));
            }
        }
        Ok(())
    }

    /// Checks where the row of a machine is.
    pub(super) fn check_place(&self) -> Outcome {
        let place = &self.place;
        within("row.place.along", place.along, lengths(0.0, LONGEST))?;
        within("row.place.right", place.right, lengths(-5.0, 5.0))?;
        let turns = between(Angle::degrees(-10.0), Angle::degrees(10.0));
        within("row.place.heading", place.heading, turns)?;
        if self.start != RowStart::default() {
            return Err("row.start: a machine starts on its line: [start] says where".into());
        }
        Ok(())
    }

    fn check_start(&self, limits: &Limits) -> Outcome {
        let start = &self.start;
        let length = self.length();
        within("row.start.station", start.station, lengths(-20.0, length))?;
        within("row.start.right", start.right, lengths(-5.0, 5.0))?;
        let turns = between(Angle::degrees(-LARGEST_TURN), Angle::degrees(LARGEST_TURN));
        within("row.start.heading", start.heading, turns)?;
        let station = start.station.get();
        let turned = start.heading.get().abs();
        let (sine, cosine) = (libm::sin(turned), libm::cos(turned));
        let reach = |along: f64, across: f64| (limits.length * along + limits.width * across) / 2.0;
        let Some(section) = self.section_at(station) else {
            return Ok(());
        };
        let room = (section.width().get() - section.thickness()) / 2.0 - reach(sine, cosine);
        let within_row = station + reach(cosine, sine) >= 0.0;
        if within_row && start.right.get().abs() > room {
            let room = match rounded(room) {
                room if room.get() > 0.0 => format!("{room} to either side of the middle"),
                _ => "no offset".into(),
            };
            return Err(format!(
                "row.start: the robot stands in the plants {} to the right of the middle, with a heading \
                 of {}: there is room for {room}",
                start.right, start.heading,
            ));
        }
        Ok(())
    }
}

impl Section {
    fn check(&self, field: &str, limits: &Limits) -> Outcome {
        let all = above(Length::new(0.0), Length::new(LONGEST));
        within(&format!("{field}.length"), self.length, all)?;
        match self.kind {
            Kind::Barriers => self.smooth(field)?,
            Kind::Poles | Kind::Stalks => self.plants(field)?,
        }
        self.room(field, limits)
    }

    /// Checks that the robot has room between the two sides, and sees them.
    fn room(&self, field: &str, limits: &Limits) -> Outcome {
        let width = self.width();
        let least = rounded(limits.width + self.thickness() + 2.0 * ROOM);
        let range = lengths(least.get(), 5.0);
        within(&format!("{field}.width"), width, range).map_err(|refused| {
            if width > least {
                return refused;
            }
            let plants = match self.kind {
                Kind::Barriers => String::new(),
                Kind::Poles | Kind::Stalks => {
                    format!(" a plant's diameter, {},", Length::new(self.thickness()))
                }
            };
            format!(
                "{refused}: the robot's width, {},{plants} and {} of room on either side",
                Length::new(limits.width),
                Length::new(ROOM)
            )
        })?;
        let across = width.get() / 2.0 + limits.sensor_beside;
        let distance = across / libm::sin(limits.beam);
        if distance > limits.range {
            return Err(format!(
                "{field}.width: {} is {} along the beam of a sensor in the middle, which \
                 measures up to {}",
                width,
                Length::new((distance * 1e3).round() / 1e3),
                Length::new(limits.range)
            ));
        }
        Ok(())
    }

    /// Checks the values of plants.
    fn plants(&self, field: &str) -> Outcome {
        let given = |value: f64, given: Option<Length>| given.unwrap_or(Length::new(value));
        within(
            &format!("{field}.spacing"),
            given(self.spacing(), self.spacing),
            lengths(0.02, 2.0),
        )?;
        within(
            &format!("{field}.diameter"),
            given(self.diameter(), self.diameter),
            lengths(0.004, 0.2),
        )?;
        for (name, value, most) in [
            ("diameter_scatter", self.diameter_scatter, 0.05),
            ("along", self.along, 0.2),
            ("across", self.across, 0.2),
        ] {
            let value = value.unwrap_or_default();
            within(&format!("{field}.{name}"), value, lengths(0.0, most))?;
        }
        if self.diameter() >= self.spacing() {
            return Err(format!(
                "{field}.diameter: {} leaves no room between plants that are {} apart",
                Length::new(self.diameter()),
                Length::new(self.spacing())
            ));
        }
        let shares = between(Ratio::new(0.0), Ratio::new(1.0));
        within(&format!("{field}.missing"), self.missing, shares)?;
        super::check::whole(&format!("{field}.behind"), self.behind().into(), 0, 5)
    }

    /// Checks that a barrier has no values of plants.
    fn smooth(&self, field: &str) -> Outcome {
        let values = [
            ("spacing", self.spacing.is_some()),
            ("diameter", self.diameter.is_some()),
            ("diameter_scatter", self.diameter_scatter.is_some()),
            ("along", self.along.is_some()),
            ("across", self.across.is_some()),
            ("missing", self.missing.get() != 0.0),
            ("behind", self.behind.is_some()),
        ];
        match values.iter().find(|(_, given)| *given) {
            Some((name, _)) => Err(format!(
                "{field}.{name}: smooth barriers have no plants, leave it out"
            )),
            None => Ok(()),
        }
    }
}
