//! Compares facts that the HAL states in its own form with the crate `parts`, at build time.

use crate::pac::{self, Interrupt};
use core::marker::PhantomData;
use parts::{Family, SLED_F446, interrupt};
use stm32f4xx_hal::gpio::{self, Pin};

const PART: &parts::Part = SLED_F446.part;

const fn dma_is(controller: usize, unit: usize, number: Interrupt) -> bool {
    interrupt::dma(PART.family, controller, unit) == number as u16
}

const _: () = assert!(
    interrupt::PVD == Interrupt::PVD as u16
        && interrupt::TIM2 == Interrupt::TIM2 as u16
        && interrupt::TIM2 + 1 == Interrupt::TIM3 as u16
        && interrupt::TIM2 + 2 == Interrupt::TIM4 as u16
        && interrupt::TIM7 == Interrupt::TIM7 as u16
        && interrupt::USART1 == Interrupt::USART1 as u16
        && interrupt::USART1 + 1 == Interrupt::USART2 as u16
        && interrupt::USART1 + 2 == Interrupt::USART3 as u16
        && interrupt::ADC == Interrupt::ADC as u16
        && interrupt::CAN == Interrupt::CAN1_TX as u16
        && interrupt::CAN + 1 == Interrupt::CAN1_RX0 as u16
        && interrupt::CAN + 2 == Interrupt::CAN1_RX1 as u16
        && interrupt::CAN + 3 == Interrupt::CAN1_SCE as u16
        && dma_is(0, 0, Interrupt::DMA1_STREAM0)
        && dma_is(0, 3, Interrupt::DMA1_STREAM3)
        && dma_is(0, 6, Interrupt::DMA1_STREAM6)
        && dma_is(0, 7, Interrupt::DMA1_STREAM7)
        && dma_is(1, 0, Interrupt::DMA2_STREAM0)
        && dma_is(1, 2, Interrupt::DMA2_STREAM2)
        && dma_is(1, 5, Interrupt::DMA2_STREAM5)
        && dma_is(1, 7, Interrupt::DMA2_STREAM7),
    "the interrupt numbers are those of the peripheral access crate"
);

const _: () = assert!(
    matches!(PART.family, Family::F4) && PART.priority_bits == pac::NVIC_PRIO_BITS,
    "family and priorities are those of the peripheral access crate"
);

/// True if the HAL's pin type is the pin that `parts` wires a line of a connector to.
const fn wired<const PORT: char, const NUMBER: u8, MODE>(
    _: PhantomData<Pin<PORT, NUMBER, MODE>>,
    connector: &str,
    signal: &str,
) -> bool {
    match SLED_F446.pin(connector, signal) {
        Some(pin) => pin.port == PORT && pin.number == NUMBER,
        None => false,
    }
}

/// True if the HAL's pin types are those of a tap.
const fn tapped<const LINE: u8, const GATE: u8, L, G>(
    _: PhantomData<Pin<'C', LINE, L>>,
    _: PhantomData<Pin<'C', GATE, G>>,
    tap: usize,
) -> bool {
    let tap = SLED_F446.taps[tap];
    tap.line.port == 'C'
        && tap.line.number == LINE
        && tap.gate.port == 'C'
        && tap.gate.number == GATE
}

const _: () = assert!(
    tapped(PhantomData::<gpio::PC0>, PhantomData::<gpio::PC6>, 0)
        && tapped(PhantomData::<gpio::PC1>, PhantomData::<gpio::PC7>, 1)
        && tapped(PhantomData::<gpio::PC2>, PhantomData::<gpio::PC8>, 2)
        && tapped(PhantomData::<gpio::PC3>, PhantomData::<gpio::PC9>, 3)
        && SLED_F446.taps.len() == 4,
    "the taps that this crate uses are those of the crate parts"
);

const _: () = assert!(
    wired(PhantomData::<gpio::PB9>, "can", "tx")
        && wired(PhantomData::<gpio::PB8>, "can", "rx")
        && wired(PhantomData::<gpio::PA2>, "console", "tx")
        && wired(PhantomData::<gpio::PA3>, "console", "rx")
        && wired(PhantomData::<gpio::PA5>, "led", "led")
        && wired(PhantomData::<gpio::PA9>, "receiver", "tx")
        && wired(PhantomData::<gpio::PA10>, "receiver", "rx")
        && wired(PhantomData::<gpio::PC10>, "display", "tx")
        && wired(PhantomData::<gpio::PC11>, "display", "rx")
        && wired(PhantomData::<gpio::PA0>, "joystick", "x")
        && wired(PhantomData::<gpio::PA1>, "joystick", "y")
        && wired(PhantomData::<gpio::PC0>, "inputs", "a")
        && wired(PhantomData::<gpio::PC1>, "inputs", "b")
        && wired(PhantomData::<gpio::PC2>, "inputs", "c")
        && wired(PhantomData::<gpio::PC3>, "inputs", "d")
        && wired(PhantomData::<gpio::PC4>, "inputs", "joystick-switch")
        && wired(PhantomData::<gpio::PC5>, "inputs", "stop-loop"),
    "the pin types that this crate uses are the pins of the crate parts"
);
