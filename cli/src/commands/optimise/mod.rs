//! `scenesplat optimise`

mod args;
mod budget;
mod exposure;
mod frames;
mod pictures;
mod previews;
mod report;
mod run;

use crate::error::{WrongUse, refuse};
use crate::session::Session;
use crate::terminal::print;
use anyhow::Result;
pub use args::Args;
use frames::Frames;
use previews::Previews;
use run::checkpoints;
use scenesplat::optimisation::{OptimiseSettings, Optimiser, newest_checkpoint};
use scenesplat::scene::{SceneFormat, WriteOptions, write_scene};
use std::path::Path;
use std::time::Instant;

/// Runs the command.
pub fn run(args: &Args, line: &str) -> Result<()> {
    let began = Instant::now();
    let session = Session::start(&args.shared, line)?;
    let mut settings = args.settings();
    settings.check().map_err(|e| WrongUse(e.to_string()))?;
    if let Some(text) = args.idle_depth_flag(&settings) {
        return Err(WrongUse(text).into());
    }
    if args.depth.is_some() && settings.depth_loss().is_none() {
        let text = "no depth loss: depths give the first points, if nothing else does, and the figures \
                    (--depth-weight 1 turns it on)";
        session.progress.say(text);
    }
    args.claim(&session)?;
    let newest = newest_checkpoint(&checkpoints(&args.shared.out))?;
    if newest.is_some() && !args.resume {
        refuse!(
            "--out {}: holds checkpoints of a run; give --resume to go on with it, or another --out",
            args.shared.out.display()
        );
    }
    let frames = args.frames(&session)?;
    settings.exposure = args.decide_exposure(&session, &frames);
    let mut optimiser = match newest {
        Some(place) => args.go_on(&session, &place, &frames, settings)?,
        None => {
            if args.resume {
                session.progress.say("nothing to go on with: beginning anew");
            }
            let settings = args.bounded(&session, settings, &frames)?;
            let model = args.start(&session, &frames, &settings)?;
            args.begin(&session, model, &frames, settings, began)?
        }
    };
    note(&session, optimiser.settings())?;
    let mut previews = Previews::of(&args.shared.out);
    let ran = args.steps(&session, &mut optimiser, &frames, &mut previews, began)?;
    if let Some(place) = &ran.stopped {
        let total = optimiser.settings().steps;
        print(&format!("checkpoint: {}", place.display()));
        print(&format!("stopped at step {} of {total}: --resume goes on", optimiser.steps_done()));
        previews.keep();
        return Ok(());
    }
    if ran.out_of_time {
        let (done, total) = (optimiser.steps_done(), optimiser.settings().steps);
        session.warn(format!(
            "the time is over at step {done} of {total}: the scene is as it is there"
        ));
    }
    if let Some((next, more)) = ran.out_of_memory {
        let (done, total) = (optimiser.steps_done(), optimiser.settings().steps);
        anyhow::ensure!(
            done > 0,
            "the first refinement may make {next} Gaussians, which need {more} more than the system gives this process; use \
             a smaller --initial or --cap"
        );
        session.warn(format!(
            "{next} Gaussians need {more} more, which the system does not give this process: the scene is as it is at \
             step {done} of {total}; a smaller --cap, or --max-memory, goes on to the end"
        ));
    }
    let mut kept = frames.placed(args.finish(&session, &optimiser, &frames, &ran)?);
    kept.antialiased = optimiser.settings().antialiased;
    let stated_up = frames.up();
    if let Some(up) = stated_up {
        session.receipt.setting("up", up, "by how the cameras were held; scene.ply says so");
    }
    let options = WriteOptions { overwrite: true, stated_up, ..WriteOptions::default() };
    session.write("scene.ply", |path| {
        write_scene(&kept, path, SceneFormat::Ply, &options, &mut |_| true).map(drop)
    })?;
    session.receipt.add_rows_out(kept.len());
    if kept.antialiased {
        session.progress.say("the scene was made with antialiasing, and scene.ply says so");
    }
    session.finish()?;
    previews.keep();
    Ok(())
}

impl Args {
    /// The run of a checkpoint.
    fn go_on(
        &self,
        session: &Session<'_>,
        place: &Path,
        frames: &Frames,
        settings: OptimiseSettings,
    ) -> Result<Optimiser> {
        // A budget chose its settings by the clock; they are in the checkpoint.
        let asked = self.budget.is_none().then(|| self.bounded(session, settings, frames));
        let optimiser = Optimiser::resume(place, &frames.train, asked.transpose()?)?;
        let (step, total) = (optimiser.steps_done(), optimiser.settings().steps);
        session.progress.say(format!("going on at step {step} of {total}"));
        Ok(optimiser)
    }

    /// Notes the files that are read and written.
    fn claim(&self, session: &Session<'_>) -> Result<()> {
        let outputs = &session.outputs;
        let inputs = [Some(self.cameras.as_path()), Some(&self.images), self.depth.as_deref()];
        outputs.reads_any(inputs)?;
        outputs.reads_any([self.masks.as_deref(), self.points.as_deref()])?;
        outputs.claim_any("--json", self.json.as_ref())?;
        outputs.open_folder(&["scene.ply", "optimise.json", "progress.jsonl"])
    }
}

/// Notes the settings.
fn note(session: &Session<'_>, settings: &OptimiseSettings) -> Result<()> {
    let text = serde_json::to_string(settings)?;
    session.receipt.setting("settings", text, "all that decides what optimisation does");
    Ok(())
}
