//! In which form messages and progress go to standard error: lines for people, or JSON, one object a line.

use scenesplat::scene::printable_text;
use serde_json::{Map, Value, json};
use std::cell::Cell;
use std::ffi::OsString;

/// The form of a message.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum LogFormat {
    /// Lines, and a bar on a terminal.
    #[default]
    Text,
    /// One JSON object a line: level, message, and of progress stage, done and total.
    Json,
}

/// How bad it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Level {
    /// It goes on as it should.
    Info,
    /// Something to know; the command goes on.
    Warning,
    /// The command fails.
    Error,
}

impl Level {
    /// Its name in JSON.
    fn name(self) -> &'static str {
        match self {
            Self::Info => "info",
            Self::Warning => "warning",
            Self::Error => "error",
        }
    }

    /// What a line for people begins with.
    fn prefix(self) -> &'static str {
        match self {
            Self::Info => "",
            Self::Warning => "warning: ",
            Self::Error => "error: ",
        }
    }
}

thread_local! {
    /// The form that the command of this thread was asked for.
    static FORMAT: Cell<LogFormat> = const { Cell::new(LogFormat::Text) };
}

thread_local! {
    /// Whether the command of this thread prints what it does step by step.
    static VERBOSE: Cell<bool> = const { Cell::new(false) };
}

/// Begins a command that prints what it does step by step, or not.
pub fn set_verbose(verbose: bool) {
    VERBOSE.set(verbose);
}

/// Whether the command prints what it does step by step.
pub fn is_verbose() -> bool {
    VERBOSE.get()
}

/// Begins a command whose messages have this form.
pub fn set_format(format: LogFormat) {
    FORMAT.set(format);
}

/// Whether messages are JSON.
pub fn is_json() -> bool {
    FORMAT.get() == LogFormat::Json
}

/// What a command line that cannot be understood asks for.
pub fn format_in(args: &[OsString]) -> LogFormat {
    let words: Vec<&str> = args.iter().filter_map(|word| word.to_str()).collect();
    let apart = words.windows(2).any(|pair| pair == ["--log-format", "json"]);
    match apart || words.contains(&"--log-format=json") {
        true => LogFormat::Json,
        false => LogFormat::Text,
    }
}

/// A message as a line, without its end.
pub fn line_of(level: Level, text: &str) -> String {
    match FORMAT.get() {
        LogFormat::Text => printable_text(&format!("{}{text}", level.prefix())).into_owned(),
        LogFormat::Json => json!({ "level": level.name(), "message": text.trim_end() }).to_string(),
    }
}

/// How far a stage of the work is.
#[derive(Debug, Clone, Copy)]
pub struct Stage<'a> {
    /// Its name.
    pub name: &'a str,
    /// How much of it is done.
    pub done: f64,
    /// How much there is to do.
    pub total: f64,
}

/// How far a stage is as a line, without its end; `more` is for JSON alone.
pub fn line_of_stage(stage: Stage<'_>, text: &str, more: Map<String, Value>) -> String {
    if !is_json() {
        return line_of(Level::Info, text);
    }
    let Stage { name, done, total } = stage;
    let mut line = json!({
        "level": "info", "message": text, "stage": name, "done": number(done), "total": number(total)
    });
    if let Value::Object(fields) = &mut line {
        fields.extend(more);
    }
    line.to_string()
}

/// Whole numbers without a point.
fn number(value: f64) -> Value {
    if value.fract() == 0.0 && value.abs() < 1e15 { json!(value as i64) } else { json!(value) }
}

/// The message of the last error in what a command said, in whichever form.
pub fn last_error(said: &str) -> Option<String> {
    let of_json = |line: &str| {
        let value: Value = serde_json::from_str(line).ok()?;
        let is_error = value["level"] == Level::Error.name();
        value["message"].as_str().filter(|_| is_error).map(str::to_owned)
    };
    said.lines().rev().find_map(of_json).or_else(|| {
        let prefix = Level::Error.prefix();
        said.rfind(prefix).map(|at| said[at + prefix.len()..].trim().to_owned())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_error_is_found_in_both_forms() {
        let text = "reading\nerror: a.ply: no file\n";
        assert_eq!(last_error(text).as_deref(), Some("a.ply: no file"));
        set_format(LogFormat::Json);
        let lines = [line_of(Level::Info, "error: none"), line_of(Level::Error, "a\n\"b\"")];
        set_format(LogFormat::Text);
        assert_eq!(lines[1], r#"{"level":"error","message":"a\n\"b\""}"#);
        assert_eq!(last_error(&lines.join("\n")).as_deref(), Some("a\n\"b\""));
        assert_eq!(last_error("all well"), None);
    }

    #[test]
    fn the_form_is_known_before_the_command_line_is() {
        let form = |line: &str| format_in(&line.split(' ').map(OsString::from).collect::<Vec<_>>());
        assert_eq!(form("scenesplat segmnt --log-format json"), LogFormat::Json);
        assert_eq!(form("scenesplat --log-format=json segmnt"), LogFormat::Json);
        assert_eq!(form("scenesplat segmnt --log-format text"), LogFormat::Text);
    }
}
