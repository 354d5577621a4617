//! `scenesplat text`

mod build;

use crate::commands::classes::open_text_model;
use crate::error::refuse;
use crate::outputs::Outputs;
use crate::terminal::print;
use crate::threads::set_threads;
use anyhow::Result;
use scenesplat::phrases::{
    Encoded, Phrase, PhraseError, PhraseReader, PhraseTable, Placed, Reading, TextEncoder,
};
use scenesplat::rooms::CLASSES;
use scenesplat::scene::TextTable;
use scenesplat::scene::label_set::read_names;
use scenesplat::text_model::{TextModel, TextVectors};
use serde_json::json;
use std::path::{Path, PathBuf};

/// Prints what phrases mean to the network inside the program: its nearest classes, how much they are alike, and what
/// was corrected or not known. Also writes their vectors as text embeddings that --text takes.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Phrases, such as "a place to sleep".
    pub phrases: Vec<String>,
    /// A file of further phrases, one a line, or a JSON list.
    #[arg(long, value_name = "FILE")]
    pub names: Option<PathBuf>,
    /// Folder of a text model, in place of the phrase table inside the program: a sentence encoder (all-MiniLM-L6-v2), or
    /// SigLIP 2 (siglip2-base-patch16-512), which needs --out. Both have config.json, tokenizer.json, model.safetensors.
    #[arg(long, value_name = "DIR")]
    pub text_model: Option<PathBuf>,
    /// What SigLIP reads a phrase in; several are averaged. [default: "this is a {}"]
    #[arg(long, value_name = "TEXT", requires = "text_model")]
    pub template: Vec<String>,
    /// Writes the phrases and their vectors as a text table: those of the model with --text-model, else the 96 numbers
    /// of the phrase table inside the program.
    #[arg(long, value_name = "FILE.safetensors")]
    pub out: Option<PathBuf>,
    /// Makes the vectors of a phrase table of the phrases; needs --text-model.
    #[arg(long, value_name = "FILE.safetensors", conflicts_with = "out")]
    pub phrase_table: Option<PathBuf>,
    /// Writes what the phrases were taken for as JSON.
    #[arg(long, value_name = "FILE.json")]
    pub json: Option<PathBuf>,
    /// Threads; all cores by default. Results do not depend on it.
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    set_threads(args.threads)?;
    let outputs = Outputs::new(Path::new("."));
    outputs.reads_any([args.names.as_deref(), args.text_model.as_deref()])?;
    for (flag, path) in
        [("--out", &args.out), ("--phrase-table", &args.phrase_table), ("--json", &args.json)]
    {
        outputs.claim_any(flag, path.as_ref())?;
    }
    let mut phrases = args.phrases.clone();
    if let Some(path) = &args.names {
        phrases.extend(read_names(path)?);
    }
    let given = phrases.len();
    let mut seen = std::collections::BTreeSet::new();
    phrases.retain(|phrase| seen.insert(phrase.clone()));
    if phrases.len() < given {
        print(&format!("{} phrases were given more than once", given - phrases.len()));
    }
    if phrases.is_empty() {
        refuse!("give a phrase, or a file of them with --names");
    }
    let encoder = match args
        .text_model
        .as_deref()
        .map(|dir| open_text_model(dir, &args.template))
        .transpose()?
    {
        Some(TextModel::Sentence(encoder)) => Some(*encoder),
        Some(model) => {
            let Some(path) = &args.out else {
                refuse!(
                    "SigLIP's vectors say nothing to the network inside the program: give --out for a text table"
                );
            };
            if args.json.is_some() {
                refuse!(
                    "--json says what phrases are taken for, which SigLIP does not tell; leave it out"
                );
            }
            let TextVectors { values, dim, cut } = model.encode(&phrases)?;
            for phrase in cut {
                let name: String = phrases[phrase].chars().take(40).collect();
                print(&format!("{name:?}: only the beginning was read"));
            }
            write_table(&outputs, (values, dim), &phrases, path)?;
            return outputs.commit(None);
        }
        None => None,
    };
    match (&args.phrase_table, &args.out, &encoder) {
        (Some(_), _, None) => {
            refuse!(
                "a phrase table is made with a sentence encoder: give its folder with \
                        --text-model"
            );
        }
        (Some(path), _, Some(encoder)) => {
            if args.json.is_some() {
                refuse!("--json says what phrases are taken for; leave it out with --phrase-table");
            }
            build::run(&outputs, encoder, phrases, path)?;
            return outputs.commit(None);
        }
        (_, Some(path), Some(encoder)) => {
            write_table(&outputs, encode(encoder, &phrases)?, &phrases, path)?;
        }
        (_, Some(path), None) => {
            write_table(&outputs, look_up(&phrases)?, &phrases, path)?;
        }
        _ => {}
    }
    let readings = tell(&phrases, encoder.as_ref(), args.out.is_some())?;
    if let Some(path) = &args.json {
        let about = json!({
            "read_by": if encoder.is_some() { "encoder" } else { "phrase table" },
            "phrases": readings,
        });
        outputs.file(path, (serde_json::to_string_pretty(&about)? + "\n").as_bytes())?;
    }
    outputs.commit(None)
}

