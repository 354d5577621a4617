//! What is drawn, found in the SVG by places computed here.

use super::super::record::tests::record;
use super::super::summary::Around;
use super::*;

fn summary() -> Summary {
    let mut records = vec![
        record("net=a,voxel=0.1,k=8", 1.0, 0.30),
        record("net=a,voxel=0.1,k=1", 0.5, 0.10),
        record("net=a,voxel=0.02,k=8", 8.0, 0.40),
        record("net=a,voxel=0.02,k=25", 9.0, 0.35),
    ];
    let row = |kind, f_miou| super::super::record::Record { kind, ..record("x", 0.1, f_miou) };
    records.push(row(super::super::record::Kind::Oracle, 0.9));
    records.push(row(super::super::record::Kind::Random, 0.02));
    let around = Around { reference: "net=a,voxel=0.02,k=8".to_owned(), ..Around::default() };
    Summary::of(&records, around).unwrap()
}

fn line(from: [f64; 2], to: [f64; 2], color: &str, width: f64) -> String {
    let [[x1, y1], [x2, y2]] = [from, to];
    format!(
        "<line x1=\"{x1:.1}\" y1=\"{y1:.1}\" x2=\"{x2:.1}\" y2=\"{y2:.1}\" stroke=\"{color}\" stroke-width=\"{width}\""
    )
}

#[test]
fn a_front_is_drawn_where_its_seconds_and_qualities_are() {
    let mut summary = summary();
    assert_eq!(summary.knee.as_deref(), Some("net=a,voxel=0.1,k=8"));
    let svg = chart(&summary).to_svg();
    // Times from 0.98 of the least to 1.02 of the largest; quality from chance to the ceiling.
    let x = Scale::over(&[0.49, 9.18], true, [110.0, 1010.0]);
    let y = Scale::over(&[0.02, 0.9], false, [810.0, 90.0]);
    let has = |part: &str| assert!(svg.contains(part), "{part}\n{svg}");
    let disc = |[seconds, worth]: [f64; 2], radius: f64, fill: &str, rim: &str| {
        has(&format!(
            "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"{radius}\" fill=\"{fill}\" stroke=\"{rim}\"",
            x.at(seconds),
            y.at(worth)
        ));
    };
    disc([0.5, 0.1], 7.0, "#1462be", "#ffffff");
    disc([1.0, 0.3], 9.0, "#e26a14", "#ffffff");
    disc([8.0, 0.4], 7.0, "#1462be", "#ffffff");
    disc([9.0, 0.35], 5.0, "#dee0e3", "#babdc2");
    assert_eq!(svg.matches("<circle").count(), 5, "four and the one of the legend");
    // Steps of the front: to the right first, then up.
    let (a, b) = ([x.at(0.5), y.at(0.1)], [x.at(1.0), y.at(0.3)]);
    has(&line(a, [b[0], a[1]], "#1462be", 2.0));
    has(&line([b[0], a[1]], b, "#1462be", 2.0));
    // Spreads of time and of quality, of the beaten one in its own color.
    for (seconds, worth, color) in [(0.5, 0.1, "#82aadc"), (9.0, 0.35, "#dee0e3")] {
        let (at_x, at_y) = (x.at(seconds), y.at(worth));
        has(&line([x.at(0.98 * seconds), at_y], [x.at(1.02 * seconds), at_y], color, 1.5));
        has(&line([at_x, y.at(worth - 0.02)], [at_x, y.at(worth + 0.02)], color, 1.5));
    }
    for (worth, name, color) in [(0.9, "oracle", "#228c50"), (0.02, "random labels", "#be3c3c")] {
        let at = y.at(worth);
        has(&(line([110.0, at], [1010.0, at], color, 1.5) + " stroke-dasharray"));
        let text = format!(
            "<text x=\"1004.0\" y=\"{:.1}\" font-size=\"26\" fill=\"{color}\" text-anchor=\"end\">{name}</text>",
            at - 22.0 + 16.0
        );
        has(&text);
    }
    for text in [
        "What accuracy costs: f-mIoU against seconds, 0 scenes",
        "seconds a scene (median)",
        "the front",
        " 1 0.5 s 10.0 %<",
        " 2 1 s 30.0 % knee<",
        " 3 8 s 40.0 %<",
        ">voxel=0.1,k=1<",
        ">all: net=a<",
        "cheapest of each class",
        "= 99.9 %: 8 s<",
        "= 95.0 %: 8 s<",
        "beaten by one of the front",
        "bars: spread of repeats; 95 % over scenes",
    ] {
        has(text);
    }
    assert!(svg.contains("height=\"900\"") && !svg.contains("What training costs"));
    // A number that would stand on the one before goes below: 34 pixels are far enough.
    let number = |i: usize, at: [f64; 2], below: bool| {
        let (side, up, anchor) = if below { (12.0, 12.0, "start") } else { (-12.0, -28.0, "end") };
        format!(
            "x=\"{:.1}\" y=\"{:.1}\" font-size=\"26\" fill=\"#1462be\" text-anchor=\"{anchor}\">{i}<",
            at[0] + side,
            at[1] + up + 16.0
        )
    };
    has(&number(1, a, false));
    has(&number(3, [x.at(8.0), y.at(0.4)], false));
    // Twelve points, of which the list names eleven, and a class that nobody wins.
    let base = summary.points[0].clone();
    summary.points = (0..12)
        .map(|i| Point {
            setting: format!("k={i}"),
            seconds_p50: 1.0 + 0.01 * f64::from(i),
            f_miou: Some(0.1 + 0.01 * f64::from(i)),
            ..base.clone()
        })
        .collect();
    (summary.classes[0].setting, summary.classes[0].seconds_p50, summary.num_scenes) =
        (None, None, 1);
    let svg = chart(&summary).to_svg();
    let has = |part: &str| assert!(svg.contains(part), "{part}\n{svg}");
    has("and 1 more");
    has("= 99.9 %: none");
    has("seconds, 1 scene<");
    let at = [x.at(1.01), y.at(0.11)];
    has(&number(2, at, true));
    assert!(
        !svg.contains(">12 1.11 s") && svg.contains(">11 1.1 s 20.0 %<") && !svg.contains("all: ")
    );
}

