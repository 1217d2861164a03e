//! The controller node: modes, states, control law, logging messages, operator's panel and
//! display; backup time master.
//!
//! | task | bound to | priority | does |
//! | --- | --- | --- | --- |
//! | `can_rx` | receive FIFO 0 | 6 | stamps, feeds the protocol stack |
//! | `can_tx` | mailbox empty | 6 | stamps, reports the outcome |
//! | `can_error` | status change | 6 | bus-off |
//! | `window_timer` | TIM2 | 6 | channel 1 loads the mailbox, channel 2 releases `control` |
//! | `display_rx` | USART3 | 6 | the display's answers |
//! | `control` | EXTI1, pended by software | 5 | one step for each basic cycle: message 300 |
//! | `record` | EXTI4, pended by software | 4 | behind `control`: messages 450-453, changes of mode, prediction |
//! | `scan` | DMA2 stream 0 | 4 | 200 Hz: joystick, buttons |
//! | `console_dma` | DMA1 stream 6 | 3 | next console line |
//! | `SysTick` | SysTick | 3 | 100 Hz: the tick of `rtic-monotonics`, wakes `housekeeping` |
//! | `display_dma` | DMA1 stream 3 | 2 | end of the display's string |
//! | `display_tick` | TIM4 | 2 | 5 Hz, and when a node is in trouble: builds and sends the display's string |
//! | `housekeeping` | software, by EXTI2 | 2 | 100 Hz: watchdog, status, bus recovery, LED |
//! | `plan` | EXTI0, pended by software | 1 | with missions only: requests, and the path ahead of the vehicle |
//! | `console` | EXTI3, pended by software | 1 | 10 Hz lines |

#![no_std]
#![no_main]

use defmt_rtt as _;

firmware::tick!();

#[rtic::app(device = firmware::board::pac, peripherals = true, dispatchers = [EXTI2])]
mod app {
    use super::Mono;
    use firmware::board::fault::Fault;
    use firmware::board::{
        self,
        lcd::{Lcd, Replies, Tick},
        pac::Interrupt,
        panel::{self, Joystick},
        time::Clock,
    };
    use firmware::buttons::{Buttons, Untold};
    use firmware::console::{self as lines, BusView};
    use firmware::display::{self, Lk204, Supervision};
    use firmware::e2e::{self, Secret};
    use firmware::housekeeping::Start;
    use firmware::log::Own;
    use firmware::node::{self, Keeper, Log, Pace};
    use firmware::peers::Trouble;
    use firmware::pilot::Change;
    use firmware::selftest::{Motor, Report};
    use firmware::text::Text;
    use firmware::{design, fault};
    use network::Message as _;
    use rtic::Mutex as _;
    use uagv::design::{CONTROL_RELEASE, REMOTE};
    use uagv::matrix::{BASIC_CYCLE, CONTROLLER, NAMES, window};
    use uagv::messages::{ButtonEvent, ControllerStatus, ModeChange};
    #[cfg(mission)]
    use uagv::messages::{MissionAnswer, MissionEvent};
    // RTIC names the type of a resource even where it is switched off.
    use uagv::mission;
    use uagv::session::{self, Session};
    use uagv::wire::{self, Record};
    use uagv::{Link, Pilot, Stack, guide, identity, peers, tilt};

    /// What the control step works on. One resource, because each lock costs the step time.
    pub struct Driving {
        pilot: Pilot,
        /// What is known of roll and pitch.
        tilt: tilt::Watch,
        buttons: Buttons,
        /// Latest samples of the joystick, x and y.
        axes: (u16, u16),
        /// A change of mode that `record` has not sent yet.
        change: Option<Change>,
        /// Which of the other nodes does not do its part on the bus.
        trouble: Option<Trouble>,
        /// What the operator sees of the mission.
        shown: mission::Shown,
        /// A session in which `control` does not seal yet.
        session: session::News,
    }

