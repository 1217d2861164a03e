//! Handlers that are no task, and masked sections in the code around the tasks.

use schedulability::results::NodeReport;

use super::{Change, answer, from_package, said, with_rows};

/// Where `idle` goes, and what in `init` and in a task is replaced.
const BEFORE_TASKS: &str = "    #[task(binds = EXTI0, priority = 3";
const IN_INIT: &str = "let shared = Shared { samples: [0; 16] };";
const REPORTED: &str = "output(checksum(&samples, ROUNDS));";
const BEFORE_APP: &str = "#[rtic::app(";

/// An `idle` with this attribute, these names of its context and this loop.
macro_rules! idle {
    ($attribute:literal, $context:literal, $body:literal) => {
        &[(
            BEFORE_TASKS,
            concat!(
                "    #[",
                $attribute,
                "]\n    fn idle(",
                $context,
                ": idle::Context) -> ! {\n        loop {\n            ",
                $body,
                "\n        }\n    }\n\n    #[task(binds = EXTI0, priority = 3"
            ),
        )]
    };
}

/// Statements at the begin of `init`.
macro_rules! in_init {
    ($body:literal) => {
        &[(
            IN_INIT,
            concat!($body, "\n        let shared = Shared { samples: [0; 16] };"),
        )]
    };
}

/// Items before the program.
macro_rules! before_app {
    ($($items:literal)*) => {
        &[(BEFORE_APP, concat!($($items,)* "\n\n#[rtic::app("))]
    };
}

/// The handler of an interrupt that is no task.
macro_rules! interrupt {
    ($signature:literal, $body:literal) => {
        before_app!(
            "use part::interrupt;\n\n#[cortex_m_rt::interrupt]\n"
            $signature " {\n    " $body "\n}"
        )
    };
}

/// The handler of an exception of the core, which returns.
macro_rules! exception {
    ($signature:literal) => {
        before_app!(
            "#[cortex_m_rt::exception]\n"
            $signature " {\n    part::output(part::input());\n}"
        )
    };
}

/// The programs, as [`super::PROGRAMS`].
pub(super) const PROGRAMS: [(&str, &[Change]); 22] = [
    (
        "idle-section",
        idle!(
            "idle",
            "_",
            "cortex_m::interrupt::free(|_| {
                for _ in 0..3000 {
                    output(input());
                }
            });"
        ),
    ),
    (
        "idle-bounded",
        idle!(
            "idle",
            "_",
            "cortex_m::interrupt::free(|_| {
                // loop-bound: 3000
                for _ in 0..3000 {
                    output(input());
                }
            });"
        ),
    ),
    (
        "idle-lock",
        idle!(
            "idle(shared = [samples])",
            "mut cx",
            "cx.shared.samples.lock(|_| while input() & 1 == 0 {});"
        ),
    ),
    (
        "idle-sleep",
        idle!(
            "idle(shared = [samples])",
            "mut cx",
            "cx.shared.samples.lock(|_| cortex_m::asm::wfi());"
        ),
    ),
    (
        "idle-wait",
        idle!(
            "idle",
            "_",
            "while input() & 0x100 == 0 {}
            cortex_m::interrupt::free(|_| output(1));
            cortex_m::asm::wfi();"
        ),
    ),
    (
        "init-section",
        in_init!(
            "// SAFETY: no task shares anything with what follows.
        unsafe { cortex_m::interrupt::enable() };
        cortex_m::interrupt::free(|_| while input() & 1 == 0 {});"
        ),
    ),
    ("init-wait", in_init!("while input() & 0x100 == 0 {}")),
    (
        "primask",
        &[(
            REPORTED,
            "output(cortex_m::interrupt::free(|_| checksum(&samples, ROUNDS)));",
        )],
    ),
    (
        "masked-wait",
        &[(
            REPORTED,
            "output(cortex_m::interrupt::free(|_| checksum(&samples, ROUNDS)));
        cortex_m::interrupt::free(|_| while input() & 1 == 0 {});",
        )],
    ),
    (
        "left-masked",
        &[(
            REPORTED,
            "output(checksum(&samples, ROUNDS));
        cortex_m::interrupt::disable();",
        )],
    ),
    (
        "foreign",
        interrupt!("fn EXTI3()", "part::output(part::input());"),
    ),
    (
        "foreign-hang",
        interrupt!("fn EXTI3() -> !", "loop {\n        part::output(1);\n    }"),
    ),
    (
        "foreign-reset",
        interrupt!("fn EXTI3() -> !", "cortex_m::peripheral::SCB::sys_reset()"),
    ),
    (
        "stray",
        before_app!(r#"core::arch::global_asm!(".globl EXTI3", ".set EXTI3, 0x20000001");"#),
    ),
    ("pendsv", exception!("fn PendSV()")),
    ("svcall", exception!("fn SVCall()")),
    ("systick", exception!("fn SysTick()")),
    ("nmi", exception!("unsafe fn NonMaskableInt()")),
    ("default", exception!("unsafe fn DefaultHandler(_: i16)")),
    (
        "priority",
        in_init!(
            "// SAFETY: no section relies on priorities yet.
        unsafe {
            let mut core = cortex_m::Peripherals::steal();
            core.NVIC.set_priority(Interrupt::EXTI2, 0x20);
        }"
        ),
    ),
    (
        "task-priority",
        &[(
            REPORTED,
            "output(checksum(&samples, ROUNDS));
        // SAFETY: the analysis refuses it.
        unsafe {
            let mut core = cortex_m::Peripherals::steal();
            core.NVIC.set_priority(Interrupt::EXTI0, 0x20);
        }",
        )],
    ),
    (
        "vectors",
        in_init!(
            "// SAFETY: nothing is there, and no interrupt is taken before the analysis refuses it.
        unsafe { cortex_m::Peripherals::steal().SCB.vtor.write(0x2000_0000) };"
        ),
    ),
];

