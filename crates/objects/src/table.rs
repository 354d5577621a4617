//! Catalogues as text: JSON, CSV, Markdown.

use crate::catalogue::{Catalogue, Object};
use serde_json::{Value, json};
use std::fmt::Write;

/// A catalogue as JSON: `gaussians`, `left_over`, `small_instances`, `nameless_instances`, `floor`, and `objects` with id, class, score, count,
/// box (center, size, yaw, corners), volume, position, above_floor and wall_distance.
///
/// `position`, `center` and `corners` are in the frame and unit of the scene, all else in meters,
/// radians about up.
pub fn json(catalogue: &Catalogue) -> Value {
    let objects: Vec<Value> = catalogue.objects.iter().map(object).collect();
    json!({
        "version": 1,
        "gaussians": catalogue.gaussians,
        "left_over": catalogue.left_over,
        "small_instances": catalogue.small_instances,
        "nameless_instances": catalogue.nameless_instances,
        "instances_from": if catalogue.is_carried { "scene" } else { "labels" },
        "floor": {
            "height": catalogue.floor.height,
            "labelled": catalogue.floor.is_labelled,
            "given": catalogue.floor.is_given,
        },
        "objects": objects,
    })
}

fn object(o: &Object) -> Value {
    json!({
        "id": o.id,
        "class": o.class,
        "score": o.score,
        "count": o.count,
        "box": {
            "center": o.position,
            "size": o.bounds.size,
            "yaw": o.bounds.yaw,
            "corners": o.corners,
        },
        "volume": o.volume,
        "position": o.position,
        "above_floor": o.above_floor,
        "wall_distance": o.wall_distance,
    })
}

/// The columns of the CSV table.
const COLUMNS: &str =
    "id,class,score,count,x,y,z,length,width,height,yaw,volume,above_floor,wall_distance\n";

/// A catalogue as CSV, one object a line; what is not known is empty. A field with a comma, a quote or a
/// line break stands in quotes; a class that a spreadsheet would take for a formula begins with an
/// apostrophe.
pub fn csv(catalogue: &Catalogue) -> String {
    let mut out = COLUMNS.to_owned();
    for o in &catalogue.objects {
        let [x, y, z] = o.position;
        let [length, width, height] = o.bounds.size;
        let number = |v: Option<f64>| v.map_or(String::new(), |v| format!("{v:.4}"));
        let _ = write!(out, "{},{},{},{},", o.id, field(&o.class), number(o.score), o.count);
        let values =
            [x, y, z, length, width, height, o.bounds.yaw, o.volume, o.above_floor].map(Some);
        let cells: Vec<String> = values.into_iter().chain([o.wall_distance]).map(number).collect();
        out += &(cells.join(",") + "\n");
    }
    out
}

fn field(text: &str) -> String {
    let formula = text.starts_with(['=', '+', '-', '@', '\t', '\r']);
    let text = if formula { format!("'{text}") } else { text.to_owned() };
    if text.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text
    }
}

/// A catalogue as a Markdown table. Of long names the first 60 letters.
pub fn markdown(catalogue: &Catalogue) -> String {
    let mut out = String::from(
        "| # | class | score | Gaussians | position | length × width × height, m | volume, m³ | \
         over the floor, m | from a wall, m |\n|---|---|---|---|---|---|---|---|---|\n",
    );
    for o in &catalogue.objects {
        let [x, y, z] = o.position;
        let [l, w, h] = o.bounds.size;
        let known = |v: Option<f64>| v.map_or("–".to_owned(), |v| format!("{v:.2}"));
        let _ = writeln!(
            out,
            "| {} | {} | {} | {} | {x:.2}, {y:.2}, {z:.2} | {l:.2} × {w:.2} × {h:.2} | {:.3} | {:.2} | {} |",
            o.id,
            cell(&o.class),
            known(o.score),
            o.count,
            o.volume,
            o.above_floor,
            known(o.wall_distance)
        );
    }
    out
}

