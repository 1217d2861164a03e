//! The events whose cycles are counted, and the preparation of each.

#![no_std]
#![no_main]
#![forbid(unsafe_code)]

#[path = "../../../kernels.rs"]
mod kernels;

use core::panic::PanicInfo;

use kernels::{Event, Few, Guarded, Kernel, Many, Watch, few, many, watch};

/// Makes a node that is right before an event.
pub type Prepare<N> = fn(&mut Option<Kernel<N>>);
/// Runs the event. Returns 1 if the result is as expected.
pub type Run<N> = fn(&mut Option<Kernel<N>>) -> u32;

macro_rules! prepare {
    ($($name:ident = $make:ident($event:ident) -> $node:ty;)*) => {
        $(
            #[inline(never)]
            fn $name(place: &mut Option<Kernel<$node>>) {
                *place = $make(Event::$event);
            }
        )*
    };
}

prepare! {
    prepare_few_data = few(ReceiveMessage) -> Few;
    prepare_few_reference = few(ReceiveReference) -> Few;
    prepare_few_window = few(TransmitWindow) -> Few;
    prepare_many_data = many(ReceiveMessage) -> Many;
    prepare_many_reference = many(ReceiveReference) -> Many;
    prepare_many_window = many(TransmitWindow) -> Many;
}

#[inline(never)]
fn run_few(place: &mut Option<Kernel<Few>>) -> u32 {
    place.as_mut().is_some_and(Kernel::<Few>::run).into()
}

#[inline(never)]
fn run_many(place: &mut Option<Kernel<Many>>) -> u32 {
    place.as_mut().is_some_and(Kernel::<Many>::run).into()
}

macro_rules! prepare_guardian {
    ($($name:ident = $event:ident;)*) => {
        $(
            #[inline(never)]
            fn $name(place: &mut Option<Watch>) {
                *place = watch(Guarded::$event);
            }
        )*
    };
}

prepare_guardian! {
    prepare_guardian_rest = Rest;
    prepare_guardian_begin = Begin;
    prepare_guardian_follow = Follow;
    prepare_guardian_beginall = BeginAll;
    prepare_guardian_followall = FollowAll;
    prepare_guardian_ahead = Ahead;
    prepare_guardian_message = Message;
    prepare_guardian_reference = Reference;
}

#[inline(never)]
fn run_guardian(place: &mut Option<Watch>) -> u32 {
    place.as_mut().is_some_and(Watch::run).into()
}

/// Makes a guardian that is right before an event.
pub type PrepareGuardian = fn(&mut Option<Watch>);
/// Runs its event. Returns 1 if the result is as expected.
pub type RunGuardian = fn(&mut Option<Watch>) -> u32;

/// All functions of the guardian.
#[used]
pub static GUARDIAN: ([PrepareGuardian; 8], RunGuardian) = (
    [
        prepare_guardian_rest,
        prepare_guardian_begin,
        prepare_guardian_follow,
        prepare_guardian_beginall,
        prepare_guardian_followall,
        prepare_guardian_ahead,
        prepare_guardian_message,
        prepare_guardian_reference,
    ],
    run_guardian,
);
/// All functions with 8 windows, so that the linker keeps them.
#[used]
pub static FEW: ([Prepare<Few>; 3], Run<Few>) = (
    [prepare_few_data, prepare_few_reference, prepare_few_window],
    run_few,
);
/// All functions with 512 windows.
#[used]
pub static MANY: ([Prepare<Many>; 3], Run<Many>) = (
    [
        prepare_many_data,
        prepare_many_reference,
        prepare_many_window,
    ],
    run_many,
);

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    loop {}
}
