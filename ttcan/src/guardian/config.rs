//! The configuration of a guardian, and the times that follow from it.

use crate::length;
use crate::matrix::REFERENCE_OFFSET_LIMIT;
use crate::schedule::{Role, ScheduleView};
use crate::time::Micros;

/// Longest distance of two stamps that are compared, as in a node.
const LONGEST_TICKS: u32 = 1 << 30;
/// Longest frame of a network with an intermission behind it, in bits: 29-bit identifier, 8 bytes, all
/// stuff bits.
const LONGEST_FRAME_BITS: u32 = 160;
/// Half bits that a line is recessive from look to look when a spell is over. A frame has at most 5
/// recessive bits in a row up to its CRC delimiter.
const SPELL_GAP_HALF_BITS: u32 = 11;
/// Least recessive bits of a TX line before the next frame: the delimiter of a flag, or the end of a
/// frame behind an acknowledge bit, and the intermission (ISO 11898-1).
const FRAME_GAP_BITS: u32 = 11;
/// Difference of the start of frame on the TX line and by a frame's end, in bits: resynchronisation.
const TOLERANCE_BITS: u32 = 2;
/// Largest distance of the end of a frame's spell and an error flag behind it, in bits: up to five
/// recessive bits at the end of the CRC, and the ten bits from there to the end of the frame.
const BEHIND_BITS: u32 = 16;
/// Largest distance of the end of a frame's spell and the next spell of its sender, if that begins up to ten bits after
/// the frame: the end of the CRC as above, and ten bits more. Who loses arbitration has been quiet for at least 34 bits
/// then: the rest of a frame without data, and the intermission.
const NEXT_BITS: u32 = 27;
/// Bits beyond the longest frame that a permitted spell may take: an error flag and one that is
/// begun anew.
pub(super) const FLAG_BITS: u32 = 14;
/// Bits from the closing of a gate until the next frame can begin: a flag of six bits, a delimiter of
/// eight and the interframe space.
const ERROR_BITS: u32 = 17;
/// 2^32 / 10^6, rounded up.
const PPM: u32 = 4295;

/// Configuration of a guardian.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GuardianConfig {
    /// Ticks of the guardian's counter per microsecond, 1 to 1000.
    pub ticks_per_us: u32,
    /// Time from the end of a received frame to its stamp, in ticks; negative if the stamp is
    /// earlier, as with bxCAN ([`StampLatency::bxcan`](crate::StampLatency::bxcan)).
    pub receive_latency: i32,
    /// Spread of that latency, up to 1000 us.
    pub jitter: Micros,
    /// Longest time from one look at the TX lines to the next one: at most 2.75 bits, which is 11 us
    /// at 250 kbit/s. All that delays a look counts.
    pub interval: Micros,
    /// Longest time from the reception of a reference until [`Watch::publish`](super::Watch::publish) has heard of
    /// it. It ends `spell_bits` behind the earliest begin of the first window, because only a short spell
    /// may go on until then. 0 for a [`Guardian`](super::Guardian), which does everything at once.
    pub handling: Micros,
    /// Longest time from a call of [`Judge::rule`](super::Judge::rule) to the next one; 0 for a
    /// [`Guardian`](super::Guardian). Of the spells of a sender between two calls one is counted, so there have to be twice as
    /// many calls in a basic cycle as `pulses`, or a sender of flags would not reach that.
    pub ruling: Micros,
    /// Largest drift of the guardian's counter against the time of the network, in parts per million,
    /// up to 10 000: the sum of the deviations of its own crystal and that of the master.
    pub drift_ppm: u16,
    /// Bits that a sender may drive where it may not begin a frame, 8 to 28. Two flags with a delimiter
    /// between them take 20; a frame needs 34, and the gate is closed up to 5.5 bits late.
    pub spell_bits: u8,
    /// Basic cycles of good conduct after which a sender that was cut may return, at least 1.
    pub penalty: u16,
    /// Basic cycles without a reference after which the guardian has lost the time, 1 to 100.
    pub lost: u8,
    /// Spells beyond the limit in a basic cycle that do not cut a sender yet while the guardian is
    /// not sure of the time, beside one for each window that the sender has in two basic cycles,
    /// and those that it could begin in an arbitrating window.
    pub strikes: u8,
    /// Short spells in a basic cycle that nothing explains, without being cut. The acknowledge bits
    /// of frames that the guardian received do not count, nor does what answers another sender's
    /// flag.
    pub pulses: u8,
    /// Attempts to send a reference in a basic cycle, none of which is received, without being cut.
    /// A CAN controller is bus-off after 32 (ISO 11898-1, transmit error count). Attempts that no
    /// other guarded sender acknowledges or disturbs do not count: they are those of a master that
    /// is alone. The guardian of one node sees no others, and counts while it knows the time.
    pub attempts: u8,
    /// References of a potential master in the middle of a basic cycle, without being cut: a backup's,
    /// or those that the master repeats. One more is granted every eight basic cycles.
    pub untimely: u8,
}

