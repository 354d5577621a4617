//! What a query asks for, with its rivals.

use super::Args;
use super::guess::guessed;
use crate::error::{WrongUse, refuse};
use crate::session::Session;
use anyhow::Result;
use scenesplat::phrases::{AskError, PhraseReader, TextEncoder, Verdict};
use scenesplat::query::Query;
use scenesplat::rooms::Vocabulary;
use scenesplat::scene::label_set::nearest_names;
use scenesplat::text::read_text_vector;

/// What is asked for; says and notes how it was understood.
pub fn query(args: &Args, session: &Session<'_>) -> Result<Query> {
    if let (Some(vocabulary), None) = (args.classes.vocabulary()?, &args.embedding) {
        return of_phrase(args, session, &vocabulary);
    }
    let table = match (&args.classes.text, &args.embedding) {
        (None, None) if args.inference.network.is_embedded() && args.features.is_none() => {
            return of_phrase(args, session, &scenesplat::embedded::vocabulary()?);
        }
        (None, None) => {
            refuse!(
                "give --text (embeddings with names, the query being one of them) or --embedding \
                 (the query's own vector)"
            );
        }
        (Some(_), _) => Some(args.classes.text_table(false)?),
        (None, Some(_)) => None,
    };
    let Some(path) = &args.embedding else {
        let Some(table) = table else {
            refuse!("--text is missing");
        };
        if let Some(query) = Query::of_table(&table, &args.query)? {
            return Ok(query);
        }
        if let Some(folder) = &args.text_model {
            return guessed(session, &args.query, &table, &TextEncoder::open(folder)?);
        }
        refuse!(
            "{:?} is not among the {} names of --text; nearest: {}. For any other text give \
             its embedding with --embedding FILE, or a sentence encoder with --text-model DIR",
            args.query,
            table.names.len(),
            nearest_names(&table.names, &args.query, 3).join(", ")
        );
    };
    let vector = read_text_vector(path)?;
    if let Some(t) = &table
        && t.dim != vector.len()
    {
        refuse!("--embedding has {} values, the rows of --text have {}", vector.len(), t.dim);
    }
    if table.is_none() && args.classes.min_score.is_none() {
        refuse!(
            "without rivals every Gaussian would be selected: give --text (other classes) or \
             --min-score"
        );
    }
    Ok(Query::of_vector(&args.query, vector, table.as_ref())?)
}

/// Any phrase, in the words of a vocabulary.
fn of_phrase(args: &Args, session: &Session<'_>, vocabulary: &Vocabulary) -> Result<Query> {
    // What the vocabulary knows needs no encoder.
    let is_known = Query::of_vocabulary(vocabulary, &args.query).is_ok();
    let folder = args.text_model.as_deref().filter(|_| !is_known);
    let encoder = folder.map(TextEncoder::open).transpose()?;
    let reader = PhraseReader::new(encoder.as_ref())?;
    let asked = reader.ask(vocabulary, &args.query).map_err(|error| match error {
        AskError::Phrase(scenesplat::phrases::PhraseError::File(error)) => {
            anyhow::Error::from(error)
        }
        other => WrongUse(other.to_string()).into(),
    })?;
    if let Some(known) = &asked.taken_for {
        let how = match &asked.reading {
            Some(reading) => {
                let by = if encoder.is_some() { "encoder" } else { "phrase table" };
                format!("{reading}; by the {by}")
            }
            None => asked.remark.clone(),
        };
        let text = format!("{:?} is taken for {known:?}: {how}", args.query);
        session.receipt.setting("taken_for", known, &how);
        // A corrected word may have been meant as it stands.
        let is_sure = asked.reading.as_ref().is_some_and(|r| r.verdict == Verdict::Sure);
        if is_sure {
            session.progress.say(text);
        } else {
            session.warn_loudly(text);
        }
    }
    Ok(asked.query)
}