#[test]
fn training_is_drawn_below_the_front_or_alone() {
    let curve = |name: &str, points: &[[f64; 2]]| TrainingCurve {
        name: name.to_owned(),
        metric: "zero_shot/f-mIoU".to_owned(),
        points: points.to_vec(),
        best: 0.5,
        seconds_to_99: 200.0,
    };
    let training = vec![curve("one", &[[10.0, 0.1], [200.0, 0.5]]), curve("two", &[[40.0, 0.3]])];
    let alone = Summary { training: training.clone(), ..Summary::default() };
    let (x, y) = (
        Scale::over(&[10.0, 200.0], true, [110.0, 1010.0]),
        Scale::over(&[0.1, 0.5], false, [540.0, 70.0]),
    );
    let both = Summary { training, ..summary() };
    for (svg, below, height) in
        [(chart(&alone).to_svg(), 0.0, 620), (chart(&both).to_svg(), 900.0, 1520)]
    {
        let has = |part: &str| assert!(svg.contains(part), "{part}\n{svg}");
        has(&format!("width=\"1600\" height=\"{height}\""));
        let at = |p: [f64; 2]| [x.at(p[0]), y.at(p[1]) + below];
        has(&line(at([10.0, 0.1]), at([200.0, 0.5]), "#1462be", 2.0));
        has(&format!(
            "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"4\" fill=\"#e26a14\"",
            at([40.0, 0.3])[0],
            at([40.0, 0.3])[1]
        ));
        has(&format!(
            "<text x=\"1045.0\" y=\"{:.1}\" font-size=\"26\" fill=\"#e26a14\" text-anchor=\"start\">two<",
            70.0 + 52.0 + 16.0 + below
        ));
        has("zero_shot/f-mIoU: best 50.0 %, 99 % of it after 3.33 min");
        has("What training costs: quality against seconds of training");
    }
}

#[test]
fn numbers_have_three_digits_and_the_unit_of_their_size() {
    for (seconds, text) in [
        (0.0, "0 us"),
        (0.000_999, "999 us"),
        (0.001, "1 ms"),
        (0.0994, "99.4 ms"),
        (0.0995, "0.1 s"),
        (9.994, "9.99 s"),
        (99.94, "99.9 s"),
        (119.6, "120 s"),
        (120.0, "2 min"),
        (7199.0, "120 min"),
        (7200.0, "2 h"),
        (7260.0, "2.02 h"),
        (f64::NAN, "-"),
        (f64::INFINITY, "-"),
    ] {
        assert_eq!(seconds_text(seconds), text, "{seconds}");
    }
    assert_eq!(
        (percent(0.3), percent(0.005), percent(-0.02)),
        ("30 %".into(), "0.5 %".into(), "-2 %".into())
    );
    assert_eq!(shared_parts(&Summary::default()), [""; 0]);
    let points =
        ["a=1,b=2,c=3", "c=3,a=1"].map(|s| Point { setting: s.to_owned(), ..Point::default() });
    let summary = Summary {
        points: points[..1].to_vec(),
        dominated: points[1..].to_vec(),
        ..Summary::default()
    };
    assert_eq!(shared_parts(&summary), ["a=1", "c=3"]);
}
