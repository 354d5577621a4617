//! Files of the repository's top that crates above this one build in. A package takes along what lies in its own folder
//! alone, and these lie in that of this crate.

/// The tables of hard cases, which `doctor` reads its expectations from.
pub const HARD_CASES: &str = include_str!("../docs/hard_cases.md");
/// The grid of settings that `pareto` tries by itself, as TOML, and its place.
pub const PARETO_GRID: [&str; 2] =
    [include_str!("../configs/pareto/default.toml"), "configs/pareto/default.toml"];
/// The front of the network inside the program, as JSON.
pub const PARETO_FRONT: &str = include_str!("../assets/pareto/embedded.json");
/// Body of the page of a front.
pub const PARETO_BODY: &str = include_str!("../page/src/reports/pareto.html");
/// Its program; made by `npm run build` in the folder `page`.
pub const PARETO_SCRIPT: &str = include_str!("../page/dist/pareto.js");
