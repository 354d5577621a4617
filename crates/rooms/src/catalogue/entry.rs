//! What a library says of a model.

use super::names::Meaning;
use std::collections::BTreeMap;

/// A model of a catalogue, as its library describes it. Lengths in meters.
#[derive(Debug, Clone, PartialEq)]
pub struct Entry {
    /// Unique among all libraries as a rule: the split goes by it.
    pub id: String,
    /// What it is called.
    pub name: String,
    /// The library: name of its archive without the ending.
    pub library: String,
    /// Whoever made it.
    pub creator: String,
    /// Where the library puts it, such as `Living room`.
    pub category: String,
    /// Width, depth, height.
    pub size: [f64; 3],
    /// Height above the floor, 0 for what stands on it.
    pub elevation: f64,
    /// Height at which other things stand on it: its own height if the library says nothing, none if
    /// nothing can stand on it.
    pub top: Option<f64>,
    /// Whether it belongs into an opening of a wall.
    pub is_opening: bool,
    /// Of an opening, thickness of the wall and distance of the wall's far side from its back.
    pub(crate) wall: [Option<f64>; 2],
    /// Turns the model upright, row by row.
    pub(super) rotation: Option<[f64; 9]>,
    /// The OBJ file, from the top of the library.
    pub(super) model: String,
    /// What its name means.
    pub meaning: Meaning,
}

/// Categories of what is in no room.
const NOT_INDOORS: [&str; 4] = ["Exterior", "Characters", "Vehicles", "Staircases"];

/// Largest extent that is taken for one of furniture, meters.
const LARGEST: f64 = 30.0;

/// A model that is left out, and why.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Refused {
    /// The library.
    pub library: String,
    /// Its id.
    pub id: String,
    /// What is wrong with it.
    pub problem: String,
}

/// The entries of a properties file that belong into rooms, and those that make no sense.
pub(super) fn entries(
    library: &str,
    values: &BTreeMap<String, String>,
) -> (Vec<Entry>, Vec<Refused>) {
    let (mut found, mut refused) = (Vec::new(), Vec::new());
    for number in 1_u32.. {
        let Some(id) = values.get(&format!("id#{number}")) else { break };
        let get = |key: &str| values.get(&format!("{key}#{number}")).map(String::as_str);
        if NOT_INDOORS.contains(&get("category").unwrap_or("")) {
            continue;
        }
        match entry(library, id, &get) {
            Ok(entry) => found.push(entry),
            Err(problem) => {
                let (library, id) = (library.to_owned(), id.clone());
                refused.push(Refused { library, id, problem });
            }
        }
    }
    (found, refused)
}

fn entry<'a>(
    library: &str,
    id: &str,
    get: &dyn Fn(&str) -> Option<&'a str>,
) -> Result<Entry, String> {
    let needed = |key: &str| get(key).ok_or_else(|| format!("no {key}"));
    let number = |key: &str| -> Result<Option<f64>, String> {
        let Some(text) = get(key) else { return Ok(None) };
        match text.trim().parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(Some(value)),
            _ => Err(format!("{key}: {text:?} is no finite number")),
        }
    };
    // Libraries count in centimeters.
    let length = |key: &str| Ok::<_, String>(number(key)?.map(|cm| cm / 100.0));
    let mut size = [0.0; 3];
    for (out, key) in size.iter_mut().zip(["width", "depth", "height"]) {
        *out = length(key)?.ok_or_else(|| format!("no {key}"))?;
        if !(0.0..=LARGEST).contains(out) {
            return Err(format!("{key}: {} cm is no size of furniture", *out * 100.0));
        }
    }
    let rotation = match get("modelRotation") {
        None => None,
        Some(text) => Some(matrix(text)?),
    };
    let name = needed("name")?.to_owned();
    Ok(Entry {
        id: id.to_owned(),
        meaning: Meaning::of(&name),
        name,
        library: library.to_owned(),
        creator: get("creator").unwrap_or("unknown").to_owned(),
        category: get("category").unwrap_or("").to_owned(),
        size,
        elevation: length("elevation")?.unwrap_or(0.0),
        top: match length("dropOnTopElevation")? {
            None => Some(size[2]),
            Some(top) => (top >= 0.0).then_some(top),
        },
        is_opening: get("doorOrWindow") == Some("true"),
        wall: [length("doorOrWindowWallThickness")?, length("doorOrWindowWallDistance")?],
        rotation,
        model: needed("model")?.to_owned(),
    })
}

fn matrix(text: &str) -> Result<[f64; 9], String> {
    let bad = || format!("modelRotation: {text:?} is not nine finite numbers");
    let numbers: Vec<f64> =
        text.split_whitespace().map(|n| n.parse().map_err(|_| bad())).collect::<Result<_, _>>()?;
    let numbers: [f64; 9] = numbers.try_into().map_err(|_| bad())?;
    if numbers.iter().all(|n| n.is_finite()) { Ok(numbers) } else { Err(bad()) }
}
