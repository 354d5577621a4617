//! The scene that is asked about, and what is answered.

use super::picture::{Pictures, Seen};
use super::tools::{Answer, Arguments, Tool, word};
use crate::caller::{Caller, called_by};
use crate::commands::labelled::{LabelArgs, LabelOrigin, Labelled};
use crate::commands::meant::Asking;
use crate::commands::query::{self, Meant, meant, place::of_objects, selected};
use crate::commands::render::parse_point;
use crate::commands::{objects, query::Args as QueryArgs};
use crate::error::{WrongUse, refuse};
use crate::flags::PreviewArgs;
use crate::frame::{Frame, frame};
use crate::session::Session;
use crate::setting::VOTE_K;
use crate::terminal::{check_warnings, tell_warnings_again};
use anyhow::Result;
use scenesplat::objects::{Catalogue, Object, UprightBox};
use scenesplat::query::Selection;
use scenesplat_lab::compensation::Consumer;
use serde_json::{Value, json};
use std::sync::{Arc, Mutex, PoisonError};

/// A labeled scene.
pub struct Scene<'a> {
    session: &'a Session<'a>,
    labels: &'a LabelArgs,
    labelled: Labelled,
    found: Catalogue,
    frame: Frame,
    /// Of the objects, as the file has it.
    table: Value,
    /// Gaussians that no query selects; empty where all may be.
    withheld: Vec<bool>,
    pictures: Pictures,
}

/// Hears how a phrase is read.
#[derive(Default)]
struct Notes(Mutex<Vec<String>>);

impl Notes {
    fn all(&self) -> Vec<String> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

impl Caller for Notes {
    fn say(&self, text: &str) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).push(text.to_owned());
    }

    fn warn(&self, text: &str) {
        self.say(text);
    }

    fn advance(&self, _: &str, _: f64) {}

    fn stops(&self) -> bool {
        false
    }
}

impl<'a> Scene<'a> {
    /// Reads a scene, labels it and finds its objects, as `objects` does.
    pub fn label(session: &'a Session<'a>, labels: &'a LabelArgs) -> Result<Self> {
        let inference = &labels.labelling.inference;
        let labelled = labels.label(session, false)?;
        let frame = frame(session, &labelled.opened, inference);
        let found = labelled.objects(session, &labels.settings(), labels.pieces, frame)?;
        session.check_stop()?;
        let mut withheld = Vec::new();
        if labelled.features.is_some() {
            let network = matches!(labelled.origin, LabelOrigin::Embedded | LabelOrigin::Network);
            let wish = labels.labelling.wish(session)?;
            let consumer = Consumer { network, labels: true };
            let about = session.compensation(&wish, &labelled.opened, inference, consumer)?;
            withheld = about.withheld().to_vec();
        }
        let mut table = objects::json(session, &labelled, &found);
        // Eight corners an object say what center, size and yaw do.
        for object in table["objects"].as_array_mut().into_iter().flatten() {
            object["box"].as_object_mut().and_then(|of| of.remove("corners"));
        }
        let pictures = Pictures::default();
        Ok(Self { session, labels, labelled, found, frame, table, withheld, pictures })
    }

    /// Answers a request.
    ///
    /// # Errors
    /// As the command line has them.
    pub fn answer(&mut self, tool: Tool, arguments: &Arguments) -> Result<Answer> {
        let known = tool.names();
        if let Some(name) = arguments.keys().find(|name| !known.contains(&name.as_str())) {
            let names = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
            refuse!("{}: no argument {name:?}; there are: {names}", tool.name());
        }
        tell_warnings_again();
        let said = |json: Value| Ok(Answer { json, png: None });
        let answer = match tool {
            Tool::Objects => said(self.table.clone()),
            Tool::Find => said(self.asked(arguments, Self::find)?),
            Tool::Query => said(self.asked(arguments, Self::query)?),
            Tool::Measure => said(self.measure(arguments)?),
            Tool::Picture => {
                let target = arguments.get("object").map(|id| self.object(id)).transpose()?;
                let target = target.map(|at| &self.found.objects[at]);
                let seen = Seen {
                    session: self.session,
                    labels: self.labels,
                    scene: &self.labelled.opened.loaded.scene,
                    found: &self.found,
                    frame: self.frame,
                };
                self.pictures.draw(&seen, target, arguments)
            }
        };
        check_warnings()?;
        answer
    }

