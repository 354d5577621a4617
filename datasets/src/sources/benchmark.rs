//! What differs between benchmarks.

use super::class_lists::{
    HOLICITY, KITTI360, MATTERPORT21, MATTERPORT160, SCANNET20, SCANNET200, SCANNETPP100, names,
};
use crate::DataError;
use crate::transforms::LimitValues;
use scenesplat_scene::LabelSet;
use std::path::Path;

/// What scenes are used for.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Split {
    /// Fitting.
    #[default]
    Train,
    /// Evaluation during training.
    Validation,
    /// Evaluation afterwards.
    Test,
}

/// One row of the table.
struct Profile {
    name: &'static str,
    /// Files with labels, the first that is there counts.
    segment: &'static [&'static str],
    /// Folders of each split, see [`Benchmark::folders`].
    folders: [&'static [&'static str]; 3],
    classes: Option<&'static str>,
    /// Classes left out of the averages called f-mIoU and f-mAcc.
    excluded: &'static [&'static str],
    /// Limits of the original's scene loader.
    limits: Limits,
}

#[derive(Clone, Copy)]
enum Limits {
    Indoor,
    Wide,
    Kitti,
}

pub(super) const STRUCTURE: &[&str] = &["wall", "floor", "ceiling"];

/// What a benchmark without preprocessing in the original is like.
const PLAIN: Profile = Profile {
    name: "",
    segment: &["segment"],
    folders: [&["train"], &["val"], &["test"]],
    classes: None,
    excluded: STRUCTURE,
    limits: Limits::Wide,
};

/// All that is not evaluated on is trained on, as in the joint configuration.
const SCANNET: Profile = Profile {
    folders: [
        &["train_grid1.0cm_chunk6x6_stride3x3", "test_grid1.0cm_chunk6x6_stride3x3"],
        &["val"],
        &["val"],
    ],
    limits: Limits::Indoor,
    ..PLAIN
};

const MATTERPORT: Profile = Profile {
    folders: [
        &["train_grid1.0cm_chunk6x6_stride3x3", "val_grid1.0cm_chunk6x6_stride3x3"],
        &["test_grid1.0cm_chunk6x6_stride3x3"],
        &["test"],
    ],
    limits: Limits::Indoor,
    ..PLAIN
};

