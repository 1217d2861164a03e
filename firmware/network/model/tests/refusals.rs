//! Errors in a network file are reported by name and line.

use network_model::{Network, worst_case_bits};

/// A network of two nodes: a reference, one exclusive and one event message.
const GOOD: &str = r#"VERSION ""
BU_: master slave
BO_ 96 Reference: 1 master
 SG_ CycleCount : 0|6@1+ (1,0) [0|63] "" slave
 SG_ Discontinuity : 6|1@1+ (1,0) [0|1] "" slave
 SG_ NextIsGap : 7|1@1+ (1,0) [0|1] "" slave
BO_ 200 Speed: 8 slave
 SG_ Left : 0|16@1- (1,0) [-100|100] "mm/s" master
 SG_ Right : 16|16@1- (1,0) [-100|100] "mm/s" master
BO_ 600 Alarm: 1 slave
 SG_ Kind : 0|8@1+ (1,0) [0|1] "" master
VAL_TABLE_ Kind 1 "Fire" 0 "Water" ;
BA_DEF_ "Baudrate" INT 1 1000000;
BA_DEF_ "BasicCycle" INT 1 1000000;
BA_DEF_ "BasicCycles" INT 1 64;
BA_DEF_ "SyncUncertainty" INT 0 1000;
BA_DEF_ "TransmitEnable" INT 1 16;
BA_DEF_ BU_ "MasterRank" INT -1 7;
BA_DEF_ BO_ "GenMsgSendType" ENUM "Cyclic","Event";
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_ BO_ "GenMsgDelayTime" INT 0 65535;
BA_DEF_ BO_ "WindowKind" ENUM "None","Reference","Exclusive","Arbitrating";
BA_DEF_ BO_ "WindowStart" INT 0 1000000;
BA_DEF_ BO_ "WindowLength" INT 0 1000000;
BA_DEF_ BO_ "WindowRepeat" INT 1 64;
BA_DEF_ BO_ "WindowOffset" INT 0 63;
BA_DEF_DEF_ "Baudrate" 250000;
BA_DEF_DEF_ "BasicCycle" 10000;
BA_DEF_DEF_ "BasicCycles" 2;
BA_DEF_DEF_ "SyncUncertainty" 20;
BA_DEF_DEF_ "TransmitEnable" 16;
BA_DEF_DEF_ "MasterRank" -1;
BA_DEF_DEF_ "GenMsgSendType" "Cyclic";
BA_DEF_DEF_ "GenMsgCycleTime" 10;
BA_DEF_DEF_ "GenMsgDelayTime" 100;
BA_DEF_ BO_ "After" STRING ;
BA_DEF_ BO_ "Preparation" INT 0 1000000;
BA_DEF_DEF_ "After" "";
BA_DEF_DEF_ "Preparation" 300;
BA_DEF_DEF_ "WindowKind" "None";
BA_DEF_DEF_ "WindowStart" 0;
BA_DEF_DEF_ "WindowLength" 1000;
BA_DEF_DEF_ "WindowRepeat" 1;
BA_DEF_DEF_ "WindowOffset" 0;
BA_ "MasterRank" BU_ master 0;
BA_ "WindowKind" BO_ 96 1;
BA_ "WindowKind" BO_ 200 2;
BA_ "WindowStart" BO_ 200 1000;
BA_ "GenMsgSendType" BO_ 600 1;
BA_ "WindowKind" BO_ 600 3;
BA_ "WindowStart" BO_ 600 2000;
VAL_ 600 Kind 1 "Fire" 0 "Water" ;
"#;

/// The error for the good file after one replacement.
fn refusal(from: &str, to: &str) -> String {
    assert!(GOOD.contains(from), "nothing to replace: {from}");
    match Network::parse(&GOOD.replacen(from, to, 1)) {
        Ok(_) => panic!("accepted: {from} -> {to}"),
        Err(problems) => problems.to_string(),
    }
}

#[track_caller]
fn refused(from: &str, to: &str, says: &[&str]) {
    let message = refusal(from, to);
    for words in says {
        assert!(message.contains(words), "`{words}` is not in: {message}");
    }
}

#[test]
fn the_good_network_is_read() {
    let network = Network::parse(GOOD).expect("nothing is wrong with it");
    assert_eq!(network.messages.len(), 3);
    assert_eq!(network.windows().len(), 3);
    assert_eq!(network.nodes[0].master_rank, Some(0));
    assert_eq!(network.messages[1].line, Some(7));
    assert_eq!(network.messages[1].signals[1].line, Some(9));
}

