//! An output folder belongs to one run at a time.
//!
//! A run locks [`LOCK_FILE`] in its folder. The kernel releases the lock when the process ends in
//! whatever way, so that a lock file that a killed run left behind stops nobody.

use crate::atomic::{TEMPORARY, sync_folder, temporary_prefix};
use crate::error::{Error, Result};
use crate::files;
use crate::owner::{self, Owner};
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, Read, Seek, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// The locked file, hidden, so that it is never taken for a scan.
pub const LOCK_FILE: &str = ".scanweave.lock";

/// How often the lock may go away just as it is taken before that is an error.
const ATTEMPTS: usize = 100;

/// A folder that no other run may write into while this value lives. The end of it removes the lock, and
/// the folders that [`take`](Self::take) made, if nothing was written into them.
///
/// The library's own functions take no lock: a program that writes into one folder from several threads
/// sees to that itself.
#[derive(Debug)]
pub struct FolderLock {
    folder: PathBuf,
    file: Option<File>,
    shared: bool,
    /// Folders that did not exist before, the deepest first.
    made: Vec<PathBuf>,
}

impl FolderLock {
    /// Makes the folder where it does not exist, locks it, and removes the temporary files that killed
    /// runs left in it and in the folders in it.
    ///
    /// Where the file system has no locks, that is logged, and only a run on the same machine is noticed.
    ///
    /// # Errors
    /// [`Error::OutputInUse`] when another run has the folder; [`Error::Write`] when it cannot be made or
    /// written into.
    pub fn take(folder: &Path) -> Result<Self> {
        Self::lock(folder, false)
    }

    /// [`take`](Self::take) for runs that may write into one folder at the same time, but not beside one
    /// that took it for itself.
    ///
    /// # Errors
    /// As [`take`](Self::take).
    pub fn take_shared(folder: &Path) -> Result<Self> {
        Self::lock(folder, true)
    }

    fn lock(folder: &Path, shared: bool) -> Result<Self> {
        let missing = folder.ancestors().take_while(|f| !f.as_os_str().is_empty() && !f.exists());
        let made = missing.map(Path::to_path_buf).collect();
        let mut lock = Self { folder: folder.to_path_buf(), file: None, shared, made };
        for _ in 0..ATTEMPTS {
            fs::create_dir_all(folder).map_err(|e| Error::write(folder, e))?;
            let Some(mut file) = lock.attempt()? else { continue };
            let stated = state(&mut file);
            // Held from here on, so that it goes when it cannot say whose it is.
            lock.file = Some(file);
            stated.map_err(|e| Error::write(folder.join(LOCK_FILE), e))?;
            sweep(folder);
            return Ok(lock);
        }
        Err(Error::write(folder, io::Error::other("its lock is taken and released again and again")))
    }

    /// The locked file; none where it was removed meanwhile, and the next attempt will find another.
    fn attempt(&self) -> Result<Option<File>> {
        let path = self.folder.join(LOCK_FILE);
        let refused = |e| Error::write(&path, e);
        if fs::symlink_metadata(&path).is_ok_and(|m| !m.is_file()) {
            // A link would have another file written over.
            return Err(refused(io::Error::other("there is something of that name that is no file")));
        }
        let file = match OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&path) {
            Ok(file) => file,
            Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(e) if e.kind() == io::ErrorKind::PermissionDenied && path.exists() => {
                return self.remove_if_stale(&path).map(|()| None);
            }
            Err(e) => return Err(Error::write(&self.folder, e)),
        };
        let locked = if self.shared { file.try_lock_shared() } else { file.try_lock() };
        match locked {
            Ok(()) if !is_at(&file, &path) => return Ok(None),
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(self.in_use(&path)),
            Err(TryLockError::Error(reason)) => {
                if stated(&path).and_then(|s| s.owner).is_some_and(|o| o.is_another_alive()) {
                    return Err(self.in_use(&path));
                }
                let folder = self.folder.display();
                tracing::warn!("{folder}: cannot be locked ({reason}): start no other run into it");
            }
        }
        Ok(Some(file))
    }

    /// The lock of another user, which this one may not write: a killed run's is removed.
    fn remove_if_stale(&self, path: &Path) -> Result<()> {
        let refused = |e| Error::write(path, e);
        let file = files::open(path)?;
        match file.try_lock() {
            Ok(()) if is_at(&file, path) => fs::remove_file(path).map_err(refused),
            Ok(()) => Ok(()),
            Err(TryLockError::WouldBlock) => Err(self.in_use(path)),
            Err(TryLockError::Error(e)) => Err(refused(e)),
        }
    }

    fn in_use(&self, lock: &Path) -> Error {
        // An owner that has just taken it writes in a moment who it is.
        let wait = || std::thread::sleep(Duration::from_millis(10));
        let owner = (0..20).find_map(|_| {
            stated(lock).or_else(|| {
                wait();
                None
            })
        });
        let owner = owner.map_or_else(|| "another process".to_owned(), |s| s.to_string());
        Error::OutputInUse { path: self.folder.clone(), owner }
    }
}

