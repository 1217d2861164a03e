//! The node of `can-node` with embassy, on a Nucleo-F446RE with a CAN transceiver: CAN RX at PB8, CAN TX at PB9. With
//! PC0 at ground it is the echo, otherwise the master. `ttcan/HOWTO.md` leads through it.
//!
//! The interrupts of the controller take the stamps and fill a queue. The node is one task, in an executor of its own
//! above all that may take longer.

#![no_std]
#![no_main]

mod bx_can;
#[path = "../../src/mailbox.rs"]
mod mailbox;
#[path = "../../src/network.rs"]
mod network;

use bx_can::BxCan;
use embassy_executor::InterruptExecutor;
use embassy_futures::select::{Either, select};
use embassy_stm32::gpio::{AfType, Flex, Input, OutputType, Pull, Speed};
use embassy_stm32::interrupt::{InterruptExt, Priority};
use embassy_stm32::time::Hertz;
use embassy_stm32::{Config, interrupt, pac, rcc};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::channel::Channel;
use embassy_time::{Duration, Instant, Timer};
use network::{BIT_RATE, Driver, ECHO, MASTER, SCHEDULE};
use ttcan::{
    BitTiming, Frame, Grant, Node, NodeConfig, NodeId, Reception, Stamp, StampLatency, SyncState,
    TransmitOutcome,
};

/// Clock of APB1, MHz.
const APB1_MHZ: u32 = 40;
const TIMING: BitTiming = BitTiming::constant::<{ APB1_MHZ * 1_000_000 }, BIT_RATE>();
/// A bit, in ticks of embassy's clock: 1 us.
const BIT: u32 = 1_000_000 / BIT_RATE;
/// From the deadline of a window to its frame on the bus, ticks: the executor wakes the task, which loads the mailbox.
const LEAD: u32 = 32;
/// How long the node stays off the bus after S3, ticks: 1 s.
const PAUSE: u32 = 1_000_000;

/// What an interrupt of the controller reports.
enum Report {
    /// A frame was received.
    Received(Frame, Stamp),
    /// The transmission that was requested last has ended.
    Ended(TransmitOutcome, Stamp),
}

/// From the interrupts to the task. A basic cycle brings three reports.
static REPORTS: Channel<CriticalSectionRawMutex, Report, 8> = Channel::new();
static EXECUTOR: InterruptExecutor = InterruptExecutor::new();

/// The clock of all stamps.
fn now() -> Stamp {
    Stamp(Instant::now().as_ticks() as u32)
}

/// Waits until the clock has reached `stamp`.
async fn reach(stamp: Stamp) {
    let left = stamp.0.wrapping_sub(now().0).cast_signed();
    if let Ok(left @ 1..) = u64::try_from(left) {
        Timer::after(Duration::from_ticks(left)).await;
    }
}

/// The task of a node.
#[embassy_executor::task]
async fn run(mut driver: Driver<BxCan>) {
    let leads = driver.node.id() == MASTER;
    let mut number = leads.then_some(0_u32);
    driver.node.start(now());
    loop {
        let deadline = driver.next_deadline(now());
        let due = reach(deadline.unwrap_or(now().after(PAUSE)));
        match select(REPORTS.receive(), due).await {
            Either::First(Report::Received(frame, stamp)) => {
                if let Some(Reception::Scheduled { .. }) = driver.handle_receive(&frame, stamp)
                    && !leads
                {
                    let [a, b, c, d, ..] = frame.buffer();
                    number = Some(u32::from_le_bytes([a, b, c, d]));
                }
            }
            Either::First(Report::Ended(outcome, stamp)) => driver.handle_transmit(outcome, stamp),
            Either::Second(()) => open(&mut driver, &mut number, leads),
        }
    }
}

