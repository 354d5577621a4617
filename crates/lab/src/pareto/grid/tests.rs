//! Grids as files have them.

use super::*;

fn grid(text: &str) -> Result<Grid, ParetoError> {
    Grid::parse(text, "grid.toml")
}

#[test]
fn a_grid_is_the_product_of_its_axes_and_its_points() {
    let text = "reference = \"voxel=0.02,k=25\"\npoints = [\"precision=bf16\"]\n\
                [axes]\nvoxel = [0.04, 0.02]\nk = [1, 25]\n";
    let grid = grid(text).unwrap();
    assert_eq!(grid.size(), 6);
    let settings: Vec<String> = grid.settings().unwrap().iter().map(ToString::to_string).collect();
    // The reference is in the product too, and is not there twice.
    assert_eq!(settings.len(), 5, "{settings:?}");
    assert_eq!(settings[0], grid.reference.to_string());
    assert!(settings.iter().any(|s| s == "voxel=0.02,precision=bf16,k=25"), "{settings:?}");
}

#[test]
fn the_grids_of_the_program_are_whole() {
    let grid = Grid::default_grid().unwrap();
    assert!(grid.settings().unwrap().len() >= 12);
    assert!(!grid.neutral.threads.is_empty());
    let grid = Grid::calibration(0.06).unwrap();
    assert_eq!(grid.settings().unwrap().len(), 8);
    assert_eq!(grid.reference.to_string(), "voxel=0.06,precision=f32,passes=1,k=25");
    assert!(Grid::calibration(-1.0).is_err());
}

#[test]
fn hostile_grids_are_refused_by_name() {
    for (text, part) in [
        ("", "reference"),
        ("reference = \"voxels=1\"", "reference: "),
        ("reference = \"\"\n[axes]\nvoxel = []\n", "axes.voxel"),
        ("reference = \"\"\n[axes]\nvoxel = 3\n", "axes.voxel"),
        ("reference = \"\"\n[axes]\nvoxel = [true]\n", "axes.voxel"),
        ("reference = \"\"\n[axes]\nvoxel = [0.02, \"0.020\"]\n", "twice"),
        ("reference = \"\"\n[axes]\nvoxel = [-1]\n", "axes.voxel"),
        ("reference = \"\"\n[axes]\ncolor = [1]\n", "axes.color"),
        ("reference = \"\"\npoints = [\"k=1,k=2\"]\n", "points"),
        ("reference = \"\"\nwrites = []\n", "writes"),
        ("reference = \"\"\nextra = 1\n", "extra"),
        ("reference = \"\"\n[neutral]\nthreads = [0]\n", "threads"),
        ("reference = \"\"\n[networks.a]\nweights = \"no/such\"\n", "networks.a"),
    ] {
        let error = grid(text).unwrap_err().to_string();
        assert!(error.contains(part) && error.contains("grid.toml"), "{text:?}: {error}");
    }
    let values = (1..=1001).map(|k| k.to_string()).collect::<Vec<_>>().join(",");
    let patches = (1..=1001).map(|k| (16 * k).to_string()).collect::<Vec<_>>().join(",");
    let text = format!("reference = \"\"\n[axes]\nk = [{values}]\npatch = [{patches}]\n");
    let error = grid(&text).unwrap_err().to_string();
    assert!(error.contains("at most"), "{error}");
}

