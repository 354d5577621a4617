//! Names of the classes in German and French, and English ones that the phrase table reads otherwise.

use scenesplat_rooms::ClassId;

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
    (ClassId::Floor, &["boden", "fußboden", "fussboden", "böden", "sol", "sols", "plancher"]),
    (ClassId::Ceiling, &["decke", "zimmerdecke", "decken", "plafond", "plafonds"]),
    (ClassId::Window, &["fenster", "fenêtre", "fenêtres"]),
    (ClassId::Door, &["tür", "türe", "türen", "porte", "portes"]),
    (ClassId::Table, &["tisch", "tische", "esstisch", "esstische", "table à manger"]),
    (ClassId::CoffeeTable, &["couchtisch", "couchtische", "table basse", "tables basses"]),
    (ClassId::Desk, &["schreibtisch", "schreibtische", "bureau", "bureaux"]),
    (ClassId::Chair, &["stuhl", "stühle", "sessel", "chaise", "chaises", "fauteuil", "fauteuils"]),
    (ClassId::Stool, &["hocker", "tabouret", "tabourets"]),
    (ClassId::Sofa, &["polstersofa", "canapé", "canapés"]),
    (ClassId::Bed, &["bett", "betten", "lit", "lits"]),
    (ClassId::Cabinet, &["schrank", "schränke", "kommode", "kommoden"]),
    (
        ClassId::KitchenCabinet,
        &["küchenschrank", "küchenschränke", "placard de cuisine", "meuble de cuisine"],
    ),
    (ClassId::Wardrobe, &["kleiderschrank", "kleiderschränke", "garde robe", "penderie"]),
    (
        ClassId::Bookshelf,
        &["regal", "regale", "bücherregal", "bücherregale", "étagère", "étagères", "bibliothèque"],
    ),
    (
        ClassId::Nightstand,
        &["nachttisch", "nachttische", "table de chevet", "table de nuit", "tables de chevet"],
    ),
    (
        ClassId::TvStand,
        &["fernsehtisch", "fernsehschrank", "tv schrank", "meuble tv", "meuble télé"],
    ),
    (
        ClassId::Tv,
        &["fernseher", "fernsehgerät", "téléviseur", "télévision", "télé", "telly", "flatscreen"],
    ),
    (ClassId::Monitor, &["bildschirm", "bildschirme", "monitore", "écran", "écrans", "moniteur"]),
    (ClassId::Keyboard, &["tastatur", "tastaturen", "clavier", "claviers"]),
    (ClassId::Laptop, &["klapprechner", "ordinateur portable", "ordinateurs portables"]),
    (ClassId::Lamp, &["lampe", "lampen", "leuchte", "leuchten", "lampes"]),
    (ClassId::Plant, &["pflanze", "pflanzen", "zimmerpflanze", "plante", "plantes"]),
    (ClassId::Picture, &["bild", "bilder", "gemälde", "tableau", "tableaux"]),
    (ClassId::Mirror, &["spiegel", "miroir", "miroirs"]),
    (ClassId::Curtain, &["vorhang", "vorhänge", "gardine", "gardinen", "rideau", "rideaux"]),
    (ClassId::Rug, &["teppich", "teppiche", "tapis"]),
    (ClassId::Pillow, &["kissen", "kopfkissen", "coussin", "coussins", "oreiller", "oreillers"]),
    (ClassId::Book, &["buch", "bücher", "livre", "livres"]),
    (
        ClassId::Box,
        &["kiste", "kisten", "schachtel", "schachteln", "karton", "kartons", "boîte", "boîtes"],
    ),
    (ClassId::TrashCan, &["mülleimer", "abfalleimer", "papierkorb", "poubelle", "poubelles"]),
    (ClassId::Mug, &["becher", "tasse", "tassen", "tasses"]),
    (ClassId::Clock, &["uhr", "uhren", "wanduhr", "horloge", "horloges", "pendule"]),
    (ClassId::Radiator, &["heizkörper", "heizung", "radiateur", "radiateurs"]),
    (ClassId::Toilet, &["toilette", "toilettes", "klo", "wc"]),
    (ClassId::Sink, &["waschbecken", "spülbecken", "spüle", "lavabo", "lavabos", "évier"]),
    (ClassId::Bathtub, &["badewanne", "badewannen", "baignoire", "baignoires"]),
    (ClassId::Refrigerator, &["kühlschrank", "kühlschränke", "réfrigérateur", "frigo"]),
    (ClassId::Stove, &["herd", "backofen", "ofen", "cuisinière", "four"]),
    (ClassId::RangeHood, &["dunstabzugshaube", "abzugshaube", "hotte", "hotte aspirante"]),
];

/// The class of a name; accents may be missing ("canape"), umlauts be spelled out ("Stuehle").
pub(super) fn class_of(words: &[String]) -> Option<ClassId> {
    let named = |words: &[String]| {
        let text = words.join(" ");
        let is = |name: &&str| *name == text || plain(name) == text || spelled_out(name) == text;
        NAMES.iter().find(|(_, names)| names.iter().any(&is)).map(|(class, _)| *class)
    };
    let first = words.iter().position(|word| !ARTICLES.contains(&word.as_str()))?;
    named(&words[first..])
}

/// Articles and every spelling of a name with its class, for readers of phrases that do not run here.
pub(super) fn spellings() -> (&'static [&'static str], Vec<(String, ClassId)>) {
    let mut all: Vec<(String, ClassId)> = Vec::new();
    for (class, names) in NAMES {
        for name in *names {
            for spelling in [(*name).to_owned(), plain(name), spelled_out(name)] {
                if all.iter().all(|(other, _)| *other != spelling) {
                    all.push((spelling, *class));
                }
            }
        }
    }
    (ARTICLES, all)
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
        for (class, names) in NAMES {
            for name in *names {
                assert!(seen.insert(*name), "{name} twice");
                assert_eq!(name.to_lowercase(), *name);
                let words: Vec<String> = name.split(' ').map(str::to_owned).collect();
                assert_eq!(class_of(&words), Some(*class), "{name}");
            }
        }
        assert_eq!(NAMES.iter().map(|n| n.0).collect::<Vec<_>>(), ClassId::ALL);
        for none in [&[] as &[&str], &["die"], &["de", "la"], &["chair"], &["lit", "chair"]] {
            let words: Vec<String> = none.iter().map(|w| (*w).to_owned()).collect();
            assert_eq!(class_of(&words), None, "{none:?}");
        }
    }
}