/// The encoder's vectors of phrases, and their length.
fn encode(encoder: &TextEncoder, phrases: &[String]) -> Result<(Vec<f32>, usize)> {
    let Encoded { dim, values, truncated } = encoder.encode(phrases)?;
    for cut in truncated {
        let name: String = phrases[cut.phrase].chars().take(40).collect();
        print(&format!(
            "{name:?}: only the first {} of its {} tokens were read",
            cut.read, cut.tokens
        ));
    }
    Ok((values, dim))
}

/// The vectors of phrases in the table inside the program, and their length.
fn look_up(phrases: &[String]) -> Result<(Vec<f32>, usize)> {
    let table = PhraseTable::embedded()?;
    let (mut values, mut unknown, mut made_up) = (Vec::new(), Vec::new(), 0);
    for phrase in phrases {
        match table.understand(phrase) {
            Ok(understood) => {
                made_up += usize::from(!understood.whole);
                values.extend(understood.row);
            }
            Err(_) => unknown.push(format!("{:?}", phrase.chars().take(40).collect::<String>())),
        }
    }
    if !unknown.is_empty() {
        refuse!(
            "no word is known of {} of the phrases: {}; leave them out, or give a sentence encoder \
             with --text-model",
            unknown.len(),
            unknown.join(", ")
        );
    }
    if made_up > 0 {
        print(&format!("{made_up} phrases are not in the phrase table: made up of their words"));
    }
    Ok((values, table.dim()))
}

/// Writes phrases with their vectors.
fn write_table(
    outputs: &Outputs,
    (values, dim): (Vec<f32>, usize),
    phrases: &[String],
    path: &Path,
) -> Result<()> {
    let table = TextTable { names: phrases.to_vec(), dim, values };
    outputs.file(path, &table.to_safetensors()?)?;
    print(&format!("{}: {} phrases, {dim} numbers each", path.display(), phrases.len()));
    Ok(())
}

/// Prints what each phrase is taken for, and gives it for JSON.
fn tell(
    phrases: &[String],
    encoder: Option<&TextEncoder>,
    has_table: bool,
) -> Result<Vec<serde_json::Value>> {
    let reader = match PhraseReader::new(encoder) {
        Ok(reader) => reader,
        // A table can be made with any encoder; what its phrases mean here, only one can say.
        Err(error @ PhraseError::Table { .. }) if encoder.is_some() && has_table => {
            print(&format!("{error}"));
            return Ok(Vec::new());
        }
        Err(error) => return Err(error.into()),
    };
    let mut all = Vec::with_capacity(phrases.len());
    for phrase in phrases {
        match meaning(&reader, phrase) {
            Ok((text, json)) => {
                print(&format!("{phrase:?}: {text}"));
                all.push(json);
            }
            Err(
                error @ (PhraseError::Phrase { .. }
                | PhraseError::Meaning { .. }
                | PhraseError::Unknown { .. }),
            ) => {
                print(&error.to_string());
                all.push(json!({ "phrase": phrase, "error": error.to_string() }));
            }
            Err(error) => return Err(error.into()),
        }
    }
    Ok(all)
}

/// What a phrase means, in words and for JSON.
fn meaning(
    reader: &PhraseReader<'_>,
    phrase: &str,
) -> Result<(String, serde_json::Value), PhraseError> {
    match Phrase::parse(phrase, &[])? {
        Phrase::Plain => {
            let reading = reader.read(phrase)?;
            Ok((reading.to_string(), as_json(&reading)))
        }
        Phrase::Denied(denied) => {
            let classes: Vec<String> = CLASSES.iter().map(|class| class.name.to_owned()).collect();
            let left = denied.labels(&classes)?;
            let json =
                json!({ "phrase": phrase, "taken_for": left.reading, "denied": left.denied });
            Ok((left.reading, json))
        }
        Phrase::Placed(placed) => {
            let help = if placed.relation.is_some() { "find by it" } else { "do not tell it" };
            let text = format!("a thing by its place ({placed}); the boxes of `objects` {help}");
            let Placed { what, relation, to, .. } = placed;
            let relation = json!({ "what": what, "relation": relation, "to": to });
            Ok((text, json!({ "phrase": phrase, "relation": relation })))
        }
    }
}

/// A reading for JSON.
pub fn as_json(reading: &Reading) -> serde_json::Value {
    let classes = reading.nearest.iter().take(5).map(|near| {
        json!({ "class": near.class.about().name, "similarity": near.similarity, "name": near.name })
    });
    json!({
        "phrase": reading.text,
        "taken_for": reading.known_text(),
        "verdict": reading.verdict.to_string(),
        "colors": reading.colors.iter().map(|c| c.word()).collect::<Vec<_>>(),
        "purpose": reading.purpose,
        "nearest": classes.collect::<Vec<_>>(),
        "remark": reading.remark,
    })
}