/// A result that grows in a hidden folder of its own until it is whole, and then takes the place of the one
/// that is there. The end of it removes what was not published.
#[derive(Debug)]
pub struct Staging {
    folder: PathBuf,
    beside: tempfile::TempDir,
}

impl FolderLock {
    /// Begins a result for the folder.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn stage(&self) -> Result<Staging> {
        let mut builder = tempfile::Builder::new();
        let prefix = temporary_prefix();
        let beside = builder.prefix(&prefix).tempdir_in(&self.folder);
        let beside = beside.map_err(|e| Error::write(&self.folder, e))?;
        Ok(Staging { folder: self.folder.clone(), beside })
    }
}

impl Staging {
    /// Where the files are written.
    pub fn path(&self) -> &Path {
        self.beside.path()
    }

    /// An error of writing into [`path`](Self::path), told of the place that the file is meant for.
    pub fn meant(&self, error: Error) -> Error {
        match error {
            Error::Write { path, source } => match path.strip_prefix(self.path()) {
                Ok(name) => Error::Write { path: self.folder.join(name), source },
                Err(_) => Error::Write { path, source },
            },
            other => other,
        }
    }

    /// Moves the files to their places: `remove_old` first removes what is not written over, then come the
    /// new files, and the one called `last` after all others.
    ///
    /// # Errors
    /// [`Error::Write`]: where a folder is in the way, before anything is removed; else those of `remove_old`
    /// and of the system.
    pub fn publish(self, last: &str, remove_old: impl FnOnce() -> Result<()>) -> Result<()> {
        let failed = |e| Error::write(&self.folder, e);
        let mut names = Vec::new();
        for entry in fs::read_dir(self.path()).map_err(failed)? {
            names.push(entry.map_err(failed)?.file_name());
        }
        names.sort_by_key(|name| (name == last, name.clone()));
        if let Some(place) = names.iter().map(|name| self.folder.join(name)).find(|place| place.is_dir()) {
            let reason = io::Error::new(io::ErrorKind::IsADirectory, "there is a folder of that name");
            return Err(Error::write(place, reason));
        }
        remove_old()?;
        for name in names {
            let place = self.folder.join(&name);
            fs::rename(self.path().join(&name), &place).map_err(|e| Error::write(place, e))?;
        }
        sync_folder(&self.folder);
        Ok(())
    }
}

impl Drop for FolderLock {
    fn drop(&mut self) {
        if let Some(file) = &self.file {
            // Removed while it is locked: who opened it before that finds another one, or none, in its
            // place. Of several that share it, the last removes it.
            if !self.shared || file.try_lock().is_ok() {
                let path = self.folder.join(LOCK_FILE);
                if is_at(file, &path) {
                    fs::remove_file(&path).ok();
                }
            }
        }
        self.file = None;
        // Only an empty folder can be removed.
        for folder in &self.made {
            fs::remove_dir(folder).ok();
        }
    }
}

/// Whether two paths lead to the same file or folder; `false` where one of them does not exist.
pub fn is_same_place(a: &Path, b: &Path) -> bool {
    matches!((fs::canonicalize(a), fs::canonicalize(b)), (Ok(a), Ok(b)) if a == b)
}