impl core::hash::Hash for GuardianConfig {
    /// The guardians of a network have one configuration.
    fn hash<H: core::hash::Hasher>(&self, state: &mut H) {
        self.ticks_per_us.hash(state);
    }
}

impl GuardianConfig {
    /// The default configuration with this longest time from look to look: no latency, 2 us of
    /// jitter, crystals within 100 ppm (200 ppm of drift), 20 bits, return after 10 basic cycles,
    /// time lost after 4, 4 strikes, 64 pulses, 32 attempts, 4 untimely references.
    pub const fn new(ticks_per_us: u32, interval: Micros) -> Self {
        Self {
            ticks_per_us,
            receive_latency: 0,
            jitter: Micros::micros(2),
            interval,
            handling: Micros::micros(0),
            ruling: Micros::micros(0),
            drift_ppm: 200,
            spell_bits: 20,
            penalty: 10,
            lost: 4,
            strikes: 4,
            pulses: 64,
            attempts: 32,
            untimely: 4,
        }
    }

    /// Checks what depends on nothing but the basic cycle, in microseconds.
    const fn check(&self, basic_cycle: u32) -> Result<(), GuardianError> {
        if self.ticks_per_us == 0 || self.ticks_per_us > 1000 {
            return Err(GuardianError::Ticks);
        }
        if self.penalty == 0 || self.lost == 0 || self.lost > 100 {
            return Err(GuardianError::Cycles);
        }
        if self.drift_ppm > 10_000 {
            return Err(GuardianError::Drift);
        }
        if self.spell_bits < 8 || self.spell_bits > 28 {
            return Err(GuardianError::SpellBits);
        }
        let counts = 2 * self.pulses as u32;
        if self.ruling.ticks().saturating_mul(counts) > basic_cycle {
            return Err(GuardianError::Ruling);
        }
        Ok(())
    }
}

/// Why a guardian cannot be made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GuardianError {
    /// There are no senders or more than 32, or one is there twice.
    Senders,
    /// `ticks_per_us` is not within 1 to 1000, or so large that a bit takes 2^16 ticks or more.
    Ticks,
    /// A time is longer than 2^30 ticks: a penalty, or `lost` basic cycles with the longest gap.
    TooLong,
    /// The latency is longer than half a basic cycle, or the jitter than 1000 us.
    Latency,
    /// The interval is longer than 2.75 bits.
    Interval,
    /// The handling of a reference ends later than a short spell in the first window.
    Handling,
    /// `ruling` is so long that `pulses` may not be reached.
    Ruling,
    /// Halves have more senders than there are looks in a short spell. A look finds the slot of one of those that begin a
    /// frame at once.
    Looks,
    /// The drift is above 10 000 ppm.
    Drift,
    /// `spell_bits` is not within 8 to 28.
    SpellBits,
    /// `penalty` is 0, or `lost` is not within 1 to 100.
    Cycles,
}

impl core::fmt::Display for GuardianError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Senders => "a guardian has 1 to 32 different senders",
            Self::Ticks => {
                "the ticks per microsecond are not within 1 to 1000, or a bit is too long"
            }
            Self::TooLong => "the penalty or the time without references exceeds 2^30 ticks",
            Self::Latency => "the latency exceeds half a basic cycle, or the jitter 1000 us",
            Self::Interval => "the time from look to look exceeds 2.75 bits",
            Self::Handling => {
                "the handling of a reference ends later than a short spell in the first window"
            }
            Self::Ruling => "so seldom as spells are judged, the limit of pulses is not reached",
            Self::Looks => "there are more senders than looks in a short spell",
            Self::Drift => "the drift exceeds 10 000 ppm",
            Self::SpellBits => "a short spell has 8 to 28 bits",
            Self::Cycles => "the penalty is 0 cycles, or the time is not lost after 1 to 100",
        })
    }
}

