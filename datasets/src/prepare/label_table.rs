//! What the names of a benchmark's annotators mean: rows of a list of classes.

use super::ScanLayout;
use crate::DataError;
use crate::files::bad_file;
use crate::sources::class_lists::{
    MATTERPORT21, MATTERPORT160, NYU40, SCANNET20, SCANNET200, SCANNETPP100, names,
};
use crate::sources::{MATTERPORT21_NYU40_IDS, SCANNET20_NYU40_IDS, SCANNET200_IDS};
use scenesplat_scene::SceneError;
use scenesplat_scene::input_file::read_text_file;
use scenesplat_scene::label_set::read_names;
use std::collections::BTreeMap;
use std::path::Path;

/// What each name means, and the file that the numbers go to.
#[derive(Debug, Clone, PartialEq)]
pub struct LabelTable {
    /// Stem of the file: `segment20`.
    pub stem: String,
    /// The classes, if they have names.
    pub classes: Vec<String>,
    /// Class of each name, by the name in lower case.
    map: BTreeMap<String, i32>,
    /// Whether names are the numbers themselves.
    numbers: bool,
}

/// The tables of a layout.
#[derive(Debug, Clone, Copy, Default)]
pub struct LabelTables<'a> {
    /// The benchmark's own table of names: ScanNet's `scannetv2-labels.combined.tsv`, Matterport3D's
    /// `category_mapping.tsv`, ScanNet++'s `map_benchmark.csv`.
    pub table: Option<&'a Path>,
    /// Names of classes, one a line, where the layout has no list of its own, or another one is wanted.
    pub classes: Option<&'a Path>,
}

impl LabelTable {
    /// The class of a name; −1 if it is none.
    pub fn class_of(&self, name: &str) -> i32 {
        if self.numbers {
            return name.parse().unwrap_or(-1);
        }
        self.map.get(&key(name)).copied().unwrap_or(-1)
    }

    /// Names as they are in a list of classes.
    pub fn of_names(stem: &str, classes: Vec<String>) -> Self {
        let mut map = BTreeMap::new();
        for (class, name) in (0..).zip(&classes) {
            map.entry(key(name)).or_insert(class);
        }
        Self::of_map(stem, classes, map)
    }

    /// Names that are the numbers of classes.
    pub fn of_numbers(stem: &str, classes: Vec<String>) -> Self {
        Self { numbers: true, ..Self::of_map(stem, classes, BTreeMap::new()) }
    }

    fn of_map(stem: &str, classes: Vec<String>, map: BTreeMap<String, i32>) -> Self {
        Self { stem: stem.to_owned(), classes, map, numbers: false }
    }
}

/// Names are compared without case and outer spaces.
fn key(name: &str) -> String {
    name.trim().to_lowercase()
}

