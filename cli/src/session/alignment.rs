//! Reports how a scene lies, and what the network makes of it.

use super::Session;
use crate::error::refuse;
use anyhow::Result;
use scenesplat::alignment::{Alignment, Remark};

impl Session<'_> {
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
        let shown: Vec<String> =
            floors.heights.iter().map(|h| format!("{:.2}", h / alignment.scale)).collect();
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
            (false, false) => "up in the scene, by its shape",
        };
        self.receipt.setting("up", up.axis, why);
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
        Remark::UpUnclear { .. } | Remark::UnitUnclear { .. } => return None,
    };
    Some((name, value, why))
}

/// What the user reads; `given`: the flags say which way is up.
fn text(remark: &Remark, given: bool) -> String {
    match *remark {
        Remark::Turned { from } => format!(
            "up is {from}{}: the network reads a copy turned to +z; files keep their frame \
             (--up AXIS if it is another, --as-is to leave it)",
            if given { "" } else { ", by the shape of the scene" }
        ),
        Remark::Scaled { by } => format!(
            "one unit is {by} m: the network reads a copy in metres; files keep their unit \
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
            "the walls are {height:.2} units high, and no room is: the network reads a copy with \
             {by:.3} m per unit; files keep their unit (--unit m if these are metres)"
        ),
        Remark::UpUnclear { likely, confidence } => format!(
            "WHICH WAY IS UP IS UNCLEAR ({likely} is likeliest, confidence {confidence:.2}): the \
             network takes +z for up, and most labels are lost if it is not; say it with --up AXIS"
        ),
        Remark::UnitUnclear { likely, confidence } => {
            let unit = likely.symbol();
            format!(
                "THE UNIT IS UNCLEAR ({unit} is likeliest, confidence {confidence:.2}): the network \
                 takes it for metres, and labels mean little if it is not; say it with --unit \
                 {unit} or --unit m"
            )
        }
    }
}
