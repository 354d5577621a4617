//! How phrases were read: what commands say and note about it.

use crate::error::WrongUse;
use crate::session::Session;
use scenesplat::objects::relations::Relation;
use scenesplat::phrases::{AskError, PhraseError, Placed, Reading, Verdict, shortened};

/// Says and notes that a phrase is taken for a text of the vocabulary; loudly if that is not sure.
pub fn tell_taken(
    session: &Session<'_>,
    phrase: &str,
    known: &str,
    (reading, remark): (Option<&Reading>, &str),
    by: &str,
) {
    let how = match reading {
        None => remark.to_owned(),
        Some(reading) if reading.purpose.is_some() => reading.to_string(),
        Some(reading) => format!("{reading}; by the {by}"),
    };
    session.receipt.setting("taken_for", known, &how);
    let text = format!("{:?} is taken for {known:?}: {how}", shortened(phrase));
    // A corrected word may have been meant as it stands.
    if reading.is_some_and(|reading| reading.verdict == Verdict::Sure) {
        session.progress.say(text);
    } else {
        session.warn_loudly(text);
    }
}

/// Says and notes what a phrase that denies is taken for.
pub fn tell_denied(session: &Session<'_>, phrase: &str, reading: &str, denied: &[String]) {
    let short = shortened(phrase);
    session.progress.say(format!("{short:?} is taken for {reading}; what has no label is neither"));
    let how = format!("{short:?} is read as {reading}");
    session.receipt.setting("denied", denied.join(", "), &how);
}

/// A phrase that asks for a place, where features are asked.
pub fn placed_refused(placed: Placed) -> WrongUse {
    let help = match placed.relation {
        Some(_) => format!(
            "`objects --find {:?}` finds it by the boxes of objects",
            shortened(&placed.text)
        ),
        None => format!("`objects --find` knows {}", relations()),
    };
    WrongUse(format!("{}; {help}", AskError::Placed { placed: Box::new(placed) }))
}

/// The relations that objects are asked for by.
pub fn relations() -> String {
    Relation::ALL.map(|relation| relation.to_string()).join(", ")
}

/// A phrase that cannot be answered as wrong use; a broken file as it is.
pub fn ask_error(error: AskError) -> anyhow::Error {
    match error {
        AskError::Phrase(error) => phrase_error(error),
        AskError::Placed { placed } => placed_refused(*placed).into(),
        other => WrongUse(other.to_string()).into(),
    }
}

/// A phrase that cannot be read as wrong use; a broken file as it is.
pub fn phrase_error(error: PhraseError) -> anyhow::Error {
    match error {
        PhraseError::File(error) => error.into(),
        other => WrongUse(other.to_string()).into(),
    }
}