#[test]
fn a_file_that_is_no_dbc_is_refused() {
    refused(
        "BU_: master slave",
        "BU_ master; slave",
        &["not a DBC file"],
    );
}

#[test]
fn a_frame_longer_than_its_window_is_refused() {
    // 135 bits and 16 of the transmit enable window at 4 us, and 20 us.
    refused(
        "BA_ \"WindowKind\" BO_ 200 2;",
        "BA_ \"WindowKind\" BO_ 200 2;\nBA_ \"WindowLength\" BO_ 200 623;",
        &[
            "line 7",
            "Speed (200)",
            "window at 1000 us",
            "623 us are too short",
            "135 bit times",
            "need 624 us",
        ],
    );
}

const LATE: &str =
    "BA_DEF_ BO_ \"RetryLate\" ENUM \"No\",\"Yes\";\nBA_DEF_DEF_ \"RetryLate\" \"No\";\n";

#[test]
fn a_message_without_windows_to_be_late_in_is_refused() {
    let late = |id: u16| format!("{LATE}BA_ \"RetryLate\" BO_ {id} 1;\nVAL_ 600");
    assert!(Network::parse(&GOOD.replacen("VAL_ 600", &late(200), 1)).is_ok());
    for id in [96, 600] {
        let only = "only a message of an exclusive window may have RetryLate";
        refused("VAL_ 600", &late(id), &[only, &format!("({id})")]);
    }
    let alone = GOOD
        .replacen("BA_ \"GenMsgSendType\" BO_ 600 1;\n", "", 1)
        .replacen("BO_ 600 3;", "BO_ 600 2;", 1)
        .replacen("VAL_ 600", &late(200), 1);
    let refusal = Network::parse(&alone).unwrap_err().to_string();
    assert!(
        refusal.contains("Speed (200)") && refusal.contains("there is none"),
        "{refusal}"
    );
    let rare = "BA_ \"WindowRepeat\" BO_ 600 2;\nVAL_ 600";
    let rare = late(200).replace("VAL_ 600", rare);
    refused("VAL_ 600", &rare, &["Speed (200)", "in every basic cycle"]);
}

#[test]
fn overlapping_windows_are_refused() {
    refused(
        "BA_ \"WindowStart\" BO_ 200 1000;",
        "BA_ \"WindowStart\" BO_ 200 1001;",
        &[
            "Alarm (600), 2000 to 3000 us",
            "Speed (200), 1001 to 2001 us",
        ],
    );
    refused(
        "BA_ \"WindowStart\" BO_ 200 1000;",
        "BA_ \"WindowStart\" BO_ 200 900;",
        &["Reference (96)", "Speed (200)"],
    );
}

#[test]
fn windows_of_different_cycles_may_share_a_time() {
    let text = GOOD.replace(
        "VAL_ 600",
        "BA_ \"WindowRepeat\" BO_ 200 2;\nBA_ \"GenMsgCycleTime\" BO_ 200 20;\n\
         BA_ \"WindowRepeat\" BO_ 600 2;\nBA_ \"WindowOffset\" BO_ 600 1;\n\
         BA_ \"WindowStart\" BO_ 600 1000;\nVAL_ 600",
    );
    let text = text.replace("BA_ \"WindowStart\" BO_ 600 2000;\n", "");
    assert_eq!(Network::parse(&text).map(|n| n.messages.len()), Ok(3));
    let same = text.replace(
        "BA_ \"WindowOffset\" BO_ 600 1;",
        "BA_ \"WindowOffset\" BO_ 600 0;",
    );
    assert!(
        Network::parse(&same)
            .unwrap_err()
            .to_string()
            .contains("overlaps")
    );
}

/// They wait in one line, and the first one would hold the others.
#[test]
fn event_messages_of_a_node_have_the_same_basic_cycles() {
    let two = |repeat: u8, offset: u8| {
        let text = GOOD.replace(
            "VAL_TABLE_",
            "BO_ 601 Level: 1 slave\n SG_ Height : 0|8@1+ (1,0) [0|1] \"\" master\nVAL_TABLE_",
        );
        let second = format!(
            "BA_ \"GenMsgSendType\" BO_ 601 1;\nBA_ \"WindowKind\" BO_ 601 3;\n\
             BA_ \"WindowStart\" BO_ 601 2000;\nBA_ \"WindowRepeat\" BO_ 601 {repeat};\n\
             BA_ \"WindowOffset\" BO_ 601 {offset};\nVAL_ 600"
        );
        Network::parse(&text.replace("VAL_ 600", &second))
    };
    assert_eq!(two(1, 0).map(|network| network.messages.len()), Ok(4));
    let refusal = two(2, 1).unwrap_err().to_string();
    assert!(
        refusal.contains(
            "WindowRepeat and WindowOffset are 2 and 1, but 1 and 0 for Alarm: all event messages of \
             slave need the same"
        ),
        "{refusal}"
    );
}