impl core::error::Error for GuardianError {}

/// Times of the schedule and the configuration in ticks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Times {
    pub(super) config: GuardianConfig,
    /// Length of a bit in 1/256 tick.
    bit: u32,
    pub(super) cycle: u32,
    /// Transmit enable window.
    pub(super) enable: u32,
    /// Largest reference trigger offset.
    pub(super) offset_limit: u32,
    /// From the mark until a reference counts as the next one.
    pub(super) earliest: u32,
    /// How long after the end of the basic cycle a reference may still begin.
    pub(super) late: u32,
    /// How much later than a basic cycle a backup's first reference begins at most: its offset, and a
    /// frame that is on the bus.
    pub(super) takeover: u32,
    /// How long after its reference a master may repeat it.
    pub(super) repeated: u32,
    /// Longest gap.
    pub(super) gap: u32,
    /// From the mark until the time is lost, without a gap.
    pub(super) lost: u32,
    pub(super) penalty: u32,
    /// A line that is recessive from look to look for so long has ended its spell.
    pub(super) spell_gap: u32,
    /// From the middle of an interval to its end.
    pub(super) half_interval: u32,
    /// Largest difference of the stamps of two spells that began at once.
    pub(super) together: u32,
    /// Largest difference of a spell's stamp and the same instant by a received frame.
    pub(super) tolerance: u32,
    /// Largest distance of a frame's spell and an error flag behind it, by their stamps.
    pub(super) behind: u32,
    /// Largest distance of a frame's spell and the next one of its sender, which begins before the frame is told.
    pub(super) next: u32,
    /// Cycle time from which the next reference may begin.
    pub(super) reference_phase: u32,
    /// Longest reference in bits, and with error flags in ticks.
    pub(super) reference_bits: u32,
    pub(super) reference: u32,
    /// So many frames can be begun again, after the gate stopped them, in the arbitrating windows of
    /// one basic cycle.
    pub(super) repetitions: u16,
    /// Uncertainty of the matrix and what the guardian adds to it, without its drift.
    fixed_margin: u32,
    /// Drift in 2^-32.
    drift: u32,
}

/// How many stretches of `each` ticks are in the arbitrating windows of a basic cycle.
fn repetitions(schedule: ScheduleView<'_>, ticks_per_us: u32, each: u32) -> u16 {
    let mut most = 0;
    // There are up to 64 basic cycles.
    for cycle in 0..64 {
        let (first, end) = schedule.entries_of(cycle);
        let mut time = 0u32;
        for at in first..end {
            if let Some(entry) = schedule.entry(at)
                && entry.role == Role::Arbitrating
            {
                time = time.saturating_add(entry.end.saturating_sub(entry.start));
            }
        }
        most = time.max(most);
    }
    let count = most.saturating_mul(ticks_per_us).div_ceil(each.max(1));
    count.min(u32::from(u16::MAX)) as u16
}

/// The least cycle time at which a window begins, in microseconds.
fn first_window(schedule: ScheduleView<'_>) -> u32 {
    let mut least = schedule.network.basic_cycle;
    for cycle in 0..64 {
        let (first, end) = schedule.entries_of(cycle);
        let entry = schedule.entry(first).filter(|_| first < end);
        least = entry.map_or(least, |entry| least.min(entry.start));
    }
    least
}

