//! Compares facts that the HAL states in its own form with the crate `parts`, at build time.

use crate::pac::{self, Interrupt};
use core::marker::PhantomData;
use parts::{Family, SLED_F303, interrupt};
use stm32f3xx_hal::gpio::{self, Gpioa, Gpiob, Pin, U};

const PART: &parts::Part = SLED_F303.part;

const fn dma_is(unit: usize, number: Interrupt) -> bool {
    interrupt::dma(PART.family, 0, unit) == number as u16
}

const _: () = assert!(
    interrupt::TIM2 == Interrupt::TIM2 as u16
        && interrupt::TIM2 + 1 == Interrupt::TIM3 as u16
        && interrupt::TIM7 == Interrupt::TIM7 as u16
        && interrupt::USART1 == Interrupt::USART1_EXTI25 as u16
        && interrupt::USART1 + 1 == Interrupt::USART2_EXTI26 as u16
        && interrupt::ADC == Interrupt::ADC1_2 as u16
        && interrupt::CAN == Interrupt::USB_HP_CAN_TX as u16
        && interrupt::CAN + 1 == Interrupt::USB_LP_CAN_RX0 as u16
        && interrupt::CAN + 2 == Interrupt::CAN_RX1 as u16
        && interrupt::CAN + 3 == Interrupt::CAN_SCE as u16
        && dma_is(0, Interrupt::DMA1_CH1)
        && dma_is(3, Interrupt::DMA1_CH4)
        && dma_is(6, Interrupt::DMA1_CH7),
    "the interrupt numbers are those of the peripheral access crate"
);

const _: () = assert!(
    matches!(PART.family, Family::F3) && PART.priority_bits == pac::NVIC_PRIO_BITS,
    "family and priorities are those of the peripheral access crate"
);

/// The letter of a port.
trait Letter {
    const LETTER: char;
}

impl Letter for Gpioa {
    const LETTER: char = 'A';
}

impl Letter for Gpiob {
    const LETTER: char = 'B';
}

/// True if the HAL's pin type is the pin that `parts` wires a line of a connector to.
const fn wired<PORT: Letter, const NUMBER: u8, MODE>(
    _: PhantomData<Pin<PORT, U<NUMBER>, MODE>>,
    connector: &str,
    signal: &str,
) -> bool {
    match SLED_F303.pin(connector, signal) {
        Some(pin) => pin.port == PORT::LETTER && pin.number == NUMBER,
        None => false,
    }
}

const _: () = assert!(
    wired(PhantomData::<gpio::PA12<()>>, "can", "tx")
        && wired(PhantomData::<gpio::PA11<()>>, "can", "rx")
        && wired(PhantomData::<gpio::PA2<()>>, "console", "tx")
        && wired(PhantomData::<gpio::PA15<()>>, "console", "rx")
        && wired(PhantomData::<gpio::PB3<()>>, "led", "led")
        && wired(PhantomData::<gpio::PA9<()>>, "motor", "tx")
        && wired(PhantomData::<gpio::PA8<()>>, "motor", "relay")
        && wired(PhantomData::<gpio::PB0<()>>, "motor", "sense")
        && wired(PhantomData::<gpio::PA0<()>>, "pot", "wiper")
        && wired(PhantomData::<gpio::PA1<()>>, "distances", "left")
        && wired(PhantomData::<gpio::PA3<()>>, "distances", "right")
        && wired(PhantomData::<gpio::PA7<()>>, "servos", "left")
        && wired(PhantomData::<gpio::PA10<()>>, "servos", "right")
        && wired(PhantomData::<gpio::PB5<()>>, "remote", "run")
        && wired(PhantomData::<gpio::PB4<()>>, "remote", "stop"),
    "the pin types that this crate uses are the pins of the crate parts"
);
