//! Where the bytes of a document become files.

use std::path::{Path, PathBuf};

/// A folder for the files of one kind, in `TMPDIR`, else in memory where the system has such a place. The
/// files of one case after the other have the same names, so that nothing piles up.
pub struct Place {
    root: PathBuf,
}

impl Place {
    /// An empty folder of this name for this process.
    ///
    /// # Panics
    /// Where the system makes none.
    pub fn new(name: &str) -> Self {
        let memory = Path::new("/dev/shm");
        let chosen = std::env::var_os("TMPDIR").is_some() || !memory.is_dir();
        let base = if chosen { std::env::temp_dir() } else { memory.to_path_buf() };
        let root = base.join(format!("scanweave-{}-{name}", std::process::id()));
        std::fs::remove_dir_all(&root).ok();
        std::fs::create_dir_all(&root).unwrap_or_else(|e| panic!("{}: {e}", root.display()));
        Self { root }
    }

    /// The folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The path of a name in it.
    pub fn path(&self, name: &str) -> PathBuf {
        self.root.join(name)
    }

    /// Writes a file, which may lie in a folder of its own.
    ///
    /// # Panics
    /// Where the system refuses.
    pub fn put(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.path(name);
        let write = || std::fs::write(&path, bytes);
        let folder = path.parent().unwrap_or(&self.root);
        let written = write().or_else(|_| std::fs::create_dir_all(folder).and_then(|()| write()));
        written.unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        path
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        std::fs::remove_dir_all(&self.root).ok();
    }
}
