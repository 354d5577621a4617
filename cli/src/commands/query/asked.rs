//! What a query asks for, with its rivals.

use super::Args;
use super::guess::guessed;
use crate::commands::phrase::{ask_error, phrase_error, placed_refused, tell_denied, tell_taken};
use crate::error::refuse;
use crate::session::Session;
use anyhow::Result;
use scenesplat::phrases::{Phrase, PhraseReader, TextEncoder};
use scenesplat::query::Query;
use scenesplat::rooms::Vocabulary;
use scenesplat::scene::TextTable;
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
        if let Some(query) = of_denial(args, session, &table)? {
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
    let asked = reader.ask(vocabulary, &args.query).map_err(ask_error)?;
    if let Some(known) = &asked.taken_for {
        if asked.denied.is_empty() {
            let by = if encoder.is_some() { "encoder" } else { "phrase table" };
            tell_taken(session, &args.query, known, (asked.reading.as_ref(), &asked.remark), by);
        } else {
            tell_denied(session, &args.query, known, &asked.denied);
        }
    }
    Ok(asked.query)
}

/// All rows of a table but those that the phrase denies; `None` for a phrase that denies none.
fn of_denial(args: &Args, session: &Session<'_>, table: &TextTable) -> Result<Option<Query>> {
    match Phrase::parse(&args.query, &table.names).map_err(phrase_error)? {
        Phrase::Plain => Ok(None),
        Phrase::Placed(placed) => Err(placed_refused(placed).into()),
        Phrase::Denied(denied) => {
            let left = denied.labels(&table.names).map_err(phrase_error)?;
            tell_denied(session, &args.query, &left.reading, &left.denied);
            Ok(Some(Query::of_rows(table, &args.query, &left.chosen)?))
        }
    }
}
