//! How a scene lies: finds it out once for a run, and reports what the network makes of it.

use super::Session;
use crate::error::refuse;
use crate::flags::Inference;
use crate::progress::interrupted;
use anyhow::Result;
use scenesplat::alignment::judge::Judge;
use scenesplat::alignment::{Alignment, AlignmentSettings, Remark};
use scenesplat::inference::EncodeError;
use scenesplat::outputs::OpenedScene;
use scenesplat::scene::Up;
use scenesplat::{Network, SceneEncoder};

impl Session<'_> {
    /// How a scene lies: as the network of this run reads it, or, without one, by its shape.
    pub fn alignment(&self, opened: &OpenedScene, inference: &Inference) -> Alignment {
        // The network inside the program knows rooms along the axes: one answer for all who ask.
        let is_square = inference.network.is_embedded();
        self.shape_alignment(opened, &inference.alignment(&opened.loaded, is_square))
    }

    /// How a scene lies as a network reads it.
    pub fn alignment_of(
        &self,
        opened: &OpenedScene,
        inference: &Inference,
        network: &Network,
    ) -> Result<Alignment> {
        let settings = inference.alignment(&opened.loaded, network.is_square());
        match inference.network.is_embedded() {
            true => self.judged_alignment(opened, &settings, &self.encoder(network, inference)),
            false => Ok(self.shape_alignment(opened, &settings)),
        }
    }

    /// How a scene lies by its shape, if nothing else was found out before.
    pub fn shape_alignment(&self, opened: &OpenedScene, settings: &AlignmentSettings) -> Alignment {
        self.known(opened, settings).unwrap_or_else(|| {
            let _stage = self.receipt.stage("alignment");
            self.remember(opened, settings, Alignment::of(&opened.loaded.scene, settings))
        })
    }

    /// As [`shape_alignment`](Self::shape_alignment); where the shape leaves up or the unit open, the network inside the
    /// program, which the encoder runs, decides.
    pub fn judged_alignment(
        &self,
        opened: &OpenedScene,
        settings: &AlignmentSettings,
        encoder: &SceneEncoder<'_>,
    ) -> Result<Alignment> {
        let found = self.shape_alignment(opened, settings);
        let is_decided = found.judged || found.sized.is_some();
        if is_decided || !(found.is_open() || found.is_size_open()) {
            return Ok(found);
        }
        let _stage = self.receipt.stage("alignment");
        if found.is_open() {
            self.progress
                .say("which way is up is unclear: the network looks at the scene in several poses");
        }
        let scene = &opened.loaded.scene;
        let found = Judge::embedded()?.decide(encoder, scene, settings, found, &mut |_| {
            if interrupted() { Err(EncodeError::Stopped) } else { Ok(()) }
        })?;
        Ok(self.remember(opened, settings, found))
    }

    /// Which way is up in a picture of a scene.
    pub fn up(&self, opened: &OpenedScene, inference: &Inference) -> Up {
        inference.up.unwrap_or_else(|| self.alignment(opened, inference).up.direction)
    }

    fn known(&self, opened: &OpenedScene, settings: &AlignmentSettings) -> Option<Alignment> {
        let aligned = self.aligned.borrow();
        let (path, is_square, alignment) = aligned.as_ref()?;
        let fits = *path == opened.loaded.path && (*is_square || !settings.square);
        fits.then(|| alignment.clone())
    }

    fn remember(
        &self,
        opened: &OpenedScene,
        settings: &AlignmentSettings,
        alignment: Alignment,
    ) -> Alignment {
        let known = (opened.loaded.path.clone(), settings.square, alignment.clone());
        *self.aligned.borrow_mut() = Some(known);
        alignment
    }

    /// Records what heights are measured from, and reports it where it is uncertain.
    pub fn tell_floor(
        &self,
        alignment: &Alignment,
        is_read: bool,
        given: Option<f64>,
    ) -> Result<()> {
        if !is_read {
            match given {
                Some(_) => refuse!("--floor: this network reads no heights"),
                None => return Ok(()),
            }
        }
        let floors = &alignment.floors;
        let heights = alignment.floor_heights();
        let shown: Vec<String> = heights.iter().map(|height| format!("{height:.2}")).collect();
        let heights = shown.join(", ");
        let percent = |share: f64| format!("{:.0} %", 100.0 * share);
        let why = match (floors.given, floors.has_plane()) {
            (true, _) => "as given".to_owned(),
            (false, true) => format!(
                "a level surface over {} of the ground plan; {} of what is seen lies below it",
                percent(floors.cover),
                percent(floors.below)
            ),
            (false, false) => {
                "no level surface was found; 1 % of what is seen lies below it".to_owned()
            }
        };
        self.receipt.setting("floor", &heights, &format!("height along up: {why}"));
        let is_plain = floors.has_plane() && floors.heights.len() == 1 && floors.below < 0.02;
        if !is_plain && !floors.given {
            let what = if floors.heights.len() == 1 { "the floor is" } else { "the floors are" };
            self.progress.say(format!(
                "{what} at {heights} along up: {why} (--floor HEIGHT if it is another)"
            ));
        }
        Ok(())
    }

    /// Reports and records how the network turns and scales a scene that is not as it expects.
    pub fn tell_alignment(&self, alignment: &Alignment, as_is: bool) {
        let up = &alignment.up;
        let why = match (as_is, up.given) {
            (true, _) => "as is: the network takes +z for up",
            (false, true) => "up in the scene, as given",
            (false, false) if alignment.judged => "up in the scene, by its shape and the network",
            (false, false) if up.is_sure() => "up in the scene, by its shape",
            (false, false) => {
                "up in the scene, open: by what its file states or else by its shape (see alignment)"
            }
        };
        self.receipt.setting("up", up.direction, why);
        self.receipt.alignment(alignment.report());
        for remark in &alignment.remarks {
            if let Some((name, value, why)) = setting(remark) {
                self.receipt.setting(name, value, why);
            }
            let text = text(remark, up.given);
            // Each scene of several has its own.
            if remark.is_warning() { self.warn_loudly(text) } else { self.warn(text) }
        }
    }
}