/// A deadline of the node has come.
fn open(driver: &mut Driver<BxCan>, number: &mut Option<u32>, leads: bool) {
    let now = now();
    if driver.controller.is_bus_off() {
        driver.node.handle_bus_off();
    }
    if driver.node.status().sync == SyncState::Off && !driver.node.is_due(now) {
        // The pause is over.
        driver.controller.join();
        driver.node.start(now);
    }
    driver.handle_timer(now, |_: Grant| {
        let number = number.as_mut()?;
        if leads {
            *number = number.wrapping_add(1);
        }
        let [a, b, c, d] = number.to_le_bytes();
        Some([a, b, c, d, 0, 0, 0, 0])
    });
}

/// An oscillator of 8 MHz from the debugger's part; core and buses 40 MHz.
///
/// With a faster core APB1 needs a divider. `embassy-stm32` 0.6 sets it by the write that switches the clock over, and it may
/// take up to 16 cycles longer (RM0390 6.3.3), in which the bus is too fast. Dividers that are not used must be
/// valid, too.
fn clocks() -> Config {
    let mut config = Config::default();
    config.rcc.hse = Some(rcc::Hse {
        freq: Hertz::mhz(8),
        mode: rcc::HseMode::Bypass,
    });
    config.rcc.pll_src = rcc::PllSource::HSE;
    config.rcc.pll = Some(rcc::Pll {
        prediv: rcc::PllPreDiv::DIV4,
        mul: rcc::PllMul::MUL80,
        divp: Some(rcc::PllPDiv::DIV4),
        divq: Some(rcc::PllQDiv::DIV4),
        divr: Some(rcc::PllRDiv::DIV2),
    });
    config.rcc.sys = rcc::Sysclk::PLL1_P;
    config
}

/// Which node this board is, by its strap.
fn role(strap: &Input<'_>) -> NodeId {
    if strap.is_low() { ECHO } else { MASTER }
}

#[cortex_m_rt::entry]
fn main() -> ! {
    let parts = embassy_stm32::init(clocks());
    let id = role(&Input::new(parts.PC0, Pull::Up));
    let (mut rx, mut tx) = (Flex::new(parts.PB8), Flex::new(parts.PB9));
    rx.set_as_af_unchecked(9, AfType::input(Pull::None));
    tx.set_as_af_unchecked(9, AfType::output(OutputType::PushPull, Speed::High));
    pac::RCC.apb1enr().modify(|w| w.set_can1en(true));
    cortex_m::asm::delay(16);
    let config = NodeConfig {
        latency: StampLatency::bxcan(BIT, 1),
        transmit_lead: LEAD,
        ..NodeConfig::new(id, 1)
    };
    if let Ok(node) = Node::new(SCHEDULE.view(), config) {
        let driver = Driver::new(node, BxCan::new(TIMING));
        // The executor below the interrupts that take the stamps, and above everything else.
        interrupt::UART4.set_priority(Priority::P2);
        if let Ok(task) = run(driver) {
            EXECUTOR.start(interrupt::UART4).spawn(task);
        }
        for interrupt in [interrupt::CAN1_RX0, interrupt::CAN1_TX] {
            interrupt.set_priority(Priority::P1);
            // SAFETY: their handlers use the queue and registers of their own only.
            unsafe { interrupt.enable() };
        }
    }
    loop {
        cortex_m::asm::wfi();
    }
}

/// Lends its vector to the executor.
#[interrupt]
fn UART4() {
    // SAFETY: called from here only.
    unsafe { EXECUTOR.on_interrupt() }
}

#[interrupt]
fn CAN1_RX0() {
    let stamp = now();
    if let Some(frame) = bx_can::receive() {
        // A report that finds no room is noticed by the node as a message that is missing.
        let _ = REPORTS.try_send(Report::Received(frame, stamp));
    }
}

#[interrupt]
fn CAN1_TX() {
    let stamp = now();
    if let Some(outcome) = bx_can::outcome() {
        let _ = REPORTS.try_send(Report::Ended(outcome, stamp));
    }
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    cortex_m::peripheral::SCB::sys_reset()
}
