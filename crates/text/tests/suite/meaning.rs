//! What phrases mean: those that name, those that deny, those that say where a thing stands.

use scenesplat_rooms::{CLASSES, Vocabulary};
use scenesplat_text::{AskError, Phrase, PhraseReader, Verdict};

/// A phrase as an answer in short: `bed` (taken for it, surely), `bed?` (not surely), `-` (nothing is like it), `!bed`
/// (all but beds), `desk, table` (these classes alone), `refused`, `on(lamp, desk)`, `?(lamp, desk)` (a place that no
/// relation is).
fn answer(reader: &PhraseReader<'_>, vocabulary: &Vocabulary, text: &str) -> String {
    match reader.ask(vocabulary, text) {
        Ok(asked) if asked.denied.is_empty() => {
            // A corrected word may have been meant as it stands.
            let is_sure = match &asked.reading {
                Some(reading) => reading.verdict == Verdict::Sure,
                None => asked.taken_for.is_none(),
            };
            let known = asked.taken_for.unwrap_or(asked.query.text);
            if is_sure { known } else { format!("{known}?") }
        }
        Ok(asked) => {
            let (meant, rivals) = (&asked.query.meant.names, &asked.query.rivals.names);
            assert_eq!(meant.len() + rivals.len(), CLASSES.len(), "{text}");
            assert!(meant.iter().all(|name| !asked.denied.contains(name)), "{text}");
            if *rivals == asked.denied {
                format!("!{}", rivals.join(", "))
            } else {
                meant.join(", ")
            }
        }
        Err(AskError::NothingAlike { .. }) => "-".to_owned(),
        Err(AskError::Placed { placed }) => {
            let relation = placed.relation.map_or("?".to_owned(), |relation| relation.to_string());
            format!("{relation}({}, {})", placed.what.as_deref().unwrap_or("*"), placed.to)
        }
        Err(error) if error.to_string().contains("none of the words") => "-".to_owned(),
        Err(_) => "refused".to_owned(),
    }
}