/// Whether a file lies in a folder, or in one of those in it; `false` where one of them does not exist.
pub fn is_within(file: &Path, folder: &Path) -> bool {
    matches!((fs::canonicalize(file), fs::canonicalize(folder)), (Ok(a), Ok(b)) if a.starts_with(&b))
}

/// Whether an open file is the one that stands at `path`.
fn is_at(file: &File, path: &Path) -> bool {
    let (Ok(open), Ok(there)) = (file.metadata(), fs::symlink_metadata(path)) else { return false };
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        (open.dev(), open.ino()) == (there.dev(), there.ino())
    }
    #[cfg(not(unix))]
    {
        open.is_file() && there.is_file()
    }
}

/// Who holds a lock, as the file states it.
struct Stated {
    pid: u32,
    host: String,
    started_s: u64,
    owner: Option<Owner>,
}

/// Writes who holds the lock.
fn state(file: &mut File) -> io::Result<()> {
    let owner = Owner::current();
    let started = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or(Duration::ZERO).as_secs();
    let text =
        format!("process {}\nhost {}\nstarted {started}\nowner {}\n", owner.pid, owner::host(), owner.tag());
    file.set_len(0)?;
    file.rewind()?;
    file.write_all(text.as_bytes())
}

/// What [`state`] wrote; none where that is not there yet.
fn stated(path: &Path) -> Option<Stated> {
    const MOST_BYTES: u64 = 4096;
    let mut bytes = Vec::new();
    files::open(path).ok()?.take(MOST_BYTES).read_to_end(&mut bytes).ok()?;
    let text = String::from_utf8_lossy(&bytes);
    let value = |key: &str| text.lines().find_map(|l| l.strip_prefix(key)?.strip_prefix(' '));
    Some(Stated {
        pid: value("process")?.parse().ok()?,
        host: value("host")?.replace(char::is_control, "\u{fffd}"),
        started_s: value("started")?.parse().ok()?,
        owner: Owner::parse(value("owner")?),
    })
}

impl std::fmt::Display for Stated {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let started = UNIX_EPOCH.checked_add(Duration::from_secs(self.started_s));
        let ago =
            started.and_then(|s| SystemTime::now().duration_since(s).ok()).unwrap_or_default().as_secs();
        let ago = match ago {
            s if s < 120 => format!("{s} s"),
            s if s < 7200 => format!("{} min", s / 60),
            s => format!("{} h", s / 3600),
        };
        write!(f, "process {} on {}, started {ago} ago", self.pid, self.host)
    }
}

/// Removes the temporary files of dead processes in a folder and in the folders in it.
fn sweep(folder: &Path) {
    let removed = sweep_below(folder, DEEPEST);
    if removed > 0 {
        tracing::info!("{}: removed {removed} temporary files of runs that were killed", folder.display());
    }
}

/// Folders in folders that runs write into: the cache, and data sets in it.
const DEEPEST: usize = 2;

fn sweep_below(folder: &Path, deepest: usize) -> usize {
    let mut removed = sweep_one(folder);
    for entry in fs::read_dir(folder).into_iter().flatten().flatten().filter(|_| deepest > 0) {
        // A link leads to a folder that this run may have no business in.
        if entry.file_type().is_ok_and(|t| t.is_dir()) {
            removed += sweep_below(&entry.path(), deepest - 1);
        }
    }
    removed
}

/// Whether nobody writes a temporary file: who does holds its lock, from a moment after it is made on. What is
/// no file stays.
fn is_abandoned(path: &Path) -> bool {
    /// Age from which it would be locked.
    const MOMENT: Duration = Duration::from_secs(60);
    let Ok(file) = files::open(path) else { return false };
    let age = file.metadata().and_then(|m| m.modified()).map(|made| made.elapsed().unwrap_or_default());
    age.is_ok_and(|age| age > MOMENT) && file.try_lock().is_ok()
}

