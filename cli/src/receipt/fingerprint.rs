//! Checksums of files and folders.

use super::error::ReceiptError;
use scenesplat::scene::input_file::open_regular_file;
use sha2::{Digest, Sha256};
use std::io::Read;
use std::path::{Path, PathBuf};

/// SHA-256 in hexadecimal and size of a file, or of all files of a folder.
///
/// Files are read in pieces, so size does not matter.
///
/// # Errors
/// If something cannot be read.
pub fn sha256_of(path: &Path) -> Result<(String, u64), ReceiptError> {
    let mut hasher = Sha256::new();
    let mut bytes = 0;
    if path.is_dir() {
        let mut files = Vec::new();
        collect_files(path, &mut files)?;
        let mut lines = Vec::with_capacity(files.len());
        for file in files {
            let (hash, size) = sha256_of(&file)?;
            let relative = file.strip_prefix(path).unwrap_or(&file);
            // One spelling on all systems.
            let parts: Vec<_> = relative.iter().map(|p| p.to_string_lossy()).collect();
            lines.push(format!("{}\0{hash}\n", parts.join("/")));
            bytes += size;
        }
        lines.sort_unstable();
        for line in lines {
            hasher.update(line.as_bytes());
        }
    } else {
        let io = |source| ReceiptError::Io {
            path: path.to_owned(),
            action: "cannot read the file for its fingerprint",
            source,
        };
        // A pipe would be waited for.
        let mut file = open_regular_file(path)?;
        let mut piece = vec![0; 1 << 20];
        loop {
            match file.read(&mut piece) {
                Ok(0) => break,
                Ok(read) => {
                    hasher.update(&piece[..read]);
                    bytes += read as u64;
                }
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
                Err(error) => return Err(io(error)),
            }
        }
    }
    let hash = hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect();
    Ok((hash, bytes))
}

fn collect_files(folder: &Path, files: &mut Vec<PathBuf>) -> Result<(), ReceiptError> {
    let io = |source| ReceiptError::Io {
        path: folder.to_owned(),
        action: "cannot list the folder for its fingerprint",
        source,
    };
    for entry in std::fs::read_dir(folder).map_err(io)? {
        let entry = entry.map_err(io)?;
        // Links are not followed into folders: they may lead round in a circle.
        if entry.file_type().map_err(io)?.is_dir() {
            collect_files(&entry.path(), files)?;
        } else if entry.path().is_file() {
            files.push(entry.path());
        }
    }
    Ok(())
}
