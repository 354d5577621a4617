//! Writes the results of a command.

use super::Session;
use crate::flags::PreviewArgs;
use crate::log;
use crate::receipt::{ReceiptReport, WrittenFile};
use crate::terminal::{check_warnings, print, write_text};
use anyhow::{Context, Result};
use scenesplat::memory::Bytes;
use scenesplat::outputs::{OpenedScene, write_scene_preview};
use scenesplat::preview::LegendEntry;
use scenesplat::scene::formats::npy_writer::{NpyElement, write_npy};
use scenesplat::scene::{GaussianScene, Up, printable};
use std::path::{Path, PathBuf};

/// Files that a command names at its end; of more it says how many.
const MOST_FILES: usize = 8;

impl Session<'_> {
    /// Writes a file of the output folder by `work`, which gets the path; it is put in place when the command is done.
    pub fn write<T, E>(&self, name: &str, work: impl FnOnce(&Path) -> Result<T, E>) -> Result<()>
    where
        anyhow::Error: From<E>,
    {
        let path = self.outputs.path(name)?;
        work(&path)?;
        self.wrote(&path, size(&path)?);
        Ok(())
    }

    /// Writes a text file of the output folder.
    pub fn write_text(&self, name: &str, text: &str) -> Result<()> {
        self.write(name, |path| write_text(path, text))
    }

    /// Writes one value for each row of the scene's file, `fill` for those that were left out.
    pub fn write_rows<T: NpyElement>(
        &self,
        name: &str,
        opened: &OpenedScene,
        values: &[T],
        fill: T,
    ) -> Result<()> {
        let rows = opened.loaded.to_source_rows(values, fill)?;
        self.write(name, |path| write_npy(path, &[rows.len()], &rows))
    }

    /// Writes preview.png: the scene in these colors, seen with `up` up.
    pub fn write_preview(
        &self,
        scene: &GaussianScene,
        colors: &[[u8; 3]],
        legend: &[LegendEntry],
        title: String,
        up: Up,
        preview: PreviewArgs,
    ) -> Result<()> {
        let settings = preview.settings(title, self.doubts(), up);
        self.write("preview.png", |path| {
            write_scene_preview(scene, colors, legend, &settings, path)
        })
    }

    /// Writes a text file outside of the output folder, which was claimed.
    pub fn write_file(&self, path: &Path, text: &str) -> Result<()> {
        self.outputs.file(path, text.as_bytes())?;
        self.wrote(path, text.len() as u64);
        Ok(())
    }

    /// Records a written file.
    pub fn wrote(&self, path: &Path, bytes: u64) {
        self.receipt.add_bytes_written(bytes);
        self.written.borrow_mut().push((self.outputs.shown(path), bytes));
    }

    /// Puts everything in place, the receipt last, and prints it.
    pub fn finish(&self) -> Result<()> {
        self.check_stop()?;
        self.put_in_place()
    }

    /// For a command that goes on until it is stopped: being stopped is its end. Writes a receipt if the user asked
    /// for one.
    pub fn finish_stopped(&self) -> Result<()> {
        if self.shared.receipt.is_some() { self.put_in_place() } else { Ok(()) }
    }

    fn put_in_place(&self) -> Result<()> {
        let written = self.written.borrow();
        let file = |(path, bytes): &(PathBuf, u64)| {
            let path = path.strip_prefix(&self.shared.out).unwrap_or(path);
            let parts: Vec<_> = path.iter().map(|part| part.to_string_lossy()).collect();
            WrittenFile { path: parts.join("/"), bytes: *bytes }
        };
        self.receipt.written(written.iter().map(file).collect());
        for fallback in scenesplat::kernels::fallbacks::take() {
            self.warn(scenesplat::device::on_the_cpu(&fallback));
        }
        check_warnings()?;
        let report = self.receipt.finish();
        let text = report.to_json()?;
        self.outputs.commit(Some((&text, self.shared.receipt.as_deref())))?;
        self.say_written();
        match (self.shared.running.quiet, log::is_verbose()) {
            (true, _) => {}
            (false, true) => print(&report.to_string()),
            (false, false) => print(&self.summary(&report)),
        }
        Ok(())
    }

    /// Where the files are and what it cost, in two lines.
    fn summary(&self, report: &ReceiptReport) -> String {
        let out = &self.shared.out;
        let written = self.written.borrow();
        let (inside, outside): (Vec<_>, Vec<_>) =
            written.iter().map(|(path, _)| path).partition(|path| path.starts_with(out));
        let mut places = Vec::new();
        if !inside.is_empty() {
            let names = inside.iter().filter_map(|path| path.strip_prefix(out).ok()).map(printable);
            let more = inside.len().saturating_sub(MOST_FILES);
            let mut names: Vec<_> = names.take(MOST_FILES).collect();
            names.push("receipt.json".into());
            if more > 0 {
                names.push(format!("{more} more").into());
            }
            places.push(format!("in {}: {}", printable(out), names.join(", ")));
        }
        let receipt = self.shared.receipt.iter();
        places.extend(outside.into_iter().chain(receipt).map(|path| printable(path).into_owned()));
        format!("{}\n{}; --verbose says more", places.join("; "), report.cost())
    }

    /// Puts everything in place, without a receipt unless the user asked for one.
    pub fn finish_quietly(&self) -> Result<()> {
        if self.shared.receipt.is_some() {
            return self.finish();
        }
        self.check_stop()?;
        check_warnings()?;
        self.outputs.commit(None)?;
        self.say_written();
        Ok(())
    }

    fn say_written(&self) {
        for (path, bytes) in self.written.borrow().iter() {
            self.progress.detail(format!("wrote {} ({})", printable(path), Bytes(*bytes)));
        }
    }
}

fn size(path: &Path) -> Result<u64> {
    Ok(std::fs::metadata(path).with_context(|| path.display().to_string())?.len())
}