#[test]
fn a_window_beyond_the_cycle_is_refused() {
    refused(
        "BA_ \"WindowStart\" BO_ 600 2000;",
        "BA_ \"WindowStart\" BO_ 600 9500;",
        &["Alarm (600)", "ends at 10500 us", "10000 us"],
    );
}

#[test]
fn a_matrix_of_three_cycles_is_refused() {
    refused(
        "\"BasicCycles\" 2",
        "\"BasicCycles\" 3",
        &["BasicCycles is 3", "1, 2, 4"],
    );
}

#[test]
fn a_repeat_factor_that_does_not_divide_the_matrix_is_refused() {
    let add = |attribute: &str| format!("BA_ \"WindowKind\" BO_ 200 2;\nBA_ {attribute};");
    refused(
        "BA_ \"WindowKind\" BO_ 200 2;",
        &add("\"WindowRepeat\" BO_ 200 4"),
        &["WindowRepeat is 4", "2 basic cycles"],
    );
    refused(
        "BA_ \"WindowKind\" BO_ 200 2;",
        &add("\"WindowOffset\" BO_ 200 1"),
        &["WindowOffset is 1", "less than WindowRepeat 1"],
    );
}

#[test]
fn a_period_that_differs_from_the_windows_is_refused() {
    refused(
        "BA_ \"WindowKind\" BO_ 200 2;",
        "BA_ \"WindowKind\" BO_ 200 2;\nBA_ \"GenMsgCycleTime\" BO_ 200 20;",
        &["Speed (200)", "GenMsgCycleTime is 20 ms", "every 10 ms"],
    );
}

#[test]
fn the_kind_of_window_must_suit_the_message() {
    refused(
        "BA_ \"WindowKind\" BO_ 200 2;",
        "BA_ \"WindowKind\" BO_ 200 3;",
        &["Speed (200)", "a cyclic message needs an exclusive window"],
    );
    refused(
        "BA_ \"WindowKind\" BO_ 600 3;",
        "BA_ \"WindowKind\" BO_ 600 2;",
        &[
            "Alarm (600)",
            "an event message needs an arbitrating window",
        ],
    );
    refused(
        "BA_ \"WindowKind\" BO_ 200 2;\n",
        "",
        &["line 7", "Speed (200) has no window"],
    );
}

#[test]
fn signals_must_fit_and_not_overlap() {
    refused(
        "Right : 16|16",
        "Right : 8|16",
        &["line 9", "Right", "overlaps signal Left in byte 1"],
    );
    refused("Right : 16|16", "Right : 56|16", &["Right", "8 data bytes"]);
    refused(
        "Left : 0|16@1- (1,0) [-100|100]",
        "Left : 0|16@1- (1,0) [-100|40000]",
        &["line 8", "-32768 to 32767"],
    );
    refused(
        "Left : 0|16@1- (1,0)",
        "Left : 0|16@1- (1,0.5)",
        &["no whole number"],
    );
    refused(
        "Left : 0|16@1- (1,0)",
        "Left : 0|16@1- (0,0)",
        &["factor 0"],
    );
    refused("SG_ Right", "SG_ Left", &["two signals Left"]);
}

#[test]
fn names_and_identifiers_must_be_known_and_unique() {
    refused(
        "BO_ 600 Alarm: 1 slave",
        "BO_ 600 Alarm: 1 stranger",
        &["stranger", "no node"],
    );
    refused(
        "BO_ 600 Alarm",
        "BO_ 600 Speed",
        &["two messages have the name Speed"],
    );
    refused(
        "[0|1] \"\" master",
        "[0|1] \"\" stranger",
        &["receiver stranger"],
    );
    refused("BO_ 600 Alarm: 1", "BO_ 600 Alarm: 9", &["9 data bytes"]);
    refused(
        "VAL_ 600 Kind 1 \"Fire\"",
        "VAL_ 600 Kind 1 \"Smoke\"",
        &["VAL_TABLE_"],
    );
}

#[test]
fn masters_and_references_must_agree() {
    refused(
        "BA_ \"MasterRank\" BU_ master 0;\n",
        "",
        &["no node has a MasterRank"],
    );
    refused("BU_ master 0", "BU_ master 1", &["rank 1", "the next is 0"]);
    refused(
        "BU_ master 0",
        "BU_ slave 0",
        &["slave sends no reference message"],
    );
    refused(
        "CycleCount : 0|6",
        "CycleCount : 0|5",
        &["line 3", "CycleCount (6 bits)"],
    );
}

