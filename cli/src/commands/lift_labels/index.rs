//! The index form: which files it has, and what does not go with it.

use super::args::{Args, FormArg, LiftArgs, RobustArg, RobustRuleArg};
use super::level::inner_folder;
use super::write::{Column, FILES, with_size};
use crate::error::refuse;
use crate::session::Session;
use anyhow::Result;
use half::f16;
use scenesplat::lifted::{CLUSTERS, FULL, INDEX};
use scenesplat::outputs::OpenedScene;
use scenesplat::principal::{PrincipalDirections, sample_step, stretched_colors};
use scenesplat::rasterizer::lifting::{IndexSettings, Lifter, NO_CLUSTER};
use scenesplat::scene::formats::npy_writer::{NpyElement, write_npy};

/// The files of one granularity in the index form, with the picture of them.
const INDEX_FILES: [&str; 6] =
    [INDEX, CLUSTERS, "confidence.npy", "views.npy", "coverage.npy", "preview.png"];

/// The number of a cluster, as files have it.
#[derive(Clone, Copy)]
struct Cluster(u16);

impl Default for Cluster {
    fn default() -> Self {
        Self(NO_CLUSTER)
    }
}

impl NpyElement for Cluster {
    const DESCR: &'static str = "<u2";
    const SIZE: usize = 2;

    fn push_le(self, out: &mut Vec<u8>) {
        out.extend_from_slice(&self.0.to_le_bytes());
    }
}

impl LiftArgs {
    /// The files of one granularity.
    pub(in crate::commands) fn files(&self) -> &'static [&'static str] {
        match self.form {
            FormArg::Full => &FILES,
            FormArg::Index => &INDEX_FILES,
        }
    }

    /// Refuses an output folder with features in the other form: nobody could tell which are newer.
    pub(super) fn check_left_over(&self, levels: &[usize]) -> Result<()> {
        let other = if self.form == FormArg::Full { INDEX } else { FULL };
        let folders = levels.iter().map(|&level| match levels.len() {
            1 => self.shared.out.clone(),
            _ => self.shared.out.join(inner_folder(level)),
        });
        for path in folders.map(|folder| folder.join(other)) {
            if path.exists() {
                refuse!(
                    "--form: {} is features of another run in the other form; remove it, or give another --out",
                    path.display()
                );
            }
        }
        Ok(())
    }
}

impl Args {
    /// Refuses what has no effect on the features of clusters.
    pub(super) fn check_form(&self) -> Result<()> {
        let given = [
            (self.lifting.robust != RobustArg::Auto, "--robust"),
            (self.robust_rule != RobustRuleArg::Median, "--robust-rule"),
            (self.view_exponent != 1.0, "--view-exponent"),
            (self.unnormalised, "--unnormalised"),
        ];
        match given.iter().find(|(is, _)| *is && self.lifting.form == FormArg::Index) {
            Some((_, flag)) => {
                refuse!("{flag} is about the features of single Gaussians; --form index has none");
            }
            None => Ok(()),
        }
    }

    /// Clusters the segments of one level and writes all files.
    pub(super) fn write_index(
        &self,
        session: &Session<'_>,
        opened: &OpenedScene,
        lifter: &mut Lifter<'_>,
        (number, level): (usize, usize),
    ) -> Result<()> {
        let folder = self.folder(session, level)?;
        let stage = session.receipt.stage("features");
        let settings = IndexSettings {
            min_coverage: self.coverage,
            min_labelled_share: self.labelled_share,
            ..IndexSettings::default()
        };
        let found = lifter.indexed(number, &settings)?;
        session.check_stop()?;
        let (dim, segments) = (lifter.tables().dim(), lifter.tables().len());
        let clusters = found.features.len() / dim;
        let column = Column { opened, folder: &folder };
        let index: Vec<Cluster> = found.index.iter().map(|&cluster| Cluster(cluster)).collect();
        let views: Vec<i32> =
            found.views.iter().map(|&v| i32::try_from(v).unwrap_or(i32::MAX)).collect();
        let rows: Vec<f16> = found.features.iter().map(|&v| f16::from_f32(v)).collect();
        write_npy(&folder.join(CLUSTERS), &[clusters, dim], &rows)?;
        let files = [
            column.write(INDEX, &index)?,
            with_size(folder.join(CLUSTERS))?,
            column.write("confidence.npy", &found.confidence)?,
            column.write("views.npy", &views)?,
            column.write("coverage.npy", &found.coverage)?,
        ];
        drop(stage);
        files.iter().for_each(|(path, bytes)| session.wrote(path, *bytes));
        session.receipt.add_rows_out(opened.loaded.source_rows());
        let why = format!(
            "of {segments} segments, each with a feature; a Gaussian has the number of one"
        );
        session.receipt.setting(&format!("clusters[{level}]"), clusters, &why);
        let has = |index: &u16| *index != NO_CLUSTER;
        let labelled = found.index.iter().filter(|index| has(index)).count();
        let sure = found.index.iter().zip(&found.confidence).filter(|(index, _)| has(index));
        let sure = sure.map(|(_, c)| f64::from(*c)).sum::<f64>() / labelled.max(1) as f64;
        session.progress.say(format!(
            "level {level}: {labelled} of {} Gaussians have one of {clusters} clusters of {segments} segments, with \
             {:.1} % of their labeled weight",
            found.index.len(),
            100.0 * sure
        ));
        let rows = found.features.chunks_exact(dim).step_by(sample_step(clusters));
        let directions = PrincipalDirections::find(rows.flatten().copied().collect(), dim);
        let of_cluster: Vec<[f32; 3]> =
            found.features.chunks_exact(dim).map(|row| directions.project(row)).collect();
        let color = |index: &u16| of_cluster.get(usize::from(*index)).copied();
        let colors: Vec<Option<[f32; 3]>> = found.index.iter().map(color).collect();
        self.picture(session, opened, &folder, &stretched_colors(&colors))
    }
}