/// Why a program is refused.
fn refused(program: &str) -> String {
    from_package(&answer(program).unwrap_err().to_string())
}

#[test]
fn a_masked_wait_around_the_tasks_is_refused() {
    let sentences = [
        (
            "idle-section",
            "node.sample misses its deadline of # us by # us: it takes # us itself, is \
             blocked # us by main at src/bin/idle-section.rs:40 (idle_section::app::idle) and waits # us for sample (# times)",
        ),
        (
            "idle-lock",
            "the start-up and idle code of node may mask interrupts for an unknown time: the loop \
             at src/bin/idle-lock.rs:40 (idle_lock::app::idle) has no bound, and interrupts are masked in it \
             since src/bin/idle-lock.rs:6 (idle_lock::app::idle): write `// loop-bound: N` on the line above it, \
             where N is the most turns that it takes, or unmask them before it",
        ),
        (
            "init-section",
            "the start-up and idle code of node may mask interrupts for an unknown time: the loop \
             at src/bin/init-section.rs:31 (init_section::app::main::__rtic_init_resources) has no \
             bound, and interrupts are masked in it since src/bin/init-section.rs:31 \
             (init_section::app::main::__rtic_init_resources): write `// loop-bound: N` on the line above \
             it, where N is the most turns that it takes, or unmask them before it",
        ),
        (
            "idle-sleep",
            "the start-up and idle code of node may mask interrupts for an unknown time: the core \
             sleeps at src/bin/idle-sleep.rs:40 (idle_sleep::app::idle), in a task or where no masked interrupt \
             wakes it: sleep in `idle` only, by `wfi`, and there not in a section that BASEPRI \
             or FAULTMASK masks",
        ),
        (
            "idle-bounded",
            "node.sample misses its deadline of # us by # ms: it takes # us itself, is \
             blocked # ms by main at src/bin/idle-bounded.rs:40 (idle_bounded::app::idle) and waits # us for sample (# times)",
        ),
        (
            "primask",
            "node.sample misses its deadline of # us by # us: it takes # us itself, is \
             blocked # us by report at src/bin/primask.rs:60 (EXTI2) and waits # us for sample (# times)",
        ),
        (
            "masked-wait",
            "node.report has no bound: the loop at src/bin/masked-wait.rs:61 (EXTI2) has no \
             bound: write `// loop-bound: N` on the line above it, where N is the most turns that \
             it takes",
        ),
        (
            "left-masked",
            "node.report has no bound: the mask that is set at src/bin/left-masked.rs:61 (EXTI2) \
             is still set when the handler returns, so its section has no end: clear it before",
        ),
    ];
    let all = sentences.map(|(program, _)| (program, said(program)));
    assert_eq!(
        all,
        sentences.map(|(program, sentence)| (program, sentence.to_owned()))
    );
}

#[test]
fn a_wait_that_masks_no_task_is_accepted() {
    for program in ["idle-wait", "init-wait"] {
        let report = answer(program).unwrap();
        assert_eq!(report.first_miss(), None, "{program}");
    }
}

/// An annotation that counts only because it bounds a section of the idle code is an assumption.
#[test]
fn a_bound_in_idle_is_an_assumption() {
    let report = answer("idle-bounded").unwrap();
    let says = "src/bin/idle-bounded.rs:42 takes at most 3000 turns";
    let mut assumptions = report.assumptions.iter();
    assert!(assumptions.any(|one| one.contains(says)), "{report:?}");
}

