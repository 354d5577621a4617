//! English names of everyday use, and things of homes that are none of the classes.

use crate::phrases::bases;
use scenesplat_rooms::ClassId;

/// Names that mean nothing else at home, singular. One that does stands among those of `foreign`, which are not called
/// sure where the phrase table has the word.
pub(super) const NAMES: &[(ClassId, &[&str])] = &[
    (ClassId::Wall, &["partition wall", "wallpaper"]),
    (ClassId::Floor, &["floorboard", "parquet", "lino", "linoleum"]),
    (ClassId::Window, &["skylight", "windowpane", "window pane"]),
    (ClassId::Door, &["doorway", "exit", "way out", "way in"]),
    (ClassId::CoffeeTable, &["cocktail table"]),
    (ClassId::Desk, &["workstation", "escritoire", "writing table"]),
    (ClassId::Chair, &["deckchair", "easy chair", "recliner"]),
    (ClassId::Stool, &["barstool", "pouffe", "pouf", "hassock", "footrest", "foot rest"]),
    (ClassId::Sofa, &["loveseat", "love seat", "chesterfield", "three piece suite"]),
    (ClassId::Bed, &["bunk bed", "cot", "crib", "four poster", "mattress", "sofa bed"]),
    (ClassId::Cabinet, &["tallboy", "credenza", "chiffonier", "filing cabinet"]),
    (
        ClassId::KitchenCabinet,
        &[
            "kitchen cupboard",
            "larder",
            "pantry",
            "worktop",
            "work top",
            "countertop",
            "counter top",
        ],
    ),
    (ClassId::Wardrobe, &["clothes cupboard", "clothes closet"]),
    (ClassId::Bookshelf, &["book rack", "shelving", "shelving unit"]),
    (
        ClassId::Nightstand,
        &["bedside cabinet", "bedside locker", "bedside cupboard", "night table"],
    ),
    (
        ClassId::TvStand,
        &[
            "telly stand",
            "tv unit",
            "tv bench",
            "tv console",
            "media console",
            "media unit",
            "entertainment center",
            "entertainment centre",
            "entertainment unit",
        ],
    ),
    (ClassId::Tv, &["telly", "flatscreen", "flat screen tv", "gogglebox", "goggle box"]),
    (ClassId::Monitor, &["vdu", "visual display unit"]),
    (ClassId::Keyboard, &["qwerty", "qwerty keyboard"]),
    (ClassId::Laptop, &["macbook", "netbook"]),
    (ClassId::Lamp, &["lightbulb", "sconce", "downlight", "lampshade"]),
    (ClassId::Picture, &["pic", "artwork"]),
    (ClassId::Mirror, &["looking glass"]),
    (
        ClassId::Curtain,
        &["roller blind", "venetian blind", "roman blind", "window blind", "net curtain"],
    ),
    (ClassId::Rug, &["doormat", "door mat"]),
    (ClassId::Book, &["cookbook", "cookery book"]),
    (ClassId::Box, &["parcel", "packing case"]),
    (ClassId::TrashCan, &["dustbin", "litter bin", "rubbish bin", "wastepaper basket"]),
    (ClassId::Mug, &["teacup", "tankard"]),
    (ClassId::Clock, &["timepiece"]),
    (ClassId::Toilet, &["loo", "lavatory", "lav", "water closet", "wc", "khazi", "dunny"]),
    (ClassId::Sink, &["handbasin", "hand basin", "washstand"]),
    (ClassId::Bathtub, &["jacuzzi", "hot tub", "bath tub"]),
    (ClassId::Refrigerator, &["icebox", "fridge freezer", "freezer", "deep freeze"]),
    (
        ClassId::Stove,
        &["hob", "stovetop", "stove top", "cooktop", "cook top", "aga", "hotplate", "hot plate"],
    ),
    (ClassId::RangeHood, &["extractor", "extractor fan", "vent hood", "oven hood", "stove hood"]),
];

/// Things of homes that are none of the classes, which words alone make like one: a kettle stands on a stove.
const OTHERS: &[&str] = &[
    "air conditioner",
    "aquarium",
    "bedspread",
    "blanket",
    "blender",
    "bread maker",
    "coffee machine",
    "coffee maker",
    "dishwasher",
    "dryer",
    "tumble dryer",
    "duvet",
    "quilt",
    "fireplace",
    "fire place",
    "fish tank",
    "food processor",
    "games console",
    "game console",
    "hairdryer",
    "hair dryer",
    "hoover",
    "ironing board",
    "kettle",
    "loudspeaker",
    "microwave",
    "microwave oven",
    "phone",
    "telephone",
    "mobile phone",
    "cell phone",
    "smartphone",
    "printer",
    "projector",
    "remote control",
    "sewing machine",
    "shoe",
    "slipper",
    "smoke detector",
    "toaster",
    "towel",
    "vacuum",
    "vacuum cleaner",
    "washer",
    "washing machine",
    "wristwatch",
];

pub(super) fn class_of(words: &[String]) -> Option<ClassId> {
    let named = |names: &[&str]| names.iter().any(|name| is(words, name));
    NAMES.iter().find(|(_, names)| named(names)).map(|(class, _)| *class)
}

pub(super) fn is_other(words: &[String]) -> bool {
    OTHERS.iter().any(|name| is(words, name))
}

/// Whether words are a name in the singular or plural.
fn is(words: &[String], name: &str) -> bool {
    let Some((last, head)) = words.split_last() else { return false };
    let mut lasts = std::iter::once(last.clone()).chain(bases(last));
    lasts.any(|last| [head, &[last]].concat().join(" ") == name)
}