#[test]
fn attributes_must_be_numbers_in_range() {
    refused(
        "\"Baudrate\" 250000",
        "\"Baudrate\" 25",
        &["Baudrate is 25 bit/s"],
    );
    refused(
        "\"TransmitEnable\" 16;\nBA_DEF_DEF_ \"MasterRank\"",
        "\"TransmitEnable\" 33;\nBA_DEF_DEF_ \"MasterRank\"",
        &["TransmitEnable is 33: 1 to 32 bit times are accepted"],
    );
    refused(
        "BA_ \"WindowStart\" BO_ 200 1000;",
        "BA_ \"WindowStart\" BO_ 200 -1;",
        &["WindowStart of message Speed (200) is -1"],
    );
}

#[test]
fn names_must_become_identifiers_of_their_own() {
    let values = |from: &str, to: &str| GOOD.replace(from, to);
    let told = |text: &str| Network::parse(text).unwrap_err().to_string();
    assert_eq!(
        told(&values("\"Fire\"", "\"Self\"")),
        "value \"Self\" of the value table Kind becomes \"Self\" in Rust: letters, digits and \
         underscores are accepted, a letter first, and no keyword"
    );
    assert!(told(&values("\"Fire\"", "\"On fire\"")).contains("\"On fire\""));
    assert_eq!(
        told(&values("\"Fire\"", "\"Water\"")),
        "value \"Water\" of the value table Kind becomes Water in Rust, which value \"Water\" of \
         the value table Kind is already: another name is accepted"
    );
    let slave = |to: &str| GOOD.replace("slave", to);
    assert!(told(&slave("self")).contains("node self becomes \"Self\" in Rust"));
    assert!(told(&slave("Master")).contains("which node master is already"));
    assert!(told(&slave("matrix")).contains("becomes MATRIX in Rust, which the generated text"));
    refused("600 Alarm", "600 Node", &["message Node (600) becomes"]);
    refused("600 Alarm", "600 Kind", &["which the value table Kind is"]);
    refused("200 Speed", "200 Events", &["becomes EVENTS in Rust"]);
    refused(
        "SG_ Right",
        "SG_ left",
        &["line 9", "signal left of message Speed becomes left"],
    );
    refused("SG_ Right", "SG_ D1", &["becomes d1 in Rust"]);
    refused("SG_ Right", "SG_ Type", &["\"type\"", "no keyword"]);
}

#[test]
fn attributes_must_be_known() {
    let with = |line: &str| format!("BA_ \"WindowKind\" BO_ 96 1;\n{line}");
    let here = "BA_ \"WindowKind\" BO_ 96 1;\n";
    let defined = |definition: &str, line: &str| {
        let text = GOOD.replacen("BA_DEF_DEF_", &format!("{definition}\nBA_DEF_DEF_"), 1);
        let text = text.replacen(here, &with(line), 1);
        Network::parse(&text).unwrap_err().to_string()
    };
    refused(
        "BO_ 200 2;",
        "BO_ 200 7;",
        &[
            "WindowKind of message Speed (200) is 7: None, Reference, Exclusive, Arbitrating are \
             accepted, or their numbers from 0 on",
        ],
    );
    refused(
        "\"GenMsgSendType\" BO_ 600 1;",
        "\"GenMsgSendType\" BO_ 600 \"Often\";",
        &["GenMsgSendType of message Alarm (600) is \"Often\": Cyclic, Event are accepted"],
    );
    let condition = "BA_DEF_ BO_ \"SendCondition\" ENUM \"Always\",\"WhileFixed\";";
    let told = defined(condition, "BA_ \"SendCondition\" BO_ 200 \"Never\";\n");
    assert!(
        told.contains("SendCondition of message Speed (200) is \"Never\""),
        "{told}"
    );
    let shortest = "BA_DEF_ BO_ \"ShortestLength\" INT -1 8;";
    let told = defined(shortest, "BA_ \"ShortestLength\" BO_ 600 2;\n");
    assert!(
        told.contains("ShortestLength of message Alarm (600) is 2: 0 to 1 data bytes, or -1"),
        "{told}"
    );
    refused(
        here,
        &with("BA_ \"After\" BO_ 200 5;\n"),
        &["After of message Speed (200) is 5"],
    );
    refused(
        here,
        &with("BA_ \"WindowKnd\" BO_ 200 2;\n"),
        &["there is no attribute WindowKnd"],
    );
    refused(
        here,
        &with("BA_ \"WindowStart\" BO_ 201 2;\n"),
        &["WindowStart of message 201: there is no such message"],
    );
    refused(
        here,
        &with("BA_ \"MasterRank\" BU_ salve 1;\n"),
        &["MasterRank of node salve: there is no such node"],
    );
}