#[test]
fn a_handler_that_is_no_task_is_refused() {
    let foreign = |vector: &str, place: &str, name: &str| {
        format!(
            "vector {vector} of the image of node leads to src/bin/{place} ({name}), which is \
             neither a task nor a handler that ends in a reset: add [node.node.task.{name}] with \
             its `priority` to the task table, or remove the handler"
        )
    };
    for (program, sentence) in [
        (
            "foreign",
            foreign("25 (interrupt 9)", "foreign.rs:8", "EXTI3"),
        ),
        (
            "foreign-hang",
            foreign("25 (interrupt 9)", "foreign-hang.rs:8", "EXTI3"),
        ),
        ("pendsv", foreign("14", "pendsv.rs:6", "PendSV")),
        ("svcall", foreign("11", "svcall.rs:6", "SVCall")),
        ("systick", foreign("15", "systick.rs:6", "SysTick")),
    ] {
        assert_eq!(refused(program), sentence, "{program}");
    }
    assert_eq!(
        refused("stray"),
        "vector 25 (interrupt 9) of the image of node leads to 0x20000000, where the image has no \
         code, so its handler is not known"
    );
    for (program, name) in [("nmi", "NonMaskableInt"), ("default", "DefaultHandler")] {
        assert_eq!(
            refused(program),
            format!(
                "the handler {name} of node may return (src/bin/{program}.rs:6 ({name})), and its \
                 time is charged to no task: let it end in a reset or in an endless loop"
            )
        );
    }
}

/// Handlers that never return are shown with what they do, and their stack counts.
#[test]
fn a_handler_that_ends_the_program_is_shown() {
    let sound = answer("sound").unwrap();
    let report = answer("foreign-reset").unwrap();
    assert_eq!(report.first_miss(), None);
    let [node] = &report.nodes[..] else {
        panic!("{report:?}")
    };
    let shown: Vec<String> = node.outside.iter().map(|one| one.sentence()).collect();
    let says = |name: &str, what: &str| {
        let mut shown = shown.iter();
        shown.any(|one| one.starts_with(name) && one.contains(what))
    };
    assert!(says("EXTI3", " ends in a reset and takes "), "{shown:?}");
    assert!(
        says("HardFault", " ends in the endless loop at "),
        "{shown:?}"
    );
    assert!(
        says("DefaultHandler", " ends in the endless loop at "),
        "{shown:?}"
    );
    // The deepest of them is on top of the tasks.
    let deepest = |node: &NodeReport| {
        let outside = node.outside.iter();
        outside.map(|one| one.depth_above(0)).max().unwrap()
    };
    let tasks = sound.nodes[0].stack - deepest(&sound.nodes[0]);
    assert_eq!(node.stack, tasks + deepest(node));
    assert!(deepest(node) > wcet::stack::FRAME_FPU);
}

/// A row makes a task of such a handler, with its priority after a reset.
#[test]
fn a_row_makes_a_task_of_a_handler() {
    let row = "\n[node.node.task.EXTI3]\npriority = 16\nevery_us = 10_000\ndeadline_us = 1000\n";
    let report = with_rows("foreign", row).unwrap();
    assert_eq!(report.first_miss(), None);
    let tasks = &report.nodes[0].tasks;
    let task = tasks.iter().find(|task| task.name == "EXTI3").unwrap();
    assert!(task.cost > 0);
    // It preempts the most urgent task, also in its locks.
    let sample = tasks.iter().find(|task| task.name == "sample").unwrap();
    assert!(sample.delayed_by.iter().any(|(by, ..)| by == "EXTI3"));
    let low = with_rows("foreign", &row.replace("16", "2")).unwrap_err();
    assert_eq!(
        low.to_string(),
        "task EXTI3 of node has priority 2, but the image gives EXTI3 priority 16: write `priority = 16` under \
         [node.node.task.EXTI3]"
    );
    let twice = with_rows(
        "sound",
        "\n[node.node.task.EXTI0]\npriority = 3\nevery_us = 1000\ndeadline_us = 200\n",
    );
    let twice = twice.unwrap_err().to_string();
    assert!(
        twice.ends_with("its `priority` stands in the source"),
        "{twice}"
    );
    let wrong = with_rows(
        "sound",
        "\n[node.node.task.EXTI4]\nevery_us = 9\ndeadline_us = 9\n",
    );
    let wrong = wrong.unwrap_err().to_string();
    assert!(
        wrong.ends_with(
            "node has no task EXTI4 (a handler that is no task of the source needs a `priority`)"
        ),
        "{wrong}"
    );
}

#[test]
fn what_the_program_changes_in_the_interrupt_controller_is_seen() {
    assert_eq!(
        refused("priority"),
        "task report of node has priority 1, but the image gives EXTI2 different ones, or one \
         that is not a constant"
    );
    assert_eq!(
        refused("task-priority"),
        "task sample of node has priority 3, but the image gives EXTI0 different ones, or one \
         that is not a constant"
    );
    assert_eq!(
        refused("vectors"),
        "the image of node may move its vector table (register VTOR), so its handlers are not \
         known: accepted is the table at the begin of the image"
    );
}