    #[shared]
    struct Shared {
        clock: Clock,
        link: Link,
        driving: Driving,
        lcd: Lcd,
        /// A refresh of the display waits until the string before it is sent.
        refresh_due: bool,
        supervision: Supervision,
        console: board::console::Console,
        /// The last self-test.
        test: Option<Report>,
        /// Requests for the mission.
        requests: mission::Requests,
    }

    #[local]
    struct Local {
        joystick: Joystick,
        inputs: panel::Buttons,
        untold: Untold,
        mode_events: u8,
        sender: e2e::Sender,
        replies: Replies,
        tick: Tick,
        screen: Text<{ display::CAPACITY }>,
        keeper: Keeper,
        log: Log,
        session: Session,
        #[cfg(mission)]
        mission: mission::Plan,
        #[cfg(mission)]
        flash: board::flash::Writer,
    }

    #[init(local = [stack: Option<Stack> = None, words: mission::Words = mission::Words::new()])]
    fn init(mut cx: init::Context) -> (Shared, Local) {
        let record = board::fault::take();
        let sled = uagv::start(cx.device);
        let start = Start {
            cause: sled.reset_cause,
            record,
            clocks: sled.clocks,
            secret: Secret::read(&sled.secret),
        };
        let (Some(operator), Ok(mut pilot)) = (sled.rest.operator(), Pilot::new()) else {
            fault::stop(Fault::Start)
        };
        let session = Session::of_sender(start.secret);
        guide::set_secret(&mut pilot, session.secret());
        #[cfg(mission)]
        let Ok(mission) = mission::plan(&mut pilot, sled.mission, cx.local.words, &start.secret)
        else {
            fault::stop(Fault::Start)
        };
        // Behind whatever stores through addresses that only the running program knows: the analysis of execution
        // times would forget where the node's schedule is.
        let Ok(mut link) = node::link(
            cx.local.stack,
            identity(CONTROLLER),
            &start,
            sled.can,
            sled.clock,
            sled.alarms,
        ) else {
            fault::stop(Fault::Start)
        };
        link.release_in(BASIC_CYCLE);
        let _ = housekeeping::spawn();
        (
            Shared {
                clock: sled.clock,
                link,
                driving: Driving {
                    pilot,
                    tilt: tilt::Watch::new(),
                    buttons: Buttons::default(),
                    axes: (design::JOYSTICK_CENTRE, design::JOYSTICK_CENTRE),
                    change: None,
                    trouble: None,
                    shown: mission::Shown::default(),
                    session: Some(session.secret()),
                },
                lcd: operator.lcd,
                refresh_due: false,
                supervision: Supervision::default(),
                console: sled.console,
                test: None,
                requests: mission::Requests::new(),
            },
            Local {
                joystick: operator.joystick,
                inputs: operator.buttons,
                untold: Untold::default(),
                mode_events: 0,
                sender: e2e::Sender::new(start.secret),
                replies: operator.replies,
                tick: operator.tick,
                screen: Text::new(),
                keeper: Keeper::start::<Mono>(
                    cx.core.SYST,
                    &mut cx.core.SCB,
                    sled.led,
                    sled.watchdog,
                    &start,
                    &sled.findings,
                ),
                log: Log::new(&start),
                session,
                #[cfg(mission)]
                mission,
                #[cfg(mission)]
                flash: sled.flash,
            },
        )
    }

    #[idle]
    fn idle(_: idle::Context) -> ! {
        loop {
            rtic::export::wfi();
        }
    }

    #[task(binds = CAN1_RX0, priority = 6, shared = [&clock, link, requests])]
    fn can_rx(cx: can_rx::Context) {
        let stamp = cx.shared.clock.now();
        (cx.shared.link, cx.shared.requests).lock(|link, requests| {
            let news = link.on_receive_keeping(stamp, |frame| requests.push(frame));
            if news.reference {
                link.release_at(CONTROL_RELEASE);
            }
        });
    }

    #[task(binds = CAN1_TX, priority = 6, shared = [&clock, link])]
    fn can_tx(mut cx: can_tx::Context) {
        let stamp = cx.shared.clock.now();
        cx.shared.link.lock(|link| {
            if link.on_transmit(stamp) {
                link.release_at(CONTROL_RELEASE);
            }
        });
    }

