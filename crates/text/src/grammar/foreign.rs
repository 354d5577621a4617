//! Names of the classes in German and French, and English ones that mean something else too.

use super::everyday;
use crate::phrases::distance;
use scenesplat_rooms::ClassId;
use std::sync::LazyLock;

/// Shorter names are the ends of too many words.
const SHORTEST_END: usize = 4;
/// A "Leinwand" is no wall, a "Bettdecke" no ceiling.
const NO_ENDS: &[ClassId] = &[ClassId::Wall, ClassId::Ceiling];
/// Shorter names are not told from others by one letter.
const SHORTEST_MISSPELT: usize = 6;

/// Articles that come before these names.
const ARTICLES: &[&str] = &[
    "der", "die", "das", "dem", "den", "des", "ein", "eine", "einen", "einem", "einer", "le", "la",
    "les", "un", "une", "du", "de",
];

/// Colors in German and French that are no English words.
const COLORS: &[&str] = &[
    "rotes",
    "roter",
    "roten",
    "blau",
    "blaue",
    "blaues",
    "blauer",
    "blauen",
    "grün",
    "grüne",
    "grünes",
    "grüner",
    "grünen",
    "gelb",
    "gelbe",
    "gelbes",
    "gelber",
    "gelben",
    "schwarz",
    "schwarze",
    "schwarzes",
    "schwarzer",
    "schwarzen",
    "weiß",
    "weiße",
    "weißes",
    "weißer",
    "weißen",
    "grau",
    "graue",
    "graues",
    "grauer",
    "grauen",
    "braun",
    "braune",
    "braunes",
    "brauner",
    "braunen",
    "rouge",
    "rouges",
    "bleu",
    "bleue",
    "bleus",
    "bleues",
    "vert",
    "verte",
    "verts",
    "vertes",
    "jaune",
    "jaunes",
    "noir",
    "noire",
    "noirs",
    "noires",
    "blanc",
    "blanche",
    "blancs",
    "blanches",
    "gris",
    "grise",
    "grises",
    "marron",
    "brun",
    "brune",
];

/// Whether a word is a color in German or French.
pub(super) fn is_color(word: &str) -> bool {
    COLORS.contains(&word)
}

