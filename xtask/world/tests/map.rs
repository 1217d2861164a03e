//! The picture of a map of shares.

use roxmltree::Document;
use world::report::{MapAxis, MapCell, MapPanel, MapPicture, map_svg};

fn cell(share: f64, label: &str) -> MapCell {
    MapCell {
        share,
        label: label.into(),
    }
}

#[test]
fn each_cell_shows_its_share_and_its_label() {
    let panel = |heading: &str| MapPanel {
        heading: heading.into(),
        cells: vec![
            cell(0.0, "a & b"),
            cell(0.25, "c"),
            cell(1.0, "d"),
            cell(0.5, "e"),
            cell(0.75, "f"),
            cell(0.1, "g"),
        ],
    };
    let text = map_svg(&MapPicture {
        name: "a <map>",
        about: "for a test",
        across: MapAxis {
            label: "length (m)",
            values: &[0.0, 1.5, 3.0],
        },
        down: MapAxis {
            label: "number (1/m)",
            values: &[2.0, 4.0],
        },
        panels: &[panel("slow"), panel("fast")],
    });
    let document = Document::parse(&text).unwrap();
    let texts: Vec<&str> = document
        .descendants()
        .filter(|node| node.has_tag_name("text"))
        .filter_map(|node| node.text())
        .collect();
    for wanted in [
        "a <map>",
        "length (m)",
        "number (1/m)",
        "slow",
        "fast",
        "1.5",
        "a & b",
    ] {
        assert!(texts.contains(&wanted), "{wanted}: {texts:?}");
    }
    assert_eq!(texts.iter().filter(|text| **text == "25 %").count(), 2);
    // The colour is as strong as the share, and cells of one line stand beside each other.
    let rectangles = document
        .descendants()
        .filter(|node| node.has_tag_name("rect"));
    let shaded: Vec<[f64; 3]> = rectangles
        .filter(|node| node.attribute("fill") == Some("#d55e00"))
        .map(|node| {
            ["x", "y", "fill-opacity"].map(|key| node.attribute(key).unwrap().parse().unwrap())
        })
        .collect();
    let shares: Vec<f64> = shaded.iter().map(|cell| cell[2]).collect();
    assert_eq!(shares[..6], [0.0, 0.25, 1.0, 0.5, 0.75, 0.1]);
    assert_eq!(shaded[0][1], shaded[2][1]);
    assert!(shaded[1][0] > shaded[0][0] && shaded[3][1] > shaded[0][1]);
    assert!(
        shaded[6][0] > shaded[2][0],
        "the second map is beside the first one"
    );
}