    #[task(binds = CAN1_SCE, priority = 6, shared = [link])]
    fn can_error(mut cx: can_error::Context) {
        cx.shared.link.lock(|link| link.on_error());
    }

    #[task(binds = TIM2, priority = 6, shared = [link])]
    fn window_timer(mut cx: window_timer::Context) {
        cx.shared.link.lock(|link| {
            if link.on_timer() {
                rtic::pend(Interrupt::EXTI1);
                // Without references the control step is released by its own period.
                link.release_in(BASIC_CYCLE);
            }
        });
    }

    /// Deadline: the beginning of the command's window, 600 us after the release. A step that
    /// misses it leaves the window empty; after two empty windows the actuators stop.
    #[task(binds = EXTI1, priority = 5, shared = [link, driving], local = [sender])]
    fn control(cx: control::Context) {
        let (mut link, mut driving) = (cx.shared.link, cx.shared.driving);
        let (mut inputs, seen, frame, time, believed) = link.lock(|link| {
            let inputs = wire::inputs(link);
            (
                inputs,
                tilt::take(link),
                guide::take(link),
                link.cycle_began(),
                link.is_time_believed(),
            )
        });
        let command = driving.lock(|driving| {
            inputs.joystick = driving.axes;
            guide::see(&mut driving.pilot, frame, time);
            let Driving { pilot, tilt, .. } = driving;
            tilt.step(pilot, &mut inputs, seen);
            let (decision, change) = driving.pilot.step(&inputs, &driving.buttons);
            if change.is_some() {
                driving.change = change;
            }
            let sender = cx.local.sender;
            session::change(sender, &mut driving.session);
            let command = wire::command(&decision, sender, time);
            (believed && session::can_seal(sender)).then_some(command)
        });
        link.lock(|link| link.replace(window::COMMAND, command));
        rtic::pend(Interrupt::EXTI4);
    }

    /// What may wait until the command is enqueued: messages, and the estimator's prediction for the
    /// next step. Deadline: the beginning of the window of message 450, 1000 us after the command's; and
    /// the next step, which needs the prediction and may change the mode again.
    #[task(binds = EXTI4, priority = 4, shared = [link, driving], local = [mode_events])]
    fn record(cx: record::Context) {
        let (mut link, mut driving) = (cx.shared.link, cx.shared.driving);
        let (decision, change, told, tilted) = driving.lock(|driving| {
            let pilot = &driving.pilot;
            (
                pilot.decision(),
                driving.change.take(),
                guide::log(pilot),
                driving.tilt.state(),
            )
        });
        // A section of its own, because it blocks the interrupts of the bus.
        let peers = link.lock(|link| peers::of(link));
        let record = Record::of(&decision, &peers);
        link.lock(|link| {
            link.put(window::LOG_POSITION, record.position);
            link.put(window::LOG_MOTION, record.motion);
            link.put(window::LOG_GUIDANCE, record.guidance);
            link.put(window::LOG_CONTROL, record.control);
            guide::put(link, told, &peers);
            tilt::Watch::put(link, tilted);
        });
        if let Some(change) = change {
            *cx.local.mode_events = cx.local.mode_events.wrapping_add(1);
            let count = *cx.local.mode_events;
            link.lock(|link| {
                let data = wire::mode_change(&change, count, link.system_time()).encode();
                // The stack counts the events that a full queue refuses; message 300 has
                // the mode, too.
                let _ = link.queue_event(ModeChange::ID, &data, design::EVENT_LIFETIME);
            });
        }
        driving.lock(|driving| driving.pilot.predict());
        #[cfg(mission)]
        rtic::pend(Interrupt::EXTI0);
    }