    /// Answers a phrase, and says how it was read. Each has a session of its own: what one warns of is not about the next.
    fn asked(
        &self,
        arguments: &Arguments,
        work: impl FnOnce(&Self, &Session<'_>, &str) -> Result<Value>,
    ) -> Result<Value> {
        let Some(phrase) = arguments.get("phrase").and_then(Value::as_str) else {
            refuse!("phrase: a text is expected, such as \"chair near the table\"");
        };
        let notes = Arc::new(Notes::default());
        let mut answer = called_by(notes.clone(), || {
            let inference = &self.labels.labelling.inference;
            let session = Session::start_network(self.session.shared, inference, None, "")?;
            work(self, &session, phrase)
        })?;
        answer["phrase"] = phrase.into();
        answer["notes"] = notes.all().into();
        answer["warnings"] = self.table["warnings"].clone();
        Ok(answer)
    }

    fn asking<'s>(&'s self, session: &'s Session<'_>) -> Asking<'s> {
        Asking { session, found: &self.found, labels: &self.labelled.names }
    }

    fn find(&self, session: &Session<'_>, phrase: &str) -> Result<Value> {
        let asking = self.asking(session);
        let places = asking.meant(phrase)?;
        if places.is_empty() {
            session.progress.say(format!("none; {}", asking.there_are()));
        }
        let objects: Vec<&Value> =
            places.iter().map(|&place| &self.table["objects"][place]).collect();
        let selection = of_objects(&self.labelled, &self.found, &places);
        Ok(json!({ "objects": objects, "gaussians": self.gaussians(&selection) }))
    }

    fn query(&self, session: &Session<'_>, phrase: &str) -> Result<Value> {
        let Some((features, _)) = &self.labelled.features else {
            refuse!(
                "there are no features to ask: the labels are those that the scene or a classifier has; `find` asks for objects"
            );
        };
        let args = self.query_args(phrase);
        let mut selection = match meant(&args, session)? {
            Meant::Place => {
                let places = self.asking(session).meant(phrase)?;
                of_objects(&self.labelled, &self.found, &places)
            }
            Meant::Query { query, near } => {
                let rows = (features, &self.labelled.opened.loaded.scene.coord[..]);
                let vote_k = args.vote_k.unwrap_or(VOTE_K);
                query::check_rivals(&args, &query)?;
                selected(&args, session, (&query, &near), rows, vote_k)?
            }
        };
        session.note_withheld(selection.withhold(&self.withheld), "selected Gaussians");
        let mut answer = json!({ "gaussians": self.gaussians(&selection) });
        answer["best_score"] = selection.best_score().into();
        Ok(answer)
    }

    /// The flags of `query` that say the same as those of this command.
    fn query_args(&self, phrase: &str) -> QueryArgs {
        let labelling = &self.labels.labelling;
        QueryArgs {
            scene: self.labels.scene.clone(),
            query: phrase.to_owned(),
            embedding: None,
            classes: labelling.classes.clone(),
            vote_k: labelling.vote_k,
            features: labelling.features.clone(),
            preview: PreviewArgs { preview_size: 720, preview_theme: Default::default() },
            budget: Default::default(),
            effects: labelling.effects.clone(),
            inference: labelling.inference.clone(),
            shared: self.session.shared.clone(),
        }
    }

    /// How many Gaussians are selected, and where they are.
    fn gaussians(&self, selection: &Selection) -> Value {
        let of = selection.selected.len();
        match selection.place(&self.labelled.opened.loaded.scene.coord) {
            None => json!({ "count": 0, "of": of }),
            Some(place) => json!({
                "count": place.count, "of": of, "center": place.center, "low": place.low, "high": place.high
            }),
        }
    }

    fn measure(&self, arguments: &Arguments) -> Result<Value> {
        let Some(from) = arguments.get("from") else {
            refuse!("from: the id of an object or a point is expected, such as 3 or [1.5, 0, -2]");
        };
        let from_box = self.place(from)?;
        let Some(to) = arguments.get("to") else {
            let Ok(at) = self.object(from) else {
                refuse!("a point has no size: give the id of an object, or to");
            };
            let Object { id, class, bounds, volume, above_floor, wall_distance, .. } =
                &self.found.objects[at];
            return Ok(json!({
                "object": id, "class": class, "size": bounds.size, "volume": volume,
                "above_floor": above_floor, "wall_distance": wall_distance
            }));
        };
        let to_box = self.place(to)?;
        let apart = [0, 1, 2].map(|a| to_box.center[a] - from_box.center[a]);
        Ok(json!({
            "from": from, "to": to,
            "distance": apart.iter().map(|v| v * v).sum::<f64>().sqrt(),
            "gap": from_box.plan_gap(&to_box).hypot(from_box.height_gap(&to_box)),
        }))
    }

    /// Where an object or a point is: a point is a box without sides.
    fn place(&self, given: &Value) -> Result<UprightBox> {
        if !given.is_array() {
            return Ok(self.found.objects[self.object(given)?].bounds);
        }
        let p = parse_point(&word(given)).map_err(WrongUse)?;
        let Frame { upright, metres_per_unit, .. } = self.frame;
        let turned = |row: [f64; 3]| (0..3).map(|k| row[k] * p[k]).sum::<f64>() * metres_per_unit;
        Ok(UprightBox { center: upright.map(turned), size: [0.0; 3], yaw: 0.0 })
    }

    /// The place of an object in the list, by its number.
    fn object(&self, given: &Value) -> Result<usize> {
        let count = self.found.objects.len();
        let place = given.as_u64().and_then(|id| usize::try_from(id.checked_sub(1)?).ok());
        match place.filter(|place| *place < count) {
            Some(place) => Ok(place),
            None => refuse!("there is no object {given}; objects are 1 to {count}"),
        }
    }
}