#[test]
fn times_that_overflow_are_refused() {
    refused(
        "\"BasicCycle\" 10000",
        "\"BasicCycle\" 4294967295",
        &["BasicCycle is 4294967295 us: 1 to 1000000 us are accepted"],
    );
    let told = with_command("Speed", u32::MAX, u32::MAX).unwrap_err();
    assert!(told.contains("Command (300)"), "{told}");
    let told = with_command("Speed", 1_000_001, 3000).unwrap_err();
    let preparation = "Command (300) has the Preparation 1000001 us: 0 to 1000000 us are accepted";
    assert!(told.contains(preparation), "{told}");
    refused(
        "VAL_ 600",
        "BA_DEF_ BO_ \"FurtherWindows\" STRING ;\nBA_DEF_DEF_ \"FurtherWindows\" \"\";\n\
         BA_ \"FurtherWindows\" BO_ 200 \"4294967295 2 1\";\nVAL_ 600",
        &["ends at 4294967295 us"],
    );
    refused(
        "BA_ \"WindowStart\" BO_ 200 1000;",
        "BA_ \"WindowStart\" BO_ 200 4294967295;",
        &["ends at 4294967295 us"],
    );
}

#[test]
fn the_first_problems_are_displayed() {
    let text = GOOD.replace("\"Baudrate\" 250000", "\"Baudrate\" 10000");
    let text = text.replace("[-100|100]", "[-40000|40000]");
    let problems = Network::parse(&text).unwrap_err();
    assert!(problems.0.len() > 4, "{:?}", problems.0);
    let told = problems.to_string();
    assert_eq!(told.lines().count(), 4);
    let more = format!("\nand {} more problems", problems.0.len() - 3);
    assert!(told.ends_with(&more), "{told}");
}

#[test]
fn every_problem_is_reported_at_once() {
    let text = GOOD
        .replace("Right : 16|16", "Right : 8|16")
        .replace("BO_ 600 Alarm: 1 slave", "BO_ 600 Alarm: 1 stranger");
    let problems = Network::parse(&text).unwrap_err();
    assert_eq!(problems.0.len(), 2, "{problems}");
}

/// Davis et al. 2007: 55 + 10 n; eight bytes take 135 bit times, 540 us at 250 kbit/s.
#[test]
fn the_longest_frame_takes_135_bit_times() {
    assert_eq!(worst_case_bits(8), 135);
    assert_eq!(worst_case_bits(0), 55);
}

/// The good file with a message `Command` that needs `after` and then takes `preparation` us,
/// in a window at `start` us.
fn with_command(after: &str, preparation: u32, start: u32) -> Result<Network, String> {
    let window = format!(
        "BA_ \"After\" BO_ 300 \"{after}\";\nBA_ \"Preparation\" BO_ 300 {preparation};\n\
         BA_ \"WindowKind\" BO_ 300 2;\n\
         BA_ \"WindowStart\" BO_ 300 {start};\nVAL_ 600"
    );
    let text = GOOD
        .replacen(
            "BO_ 600 Alarm",
            "BO_ 300 Command: 2 master\n\nBO_ 600 Alarm",
            1,
        )
        .replacen("VAL_ 600", &window, 1);
    Network::parse(&text).map_err(|problems| problems.to_string())
}

#[test]
fn a_message_before_one_that_it_needs_is_refused() {
    let network = with_command("Speed", 1300, 3000).unwrap();
    let command = network.message(300).unwrap();
    // The window at 1000 us, 64 us until the frame begins, 135 bits of 4 us, and 20 us between two
    // clocks.
    assert_eq!(network.release_us(command), Some(1650));
    let told = with_command("Speed", 0, 0).unwrap_err();
    assert!(
        told.contains("message Command (300) is scheduled before Speed, which it needs"),
        "{told}"
    );
    let told = with_command("Speed", 1400, 3000).unwrap_err();
    assert!(
        told.contains("it needs has arrived at 1650 us, and its Preparation takes 1400 us"),
        "{told}"
    );
    let told = with_command("Sped", 0, 3000).unwrap_err();
    assert!(
        told.contains("Command (300) needs Sped by its attribute After"),
        "{told}"
    );
    let told = with_command("Alarm", 0, 3000).unwrap_err();
    assert!(told.contains("both must have exclusive windows"), "{told}");
}