/// Classes with their names, singular and plural, lower case.
const NAMES: &[(ClassId, &[&str])] = &[
    (ClassId::Wall, &["wand", "wände", "mauer", "mauern", "mur", "murs"]),
    (
        ClassId::Floor,
        &["boden", "fußboden", "fussboden", "böden", "sol", "sols", "plancher", "parkett"],
    ),
    (ClassId::Ceiling, &["decke", "zimmerdecke", "decken", "plafond", "plafonds"]),
    (ClassId::Window, &["fenster", "fenêtre", "fenêtres"]),
    (ClassId::Door, &["tür", "türe", "türen", "porte", "portes", "haustür", "zimmertür"]),
    (ClassId::Table, &["tisch", "tische", "esstisch", "esstische", "table à manger"]),
    (
        ClassId::CoffeeTable,
        &[
            "couchtisch",
            "couchtische",
            "table basse",
            "tables basses",
            "wohnzimmertisch",
            "wohnzimmertische",
            "table de salon",
        ],
    ),
    (
        ClassId::Desk,
        &[
            "schreibtisch",
            "schreibtische",
            "bureau",
            "bureaux",
            "arbeitstisch",
            "arbeitstische",
            "table de travail",
        ],
    ),
    (
        ClassId::Chair,
        &[
            "stuhl",
            "stühle",
            "sessel",
            "chaise",
            "chaises",
            "fauteuil",
            "fauteuils",
            "chaise de bureau",
            "chaises de bureau",
        ],
    ),
    (ClassId::Stool, &["hocker", "tabouret", "tabourets"]),
    (ClassId::Sofa, &["polstersofa", "canapé", "canapés", "divan", "banquette", "banquettes"]),
    (ClassId::Bed, &["bett", "betten", "lit", "lits", "matelas"]),
    (
        ClassId::Cabinet,
        &[
            "schrank",
            "schränke",
            "kommode",
            "kommoden",
            "vitrine",
            "anrichte",
            "placard",
            "placards",
            "vaisselier",
            "vaisseliers",
        ],
    ),
    (
        ClassId::KitchenCabinet,
        &[
            "küchenschrank",
            "küchenschränke",
            "placard de cuisine",
            "meuble de cuisine",
            "hängeschrank",
            "hängeschränke",
        ],
    ),
    (ClassId::Wardrobe, &["kleiderschrank", "kleiderschränke", "garde robe", "penderie"]),
    (
        ClassId::Bookshelf,
        &[
            "regal",
            "regale",
            "bücherregal",
            "bücherregale",
            "étagère",
            "étagères",
            "bibliothèque",
            "bücherschrank",
            "bücherschränke",
        ],
    ),
    (
        ClassId::Nightstand,
        &[
            "nachttisch",
            "nachttische",
            "table de chevet",
            "table de nuit",
            "tables de chevet",
            "nachtkästchen",
        ],
    ),
    (
        ClassId::TvStand,
        &["fernsehtisch", "fernsehschrank", "tv schrank", "meuble tv", "meuble télé"],
    ),
    (ClassId::Tv, &["fernseher", "fernsehgerät", "téléviseur", "télévision", "télé", "glotze"]),
    (
        ClassId::Monitor,
        &[
            "bildschirm",
            "bildschirme",
            "monitore",
            "écran",
            "écrans",
            "moniteur",
            "écran ordinateur",
        ],
    ),
    (ClassId::Keyboard, &["tastatur", "tastaturen", "clavier", "claviers"]),
    (ClassId::Laptop, &["klapprechner", "ordinateur portable", "ordinateurs portables"]),
    (
        ClassId::Lamp,
        &[
            "lampe",
            "lampen",
            "leuchte",
            "leuchten",
            "lampes",
            "luminaire",
            "luminaires",
            "lampadaire",
            "lampadaires",
            "lustre",
            "lustres",
        ],
    ),
    (ClassId::Plant, &["pflanze", "pflanzen", "zimmerpflanze", "plante", "plantes"]),
    (
        ClassId::Picture,
        &[
            "bild",
            "bilder",
            "gemälde",
            "tableau",
            "tableaux",
            "foto",
            "fotos",
            "affiche",
            "affiches",
            "peinture",
            "peintures",
        ],
    ),
    (ClassId::Mirror, &["spiegel", "miroir", "miroirs"]),
    (
        ClassId::Curtain,
        &[
            "vorhang",
            "vorhänge",
            "gardine",
            "gardinen",
            "rideau",
            "rideaux",
            "rollo",
            "rollos",
            "jalousie",
            "jalousien",
            "voilage",
            "voilages",
            "blind",
            "blinds",
        ],
    ),
    (
        ClassId::Rug,
        &[
            "teppich",
            "teppiche",
            "tapis",
            "läufer",
            "fußmatte",
            "fußmatten",
            "moquette",
            "moquettes",
        ],
    ),
    (ClassId::Pillow, &["kissen", "kopfkissen", "coussin", "coussins", "oreiller", "oreillers"]),
    (ClassId::Book, &["buch", "bücher", "livre", "livres", "bouquin", "bouquins"]),
    (
        ClassId::Box,
        &["kiste", "kisten", "schachtel", "schachteln", "karton", "kartons", "boîte", "boîtes"],
    ),
    (
        ClassId::TrashCan,
        &[
            "mülleimer",
            "abfalleimer",
            "papierkorb",
            "poubelle",
            "poubelles",
            "corbeille",
            "corbeilles",
        ],
    ),
    (ClassId::Mug, &["becher", "tasse", "tassen", "tasses", "chope", "chopes"]),
    (
        ClassId::Clock,
        &["uhr", "uhren", "wanduhr", "horloge", "horloges", "pendule", "wecker", "réveil"],
    ),
    (ClassId::Radiator, &["heizkörper", "heizung", "radiateur", "radiateurs", "chauffage", "rad"]),
    (ClassId::Toilet, &["toilette", "toilettes", "klo", "bog"]),
    (
        ClassId::Sink,
        &[
            "waschbecken",
            "spülbecken",
            "spüle",
            "lavabo",
            "lavabos",
            "évier",
            "waschtisch",
            "vasque",
            "vasques",
        ],
    ),
    (ClassId::Bathtub, &["badewanne", "badewannen", "baignoire", "baignoires", "wanne"]),
    (
        ClassId::Refrigerator,
        &[
            "kühlschrank",
            "kühlschränke",
            "réfrigérateur",
            "frigo",
            "gefrierschrank",
            "eisschrank",
            "congélateur",
        ],
    ),
    (
        ClassId::Stove,
        &[
            "herd",
            "backofen",
            "ofen",
            "cuisinière",
            "four",
            "kochfeld",
            "herdplatte",
            "plaque de cuisson",
            "gazinière",
        ],
    ),
    (ClassId::RangeHood, &["dunstabzugshaube", "abzugshaube", "hotte", "hotte aspirante"]),
];

