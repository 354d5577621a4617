//! What a query asks for, with its rivals.

use super::Args;
use super::guess::guessed;
use crate::commands::phrase::{ask_error, phrase_error, placed_refused, tell_denied, tell_taken};
use crate::error::refuse;
use crate::session::Session;
use anyhow::Result;
use scenesplat::phrases::{AskError, Phrase, PhraseReader, Reading};
use scenesplat::query::Query;
use scenesplat::rooms::Vocabulary;
use scenesplat::scene::TextTable;
use scenesplat::scene::label_set::nearest_names;
use scenesplat::text::read_text_vector;
use scenesplat::text_model::TextModel;

/// What a phrase asks for.
pub enum Meant {
    /// What features tell.
    Query {
        /// What is meant, as far as words tell.
        query: Query,
        /// What may be meant as well, with the texts of the vocabulary; what is in the scene decides.
        near: Vec<(String, Query)>,
    },
    /// Things at a place, such as "lamp on the desk", which the objects of the scene tell.
    Place,
}

/// What is asked for; says and notes how it was understood.
pub fn meant(args: &Args, session: &Session<'_>) -> Result<Meant> {
    let classes = &args.classes;
    let own = args.inference.network.is_embedded() && args.features.is_none();
    let vocabulary = match (classes.vocabulary()?, &classes.text, &args.embedding) {
        (Some(vocabulary), _, None) => Some(vocabulary),
        (None, None, None) if own => Some(scenesplat::embedded::vocabulary()?),
        _ => None,
    };
    match vocabulary {
        Some(vocabulary) => of_phrase(args, session, &vocabulary),
        None => Ok(Meant::Query { query: query(args, session)?, near: Vec::new() }),
    }
}

/// What is asked for without the words of a vocabulary.
fn query(args: &Args, session: &Session<'_>) -> Result<Query> {
    let classes = &args.classes;
    if args.embedding.is_some() && classes.text_model.is_some() {
        refuse!("--embedding is the vector of the query, so --text-model has nothing to read");
    }
    // Of a list of names and of the phrase one model makes vectors; it is read once.
    let is_list = classes.is_list()?;
    let list = classes.text.as_deref().filter(|_| is_list);
    let model = list.and_then(|_| classes.model().transpose()).transpose()?;
    let table = match (&classes.text, &args.embedding) {
        (None, None) if classes.text_model.is_none() => {
            refuse!(
                "give --text (embeddings with names, the query being one of them), --embedding (the query's own vector) \
                 or --text-model (which reads it)"
            );
        }
        (Some(_), _) => Some(match (&model, list) {
            (Some(model), Some(path)) => classes.read_by(model, path)?,
            _ => classes.text_table(false)?,
        }),
        (None, _) => None,
    };
    let vector = match (&args.embedding, &table) {
        (Some(path), _) => read_text_vector(path)?,
        (None, Some(table)) => {
            if let Some(query) = Query::of_table(table, &args.query)? {
                return Ok(query);
            }
            if let Some(query) = of_denial(args, session, table)? {
                return Ok(query);
            }
            let model = model.map_or_else(|| classes.model(), |model| Ok(Some(model)))?;
            match &model {
                Some(TextModel::Sentence(encoder)) if list.is_none() => {
                    return guessed(session, &args.query, table, encoder);
                }
                Some(model) => read(args, session, model)?,
                None => refuse!(
                    "{:?} is not among the {} names of --text; nearest: {}. For any other text give its embedding with \
                     --embedding FILE, or a text model with --text-model DIR",
                    args.query,
                    table.names.len(),
                    nearest_names(&table.names, &args.query, 3).join(", ")
                ),
            }
        }
        (None, None) => {
            let Some(model) = classes.model()? else { refuse!("--text-model is missing") };
            match Phrase::parse(&args.query, &[]).map_err(phrase_error)? {
                Phrase::Plain => read(args, session, &model)?,
                Phrase::Placed(placed) => return Err(placed_refused(placed).into()),
                Phrase::Denied(_) => refuse!(
                    "{:?} denies something: that needs the names of all classes; give them with --text",
                    args.query
                ),
            }
        }
    };
    if let Some(t) = &table
        && t.dim != vector.len()
    {
        let flag = if args.embedding.is_some() { "--embedding" } else { "--text-model" };
        let values = vector.len();
        refuse!("{flag} has {values} values, the rows of --text have {}", t.dim);
    }
    if table.is_none() && classes.min_score.is_none() {
        refuse!(
            "without rivals every Gaussian would be selected: give --text (other classes) or \
             --min-score"
        );
    }
    Ok(Query::of_vector(&args.query, vector, table.as_ref())?)
}

/// The vector that a model gives the phrase; notes it, and says if its end was not read.
fn read(args: &Args, session: &Session<'_>, model: &TextModel) -> Result<Vec<f32>> {
    let found = model.encode(std::slice::from_ref(&args.query))?;
    if !found.cut.is_empty() {
        session
            .warn("the phrase is longer than the text model reads: its end is left out".to_owned());
    }
    session.receipt.setting("read", &args.query, "its vector is that of the text model");
    Ok(found.values)
}

/// Any phrase, in the words of a vocabulary.
fn of_phrase(args: &Args, session: &Session<'_>, vocabulary: &Vocabulary) -> Result<Meant> {
    // What the vocabulary knows needs no encoder.
    let is_known = Query::of_vocabulary(vocabulary, &args.query).is_ok();
    let encoder = match args.classes.model()? {
        Some(TextModel::Sentence(encoder)) => Some(encoder).filter(|_| !is_known),
        Some(_) => refuse!(
            "--text-model is SigLIP, which reads for networks that were trained with its vectors; this one knows the words \
             of its vocabulary: give the other network with --weights, or leave out --text-model"
        ),
        None => None,
    };
    let reader = PhraseReader::new(encoder.as_deref())?;
    let asked = match reader.ask(vocabulary, &args.query) {
        Err(AskError::Placed { placed }) if placed.relation.is_some() => return Ok(Meant::Place),
        asked => asked.map_err(ask_error)?,
    };
    if let Some(known) = &asked.taken_for {
        if asked.denied.is_empty() {
            let by = if encoder.is_some() { "encoder" } else { "phrase table" };
            tell_taken(session, &args.query, known, (asked.reading.as_ref(), &asked.remark), by);
        } else {
            tell_denied(session, &args.query, known, &asked.denied);
        }
    }
    let near = asked.reading.iter().flat_map(Reading::near_texts).map(|text| {
        let query = Query::of_vocabulary(vocabulary, &text).map_err(AskError::from)?;
        Ok((text, Query { text: args.query.clone(), ..query }))
    });
    let near = near.collect::<Result<_, AskError>>().map_err(ask_error)?;
    Ok(Meant::Query { query: asked.query, near })
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