fn sweep_one(folder: &Path) -> usize {
    let mut removed = 0;
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let name = entry.file_name();
        let owner = name.to_str().and_then(|n| n.strip_prefix(TEMPORARY)).and_then(Owner::parse);
        let path = entry.path();
        let is_left = |o: Owner| o.is_dead() || (o.is_known_by_lock() && is_abandoned(&path));
        if !owner.is_some_and(is_left) {
            continue;
        }
        let gone = match entry.file_type() {
            Ok(kind) if kind.is_dir() => fs::remove_dir_all(&path),
            _ => fs::remove_file(&path),
        };
        removed += usize::from(gone.is_ok());
    }
    removed
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Barrier;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> =
            fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_folder_has_one_owner_whom_the_error_names() {
        let place = tempfile::tempdir().unwrap();
        let lock = FolderLock::take(place.path()).unwrap();
        let said = FolderLock::take(place.path()).unwrap_err().to_string();
        for part in
            [&place.path().display().to_string(), &format!("process {}", std::process::id()), "--output"]
        {
            assert!(said.contains(part), "{part}: {said}");
        }
        assert!(matches!(FolderLock::take_shared(place.path()), Err(Error::OutputInUse { .. })));
        drop(lock);
        assert!(names(place.path()).is_empty());
        drop(FolderLock::take(place.path()).unwrap());
    }

    #[test]
    fn those_who_share_keep_others_out_until_the_last_has_gone() {
        let place = tempfile::tempdir().unwrap();
        let one = FolderLock::take_shared(place.path()).unwrap();
        let two = FolderLock::take_shared(place.path()).unwrap();
        assert!(FolderLock::take(place.path()).is_err());
        drop(one);
        assert!(FolderLock::take(place.path()).is_err());
        drop(two);
        assert!(names(place.path()).is_empty());
        FolderLock::take(place.path()).unwrap();
    }

    #[test]
    fn only_folders_that_it_made_and_that_stayed_empty_go_with_the_lock() {
        let place = tempfile::tempdir().unwrap();
        let deep = place.path().join("a/b");
        drop(FolderLock::take(&deep).unwrap());
        assert!(names(place.path()).is_empty());
        fs::create_dir(place.path().join("a")).unwrap();
        drop(FolderLock::take(&deep).unwrap());
        assert_eq!(names(place.path()), ["a"]);
        let lock = FolderLock::take(&deep).unwrap();
        fs::write(deep.join("result"), "").unwrap();
        drop(lock);
        assert_eq!(names(&deep), ["result"]);
    }

    #[test]
    fn a_lock_file_that_nobody_holds_stops_nobody_and_a_link_is_not_followed() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join(LOCK_FILE);
        fs::write(&path, "process 1\nhost x\nstarted 0\nowner 1-1-00000000\n").unwrap();
        drop(FolderLock::take(place.path()).unwrap());
        assert!(!path.exists());
        #[cfg(unix)]
        {
            let other = place.path().join("other");
            fs::write(&other, "kept").unwrap();
            std::os::unix::fs::symlink(&other, &path).unwrap();
            assert!(matches!(FolderLock::take(place.path()), Err(Error::Write { .. })));
            assert_eq!(fs::read(&other).unwrap(), b"kept");
        }
    }

    /// Whoever has the lock is alone, however often it is taken and its file removed meanwhile.
    #[test]
    fn two_never_own_a_folder_at_once() {
        let place = tempfile::tempdir().unwrap();
        let (folder, start) = (place.path().join("out"), Barrier::new(4));
        let inside = place.path().join("inside");
        let work = || {
            start.wait();
            let mut taken = 0;
            for _ in 0..300 {
                let Ok(_lock) = FolderLock::take(&folder) else { continue };
                let alone = OpenOptions::new().write(true).create_new(true).open(&inside);
                assert!(alone.is_ok(), "two owners");
                fs::remove_file(&inside).unwrap();
                taken += 1;
            }
            taken
        };
        let taken: usize = std::thread::scope(|s| {
            let all: Vec<_> = (0..4).map(|_| s.spawn(work)).collect();
            all.into_iter().map(|t| t.join().unwrap()).sum()
        });
        assert!(taken > 0);
        // The folder itself stays where one thread made it and the next was quick to lock it.
        assert!(!folder.exists() || names(&folder).is_empty());
    }

    /// As on a system that does not list processes, where no owner knows when it started.
    #[test]
    fn without_a_list_of_processes_old_files_that_nobody_locks_are_swept() {
        let place = tempfile::tempdir().unwrap();
        let here = Owner::current().tag();
        let machine = here.rsplit('-').next().unwrap();
        let make = |name: &str, age_s: u64| {
            let path = place.path().join(name);
            let file = File::create(&path).unwrap();
            file.set_modified(SystemTime::now() - Duration::from_secs(age_s)).unwrap();
            (path, file)
        };
        let (old, _) = make(&format!("{TEMPORARY}1-0-{machine}-a.part"), 3600);
        let (young, _) = make(&format!("{TEMPORARY}1-0-{machine}-b.part"), 1);
        let (written, writer) = make(&format!("{TEMPORARY}1-0-{machine}-c.part"), 3600);
        writer.lock().unwrap();
        let (elsewhere, _) = make(&format!("{TEMPORARY}1-0-00000000-d.part"), 3600);
        drop(FolderLock::take(place.path()).unwrap());
        assert_eq!([&old, &young, &written, &elsewhere].map(|p| p.exists()), [false, true, true, true]);
        drop(writer);
        drop(FolderLock::take(place.path()).unwrap());
        assert!(!written.exists());
    }

    #[test]
    fn a_staged_result_comes_whole_or_not_at_all() {
        let place = tempfile::tempdir().unwrap();
        let put = |name: &str, text: &str| fs::write(place.path().join(name), text).unwrap();
        let get = |name: &str| fs::read_to_string(place.path().join(name)).ok();
        let lock = FolderLock::take(place.path()).unwrap();
        put("a", "old");
        put("last", "old");
        put("stale", "old");
        let stage = || {
            let staging = lock.stage().unwrap();
            for name in ["a", "b", "last"] {
                fs::write(staging.path().join(name), "new").unwrap();
            }
            staging
        };
        let old = || assert_eq!(["a", "last", "stale"].map(|n| get(n).unwrap()), ["old"; 3]);
        drop(stage());
        old();
        fs::create_dir(place.path().join("b")).unwrap();
        let refused =
            stage().publish("last", || panic!("removed before it is known whether the rest can come"));
        assert!(matches!(refused, Err(Error::Write { path, .. }) if path == place.path().join("b")));
        old();
        fs::remove_dir(place.path().join("b")).unwrap();
        let remove = || {
            assert_eq!(get("a").as_deref(), Some("old"));
            fs::remove_file(place.path().join("stale")).map_err(|e| Error::write("stale", e))
        };
        stage().publish("last", remove).unwrap();
        assert_eq!(names(place.path()), [LOCK_FILE, "a", "b", "last"]);
        assert_eq!(["a", "b", "last"].map(|n| get(n).unwrap()), ["new"; 3]);
        let staging = stage();
        let error = Error::write(staging.path().join("x"), io::Error::other("full"));
        assert!(matches!(staging.meant(error), Error::Write { path, .. } if path == place.path().join("x")));
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn temporary_files_of_dead_processes_are_swept_and_no_others() {
        let place = tempfile::tempdir().unwrap();
        let here = Owner::current().tag();
        let machine = here.rsplit('-').next().unwrap();
        // No process has the number 2³², less one; the first of any machine started before tick 2⁶⁰.
        let dead = format!("4294967295-7-{machine}");
        let reused = format!("{}-{}-{machine}", std::process::id(), 1u64 << 60);
        for folder in ["", "cache", "cache/synth-1"] {
            let folder = place.path().join(folder);
            fs::create_dir_all(&folder).unwrap();
            for owner in [&dead, &reused, &here, "4294967295-7-00000000", "abc"] {
                fs::write(folder.join(format!(".scanweave-{owner}-x.part")), "").unwrap();
            }
            fs::create_dir_all(folder.join(format!(".scanweave-{dead}-y/PointCloud"))).unwrap();
        }
        drop(FolderLock::take(place.path()).unwrap());
        let mut left = [
            format!(".scanweave-{here}-x.part"),
            ".scanweave-4294967295-7-00000000-x.part".to_owned(),
            ".scanweave-abc-x.part".to_owned(),
        ];
        left.sort();
        assert_eq!(names(&place.path().join("cache/synth-1")), left);
        assert_eq!(names(&place.path().join("cache")).len(), 4);
        assert_eq!(names(place.path()).len(), 4);
    }
}