macro_rules! benchmarks {
    ($($(#[$about:meta])* $name:ident: $profile:expr;)*) => {
        /// A benchmark whose scenes were turned into folders of `.npy` files.
        ///
        /// Where the original has a script for that, the folders are as it writes them.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
        #[non_exhaustive]
        pub enum Benchmark {
            $($(#[$about])* $name,)*
        }

        impl Benchmark {
            /// All of them.
            pub const ALL: [Self; PROFILES.len()] = [$(Self::$name),*];
        }

        /// In the order of the variants.
        const PROFILES: &[Profile] = &[$($profile),*];
    };
}

benchmarks! {
    /// ScanNet, 20 classes.
    Scannet20: Profile {
        name: "scannet20",
        segment: &["segment20"],
        classes: Some(SCANNET20),
        excluded: &["wall", "floor"],
        ..SCANNET
    };
    /// ScanNet, 200 classes.
    Scannet200: Profile {
        name: "scannet200",
        segment: &["segment200"],
        classes: Some(SCANNET200),
        ..SCANNET
    };
    /// ScanNet++ version 1, its 100 most frequent classes.
    Scannetpp: Profile {
        name: "scannetpp",
        segment: &["segment", "segment200"],
        classes: Some(SCANNETPP100),
        ..SCANNET
    };
    /// ScanNet++ version 2, the same classes; more scenes, otherwise alike.
    ScannetppV2: Profile {
        name: "scannetpp_v2",
        segment: &["segment", "segment200"],
        classes: Some(SCANNETPP100),
        ..SCANNET
    };
    /// Matterport3D regions, 21 classes.
    Matterport21: Profile {
        name: "matterport21",
        classes: Some(MATTERPORT21),
        excluded: &["wall", "floor", "other furniture", "ceiling"],
        ..MATTERPORT
    };
    /// Matterport3D regions, 160 classes.
    Matterport160: Profile {
        name: "matterport160",
        segment: &["segment_nyu_160"],
        classes: Some(MATTERPORT160),
        ..MATTERPORT
    };
    /// Replica.
    Replica: Profile { name: "replica", ..PLAIN };
    /// Hypersim.
    Hypersim: Profile { name: "hypersim", ..PLAIN };
    /// 3RScan.
    ThreeRScan: Profile { name: "3rscan", ..PLAIN };
    /// ARKitScenes.
    Arkitscenes: Profile { name: "arkitscenes", ..PLAIN };
    /// HoliCity, 4 classes of streets.
    Holicity: Profile {
        name: "holicity",
        folders: [&["train_grid0.5cm_chunk6x6_stride4x4"], &["val"], &["test"]],
        classes: Some(HOLICITY),
        excluded: &[],
        ..PLAIN
    };
    /// KITTI-360, 37 classes of streets; label 0 stands for no class.
    Kitti360: Profile {
        name: "kitti360",
        folders: [&["test"]; 3],
        classes: Some(KITTI360),
        excluded: &["unlabeled"],
        limits: Limits::Kitti,
        ..PLAIN
    };
}

impl Benchmark {
    fn profile(self) -> &'static Profile {
        &PROFILES[self as usize]
    }

    /// Its name in configurations.
    pub fn name(self) -> &'static str {
        self.profile().name
    }

    /// Stems of the files that hold its labels; the first that a scene has counts, and of several
    /// columns the first. `pc_` before the stem gives the labeled points'.
    pub fn label_files(self) -> &'static [&'static str] {
        self.profile().segment
    }

    /// The folders in which the original's configurations look for the scenes of a split.
    ///
    /// Chunks are trained on, whole scenes evaluated on. The training sets hold the scenes of every
    /// split that is not evaluated on, so ScanNet's `test`, which has no labels, is among them;
    /// Matterport3D is evaluated on `test` and trained on the rest. Its original chunks were filtered by
    /// a script that is not published and are called `…_filtered`; here they are those that chunking
    /// writes, and `folders` names the others. HoliCity's names are those of its
    /// split lists. KITTI-360's preprocessing puts everything into `test`. Replica, Hypersim, 3RScan
    /// and ARKitScenes have no preprocessing in the original; `train`, `val` and `test` are ours.
    pub fn folders(self, split: Split) -> &'static [&'static str] {
        self.profile().folders[split as usize]
    }

    /// Limits that the original's scene loader puts on values, and its inference does not.
    pub fn exact_limits(self) -> LimitValues {
        match self.profile().limits {
            Limits::Indoor => LimitValues { scale: Some([0.0, 1.5]), ..LimitValues::default() },
            Limits::Wide => {
                LimitValues { scale: Some([1e-4, 1.0]), opacity_floor: 0.001, divide: 1.0 }
            }
            Limits::Kitti => {
                LimitValues { scale: Some([0.01, 10.0]), opacity_floor: 0.001, divide: 10.0 }
            }
        }
    }

    /// Its classes, from `names` if given, else from the list that comes with the program; those
    /// that the original leaves out of its averages are marked.
    ///
    /// # Errors
    /// If the file cannot be read, or there is no list of this benchmark.
    pub fn label_set(self, names_file: Option<&Path>) -> Result<LabelSet, DataError> {
        let profile = self.profile();
        let set = match (names_file, profile.classes) {
            (Some(path), _) => LabelSet::read(path)?,
            (None, Some(list)) => LabelSet::new(names(list))?,
            (None, None) => return Err(DataError::NoClassNames { benchmark: profile.name }),
        };
        // A list of one's own may have other classes.
        let known: Vec<&str> =
            profile.excluded.iter().copied().filter(|name| set.index_of(name).is_ok()).collect();
        Ok(set.exclude(&known)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn classes_and_background() {
        // Indices as the original's configurations give them.
        for (benchmark, count, excluded) in [
            (Benchmark::Scannet20, 20, vec![0, 1]),
            (Benchmark::Scannet200, 200, vec![0, 2, 35]),
            (Benchmark::Scannetpp, 100, vec![0, 1, 2]),
            (Benchmark::ScannetppV2, 100, vec![0, 1, 2]),
            (Benchmark::Matterport21, 21, vec![0, 1, 19, 20]),
            (Benchmark::Matterport160, 160, vec![0, 2, 3]),
            (Benchmark::Holicity, 4, vec![]),
            (Benchmark::Kitti360, 38, vec![0]),
        ] {
            let set = benchmark.label_set(None).unwrap();
            assert_eq!((set.len(), set.excluded), (count, excluded), "{benchmark:?}");
        }
    }

    #[test]
    fn lists_that_do_not_come_with_the_program_are_asked_for() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("names.txt");
        std::fs::write(&path, "chair\nfloor\n").unwrap();
        for benchmark in
            [Benchmark::Replica, Benchmark::Hypersim, Benchmark::ThreeRScan, Benchmark::Arkitscenes]
        {
            let error = benchmark.label_set(None).unwrap_err().to_string();
            assert!(error.contains(benchmark.name()) && error.contains("class_names"), "{error}");
            let set = benchmark.label_set(Some(&path)).unwrap();
            assert_eq!((set.len(), set.excluded), (2, vec![1]));
        }
    }

    #[test]
    fn names_are_unique_and_limits_are_valid() {
        let names: std::collections::BTreeSet<_> =
            Benchmark::ALL.iter().map(|b| b.name()).collect();
        assert_eq!(names.len(), Benchmark::ALL.len());
        for benchmark in Benchmark::ALL {
            crate::TransformConfig::from(benchmark.exact_limits()).build().unwrap();
            for split in [Split::Train, Split::Validation, Split::Test] {
                assert!(!benchmark.folders(split).is_empty());
            }
        }
    }
}