impl LabelTables<'_> {
    /// The tables of a layout, one for each file of labels.
    ///
    /// # Errors
    /// If a table that the layout needs is not given or lacks a column, or names of classes are needed.
    pub fn of(&self, layout: ScanLayout) -> Result<Vec<LabelTable>, DataError> {
        if let Some(path) = self.classes {
            let own = read_names(path)?;
            return Ok(vec![match layout {
                ScanLayout::Points => LabelTable::of_numbers("segment", own),
                _ => LabelTable::of_names("segment", own),
            }]);
        }
        match layout {
            ScanLayout::Scannet => self.scannet(),
            ScanLayout::ScannetPp => self.scannetpp(),
            ScanLayout::Matterport3d => self.matterport3d(),
            ScanLayout::Hypersim => {
                let nyu40 = names(NYU40);
                let scannet = (0..).zip(SCANNET20_NYU40_IDS);
                let coarse = scannet.map(|(class, id)| (key(&nyu40[id as usize - 1]), class));
                let coarse = LabelTable::of_map("segment20", names(SCANNET20), coarse.collect());
                Ok(vec![LabelTable::of_names("segment", nyu40), coarse])
            }
            ScanLayout::Points => Ok(vec![LabelTable::of_numbers("segment", Vec::new())]),
            ScanLayout::Replica
            | ScanLayout::ThreeRScan
            | ScanLayout::Arkitscenes
            | ScanLayout::InteriorGs => Err(needed(
                layout,
                "give the names of classes, one a line, in the order that their numbers shall have",
            )),
        }
    }

    fn scannet(&self) -> Result<Vec<LabelTable>, DataError> {
        let help = "give ScanNet's own, scannetv2-labels.combined.tsv";
        let path = self.table.ok_or_else(|| needed(ScanLayout::Scannet, help))?;
        let table = Table::read(path, '\t')?;
        let coarse = table.classes("nyu40id", &SCANNET20_NYU40_IDS)?;
        let fine = table.classes("id", &SCANNET200_IDS)?;
        Ok(vec![
            LabelTable::of_map("segment20", names(SCANNET20), coarse),
            LabelTable::of_map("segment200", names(SCANNET200), fine),
        ])
    }

    fn scannetpp(&self) -> Result<Vec<LabelTable>, DataError> {
        let mut table = LabelTable::of_names("segment", names(SCANNETPP100));
        if let Some(path) = self.table {
            // Renamed classes: what a name is counted as.
            let renamed = Table::read(path, ',')?.pairs("class", "semantic_map_to")?;
            for (from, to) in renamed {
                if let Some(&class) = table.map.get(&key(&to)) {
                    table.map.insert(from, class);
                }
            }
        }
        Ok(vec![table])
    }

    fn matterport3d(&self) -> Result<Vec<LabelTable>, DataError> {
        let help = "give Matterport3D's own, metadata/category_mapping.tsv";
        let path = self.table.ok_or_else(|| needed(ScanLayout::Matterport3d, help))?;
        let table = Table::read(path, '\t')?;
        let coarse = table.classes("nyu40id", &MATTERPORT21_NYU40_IDS)?;
        let mut fine = LabelTable::of_names("segment_nyu_160", names(MATTERPORT160));
        let named = table.pairs("raw_category", "nyuClass")?.into_iter();
        let named = named.map(|(name, class)| (name, fine.class_of(&class)));
        fine.map = named.filter(|(_, class)| *class >= 0).collect();
        Ok(vec![LabelTable::of_map("segment", names(MATTERPORT21), coarse), fine])
    }
}

/// A table that a layout needs is not given.
fn needed(layout: ScanLayout, help: &str) -> DataError {
    let problem = format!("no table of names for the layout {}", layout.name());
    SceneError::Classes { problem, help: help.to_owned() }.into()
}

/// A table with a header, as text.
struct Table<'a> {
    path: &'a Path,
    header: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl<'a> Table<'a> {
    fn read(path: &'a Path, separator: char) -> Result<Self, DataError> {
        let text = read_text_file(path)?;
        let cells = |line: &str| -> Vec<String> { split(line, separator) };
        let mut lines = text.trim_start_matches('\u{feff}').lines();
        let header = cells(lines.next().unwrap_or_default());
        let rows = lines.filter(|line| !line.trim().is_empty()).map(cells).collect();
        Ok(Self { path, header, rows })
    }

    fn column(&self, name: &str) -> Result<usize, DataError> {
        self.header.iter().position(|h| h == name).ok_or_else(|| {
            let problem = format!("has no column {name}; it has: {}", self.header.join(", "));
            bad_file(self.path, problem, "is it the table that the layout asks for?")
        })
    }

    /// Two columns, the first in lower case; of repeated names the first row counts.
    fn pairs(&self, from: &str, to: &str) -> Result<BTreeMap<String, String>, DataError> {
        let (from, to) = (self.column(from)?, self.column(to)?);
        let mut out = BTreeMap::new();
        for row in &self.rows {
            if let (Some(name), Some(value)) = (row.get(from), row.get(to)) {
                out.entry(key(name)).or_insert_with(|| value.clone());
            }
        }
        Ok(out)
    }

    /// The class of each raw category: where the number in the other column stands in the list.
    fn classes(&self, column: &str, list: &[i32]) -> Result<BTreeMap<String, i32>, DataError> {
        let class = |(name, number): (String, String)| {
            let number: i32 = number.trim().parse().ok()?;
            Some((name, list.iter().position(|v| *v == number)? as i32))
        };
        Ok(self.pairs("raw_category", column)?.into_iter().filter_map(class).collect())
    }
}

