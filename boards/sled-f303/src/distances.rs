//! The two distance sensors: PA1 and PA3, ADC1 channels 2 and 4, in bursts of 50 samples each,
//! stored by DMA1 channel 1 (thesis 2.2.5.1).
//!
//! A burst takes 100 conversions of 74 cycles each of the converter's clock, half the core's: 206
//! us on the external clock, 231 us on the RC oscillator. It begins with the left sensor. At its end
//! comes one interrupt, that of DMA1 channel 1, whose task calls [`Distances::take`].
//!
//! The memory is read only while nothing writes it: the DMA channel stops by itself after the last
//! sample, and the next burst can begin only after `take` has read them all.

use crate::pac;
use crate::registers::dma::{self, End};
use crate::registers::{burst, scan, timer};
use sled_common::burst::{BurstError, LENGTH, Means};
use sled_common::dma::{Shared, Window};
use stm32f3xx_hal::dma::{Channel, Event, dma1::C1};

/// Bursts per second that the timer begins (thesis 2.2.5.1).
pub const BURST_HZ: u32 = 200;

static MEMORY: Shared<u16, LENGTH> = Shared::new(0);

/// What begins a burst.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trigger {
    /// TIM3, [`BURST_HZ`] times a second.
    Timer,
    /// [`Distances::begin`].
    Software,
}

/// The distance sensors.
pub struct Distances {
    adc: pac::ADC1,
    channel: C1,
    memory: Window<u16, LENGTH>,
    trigger: Trigger,
    /// A burst has begun by software, and its end was not taken.
    running: bool,
    /// A burst's end was taken since the last call of [`Distances::watch`].
    taken: bool,
}

/// Starts the converter. The clock gates of ADC1 and TIM3 are open; `core` and `timer_clock` are in
/// hertz. `None` when the converter does not get ready, or the second time.
pub(crate) fn start(
    adc: pac::ADC1,
    common: &pac::ADC1_2,
    clock: &pac::TIM3,
    mut channel: C1,
    core: u32,
    timer_clock: u32,
    trigger: Trigger,
) -> Option<Distances> {
    let memory = MEMORY.take()?;
    scan::enable(&adc, common, core)?;
    burst::select(&adc);
    let registers = registers();
    dma::set_register(registers, scan::data_register(&adc));
    dma::set_row_of_half_words(registers);
    channel.enable_interrupt(Event::TransferComplete);
    channel.enable_interrupt(Event::TransferError);
    let mut distances = Distances {
        adc,
        channel,
        memory,
        trigger,
        running: false,
        taken: false,
    };
    distances.renew();
    if trigger == Trigger::Timer {
        timer::start::<BURST_HZ>(clock, timer_clock);
    }
    Some(distances)
}

fn registers() -> &'static pac::dma1::CH {
    // SAFETY: the channel is this module's.
    unsafe { &(*pac::DMA1::ptr()).ch1 }
}

impl Distances {
    /// Begins a burst now; it is for [`Trigger::Software`], and does nothing otherwise.
    ///
    /// # Errors
    /// The burst before has not ended, or its end was not taken: why. It is given up, and the new
    /// one begins, unless the converter is stuck.
    pub fn begin(&mut self) -> Result<(), BurstError> {
        if self.trigger == Trigger::Timer {
            return Ok(());
        }
        let before = if self.running { self.give_up() } else { Ok(()) };
        if before != Err(BurstError::Stuck) {
            self.running = true;
            burst::begin(&self.adc);
        }
        before
    }

    /// Acknowledges the interrupt at the end of a burst and gives its means. With
    /// [`Trigger::Timer`] the converter then waits for the next edge of the timer.
    ///
    /// # Errors
    /// The burst has not ended, or the DMA channel failed, which ends it. Or the converter does not
    /// stop, which the next [`Distances::begin`] or [`Distances::watch`] tries again.
    #[inline]
    pub fn take(&mut self) -> Result<Means, BurstError> {
        match dma::end_1() {
            End::Running => Err(BurstError::Unfinished),
            End::Failed => {
                self.stop_and_renew()?;
                Err(BurstError::Transfer)
            }
            End::Complete => {
                let means = Means::of(|index| self.memory.read(index).unwrap_or(0));
                self.stop_and_renew()?;
                self.taken = true;
                Ok(means)
            }
        }
    }

    /// Looks whether bursts end. Call it at intervals of two periods of the timer or more. With
    /// [`Trigger::Software`] the next [`Distances::begin`] tells, and this does nothing.
    ///
    /// # Errors
    /// No burst has ended since the last call: why. The converter starts anew.
    pub fn watch(&mut self) -> Result<(), BurstError> {
        if self.trigger == Trigger::Software || core::mem::take(&mut self.taken) {
            return Ok(());
        }
        self.give_up()
    }

    /// Gives a burst up: always an error, which says why it had not ended.
    fn give_up(&mut self) -> Result<(), BurstError> {
        let why = if burst::has_overrun(&self.adc) {
            BurstError::Overrun
        } else {
            BurstError::Unfinished
        };
        self.stop_and_renew()?;
        Err(why)
    }

    fn stop_and_renew(&mut self) -> Result<(), BurstError> {
        if !burst::stop(&self.adc) {
            return Err(BurstError::Stuck);
        }
        self.renew();
        Ok(())
    }

    /// Makes DMA channel and converter ready for a burst. The converter is stopped.
    fn renew(&mut self) {
        self.running = false;
        self.channel.disable();
        // The flags of a burst that was given up.
        dma::end_1();
        dma::set_memory(registers(), self.memory.address(), self.memory.len());
        self.channel.enable();
        let by_timer = self.trigger == Trigger::Timer;
        burst::prepare(&self.adc, by_timer);
        if by_timer {
            burst::begin(&self.adc);
        }
    }
}
