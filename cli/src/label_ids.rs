//! `--label-base`: what the ids of a scene's own labels stand for.

use crate::session::Session;
use anyhow::{Result, anyhow};
use scenesplat::outputs::OpenedScene;
use scenesplat::scene::{LabelBase, LabelIds, NumberedLabels};

/// From where ids count.
#[derive(Debug, Clone, Copy, Default, clap::Args)]
pub struct LabelIdArgs {
    /// The id of the first name in the labels of a scene: 0, or 1 where 0 is no label, as in NYU40 and ScanNet's
    /// *_vh_clean_2.labels.ply. If not given, 0, with a warning where ids may count from 1.
    #[arg(long, value_name = "0|1")]
    pub label_base: Option<LabelBase>,
}

impl LabelIdArgs {
    /// What ids stand for in a list of so many names.
    pub fn of(self, names: usize) -> LabelIds {
        LabelIds::new(names, self.label_base)
    }

    /// Makes the labels of a scene rows of a list of so many names; says what is lost or doubtful.
    pub fn number(
        self,
        session: &Session<'_>,
        opened: &mut OpenedScene,
        names: usize,
    ) -> Result<NumberedLabels> {
        let loaded = &mut opened.loaded;
        let path = loaded.path.display();
        let found = self
            .of(names)
            .number(&mut loaded.scene)
            .map_err(|error| anyhow!("{path}: {error} (--label-base 1 or --label-base 0)"))?;
        if let Some(base) = self.label_base {
            session.receipt.setting("label_base", base, "id of the first name");
        }
        if let Some(doubt) = found.doubt_text() {
            session.warn_loudly(format!(
                "{path}: {doubt}; they are read as counted from 0. Give --label-base 1 if 1 is the first name, \
                 --label-base 0 if 0 is"
            ));
        }
        if let Some(lost) = found.unnamed_text() {
            session.warn(format!("{path}: {lost}: counted as unlabeled"));
        }
        if found.left_out > 0 {
            let rows = found.left_out;
            session
                .progress
                .say(format!("{path}: {rows} labels are 255, which is none of {names}"));
        }
        Ok(found)
    }
}