/// A name that neither ends its cell nor is markup.
fn cell(text: &str) -> String {
    let mut out = String::new();
    for c in text.chars().take(60) {
        match c {
            '|' | '\\' | '`' | '*' | '_' | '<' | '>' | '[' | ']' => {
                out.push('\\');
                out.push(c);
            }
            c if c.is_control() => out.push(' '),
            c => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Floor, UprightBox};

    fn catalogue(class: &str) -> Catalogue {
        let bounds = UprightBox { center: [1.0, 2.0, 0.5], size: [2.0, 1.0, 0.5], yaw: 0.1 };
        let object = Object {
            id: 1,
            class: class.to_owned(),
            label: 0,
            score: Some(0.75),
            count: 40,
            bounds,
            position: bounds.center,
            corners: bounds.corners(),
            volume: bounds.volume(),
            above_floor: 0.25,
            wall_distance: None,
            rows: (0..40).collect(),
        };
        let floor = Floor { height: 0.0, is_labelled: true, is_given: false };
        Catalogue {
            objects: vec![object],
            floor,
            left_over: 3,
            small_instances: 0,
            nameless_instances: 0,
            gaussians: 50,
            is_carried: true,
        }
    }

    #[test]
    fn all_three_say_the_same() {
        let c = catalogue("chair");
        let value = json(&c);
        let o = &value["objects"][0];
        assert_eq!((o["class"].as_str(), o["count"].as_u64()), (Some("chair"), Some(40)));
        assert_eq!(o["position"], json!([1.0, 2.0, 0.5]));
        assert_eq!(o["box"]["size"], json!([2.0, 1.0, 0.5]));
        assert!(o["wall_distance"].is_null());
        let lines = csv(&c);
        assert_eq!(
            lines.lines().nth(1),
            Some(
                "1,chair,0.7500,40,1.0000,2.0000,0.5000,2.0000,1.0000,0.5000,0.1000,1.0000,0.2500,"
            )
        );
        assert!(markdown(&c).contains("| 1 | chair | 0.75 | 40 | 1.00, 2.00, 0.50 |"));
    }

    #[test]
    fn hostile_names_stay_in_their_cells() {
        let c = catalogue("=cmd(),\"a\"\n|b`<script>");
        let lines = csv(&c);
        assert!(lines.contains("\"'=cmd(),\"\"a\"\"\n|b`<script>\""), "{lines}");
        let text = markdown(&c);
        assert!(text.contains("=cmd(),\"a\" \\|b\\`\\<script\\>"), "{text}");
        assert_eq!(text.lines().count(), 3);
        let long = markdown(&catalogue(&"x".repeat(1 << 20)));
        assert!(long.len() < 1000);
    }

    #[test]
    fn every_number_stands_below_its_name() {
        let text = markdown(&catalogue("chair"));
        let lines: Vec<Vec<&str>> =
            text.lines().map(|line| line.split('|').map(str::trim).collect()).collect();
        let below = |name: &str| lines[2][lines[0].iter().position(|cell| *cell == name).unwrap()];
        // The box is 2 m by 1 m by 0.5 m, 1 m³; it is 0.25 m above the floor.
        assert_eq!(below("length × width × height, m"), "2.00 × 1.00 × 0.50");
        assert_eq!(below("volume, m³"), "1.000");
        assert_eq!(below("over the floor, m"), "0.25");
        assert_eq!(below("from a wall, m"), "–");
    }

    #[test]
    fn all_that_is_known_is_written_in_its_place() {
        let mut c = catalogue("chair");
        (c.small_instances, c.nameless_instances) = (7, 8);
        c.floor = Floor { height: -0.25, is_labelled: false, is_given: true };
        let o = &mut c.objects[0];
        // Centimeters of another frame: the box itself is in meters.
        (o.id, o.position, o.wall_distance) = (5, [100.0, 200.0, 50.0], Some(1.5));
        (o.volume, o.corners) = (1.25, [[0.5, 1.5, 2.5]; 8]);
        let want = json!({
            "version": 1,
            "gaussians": 50,
            "left_over": 3,
            "small_instances": 7,
            "nameless_instances": 8,
            "instances_from": "scene",
            "floor": { "height": -0.25, "labelled": false, "given": true },
            "objects": [{
                "id": 5,
                "class": "chair",
                "score": 0.75,
                "count": 40,
                "box": {
                    "center": [100.0, 200.0, 50.0],
                    "size": [2.0, 1.0, 0.5],
                    "yaw": 0.1,
                    "corners": vec![[0.5, 1.5, 2.5]; 8],
                },
                "volume": 1.25,
                "position": [100.0, 200.0, 50.0],
                "above_floor": 0.25,
                "wall_distance": 1.5,
            }],
        });
        assert_eq!(json(&c), want);
        let lines = "id,class,score,count,x,y,z,length,width,height,yaw,volume,above_floor,wall_distance\n\
                     5,chair,0.7500,40,100.0000,200.0000,50.0000,2.0000,1.0000,0.5000,0.1000,1.2500,0.2500,1.5000\n";
        assert_eq!(csv(&c), lines);
        let row = "| 5 | chair | 0.75 | 40 | 100.00, 200.00, 50.00 | 2.00 × 1.00 × 0.50 | 1.250 | 0.25 | 1.50 |";
        assert_eq!(markdown(&c).lines().nth(2), Some(row));
        for (text, want) in [
            ("+1", "'+1"),
            ("-1", "'-1"),
            ("@a", "'@a"),
            ("a=b", "a=b"),
            ("a\rb", "\"a\rb\""),
            ("\tx", "'\tx"),
        ] {
            assert_eq!(field(text), want);
        }
        assert_eq!(cell("a*b_c[d]\\e>\t"), "a\\*b\\_c\\[d\\]\\\\e\\> ");
        assert_eq!(cell(&"y".repeat(61)).len(), 60);
    }
}