    #[task(binds = DMA2_STREAM0, priority = 4, shared = [link, driving], local = [joystick, inputs, untold])]
    fn scan(cx: scan::Context) {
        cx.local.joystick.acknowledge();
        let counts = cx.local.joystick.counts();
        let levels = cx.local.inputs.levels();
        let mut driving = cx.shared.driving;
        let untold = cx.local.untold;
        driving.lock(|driving| {
            driving.axes = counts;
            let pilot = &mut driving.pilot;
            driving
                .buttons
                .sample(REMOTE, levels.as_array(), |button, edge| {
                    pilot.button(button, edge);
                    untold.push(button, edge);
                });
        });
        // Not inside the lock, which would block the control step.
        let mut link = cx.shared.link;
        if let Some(change) = untold.pop() {
            let data = wire::button_event(change).encode();
            // The stack counts the events that a full queue refuses; the request itself is not
            // lost.
            let _ =
                link.lock(|link| link.queue_event(ButtonEvent::ID, &data, design::EVENT_LIFETIME));
        }
    }

    #[task(binds = DMA1_STREAM3, priority = 2, shared = [lcd, refresh_due])]
    fn display_dma(cx: display_dma::Context) {
        let (mut lcd, mut due) = (cx.shared.lcd, cx.shared.refresh_due);
        lcd.lock(|lcd| lcd.on_transfer_complete());
        if due.lock(core::mem::take) {
            rtic::pend(Interrupt::TIM4);
        }
    }

    /// Deadline: a byte later, 520 us, which would overrun the port's only register.
    #[task(binds = USART3, priority = 6, shared = [supervision], local = [replies])]
    fn display_rx(mut cx: display_rx::Context) {
        if let Some(byte) = cx.local.replies.received() {
            cx.shared
                .supervision
                .lock(|supervision| supervision.received::<Lk204>(byte));
        }
    }

    #[task(binds = DMA1_STREAM6, priority = 3, shared = [console])]
    fn console_dma(mut cx: console_dma::Context) {
        cx.shared
            .console
            .lock(|console| console.on_transfer_complete());
    }

    /// Deadline: the next tick, 200 ms later. If the last string is still being sent then, the end of
    /// it releases the task again.
    #[task(binds = TIM4, priority = 2, shared = [link, driving, lcd, refresh_due, supervision], local = [tick, screen])]
    fn display_tick(cx: display_tick::Context) {
        cx.local.tick.acknowledge();
        let mut link = cx.shared.link;
        let mut driving = cx.shared.driving;
        let (time, bus) = link.lock(|link| (link.system_time(), link.node().is_alive()));
        let (view, shown) = driving.lock(|driving| {
            let trouble = driving.trouble.map(|trouble| trouble.named(&NAMES));
            (driving.pilot.view(time, bus, trouble), driving.shown)
        });
        let screen = cx.local.screen;
        screen.clear();
        display::write::<Lk204>(screen, &view, &shown);
        let (mut lcd, mut supervision) = (cx.shared.lcd, cx.shared.supervision);
        let sent = lcd.lock(|lcd| {
            let idle = !lcd.is_busy();
            if idle {
                supervision.lock(|supervision| supervision.sent(1));
                lcd.send(screen.as_bytes());
            }
            idle
        });
        let mut due = cx.shared.refresh_due;
        due.lock(|due| *due = !sent);
    }

    #[task(priority = 2, shared = [link, driving, test], local = [keeper, session])]
    async fn housekeeping(mut cx: housekeeping::Context) {
        let mut pace = Pace::begin();
        // loop-bound: 1. One step per tick; holds while each step meets its deadline.
        loop {
            // at-most: 1. The same; the first step waits for nothing.
            keep(&mut cx.shared, cx.local.keeper, cx.local.session);
            pace.wait().await;
        }
    }

