//! Whether a scene is out of the distribution of the network inside the program.

use super::Session;
use anyhow::Result;
use scenesplat::SceneFeatures;
use scenesplat::familiarity::Familiarity;

/// How far a scene is from what the network inside the program was trained on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Novelty {
    /// Not at all.
    None,
    /// More than any room it was checked on.
    Some,
    /// Far more.
    Clear,
}

impl Session<'_> {
    /// How far a scene is from what the network inside the program, whose features these are, was trained on; `None` if
    /// the features cannot tell. Warns if it is far, with the consequence, `what`: the network gives everything a class,
    /// so labels of such a scene mean little.
    pub fn novelty(
        &self,
        features: &SceneFeatures,
        what: impl Fn(Novelty) -> &'static str,
    ) -> Result<Option<Novelty>> {
        let _stage = self.receipt.stage("familiarity");
        let familiar = Familiarity::embedded()?;
        let Some(found) = familiar.strangeness(features)? else {
            let why = "codes, or features without direction, do not tell how strange a scene is";
            self.receipt.setting("strangeness", "not judged", why);
            return Ok(None);
        };
        let [least, most] = familiar.rooms();
        let (limit, clear) = (familiar.limit(), familiar.clear_limit());
        let how = match found {
            found if found > clear => Novelty::Clear,
            found if found > limit => Novelty::Some,
            _ => Novelty::None,
        };
        let why = format!(
            "rooms have {least:.1} to {most:.1}, strange is above {limit:.1}, clearly so above {clear:.1}"
        );
        self.receipt.setting("strangeness", format!("{found:.2}"), &why);
        if how > Novelty::None {
            self.warn(format!(
                "this looks like nothing that the network inside the program was trained on (strangeness \
                 {found:.1}; {why}): {}",
                what(how)
            ));
        }
        Ok(Some(how))
    }
}