/// Cells of a line; those in quotes may hold the separator.
fn split(line: &str, separator: char) -> Vec<String> {
    let (mut out, mut cell, mut quoted) = (Vec::new(), String::new(), false);
    for c in line.trim_end_matches('\r').chars() {
        match c {
            '"' => quoted = !quoted,
            c if c == separator && !quoted => out.push(std::mem::take(&mut cell).trim().to_owned()),
            c => cell.push(c),
        }
    }
    out.push(cell.trim().to_owned());
    out
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test may fail loudly")]
    use super::*;

    #[test]
    fn names_of_the_benchmarks_mean_their_classes() {
        let dir = tempfile::tempdir().unwrap();
        let tsv = dir.path().join("labels.tsv");
        let text = "id\traw_category\tcategory\tcount\tnyu40id\n1\twall\twall\t1\t1\n2\tchair\tchair\t2\t5\n\
                    1191\tmattress\tmattress\t3\t4\n12\todd\todd\t4\t40\n9\tchair\tother\t5\t6\n";
        std::fs::write(&tsv, text).unwrap();
        let tables = LabelTables { table: Some(&tsv), classes: None };
        let found = tables.of(ScanLayout::Scannet).unwrap();
        let classes =
            |i: usize| ["wall", "Chair", "mattress", "odd", "?"].map(|n| found[i].class_of(n));
        // The first row of a name counts; 40 and 12 are in neither list.
        assert_eq!((found[0].stem.as_str(), classes(0)), ("segment20", [0, 4, 3, -1, -1]));
        assert_eq!((found[1].stem.as_str(), classes(1)), ("segment200", [0, 1, 199, -1, -1]));
        assert_eq!((found[0].classes.len(), found[1].classes.len()), (20, 200));
        let error = tables.of(ScanLayout::Matterport3d).unwrap_err().to_string();
        assert!(error.contains("no column nyuClass"), "{error}");
        let none = LabelTables::default();
        for layout in [ScanLayout::Scannet, ScanLayout::Matterport3d, ScanLayout::Replica] {
            assert!(none.of(layout).is_err(), "{layout:?}");
        }
        let names = dir.path().join("names.txt");
        std::fs::write(&names, "sofa\nlamp\n").unwrap();
        let own = LabelTables { table: None, classes: Some(&names) };
        assert_eq!(own.of(ScanLayout::Replica).unwrap()[0].class_of(" Lamp "), 1);
        assert_eq!(none.of(ScanLayout::Points).unwrap()[0].class_of("7"), 7);
    }

    #[test]
    fn the_tables_of_the_others() {
        let dir = tempfile::tempdir().unwrap();
        let tsv = dir.path().join("category_mapping.tsv");
        let text = "index\traw_category\tnyu40id\tnyuClass\n1\tdoor frame\t8\tdoor\n2\tceiling\t22\tceiling\n3\tx\t0\t\n";
        std::fs::write(&tsv, text).unwrap();
        let tables = LabelTables { table: Some(&tsv), classes: None };
        let found = tables.of(ScanLayout::Matterport3d).unwrap();
        let of = |i: usize| ["door frame", "ceiling", "x"].map(|n| found[i].class_of(n));
        assert_eq!((of(0), of(1)), ([7, 20, -1], [1, 2, -1]));
        let csv = dir.path().join("map_benchmark.csv");
        std::fs::write(
            &csv,
            "class,count,semantic_map_to\n\"table, small\",3,table\noffice chair,9,chair\nbed,1,nothing\n",
        )
        .unwrap();
        let tables = LabelTables { table: Some(&csv), classes: None };
        let found = tables.of(ScanLayout::ScannetPp).unwrap().remove(0);
        // Of ScanNet++'s 100, table is the fourth and chair the tenth; "office chair", the twelfth, is counted as a
        // chair; "bed", the 26th, is renamed to what is no class, and stays.
        let names = ["table, small", "table", "chair", "office chair", "bed", "no such thing"];
        assert_eq!(names.map(|n| found.class_of(n)), [3, 3, 9, 9, 25, -1]);
        // Hypersim's numbers are NYU40's, from 1: the names stand one place before.
        let tables = LabelTables::default().of(ScanLayout::Hypersim).unwrap();
        let of = |i: usize| {
            ["wall", "floor", "cabinet", "bed", "chair", "desk", "ceiling"]
                .map(|n| tables[i].class_of(n))
        };
        assert_eq!((tables[0].stem.as_str(), of(0)), ("segment", [0, 1, 2, 3, 4, 13, 21]));
        assert_eq!((tables[1].stem.as_str(), of(1)), ("segment20", [0, 1, 2, 3, 4, 12, -1]));
    }

    #[test]
    fn lists_and_tables_have_their_sizes_and_their_odd_rows() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("table.tsv");
        // A mark of the byte order, ends of lines with a return, an empty line, a short row, spaces and quotes.
        let text = "\u{feff}raw_category\tid\tnyu40id\tnyuClass\r\n\r\n \"Sofa\tbed\" \t 6 \t6\tsofa\r\nshort\r\n\
                    shower curtain\t28\t28\tcurtain\r\nroof\t41\t22\tno such\r\nother\t39\t39\tLAMP\r\npanel\t1\t1\twall\r\nx\ty\tz\t\r\n";
        std::fs::write(&path, text).unwrap();
        let tables = LabelTables { table: Some(&path), classes: None };
        let names = ["sofa\tbed", "Shower Curtain ", "roof", "other", "short", "panel"];
        let of = |layout| -> Vec<(String, usize, [i32; 6])> {
            let found: Vec<LabelTable> = tables.of(layout).unwrap();
            let each =
                |t: &LabelTable| (t.stem.clone(), t.classes.len(), names.map(|n| t.class_of(n)));
            found.iter().map(each).collect()
        };
        let want = |stem: &str, size, classes| (stem.to_owned(), size, classes);
        // ScanNet: places of 6, 28, (22), 39 in the list of 20; of 6, 28, 41, 39 in the list of 200.
        let coarse = want("segment20", 20, [5, 15, -1, 19, -1, 0]);
        let fine =
            [6, 28, 41, 39].map(|id| SCANNET200_IDS.iter().position(|v| *v == id).unwrap() as i32);
        let fine = want("segment200", 200, [fine[0], fine[1], fine[2], fine[3], -1, 0]);
        assert_eq!((of(ScanLayout::Scannet), fine.2[0]), (vec![coarse, fine], 5));
        let class = |list: &str, name: &str| names_at(list, name);
        let coarse = want("segment", 21, [5, 15, 20, 19, -1, 0]);
        let [sofa, curtain, lamp] = ["sofa", "curtain", "lamp"].map(|n| class(MATTERPORT160, n));
        let fine = want("segment_nyu_160", 160, [sofa, curtain, -1, lamp, -1, 0]);
        assert_eq!(of(ScanLayout::Matterport3d), [coarse, fine]);
        let none = LabelTables::default();
        let sizes = |layout| -> Vec<(String, usize)> {
            none.of(layout).unwrap().into_iter().map(|t| (t.stem, t.classes.len())).collect()
        };
        let own = |stem: &str, size| (stem.to_owned(), size);
        assert_eq!(sizes(ScanLayout::Hypersim), [own("segment", 40), own("segment20", 20)]);
        assert_eq!(sizes(ScanLayout::ScannetPp), [own("segment", 100)]);
        assert_eq!(sizes(ScanLayout::Points), [own("segment", 0)]);
        for layout in [ScanLayout::ThreeRScan, ScanLayout::Arkitscenes, ScanLayout::InteriorGs] {
            let error = none.of(layout).unwrap_err().to_string();
            assert!(error.contains(&format!("for the layout {}", layout.name())), "{error}");
        }
        // One's own list comes before the layout's, and of points names are the numbers themselves.
        std::fs::write(&path, "lamp\nsofa\nLAMP\n").unwrap();
        let own = LabelTables { table: None, classes: Some(&path) };
        for layout in ScanLayout::ALL {
            let found = own.of(layout).unwrap();
            let is_points = layout == ScanLayout::Points;
            let want = if is_points { [-1, -1, 1, -2] } else { [0, 1, -1, -1] };
            let classes = ["lamp", "Sofa", "1", "-2"].map(|name| found[0].class_of(name));
            assert_eq!(
                (found.len(), classes, found[0].stem.as_str()),
                (1, want, "segment"),
                "{layout:?}"
            );
            assert_eq!(found[0].classes, ["lamp", "sofa", "LAMP"], "{layout:?}");
        }
    }

    fn names_at(list: &str, name: &str) -> i32 {
        list.lines().position(|line| line.trim() == name).unwrap() as i32
    }
}