impl Times {
    /// Checks the configuration.
    pub(super) fn new(
        schedule: ScheduleView<'_>,
        config: GuardianConfig,
    ) -> Result<Self, GuardianError> {
        let network = schedule.network;
        config.check(network.basic_cycle)?;
        let bit = (u64::from(network.bit) * u64::from(config.ticks_per_us)) >> 8;
        if bit >> 24 != 0 {
            return Err(GuardianError::Ticks);
        }
        let bit = bit as u32;
        let ticks = |micros: u32| micros.saturating_mul(config.ticks_per_us);
        let cycle = ticks(network.basic_cycle);
        let gap = ticks(network.longest_gap);
        let penalty = cycle.saturating_mul(u32::from(config.penalty));
        let lost = cycle.saturating_mul(u32::from(config.lost) + 1);
        // Two more basic cycles, so that a late call does not exceed the counter's range.
        let longest = lost
            .saturating_add(gap)
            .saturating_add(cycle.saturating_mul(2));
        if longest > LONGEST_TICKS || penalty > LONGEST_TICKS {
            return Err(GuardianError::TooLong);
        }
        let latency = config.receive_latency.unsigned_abs();
        if latency > cycle / 2 || config.jitter.ticks() > 1000 {
            return Err(GuardianError::Latency);
        }
        // A bit is less than 2^24 and none of the factors above 255.
        let bits = |bits: u32| (bit * bits) >> 8;
        let interval = ticks(config.interval.ticks());
        let spell_gap = (bit * SPELL_GAP_HALF_BITS).div_ceil(512);
        // A look finds the line recessive at the latest one interval behind the end of a spell, and the
        // last one before the next frame is at most another interval ahead of it.
        let shortest = spell_gap.saturating_add(interval.saturating_mul(2));
        if shortest > bits(FRAME_GAP_BITS) {
            return Err(GuardianError::Interval);
        }
        let half_interval = interval.div_ceil(2);
        let jitter = ticks(config.jitter.ticks());
        let reference = network.reference_length;
        let reference_bits =
            length::worst_case_bits(network.reference, network.reference_format.longest());
        // The last backup's offset, and three repetitions behind the first attempt.
        let late = REFERENCE_OFFSET_LIMIT + network.uncertainty + 4 * reference;
        let mut times = Self {
            config,
            bit,
            cycle,
            enable: ticks(network.transmit_enable),
            offset_limit: ticks(REFERENCE_OFFSET_LIMIT),
            earliest: ticks(network.reference_early),
            late: ticks(late),
            takeover: ticks(REFERENCE_OFFSET_LIMIT + network.uncertainty)
                .saturating_add(bits(LONGEST_FRAME_BITS)),
            repeated: ticks(5 * reference),
            gap,
            lost,
            penalty,
            spell_gap,
            half_interval,
            together: interval,
            tolerance: bits(TOLERANCE_BITS)
                .saturating_add(jitter)
                .saturating_add(half_interval),
            behind: bits(BEHIND_BITS).saturating_add(half_interval),
            next: bits(NEXT_BITS).saturating_add(half_interval),
            reference_phase: 0,
            reference_bits,
            reference: bits(reference_bits + FLAG_BITS).saturating_add(half_interval),
            repetitions: repetitions(
                schedule,
                ticks(1),
                bits(u32::from(config.spell_bits) + ERROR_BITS),
            ),
            fixed_margin: ticks(network.uncertainty)
                .saturating_add(jitter.saturating_mul(2))
                .saturating_add(half_interval)
                .saturating_add(bits(TOLERANCE_BITS)),
            drift: u32::from(config.drift_ppm) * PPM,
        };
        let early = times.offset_limit.saturating_add(times.margin(cycle));
        times.reference_phase = cycle.saturating_sub(early);
        let handling = ticks(config.handling.ticks());
        if handling > times.longest_handling(schedule) {
            return Err(GuardianError::Handling);
        }
        Ok(times)
    }

    /// The most ticks from the end of a reference to the end of a short spell that begins as early as it can in
    /// the first window.
    fn longest_handling(&self, schedule: ScheduleView<'_>) -> u32 {
        let first = self.ticks(first_window(schedule));
        let opens = first.saturating_sub(self.margin(first));
        let quiet = opens.saturating_sub(self.bits(self.reference_bits));
        quiet.saturating_add(self.bits(u32::from(self.config.spell_bits)))
    }

    /// Whether as many looks as there are senders fit into a short spell, where looks find one slot each.
    pub(super) fn fits(&self, senders: u32) -> bool {
        let whole = self.config.handling.ticks() == 0;
        let interval = self.ticks(self.config.interval.ticks());
        let looks = interval.saturating_mul(senders);
        whole || looks <= self.bits(u32::from(self.config.spell_bits))
    }

    /// Ticks of a time of the schedule, at most two basic cycles in microseconds.
    pub(super) fn ticks(&self, micros: u32) -> u32 {
        micros.wrapping_mul(self.config.ticks_per_us)
    }

    /// Ticks of up to 255 bits. A bit is less than 2^24, see `new`.
    pub(super) fn bits(&self, bits: u32) -> u32 {
        self.bit.wrapping_mul(bits) >> 8
    }

    /// Uncertainty of a cycle time in ticks.
    pub(super) fn margin(&self, elapsed: u32) -> u32 {
        let drift = (u64::from(elapsed) * u64::from(self.drift)) >> 32;
        self.fixed_margin.wrapping_add(drift as u32)
    }
}