/// What the receipt says of a copy that the network read: name, value and meaning.
fn setting(remark: &Remark) -> Option<(&'static str, String, &'static str)> {
    let (name, value, why) = match *remark {
        Remark::Turned { from } => (
            "turned",
            from.to_string(),
            "the network read a copy turned from this up to +z; files keep theirs",
        ),
        Remark::Scaled { by } => {
            ("unit", by.to_string(), "meters per unit; the network read a copy in meters")
        }
        Remark::Leveled { tilt } => (
            "leveled",
            format!("{tilt:.1}"),
            "degrees that the floor was off; the network read a level copy",
        ),
        Remark::Squared { yaw } => (
            "squared",
            format!("{yaw:.1}"),
            "degrees that walls were off the axes; the network read a turned copy",
        ),
        Remark::ScaledToRoom { by, .. } => (
            "unit",
            format!("{by:.4}"),
            "meters per unit, by the height of the walls; the network read a copy in meters",
        ),
        Remark::ScaledBySize { by, .. } => (
            "unit",
            format!("{by:.4}"),
            "meters per unit, by the sizes of things; the network read a copy in meters",
        ),
        Remark::UpUnclear { .. } | Remark::UnitUnclear { .. } | Remark::SizeUnclear { .. } => {
            return None;
        }
    };
    Some((name, value, why))
}

/// What the user reads; `given`: the flags say which way is up.
fn text(remark: &Remark, given: bool) -> String {
    match *remark {
        Remark::Turned { from } => format!(
            "up is {}{}: the network reads a copy turned to +z; files keep their frame \
             (--up AXIS or X,Y,Z if it is another, --as-is to leave it)",
            from.described(),
            if given { "" } else { ", by the shape of the scene" }
        ),
        Remark::Scaled { by } => format!(
            "one unit is {by} m: the network reads a copy in meters; files keep their unit \
             (--unit UNIT if it is another, --as-is to leave it)"
        ),
        Remark::Leveled { tilt } => format!(
            "the floor is {tilt:.1} degrees out of level: the network reads a level copy; files \
             keep their frame (--as-is to leave it)"
        ),
        Remark::Squared { yaw } => format!(
            "walls are turned by {yaw:.1} degrees: the network reads a copy with its walls along \
             the axes; files keep their frame (--as-is to leave it)"
        ),
        Remark::ScaledToRoom { by, height } => format!(
            "THE UNIT IS A GUESS: the walls are {height:.2} units high, and no room is, so the network reads a copy with \
             {by:.3} m per unit; files keep their unit (--unit METERS if you know it, --unit m if these are meters)"
        ),
        Remark::ScaledBySize { by, confidence } => format!(
            "THE UNIT IS A GUESS by the sizes of things: {by:.3} m per unit, off by less than a tenth with confidence \
             {confidence:.2}; the network reads a copy in meters, files keep their unit (--unit METERS if you know it)"
        ),
        Remark::UpUnclear { likely, confidence } => format!(
            "WHICH WAY IS UP IS UNCLEAR (confidence {confidence:.2}): {likely} is taken, \
             and most labels are lost if it is not; say it with --up AXIS or X,Y,Z"
        ),
        Remark::UnitUnclear { likely, confidence } => {
            let unit = likely.symbol();
            format!(
                "THE UNIT IS UNCLEAR ({unit} is likeliest, confidence {confidence:.2}): the network \
                 takes it for meters, and labels mean little if it is not; say it with --unit \
                 {unit} or --unit m"
            )
        }
        Remark::SizeUnclear { height } => format!(
            "HOW LARGE THE SCENE IS IS UNCLEAR: it is {height:.3} units high, and nothing of known size was found in it; the \
             network takes units for meters, and labels mean little if they are not; say it with --unit METERS"
        ),
    }
}