#[test]
fn what_a_grid_leaves_out_has_its_default_and_what_it_says_is_kept() {
    let small = grid("reference = \"k=8\"").unwrap();
    let want = Grid {
        reference: "k=8".parse().unwrap(),
        axes: Vec::new(),
        points: Vec::new(),
        skip: true,
        neutral: Neutral::default(),
        networks: BTreeMap::new(),
        training: Vec::new(),
        writes: vec![Written::Labels],
    };
    assert_eq!(small, want);
    assert_eq!((small.size(), small.settings().unwrap().len()), (1, 1));
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("grid.toml");
    let text = format!(
        "reference = \"voxel=0.02,k=25\"\nskip = false\nwrites = [\"features\", \"labels\"]\ntraining = [\"run\"]\n\
         points = [\"k=1\", \"k=8\"]\n[axes]\nk = [1, \"8\"]\nvoxel = [0.10, 0.050, 0.02]\n\
         [neutral]\nthreads = [1, 3]\nmax_memory = [\"1GB\"]\nisa = [\"all\"]\n\
         [networks.a-1_b]\nweights = {:?}\nconfig = \"c\"\ntext = \"t\"\ntext_names = \"n\"\n",
        folder.path().display().to_string()
    );
    std::fs::write(&path, &text).unwrap();
    let full = Grid::read(&path).unwrap();
    assert!(!full.skip);
    assert_eq!(full.writes, [Written::Features, Written::Labels]);
    assert_eq!((full.training, full.neutral.threads), (vec![PathBuf::from("run")], vec![1, 3]));
    assert_eq!(
        (full.neutral.max_memory, full.neutral.isa),
        (vec!["1GB".to_owned()], vec!["all".to_owned()])
    );
    let network = &full.networks["a-1_b"];
    assert_eq!(
        (&network.weights, network.config.as_deref()),
        (&folder.path().to_owned(), Some("c"))
    );
    assert_eq!(network.text.as_deref(), Some(Path::new("t")));
    assert_eq!(network.text_names.as_deref(), Some(Path::new("n")));
    // Values are written as settings write them, in their order.
    let axes: Vec<_> = full.axes.iter().map(|a| (a.name.as_str(), a.values.join(" "))).collect();
    assert_eq!(axes, [("k", "1 8".to_owned()), ("voxel", "0.1 0.05 0.02".to_owned())]);
    // Two by three, two points and the reference; the first axis changes slowest. Points that are in it go.
    let grid = Grid::read(&path).unwrap();
    assert_eq!(grid.size(), 9);
    let all: Vec<String> = grid.settings().unwrap().iter().map(ToString::to_string).collect();
    let of = |k: u32| ["0.1", "0.05", "0.02"].map(|v| format!("voxel={v},k={k}"));
    let want = [vec!["voxel=0.02,k=25".to_owned()], of(1).to_vec(), of(8).to_vec()].concat();
    assert_eq!(all, want);
    for (change, part) in [
        (("a-1_b", "\"a b\""), "letters, digits, dots"),
        (("a-1_b", "\"\""), "letters, digits, dots"),
        (("config =", "configs ="), "configs"),
        (("\"features\"", "\"rows\""), "rows"),
        (("threads", "thread"), "thread"),
    ] {
        let error = Grid::parse(&text.replace(change.0, change.1), "g").unwrap_err().to_string();
        assert!(error.contains(part) && error.starts_with("g: "), "{error}");
    }
    assert!(
        Grid::read(&folder.path().join("no"))
            .unwrap_err()
            .to_string()
            .contains("cannot read the grid")
    );
}

#[test]
fn a_calibration_goes_from_twice_as_coarse_to_two_passes() {
    let grid = Grid::calibration(0.1).unwrap();
    let all: Vec<String> = grid.settings().unwrap().iter().map(ToString::to_string).collect();
    let want = [
        "voxel=0.1,precision=f32,passes=1,k=25",
        "voxel=0.1,precision=f32,passes=1,k=8",
        "voxel=0.1,precision=bf16,passes=1,k=8",
        "voxel=0.1,precision=f32,passes=2,k=8",
        "voxel=0.1,precision=bf16,passes=1,k=1",
        "voxel=0.125,precision=f32,passes=1,k=8",
        "voxel=0.15,precision=bf16,passes=1,k=8",
        "voxel=0.2,precision=bf16,passes=1,k=1",
    ];
    assert_eq!(all, want);
    assert_eq!((tidy(0.1 * 1.2), tidy(0.1 / 3.0), MOST_POINTS), (0.12, 0.033_333, 1_000_000));
    // The grid of the program: five by one, ten points and the reference, which is the last of the axes but for k.
    let own = Grid::default_grid().unwrap();
    assert_eq!((own.size(), own.skip), (16, true));
    assert_eq!(own.reference.to_string(), "voxel=0.06,precision=f32,passes=1,k=25");
    assert_eq!(own.axes[1].values, ["0.48", "0.12", "0.09", "0.07", "0.06"]);
    assert_eq!((own.neutral.threads, own.neutral.isa), (vec![1, 2], vec!["all".to_owned()]));
}

#[test]
fn the_schema_has_what_the_program_takes() {
    let schema: serde_json::Value = serde_json::from_str(Grid::SCHEMA).unwrap();
    let fits = |text: &str| {
        let table: toml::Table = text.parse().unwrap();
        scenesplat_test_support::schema_problems(&schema, &serde_json::to_value(table).unwrap())
    };
    assert_eq!(fits(scenesplat::shipped::PARETO_GRID[0]), [""; 0]);
    assert_eq!(fits("point = []").len(), 2, "reference is missing, and point is unknown");
    // As many fields as the program offers, top level and neutral.
    for (pointer, text) in [
        ("/properties", "reference = \"k=1\"\nzzz = 1"),
        ("/properties/neutral/properties", "reference = \"k=1\"\nneutral = { zzz = 1 }"),
    ] {
        let Err(error) = grid(text) else { panic!("{text}") };
        let error = with_causes(&error);
        let fields = schema.pointer(pointer).unwrap().as_object().unwrap();
        for name in fields.keys() {
            assert!(error.contains(&format!("`{name}`")), "{name}: {error}");
        }
        let offered = error.split_once("expected one of").unwrap().1;
        assert_eq!(offered.matches('`').count(), 2 * fields.len(), "{error}");
    }
}

/// An error with what is behind it.
fn with_causes(error: &dyn std::error::Error) -> String {
    match error.source() {
        Some(source) => format!("{error}: {}", with_causes(source)),
        None => error.to_string(),
    }
}
