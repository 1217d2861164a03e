//! Each check of a matrix, and the sentence with which a violation fails the
//! build.

use ttcan::{Event, Id, MatrixConfig, Micros, NodeId, ReferenceFormat, SystemMatrix, Window};

const A: NodeId = NodeId(0);
const B: NodeId = NodeId(1);

fn id(raw: u16) -> Id {
    Id::standard(raw).unwrap()
}

fn micros(micros: u32) -> Micros {
    Micros::micros(micros)
}

fn speed() -> Window<'static> {
    Window::exclusive("speed", micros(1000), micros(1000), id(200), 8, A)
}

fn config<'a>(windows: &'a [Window<'a>]) -> MatrixConfig<'a> {
    MatrixConfig {
        bit_rate: 250_000,
        basic_cycle: Micros::millis(10),
        cycles: 4,
        reference: id(100),
        reference_format: ReferenceFormat::LEVEL_2,
        masters: &[A, B],
        transmit_enable_bits: 16,
        sync_uncertainty: micros(20),
        longest_gap: micros(0),
        windows,
        events: &[],
    }
}

fn refusal(config: MatrixConfig) -> String {
    SystemMatrix::new(config)
        .expect_err("it is refused")
        .to_string()
}

fn windows_refusal(windows: &[Window]) -> String {
    refusal(config(windows))
}

#[test]
fn a_sound_matrix_is_accepted() {
    let windows = [
        speed(),
        speed().every(4, 0),
        Window::arbitrating("events", micros(2000), micros(500)).merged(),
        Window::arbitrating("more", micros(2500), micros(500)),
        Window::exclusive("odd", micros(3000), micros(1000), id(201), 8, B).every(2, 1),
        Window::exclusive("even", micros(3000), micros(1000), id(202), 8, A).every(2, 0),
        Window::free("margin", micros(4000), micros(1000)),
    ];
    let matrix = SystemMatrix::new(config(&windows[2..])).unwrap();
    assert_eq!(matrix.window_count(), 5);
    assert_eq!(matrix.node_count(), 2);
    assert_eq!(matrix.entry_count(), 4, "two cycles of two windows each");
}

#[test]
fn windows_are_refused_by_name() {
    let window =
        |start, length| Window::exclusive("w", micros(start), micros(length), id(201), 8, B);
    assert_eq!(
        windows_refusal(&[Window::exclusive(
            "w",
            micros(1000),
            micros(600),
            id(201),
            8,
            B
        )]),
        "window `w`: is 600 us long, but its longest frame with the transmit enable window and \
         the synchronisation uncertainty needs 624 us"
    );
    assert_eq!(
        windows_refusal(&[speed(), window(1900, 1000)]),
        "window `w`: overlaps `speed` in basic cycle 0"
    );
    assert_eq!(
        windows_refusal(&[speed().every(2, 1), window(1900, 1000).every(4, 3)]),
        "window `w`: overlaps `speed` in basic cycle 3"
    );
    assert_eq!(
        windows_refusal(&[window(3000, 1000), speed()]),
        "window `speed`: begins before `w`, which stands before it in the list"
    );
    assert_eq!(
        windows_refusal(&[window(400, 1000)]),
        "window `w`: begins while the reference message may be on the bus; the earliest start is \
         520 us"
    );
    assert_eq!(
        windows_refusal(&[window(9000, 1000)]),
        "window `w`: ends when the next reference message may begin; the latest end is 9853 us"
    );
    assert_eq!(
        windows_refusal(&[window(1000, 1000).every(3, 0)]),
        "window `w`: repeat factor 3 is no power of two of at most the number of basic cycles"
    );
    assert_eq!(
        windows_refusal(&[window(1000, 1000).every(8, 0)]),
        "window `w`: repeat factor 8 is no power of two of at most the number of basic cycles"
    );
    assert_eq!(
        windows_refusal(&[window(1000, 1000).every(2, 2)]),
        "window `w`: cycle offset 2 is not below the repeat factor"
    );
    assert_eq!(
        windows_refusal(&[Window::exclusive(
            "w",
            micros(1000),
            micros(1000),
            id(201),
            9,
            B
        )]),
        "window `w`: a message of 9 bytes, but a CAN frame carries at most 8"
    );
    assert_eq!(
        windows_refusal(&[Window::exclusive(
            "w",
            micros(1000),
            micros(1000),
            id(101),
            8,
            B
        )]),
        "window `w`: uses an identifier of the reference message"
    );
    assert_eq!(
        windows_refusal(&[
            speed(),
            Window::exclusive("w", micros(2000), micros(1000), id(200), 8, B)
        ]),
        "window `w`: and `speed` give one identifier two senders, lengths or kinds"
    );
}

#[test]
fn merged_windows_must_be_closed() {
    let message = "window `m`: is merged with a next window, but no arbitrating window follows \
                   at its end in the same basic cycles";
    let merged = Window::arbitrating("m", micros(1000), micros(500)).merged();
    let next = Window::arbitrating("n", micros(1500), micros(500));
    assert_eq!(windows_refusal(&[merged]), message);
    assert_eq!(windows_refusal(&[merged, next.every(2, 0)]), message);
    let later = Window::arbitrating("n", micros(1600), micros(500));
    assert_eq!(windows_refusal(&[merged, later]), message);
    let exclusive = Window::exclusive("x", micros(1500), micros(1000), id(201), 8, B);
    assert_eq!(windows_refusal(&[merged, exclusive]), message);
    assert!(SystemMatrix::new(config(&[merged, next])).is_ok());
}

#[test]
fn networks_are_refused() {
    let base = config(&[]);
    let cases = [
        (
            MatrixConfig { cycles: 3, ..base },
            "system matrix: 3 basic cycles, but the count must be 1, 2, 4, 8, 16, 32 or 64",
        ),
        (
            MatrixConfig {
                cycles: 128,
                ..base
            },
            "system matrix: 128 basic cycles, but the count must be 1, 2, 4, 8, 16, 32 or 64",
        ),
        (
            MatrixConfig {
                bit_rate: 0,
                ..base
            },
            "system matrix: bit rate 0 bit/s, but it must be 1 to 1000000",
        ),
        (
            MatrixConfig {
                transmit_enable_bits: 33,
                ..base
            },
            "system matrix: a transmit enable window of 33 bit times, but it must be 1 to 32",
        ),
        (
            MatrixConfig {
                basic_cycle: micros(700),
                ..base
            },
            "system matrix: a basic cycle of 700 us, but it must hold two reference messages and \
             last at most 10 s",
        ),
        (
            MatrixConfig {
                masters: &[],
                ..base
            },
            "system matrix: 0 potential masters, but the reference identifier leaves room for 1 \
             to 4",
        ),
        (
            MatrixConfig {
                masters: &[A, B, A],
                ..base
            },
            "system matrix: node 0 has two ranks among the potential masters",
        ),
        (
            MatrixConfig {
                reference_format: ReferenceFormat::new(0, Some(0), 3, None),
                ..base
            },
            "system matrix: the fields of the reference message overlap or exceed 8 bytes",
        ),
        (
            MatrixConfig {
                events: &[Event::new("e", Id::constant::<102>(), 8, A)],
                ..base
            },
            "window `e`: uses an identifier of the reference message",
        ),
    ];
    for (config, message) in cases {
        assert_eq!(refusal(config), message);
    }
}

/// The event messages of a node wait in one line.
#[test]
fn event_messages_have_basic_cycles_that_can_be() {
    let base = config(&[]);
    let cases = [
        (
            MatrixConfig {
                events: &[Event::new("e", Id::constant::<40>(), 8, A).every(3, 0)],
                ..base
            },
            "window `e`: repeat factor 3 is no power of two of at most the number of basic cycles",
        ),
        (
            MatrixConfig {
                cycles: 2,
                events: &[
                    Event::new("e", Id::constant::<40>(), 8, A).every(2, 0),
                    Event::new("f", Id::constant::<41>(), 8, B).every(2, 1),
                    Event::new("g", Id::constant::<42>(), 8, A).every(2, 1),
                ],
                ..base
            },
            "window `g`: and `e` are event messages of one node with different basic cycles",
        ),
    ];
    for (config, message) in cases {
        assert_eq!(refusal(config), message);
    }
}