fn check(table: &[(&str, &str)]) {
    let (reader, vocabulary) = (PhraseReader::new(None).unwrap(), Vocabulary::new(96).unwrap());
    let wrong: Vec<String> = table
        .iter()
        .map(|(text, right)| (text, right, answer(&reader, &vocabulary, text)))
        .filter(|(_, right, got)| right != &got)
        .map(|(text, right, got)| format!("{text:?} is {right:?}, not {got:?}"))
        .collect();
    println!("{} phrases, {} right", table.len(), table.len() - wrong.len());
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn what_is_denied_is_never_what_is_asked_for() {
    check(DENIED);
}

#[test]
fn a_place_is_no_class() {
    check(PLACED);
}

#[test]
fn words_that_only_look_like_denials_or_places_are_names() {
    check(NAMED);
}

#[test]
fn names_in_german_french_and_everyday_english_are_understood_or_like_nothing() {
    check(FOREIGN);
}

const DENIED: &[(&str, &str)] = &[
    // The cases.
    ("not a bed", "!bed"),
    ("without chairs", "!chair"),
    ("anything but the bed", "!bed"),
    ("no chair", "!chair"),
    ("non-red chair", "refused"),
    ("all chairs except the red one", "refused"),
    ("everything except the walls", "!wall"),
    (
        "the thing that is not furniture",
        "!table, coffee table, desk, chair, stool, sofa, bed, cabinet, \
      kitchen cabinet, wardrobe, bookshelf, nightstand, tv stand",
    ),
    // One denial of everything.
    ("no chairs", "!chair"),
    ("NOT A BED", "!bed"),
    ("  not   a\tbed!! ", "!bed"),
    ("not the beds", "!bed"),
    ("it's not a bed", "!bed"),
    ("something that isn't a bed", "!bed"),
    ("something that isn\u{2019}t a bed", "!bed"),
    ("things that aren't chairs", "!chair"),
    ("things that arent chairs", "!chair"),
    ("what is not a wall", "!wall"),
    ("whatever isn't the floor", "!floor"),
    ("everything but the bed", "!bed"),
    ("all but the bed", "!bed"),
    ("everything other than chairs", "!chair"),
    ("other than the sofa", "!sofa"),
    ("everything apart from the ceiling", "!ceiling"),
    ("everything aside from the walls", "!wall"),
    ("everything except for the walls", "!wall"),
    ("everything with the exception of the walls", "!wall"),
    ("everything excluding the walls", "!wall"),
    ("exclude the walls", "!wall"),
    ("everything minus the walls", "!wall"),
    ("everything besides the walls", "!wall"),
    ("everything unlike a chair", "!chair"),
    ("show me everything except the walls", "!wall"),
    ("everything in the room except the bed", "!bed"),
    ("the room without the bed", "!bed"),
    ("a room with no chairs", "!chair"),
    ("w/o chairs", "!chair"),
    (
        "non-furniture",
        "!table, coffee table, desk, chair, stool, sofa, bed, cabinet, kitchen cabinet, wardrobe, \
      bookshelf, nightstand, tv stand",
    ),
    ("none of the chairs", "!chair"),
    ("!bed", "!bed"),
    ("-bed", "!bed"),
    ("exept the walls", "!wall"),
    ("everything excpet the walls", "!wall"),
    ("withot chairs", "!chair"),
    ("not a couch", "!sofa"),
    ("no tv", "!tv"),
    ("no televisions", "!tv"),
    ("no Stuhl", "!chair"),
    ("everything except the walls and the floor", "!wall, floor"),
    ("everything except walls, floors and ceilings", "!wall, floor, ceiling"),
    ("no bed or sofa", "!sofa, bed"),
    ("no seats", "!chair, stool, sofa"),
    ("kein Bett", "!bed"),
    ("ohne St\u{fc}hle", "!chair"),
    ("alles au\u{df}er dem Bett", "!bed"),
    ("alles ausser dem Bett", "!bed"),
    ("sans chaises", "!chair"),
    ("tout sauf le lit", "!bed"),
    ("pas de chaise", "!chair"),
    // Taken from a group.
    ("seats except sofas", "chair, stool"),
    ("seats that are not sofas", "chair, stool"),
    ("all seats but the chairs", "stool, sofa"),
    ("non-chair seats", "stool, sofa"),
    ("structure without the walls", "floor, ceiling, window, door"),
    ("seats but not chairs or stools", "sofa"),
    // What cannot be told.
    ("not", "refused"),
    ("no", "refused"),
    ("except", "refused"),
    ("anything but", "refused"),
    ("nothing", "refused"),
    ("but", "refused"),
    ("without", "refused"),
    ("bed not", "refused"),
    ("not not a bed", "refused"),
    ("no chair but the table", "refused"),
    ("nothing but the bed", "refused"),
    ("neither bed nor chair", "refused"),
    ("not the bed but the sofa", "refused"),
    ("a chair without arms", "refused"),
    ("a chair with no arms", "refused"),
    ("table without chairs", "refused"),
    ("a bed, not a sofa", "refused"),
    ("chairs except chairs", "refused"),
    ("not a red chair", "refused"),
    ("no red", "refused"),
    ("not red", "refused"),
    ("chairs that are not red", "refused"),
    ("everything except red chairs", "refused"),
    ("red seats except sofas", "refused"),
    ("not a kitchen lamp", "refused"),
    ("not a box of books", "refused"),
    ("not a wooden chair", "refused"),
    ("everything except wooden chairs", "refused"),
    ("not a place to sleep", "refused"),
    ("not all chairs", "refused"),
    ("not every chair", "refused"),
    ("not only chairs", "refused"),
    ("all chairs except one", "refused"),
    ("no thing", "refused"),
    ("not volcano", "refused"),
    ("non-stick pan", "refused"),
    ("non-slip mat", "refused"),
    ("small but comfy sofa", "refused"),
    ("room no. 5", "refused"),
    ("lamp not on the desk", "refused"),
    ("everything on the desk except the lamp", "refused"),
    ("everything except the picture on the wall", "refused"),
    ("not next to the bed", "refused"),
    ("everything except the box with books", "refused"),
    ("furniture except walls", "refused"),
    ("do not select the bed", "refused"),
];

const PLACED: &[(&str, &str)] = &[
    ("lamp on the desk", "on(lamp, desk)"),
    ("the lamp standing on the desk", "on(lamp, desk)"),
    ("lamp on top of a desk", "on(lamp, desk)"),
    ("red lamp on the desk", "on(red lamp, desk)"),
    ("cactus on the desk", "on(cactus, desk)"),
    ("Lampe auf dem Tisch", "on(lampe, dem tisch)"),
    ("lampe sur la table", "on(lampe, la table)"),
    ("picture above the sofa", "above(picture, sofa)"),
    ("lamp over the table", "above(lamp, table)"),
    ("box under the bed", "under(box, bed)"),
    ("box underneath the bed", "under(box, bed)"),
    ("book in the box", "in(book, box)"),
    ("pillow in the bathtub", "in(pillow, bathtub)"),
    ("chair next to the desk", "near(chair, desk)"),
    ("chair right next to the desk", "near(chair, desk)"),
    ("nightstand beside the bed", "near(nightstand, bed)"),
    ("lamp by the bed", "near(lamp, bed)"),
    ("lamp near the couch", "near(lamp, couch)"),
    ("what is under the bed", "under(*, bed)"),
    ("everything on the desk", "on(*, desk)"),
    ("on the desk", "on(*, desk)"),
    ("next to the bed", "near(*, bed)"),
    ("chair left of the table", "?(chair, table)"),
    ("the chair to the left of the table", "?(chair, table)"),
    ("chair to the right of the table", "?(chair, table)"),
    ("chair in front of the desk", "?(chair, desk)"),
    ("chair behind the sofa", "?(chair, sofa)"),
    ("table between the bed and the wall", "?(table, bed and wall)"),
    ("tv opposite the sofa", "?(tv, sofa)"),
    ("desk against the wall", "?(desk, wall)"),
    ("chair closest to the window", "?(chair, window)"),
    ("bed with pillows", "?(bed, pillows)"),
    ("lamp in the kitchen", "?(lamp, kitchen)"),
    ("chair far from the table", "?(chair, table)"),
    // What a place is by has to be a name; what the phrase table has whole is no place.
    ("something soft under my head", "pillow?"),
    ("something to hang on the wall", "picture"),
    ("something to put my feet on", "stool"),
    ("a lamp that is on", "lamp"),
    ("chair with arms", "chair"),
];

const NAMED: &[(&str, &str)] = &[
    ("bed", "bed"),
    ("a bed", "a bed"),
    ("the beds", "the beds"),
    ("chairs", "chairs"),
    ("couch", "couch"),
    ("red chair", "red chair"),
    ("the GREY couches", "the GREY couches"),
    ("furniture", "furniture"),
    ("box of books", "box of books"),
    ("chiar", "chair?"),
    ("another chair", "chair"),
    ("other chairs", "chair"),
    ("the other chair", "chair"),
    ("north wall", "wall"),
    ("notebook", "laptop"),
    ("nonstick pan", "-"),
    ("doorknob", "door"),
    ("button", "-"),
    ("butter", "-"),
    ("knot", "-"),
    ("knob", "-"),
    ("note", "-"),
    ("nose", "-"),
    ("noodle", "-"),
    ("onion", "-"),
    ("canon", "-"),
    ("volcano", "-"),
    ("buttercup", "-"),
    ("exception", "-"),
    ("withdrawal", "-"),
    ("nothingness", "-"),
    ("noticeboard", "cabinet?"),
    ("monitor", "monitor"),
    ("piano stool", "stool"),
    ("swivel chair", "chair"),
    ("a place to sleep", "bed"),
    ("swivel chair qwzxk", "chair?"),
    ("xyzzy chair", "chair?"),
    ("nightstand", "nightstand"),
    ("snow", "-"),
    ("table", "table"),
    ("", "refused"),
    ("   ", "refused"),
    ("\u{0}", "refused"),
    ("\u{6905}\u{5b50}", "-"),
    ("\u{ff4e}\u{ff4f}\u{ff54} chair", "chair?"),
];

const FOREIGN: &[(&str, &str)] = &[
    ("Wand", "wall?"),
    ("mur", "wall"),
    ("Boden", "floor"),
    ("Fu\u{df}boden", "floor"),
    ("sol", "floor?"),
    ("Decke", "ceiling"),
    ("plafond", "ceiling"),
    ("Fenster", "window"),
    ("fen\u{ea}tre", "window"),
    ("fenetre", "window"),
    ("T\u{fc}r", "door"),
    ("Tuer", "door"),
    ("die T\u{fc}ren", "door"),
    ("porte", "door?"),
    ("la porte", "door"),
    ("Tisch", "table"),
    ("ein Tisch", "table"),
    ("Couchtisch", "coffee table"),
    ("table basse", "coffee table"),
    ("Schreibtisch", "desk"),
    ("bureau", "desk?"),
    ("Stuhl", "chair"),
    ("St\u{fc}hle", "chair"),
    ("Stuehle", "chair"),
    ("der Stuhl", "chair"),
    ("chaise", "chair?"),
    ("chaises", "chair?"),
    ("les chaises", "chair"),
    ("fauteuil", "chair?"),
    ("Hocker", "stool"),
    ("tabouret", "stool?"),
    ("Sofa", "Sofa"),
    ("canap\u{e9}", "sofa"),
    ("canape", "sofa"),
    ("Bett", "bed"),
    ("das Bett", "bed"),
    ("Betten", "bed"),
    ("lit", "bed?"),
    ("le lit", "bed"),
    ("Schrank", "cabinet"),
    ("commode", "-"),
    ("K\u{fc}chenschrank", "kitchen cabinet"),
    ("Kleiderschrank", "wardrobe"),
    ("armoire", "armoire"),
    ("Regal", "bookshelf?"),
    ("B\u{fc}cherregal", "bookshelf"),
    ("\u{e9}tag\u{e8}re", "bookshelf"),
    ("biblioth\u{e8}que", "bookshelf"),
    ("Nachttisch", "nightstand"),
    ("table de chevet", "nightstand"),
    ("Fernsehtisch", "tv stand"),
    ("meuble t\u{e9}l\u{e9}", "tv stand"),
    ("Fernseher", "tv"),
    ("t\u{e9}l\u{e9}viseur", "tv"),
    ("telly", "tv"),
    ("Bildschirm", "monitor"),
    ("\u{e9}cran", "monitor"),
    ("Tastatur", "keyboard"),
    ("clavier", "keyboard?"),
    ("ordinateur portable", "laptop"),
    ("Lampe", "lamp"),
    ("Lampen", "lamp"),
    ("Pflanze", "plant"),
    ("plante", "plant"),
    ("Bild", "picture"),
    ("tableau", "picture?"),
    ("Spiegel", "mirror"),
    ("miroir", "mirror"),
    ("Vorhang", "curtain"),
    ("rideau", "curtain"),
    ("rideaux", "curtain"),
    ("Teppich", "rug"),
    ("tapis", "rug?"),
    ("Kissen", "pillow"),
    ("coussin", "pillow"),
    ("Buch", "book"),
    ("B\u{fc}cher", "book"),
    ("livre", "book"),
    ("Kiste", "box"),
    ("bo\u{ee}te", "box"),
    ("M\u{fc}lleimer", "trash can"),
    ("poubelle", "trash can"),
    ("Becher", "mug"),
    ("tasse", "mug"),
    ("Uhr", "clock"),
    ("horloge", "clock"),
    ("l'horloge", "clock"),
    ("Heizk\u{f6}rper", "radiator"),
    ("radiateur", "radiator"),
    ("Toilette", "toilet"),
    ("toilettes", "toilet"),
    ("Waschbecken", "sink"),
    ("\u{e9}vier", "sink"),
    ("Badewanne", "bathtub"),
    ("baignoire", "bathtub"),
    ("K\u{fc}hlschrank", "refrigerator"),
    ("Kuehlschrank", "refrigerator"),
    ("r\u{e9}frig\u{e9}rateur", "refrigerator"),
    ("frigo", "refrigerator"),
    ("Herd", "stove?"),
    ("four", "stove?"),
    ("cuisini\u{e8}re", "stove"),
    ("Dunstabzugshaube", "range hood"),
    ("hotte", "range hood"),
    ("rotes Sofa", "refused"),
    ("chaise rouge", "refused"),
    ("red Stuhl", "red chair"),
    ("loo", "toilet"),
    ("fridge", "fridge"),
    ("settee", "settee"),
    ("telly stand", "tv stand"),
];

#[test]
fn labels_of_any_list_can_be_denied() {
    let labels = ["wall", "no parking sign", "whiteboard", "chair", "couch", "otherfurniture"];
    let labels = labels.map(str::to_owned);
    let left = |text: &str| match Phrase::parse(text, &labels).unwrap() {
        Phrase::Denied(denied) => denied.labels(&labels).map(|left| (left.chosen, left.denied)),
        other => panic!("{text}: {other:?}"),
    };
    let of = |chosen: &[usize], denied: &[&str]| {
        (chosen.to_vec(), denied.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>())
    };
    assert_eq!(left("not a whiteboard").unwrap(), of(&[0, 1, 3, 4, 5], &["whiteboard"]));
    assert_eq!(
        left("no whiteboards or walls").unwrap(),
        of(&[1, 3, 4, 5], &["wall", "whiteboard"])
    );
    // Only what is there of a group.
    assert_eq!(left("no seats").unwrap(), of(&[0, 1, 2, 4, 5], &["chair"]));
    assert!(left("no beds").is_err(), "the list has none");
    assert_eq!(Phrase::parse("No Parking Sign", &labels).unwrap(), Phrase::Plain);
    let placed = Phrase::parse("the chair by the whiteboards", &labels).unwrap();
    assert!(matches!(placed, Phrase::Placed(placed) if placed.to == "whiteboards"));
}

#[test]
fn hostile_phrases_are_read_in_time() {
    let (reader, vocabulary) = (PhraseReader::new(None).unwrap(), Vocabulary::new(96).unwrap());
    let long = |word: &str, count| vec![word; count].join(" ");
    for text in [
        long("not", 50_000),
        long("on the bed", 20_000),
        format!("{} not a bed", long("everything", 50_000)),
        format!("not {}", long("bed and", 20_000)),
        "x".repeat(1 << 20),
        "'".repeat(1 << 16),
        "-".repeat(1 << 16),
        "w/o ".repeat(1 << 12),
    ] {
        let start: String = text.chars().take(20).collect();
        let answer = answer(&reader, &vocabulary, &text);
        println!("{start}: {}", answer.chars().take(60).collect::<String>());
        assert_ne!(answer, "bed", "{start}");
    }
    let labels: Vec<String> = (0..2_000).map(|i| format!("class {i}")).collect();
    let phrase = long("on top of the shoe", 20_000);
    assert_eq!(Phrase::parse(&phrase, &labels).unwrap(), Phrase::Plain);
}
