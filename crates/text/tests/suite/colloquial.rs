//! Phrases of everyday use against what a person expects of them.

use scenesplat_rooms::{ClassId, Vocabulary};
use scenesplat_text::{ALIKE, LEAD, Phrase, PhraseReader, PhraseTable, Query, Verdict};

/// One phrase a line with its expected answer; the file says how answers are written.
const PHRASES: &str = include_str!("../data/colloquial.tsv");

/// The classes that a phrase is taken for, and whether that is called sure; `None` if it is refused.
fn answer(reader: &PhraseReader<'_>, text: &str) -> Option<(String, bool)> {
    if !matches!(Phrase::parse(text, &[]), Ok(Phrase::Plain)) {
        return None;
    }
    let known = reader.known(text).ok()?;
    let is_sure = match &known.reading {
        Some(reading) => reading.verdict == Verdict::Sure,
        None => known.text == text,
    };
    let classes = Vocabulary::named(&known.text).unwrap().classes();
    let names: Vec<&str> = classes.iter().map(|class| class.about().name).collect();
    Some((names.join(", "), is_sure))
}

/// Whether an answer is one of those that are right.
fn is_right(got: Option<&(String, bool)>, expected: &str) -> bool {
    expected.split('|').any(|right| match (right, got) {
        ("-", got) => got.is_none(),
        (_, None) => false,
        (right, Some((names, is_sure))) => match right.strip_suffix('?') {
            Some(unsure) => names == unsure && !is_sure,
            None => names == right,
        },
    })
}

#[test]
fn phrases_of_everyday_use_mean_what_a_person_expects() {
    let reader = PhraseReader::new(None).unwrap();
    let lines = PHRASES.lines().filter(|line| !line.is_empty() && !line.starts_with('#'));
    let (mut all, mut sure_and_wrong, mut wrong) = (0, Vec::new(), Vec::new());
    for (text, expected) in lines.map(|line| line.split_once('\t').unwrap()) {
        all += 1;
        let got = answer(&reader, text);
        if is_right(got.as_ref(), expected) {
            continue;
        }
        let (names, is_sure) = got.unwrap_or(("-".to_owned(), false));
        let said = format!("{text:?} is {expected:?}, not {names:?}");
        if is_sure { sure_and_wrong.push(said) } else { wrong.push(said) }
    }
    let right = all - wrong.len() - sure_and_wrong.len();
    println!("{right} of {all} right; not: {wrong:#?}; sure and wrong: {sure_and_wrong:#?}");
    // What was measured; the second list was read once, after the words of the first were known.
    assert!(all >= 508 && right >= 487 && sure_and_wrong.len() <= 4, "{right} of {all}");
}

#[test]
fn what_serves_a_purpose_is_taken_as_a_whole_and_said() {
    let (reader, vocabulary) = (PhraseReader::new(None).unwrap(), Vocabulary::new(96).unwrap());
    let asked = reader.ask(&vocabulary, "something to sit on").unwrap();
    let seats = Query::of_vocabulary(&vocabulary, "seat").unwrap();
    assert_eq!((asked.query.meant.values, asked.query.rivals), (seats.meant.values, seats.rivals));
    let reading = asked.reading.unwrap();
    assert_eq!((reading.purpose, reading.verdict), (Some("seat"), Verdict::Sure));
    assert_eq!(reading.to_string(), "all of chair, stool, sofa serve this purpose; sure");
    let names: Vec<&str> = reading.nearest[..3].iter().map(|n| n.class.about().name).collect();
    assert!(["chair", "stool", "sofa"].iter().all(|seat| names.contains(seat)), "{names:?}");
    // A correction is told and not called sure.
    let reading = reader.read("somthing red to sit on").unwrap();
    assert_eq!((reading.known_text().as_str(), reading.verdict), ("red seat", Verdict::NotSure));
    assert!(reading.to_string().contains("took \"somthing\" as \"something\""), "{reading}");
    // What is eaten is not what it is eaten at.
    for (text, purpose) in [("something to eat at", Some("table")), ("something to eat", None)] {
        assert_eq!(reader.read(text).unwrap().purpose, purpose, "{text}");
    }
    assert!(reader.known("something to eat").unwrap_err().to_string().contains("no class serves"));
}

#[test]
fn classes_that_are_as_near_are_told_and_the_one_that_is_there_is_taken() {
    let reader = PhraseReader::new(None).unwrap();
    let phrases = PhraseTable::embedded().unwrap().phrases().iter().step_by(7);
    let readings = phrases.filter_map(|phrase| reader.read(phrase).ok());
    let near = readings.filter(|r| r.verdict != Verdict::NothingAlike && r.near().count() > 0);
    let mut ties = 0;
    for before in near {
        assert_eq!(before.verdict, Verdict::NotSure, "{before}");
        let (first, other) = (before.nearest[0], *before.near().next().unwrap());
        assert!(before.to_string().contains(&format!("; near: {other}")), "{before}");
        let among = |there: &[ClassId]| {
            PhraseReader::new(None).unwrap().among(there).read(&before.text).unwrap()
        };
        let is_alike = other.similarity >= ALIKE;
        let after = among(&[other.class]);
        assert_eq!(after.nearest[0], if is_alike { other } else { first }, "{after}");
        assert_eq!(after.remark.contains("as near, but is not there"), is_alike, "{after}");
        assert_ne!(after.verdict, Verdict::Sure, "{after}");
        assert_eq!(among(&[first.class, other.class]), before);
        assert_eq!(among(&[]), before);
        ties += 1;
    }
    println!("{ties} phrases with classes as near");
    assert!(ties >= 20, "{ties}");
    // What is farther behind is not taken, there or not.
    let reading = reader.read("swivel chair").unwrap();
    assert!(reading.nearest[0].similarity - reading.nearest[1].similarity >= LEAD);
    let there = [reading.nearest[1].class];
    assert_eq!(
        PhraseReader::new(None).unwrap().among(&there).read("swivel chair").unwrap(),
        reading
    );
}

#[test]
fn no_message_repeats_a_long_phrase() {
    let (reader, vocabulary) = (PhraseReader::new(None).unwrap(), Vocabulary::new(96).unwrap());
    let many = |words: &str| words.repeat(200);
    for text in [
        many("volcano "),
        many("qwzxk "),
        many("swivel chiar "),
        many("... "),
        many("not "),
        many("chair without arms "),
        format!("lamp behind the {}", many("sofa ")),
        format!("not {}", many("zzyzx ")),
        format!("{} except red", many("wooden ")),
        format!("chair without {}", many("arms ")),
        "x".repeat(5_000),
    ] {
        let said = match reader.ask(&vocabulary, &text) {
            Ok(asked) => asked.reading.map_or(asked.remark, |reading| reading.to_string()),
            Err(error) => error.to_string(),
        };
        assert!(said.chars().count() <= 600, "{}: {said}", &text[..20]);
    }
}

#[test]
fn two_names_side_by_side_are_the_second() {
    let reader = PhraseReader::new(None).unwrap();
    for (text, known) in [
        ("desk chair", "chair"),
        ("red wall clocks", "red clock"),
        ("sofa-bed", "bed"),
        ("chair and table", "chair and table"),
        ("chair, table", "chair, table"),
        ("box of books", "box of books"),
        ("kitchen lamp", "kitchen lamp"),
    ] {
        assert_eq!(reader.known(text).unwrap().text, known, "{text}");
    }
}