/// The class of a name; accents may be missing ("canape"), umlauts be spelled out ("Stuehle").
pub(super) fn class_of(words: &[String]) -> Option<ClassId> {
    let named = |words: &[String]| {
        let text = words.join(" ");
        let is = |name: &&str| *name == text || plain(name) == text || spelled_out(name) == text;
        NAMES.iter().find(|(_, names)| names.iter().any(&is)).map(|(class, _)| *class)
    };
    let words = without_articles(words)?;
    named(words).or_else(|| everyday::class_of(words))
}

fn without_articles(words: &[String]) -> Option<&[String]> {
    words.iter().position(|word| !ARTICLES.contains(&word.as_str())).map(|first| &words[first..])
}

/// The name that words are one letter from, unless they are as near to that of another class.
pub(super) fn misspelt(words: &[String]) -> Option<(String, ClassId)> {
    let text: Vec<char> = without_articles(words)?.join(" ").chars().take(40).collect();
    let is_near = |name: &str| {
        let name: Vec<char> = name.chars().collect();
        name.len() >= SHORTEST_MISSPELT && distance(&text, &name) == 1
    };
    let mut found = spellings().1.iter().filter(|(name, _)| is_near(name));
    let (name, class) = found.next()?;
    found.all(|(_, other)| other == class).then(|| (name.clone(), *class))
}

/// The class that a German compound ends with, by its longest end: a "Stehlampe" is a lamp.
pub(super) fn compound(words: &[String]) -> Option<(String, ClassId)> {
    let [word] = without_articles(words)? else { return None };
    let ends = |name: &str| {
        let head = word.strip_suffix(name);
        name.chars().count() >= SHORTEST_END && head.is_some_and(|head| head.chars().count() >= 3)
    };
    let names = NAMES.iter().filter(|(class, _)| !NO_ENDS.contains(class));
    let names = names.flat_map(|(class, names)| names.iter().map(move |name| (*name, *class)));
    let found =
        names.filter(|(name, _)| ends(name) || ends(&plain(name)) || ends(&spelled_out(name)));
    found.max_by_key(|(name, _)| name.len()).map(|(name, class)| (name.to_owned(), class))
}

/// Articles and every spelling of a name with its class, for readers of phrases that do not run here.
pub(super) fn spellings() -> (&'static [&'static str], &'static [(String, ClassId)]) {
    static ALL: LazyLock<Vec<(String, ClassId)>> = LazyLock::new(|| {
        let mut all: Vec<(String, ClassId)> = Vec::new();
        for (class, names) in NAMES.iter().chain(everyday::NAMES) {
            for name in *names {
                for spelling in [(*name).to_owned(), plain(name), spelled_out(name)] {
                    if all.iter().all(|(other, _)| *other != spelling) {
                        all.push((spelling, *class));
                    }
                }
            }
        }
        all
    });
    (ARTICLES, &ALL)
}

/// Without accents.
fn plain(name: &str) -> String {
    let letter = |c| match c {
        'ä' | 'à' => 'a',
        'é' | 'è' | 'ê' => 'e',
        'î' => 'i',
        'ö' => 'o',
        'ü' => 'u',
        other => other,
    };
    name.chars().map(letter).collect()
}

/// With umlauts in two letters.
fn spelled_out(name: &str) -> String {
    name.replace('ä', "ae").replace('ö', "oe").replace('ü', "ue").replace('ß', "ss")
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn every_class_has_names_of_its_own() {
        let mut seen = BTreeSet::new();
        for (class, names) in NAMES.iter().chain(everyday::NAMES) {
            for name in *names {
                assert!(seen.insert(*name), "{name} twice");
                assert_eq!(name.to_lowercase(), *name);
                let words: Vec<String> = name.split(' ').map(str::to_owned).collect();
                assert_eq!(class_of(&words), Some(*class), "{name}");
            }
        }
        assert_eq!(NAMES.iter().map(|n| n.0).collect::<Vec<_>>(), ClassId::ALL);
        // What the vocabulary has is its own, and no thing is another one as well.
        for (name, _) in scenesplat_rooms::Vocabulary::class_phrases() {
            assert!(!seen.contains(name), "{name}");
        }
        let words = |name: &str| name.split(' ').map(str::to_owned).collect::<Vec<_>>();
        assert!(seen.iter().all(|name| !everyday::is_other(&words(name))));
        for none in [&[] as &[&str], &["die"], &["de", "la"], &["chair"], &["lit", "chair"]] {
            let words: Vec<String> = none.iter().map(|w| (*w).to_owned()).collect();
            assert_eq!(class_of(&words), None, "{none:?}");
        }
    }
}
