//! A text, and the texts that it competes with.

use scenesplat_rooms::Vocabulary;
use scenesplat_rooms::vocabulary::VocabularyError;
use scenesplat_scene::label_set::find_name;
use scenesplat_scene::{SceneError, TextTable};

/// What is looked for: texts that mean it, and texts that it has to beat.
#[derive(Debug, Clone, PartialEq)]
pub struct Query {
    /// The text as it was asked for.
    pub text: String,
    /// What means it; the best of them counts. A group ("seat") is meant by its members too
    /// ("chair", "sofa"). At least one row.
    pub meant: TextTable,
    /// What else a Gaussian may be; may be without any row.
    pub rivals: TextTable,
}

impl Query {
    /// A row of a table; the other rows are its rivals. `None` if the table has no such name.
    ///
    /// # Errors
    /// If the row has no direction.
    pub fn of_table(table: &TextTable, text: &str) -> Result<Option<Self>, SceneError> {
        let Ok(row) = find_name(&table.names, text) else { return Ok(None) };
        let vector = table.row(row).unwrap_or_default().to_vec();
        Self::of_vector(text, vector, Some(table)).map(Some)
    }

    /// Some rows of a table, by number; all its other rows are their rivals: what is nearest to one of these.
    ///
    /// # Errors
    /// If none of the rows is in the table.
    pub fn of_rows(table: &TextTable, text: &str, rows: &[usize]) -> Result<Self, SceneError> {
        let part = |is_meant: bool| {
            let mut part = TextTable { names: Vec::new(), dim: table.dim, values: Vec::new() };
            for row in (0..table.len()).filter(|row| rows.contains(row) == is_meant) {
                part.names.push(table.names[row].clone());
                part.values.extend_from_slice(table.row(row).unwrap_or_default());
            }
            part
        };
        let (meant, rivals) = (part(true), part(false));
        let meant = TextTable::from_rows(meant.names, meant.values, meant.dim)?;
        Ok(Self { text: text.to_owned(), meant, rivals })
    }

    /// Any vector; the rows of `rivals` but one of the same name are its rivals.
    ///
    /// # Errors
    /// If the vector has no direction, or its width is not that of the rivals.
    pub fn of_vector(
        text: &str,
        vector: Vec<f32>,
        rivals: Option<&TextTable>,
    ) -> Result<Self, SceneError> {
        let width = vector.len();
        let meant = TextTable::from_rows(vec![text.to_owned()], vector, width)?;
        let mut others = TextTable { names: Vec::new(), values: Vec::new(), dim: width };
        if let Some(table) = rivals {
            others.dim = table.dim;
            // A row of the same name would be its own rival.
            let own = find_name(&table.names, text).ok();
            for (row, name) in table.names.iter().enumerate().filter(|(row, _)| Some(*row) != own) {
                others.names.push(name.clone());
                others.values.extend_from_slice(table.row(row).unwrap_or_default());
            }
        }
        Ok(Self { text: text.to_owned(), meant, rivals: others })
    }

    /// The words of the network inside the program.
    ///
    /// # Errors
    /// If the vocabulary does not know a word.
    pub fn of_vocabulary(vocabulary: &Vocabulary, text: &str) -> Result<Self, VocabularyError> {
        let mut meant = vocabulary.members(text)?;
        meant.names.insert(0, text.to_owned());
        meant.values.splice(0..0, vocabulary.embed(text)?);
        Ok(Self { text: text.to_owned(), meant, rivals: vocabulary.rivals(text)? })
    }

    /// Values of a text row.
    pub fn width(&self) -> usize {
        self.meant.dim
    }
}