    /// A step of the housekeeping.
    fn keep(
        shared: &mut housekeeping::SharedResources<'_>,
        keeper: &mut Keeper,
        session: &mut Session,
    ) {
        // Sections of their own, because each blocks the interrupts of the bus.
        shared.link.lock(|link| {
            link.keep();
            if !link.is_started() && keeper.uptime() >= design::MASTER_PATIENCE {
                link.start();
            }
        });
        if shared.link.lock(|link| session.step(link)) {
            let secret = session.secret();
            shared.driving.lock(|driving| {
                guide::set_secret(&mut driving.pilot, secret);
                driving.session = Some(secret);
            });
        }
        let bus = shared.link.lock(|link| BusView::of(link));
        let trouble = Trouble::among(&shared.link.lock(|link| peers::of(link)));
        let (steps, idle, is_news) = shared.driving.lock(|driving| {
            let before = core::mem::replace(&mut driving.trouble, trouble);
            let pilot = &driving.pilot;
            (pilot.steps(), pilot.may_restart(), before != trouble)
        });
        if is_news {
            // The operator reads it at once.
            rtic::pend(Interrupt::TIM4);
            rtic::pend(Interrupt::EXTI3);
        }
        keeper.step::<ControllerStatus>(&mut shared.link, &bus, steps, Motor::none(idle));
        shared.test.lock(|test| *test = keeper.last_test());
        if keeper.is_report_due() {
            rtic::pend(Interrupt::EXTI3);
        }
    }

    /// Deadline: the window of its message.
    #[cfg(mission)]
    #[task(binds = EXTI0, priority = 1, shared = [link, driving, requests], local = [mission, flash])]
    fn plan(cx: plan::Context) {
        let (mut link, mut driving) = (cx.shared.link, cx.shared.driving);
        let mut requests = cx.shared.requests;
        let plan = cx.local.mission;
        let look = driving.lock(|driving| mission::look(&driving.pilot));
        // loop-bound: 10. mission::FRAMES.
        for _ in 0..mission::FRAMES {
            let frame = requests.lock(mission::Requests::pop);
            if let Some(effect) = plan.read(frame, look) {
                driving.lock(|driving| mission::apply(&mut driving.pilot, effect));
            }
        }
        // loop-bound: 2. mission::ANSWERS.
        for _ in 0..mission::ANSWERS {
            if let Some(answer) = plan.answer() {
                // Whoever gets no answer asks again.
                let _ = link.lock(|link| {
                    link.queue_event(MissionAnswer::ID, &answer, design::EVENT_LIFETIME)
                });
            }
        }
        if let Some(event) = plan.event(look) {
            let _ = link
                .lock(|link| link.queue_event(MissionEvent::ID, &event, design::EVENT_LIFETIME));
        }
        // loop-bound: 2. mission::STEPS.
        for _ in 0..mission::STEPS {
            // Sections of their own: a step of the planning takes long.
            let at = driving.lock(|driving| mission::at(&mut driving.pilot));
            if plan.is_checking() {
                plan.check(look);
            } else if let Some(piece) = plan.step(at) {
                driving.lock(|driving| mission::push(&mut driving.pilot, piece));
            }
        }
        // A copy, so that the lock is short.
        let seen = driving.lock(|driving| mission::see(&driving.pilot));
        let shown = plan.shown(&seen, look);
        let strays = plan.strays(&seen);
        driving.lock(|driving| {
            driving.shown = shown;
            driving.pilot.set_strays(strays);
        });
        let (state, sections) = plan.tell(&seen);
        link.lock(|link| link.put(window::MISSION_STATE, state));
        link.lock(|link| link.put(window::SECTION_SWITCHING, sections));
        if let Some(written) = plan.written(look) {
            link.lock(|link| {
                link.leave();
                firmware::mission::replace(
                    cx.local.flash,
                    written.place,
                    written.number,
                    written.record,
                )
            });
        }
    }

    #[task(binds = EXTI3, priority = 1, shared = [link, driving, supervision, console, test], local = [log])]
    fn console(mut cx: console::Context) {
        let present = cx
            .shared
            .supervision
            .lock(|supervision| supervision.is_present());
        let view = cx.shared.driving.lock(|driving| {
            let trouble = driving.trouble.map(|trouble| trouble.named(&NAMES));
            driving.pilot.line(present, trouble)
        });
        let test = cx.shared.test.lock(|test| *test);
        node::report(
            &mut cx.shared.link,
            &mut cx.shared.console,
            cx.local.log,
            &Own::from(&view),
            test,
            |line| lines::pilot(line, "uagv", &view),
        );
    }
}
