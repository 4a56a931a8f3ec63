//! What a routine leaves behind: a rig file, JSON, a page to read.

use std::{
    fs,
    io::{self, Write},
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
};

use mirrorball_calib::{
    report::Report,
    rig::{RigDraft, RigError},
};
use serde::Serialize;

use super::explain::Explain;

/// Links that are followed from one to the next, as many as the kernel follows.
const MAX_LINKS: usize = 40;

/// Where the results go.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct OutputArgs {
    /// Rig file that the result is written into. What was there stays, and the old file is kept as `FILE.old`.
    #[arg(long, value_name = "FILE")]
    pub(crate) out: Option<PathBuf>,
    /// File for the numbers.
    #[arg(long, value_name = "FILE")]
    pub(crate) json: Option<PathBuf>,
    /// File for a page with plots.
    #[arg(long, value_name = "FILE.html")]
    pub(crate) report: Option<PathBuf>,
}

/// Why results cannot be written.
#[derive(Debug, thiserror::Error)]
pub(crate) enum OutputError {
    #[error("cannot read rig file `{}`", file.display())]
    Read {
        file: PathBuf,
        #[source]
        source: io::Error,
    },
    #[error("the rig file `{}` cannot take the result", file.display())]
    Rig {
        file: PathBuf,
        #[source]
        source: Box<RigError>,
    },
    #[error("`{}` is given for two results", file.display())]
    Clash { file: PathBuf },
    #[error("cannot write `{}`", file.display())]
    Write {
        file: PathBuf,
        #[source]
        source: io::Error,
    },
}

impl Explain for OutputError {
    fn is_bad_input(&self) -> bool {
        match self {
            Self::Rig { .. } | Self::Clash { .. } => true,
            Self::Read { .. } | Self::Write { .. } => false,
        }
    }

    fn hint(&self) -> Option<&str> {
        match self {
            Self::Rig { source, .. } => source.hint().or(Some("mend it, or name a new file with `--out`")),
            Self::Clash { .. } => Some("give each result a file of its own"),
            Self::Read { source, .. } | Self::Write { source, .. } => remedy(source.kind()),
        }
    }
}

/// What to do about a file that cannot be read or written.
fn remedy(kind: io::ErrorKind) -> Option<&'static str> {
    match kind {
        io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem => {
            Some("name a file in a folder that you may write to")
        }
        io::ErrorKind::NotFound | io::ErrorKind::NotADirectory => Some("make the folder first, or name another one"),
        io::ErrorKind::IsADirectory => Some("that is a folder: name a file in it"),
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => Some("make room on the disk"),
        io::ErrorKind::InvalidData => Some("the file is no text: name another one"),
        _ => None,
    }
}

/// The rig file that a routine adds to: the one that is there, or an empty one.
pub(crate) fn draft(file: &Path) -> Result<RigDraft, OutputError> {
    let text = match fs::read_to_string(file) {
        Ok(text) => text,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(RigDraft::new()),
        Err(source) => {
            return Err(OutputError::Read {
                file: file.to_owned(),
                source,
            });
        }
    };
    RigDraft::from_toml(&text, file).map_err(|source| OutputError::Rig {
        file: file.to_owned(),
        source: Box::new(source),
    })
}

impl OutputArgs {
    /// Finds out before a long measurement whether its results can be written: every folder takes a file, and no file is
    /// named twice.
    pub(crate) fn check(&self) -> Result<(), OutputError> {
        let files: Vec<&PathBuf> = [&self.out, &self.json, &self.report].into_iter().flatten().collect();
        for (index, file) in files.iter().enumerate() {
            if files[..index].contains(file) {
                return Err(OutputError::Clash {
                    file: file.to_path_buf(),
                });
            }
            let place = Place::of(file).map_err(|source| write_error(file, source))?;
            if let Place::File(target) = place {
                new_beside(&target).map_err(|source| write_error(file, source))?;
            }
        }
        Ok(())
    }

    /// Writes the rig file: whole or not at all, and the old one is kept.
    pub(crate) fn write_rig(&self, draft: &RigDraft) -> Result<(), OutputError> {
        let Some(file) = &self.out else { return Ok(()) };
        draft.parts(file).map_err(|source| OutputError::Rig {
            file: file.clone(),
            source: Box::new(source),
        })?;
        if file.exists() {
            let mut old = file.clone().into_os_string();
            old.push(".old");
            let old = PathBuf::from(old);
            let copy = || -> io::Result<()> { replace(&old, &fs::read(file)?) };
            copy().map_err(|source| write_error(&old, source))?;
        }
        replace(file, draft.to_toml().as_bytes()).map_err(|source| write_error(file, source))
    }

    /// Writes the numbers.
    pub(crate) fn write_json(&self, numbers: &impl Serialize) -> Result<(), OutputError> {
        let Some(file) = &self.json else { return Ok(()) };
        let write = || -> io::Result<()> {
            let mut text = serde_json::to_vec_pretty(numbers)?;
            text.push(b'\n');
            replace(file, &text)
        };
        write().map_err(|source| write_error(file, source))
    }

    /// Writes the page.
    pub(crate) fn write_report(&self, report: impl FnOnce() -> Report) -> Result<(), OutputError> {
        let Some(file) = &self.report else { return Ok(()) };
        replace(file, report().to_html().as_bytes()).map_err(|source| write_error(file, source))
    }
}

/// Writes a file: whole or not at all.
pub(crate) fn write_file(file: &Path, bytes: &[u8]) -> Result<(), OutputError> {
    replace(file, bytes).map_err(|source| write_error(file, source))
}

/// What a path leads to.
enum Place {
    /// A file that is there or will be; where the path is a link, the file behind it.
    File(PathBuf),
    /// Something that cannot be replaced, such as `/dev/stdout`: it takes bytes.
    Stream,
}

impl Place {
    fn of(file: &Path) -> io::Result<Self> {
        // A link to nowhere is followed too.
        let mut target = file.to_owned();
        for _ in 0..MAX_LINKS {
            let Ok(link) = fs::read_link(&target) else { break };
            target = target.parent().unwrap_or(Path::new("")).join(link);
        }
        match fs::metadata(file) {
            Ok(found) if found.is_dir() => Err(io::ErrorKind::IsADirectory.into()),
            Ok(found) if !found.is_file() || file.starts_with("/dev") => Ok(Self::Stream),
            Ok(_) => Ok(Self::File(target)),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Self::File(target)),
            Err(error) => Err(error),
        }
    }
}

/// Puts a file in the place of another in one step, so that a reader, or whoever comes after a power cut, sees the old one or
/// the new one, never a part. A link stays, as do the permissions of a file that is there.
fn replace(file: &Path, bytes: &[u8]) -> io::Result<()> {
    let target = match Place::of(file)? {
        Place::File(target) => target,
        Place::Stream => return fs::OpenOptions::new().append(true).open(file)?.write_all(bytes),
    };
    let mut new = new_beside(&target)?;
    if let Ok(old) = fs::metadata(&target) {
        new.as_file().set_permissions(old.permissions())?;
    }
    new.write_all(bytes)?;
    new.as_file().sync_all()?;
    new.persist(&target).map_err(|error| error.error)?;
    // The new name is on the disk when its folder is; some file systems cannot be asked to see to it.
    let _ = fs::File::open(folder_of(&target)).and_then(|folder| folder.sync_all());
    Ok(())
}

/// A file without a lasting name in the folder of this one, readable for whom the user's mask lets read.
fn new_beside(target: &Path) -> io::Result<tempfile::NamedTempFile> {
    tempfile::Builder::new()
        .prefix(".mirrorball-")
        .permissions(fs::Permissions::from_mode(0o666))
        .tempfile_in(folder_of(target))
        .map_err(|error| io::Error::new(error.kind(), error))
}

fn folder_of(file: &Path) -> &Path {
    let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty());
    folder.unwrap_or(Path::new("."))
}

fn write_error(file: &Path, source: io::Error) -> OutputError {
    OutputError::Write {
        file: file.to_owned(),
        source,
    }
}

#[cfg(test)]
mod tests {
    use mirrorball_calib::rig::Role;

    use super::*;

    fn args(out: &Path) -> OutputArgs {
        OutputArgs {
            out: Some(out.to_owned()),
            json: None,
            report: None,
        }
    }

    /// A draft with one camera more.
    fn added(file: &Path, name: &str) -> RigDraft {
        let mut draft = draft(file).unwrap();
        draft.set_camera(name, Role::Ball, [640, 480]);
        draft
    }

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap();
        let mut names: Vec<String> = entries
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn the_old_file_is_kept_and_so_are_comments_and_permissions() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("rig.toml");
        args(&file).write_rig(&added(&file, "first")).unwrap();
        assert_eq!(names(folder.path()), ["rig.toml"]);
        let first = format!("# ours\n{}", fs::read_to_string(&file).unwrap());
        fs::write(&file, &first).unwrap();
        fs::set_permissions(&file, fs::Permissions::from_mode(0o640)).unwrap();
        args(&file).write_rig(&added(&file, "second")).unwrap();
        assert_eq!(names(folder.path()), ["rig.toml", "rig.toml.old"]);
        assert_eq!(fs::read_to_string(folder.path().join("rig.toml.old")).unwrap(), first);
        let second = fs::read_to_string(&file).unwrap();
        assert!(second.starts_with("# ours") && second.contains("first") && second.contains("second"));
        assert_eq!(fs::metadata(&file).unwrap().permissions().mode() & 0o777, 0o640);
    }

    #[test]
    fn a_link_stays_a_link() {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("real")).unwrap();
        let (link, file) = (folder.path().join("rig.toml"), folder.path().join("real/lab.toml"));
        std::os::unix::fs::symlink("real/lab.toml", &link).unwrap();
        // First to nowhere, then to a file.
        for name in ["first", "second"] {
            args(&link).write_rig(&added(&link, name)).unwrap();
            assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
            assert!(fs::read_to_string(&file).unwrap().contains(name));
        }
        assert!(
            fs::read_to_string(folder.path().join("rig.toml.old"))
                .unwrap()
                .contains("first")
        );
    }

    #[test]
    fn a_file_of_a_newer_version_is_left_as_it_is() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("rig.toml");
        for (text, remedy) in [
            ("version = 2\n", "take the program that wrote the file, or a newer one"),
            ("version = 1\nfocus = 3\n", "`configs/README.md` lists every key"),
            (
                "version = 1\n[[camera]]\nname = \"a\"\nrole = \"ball\"\nsize_px = [0, 1]\n",
                "mend it",
            ),
        ] {
            fs::write(&file, text).unwrap();
            let error = draft(&file).unwrap_err();
            assert!(error.is_bad_input(), "{error:?}");
            assert!(error.hint().unwrap().contains(remedy), "{:?}", error.hint());
            assert!(error.to_string().contains("rig.toml"));
            assert_eq!(fs::read_to_string(&file).unwrap(), text);
            assert_eq!(names(folder.path()), ["rig.toml"]);
        }
    }

    #[test]
    fn a_draft_that_is_no_rig_changes_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("rig.toml");
        args(&file).write_rig(&added(&file, "first")).unwrap();
        let before = fs::read_to_string(&file).unwrap();
        let error = args(&file).write_rig(&added(&file, "no/name")).unwrap_err();
        assert!(matches!(error, OutputError::Rig { .. }), "{error:?}");
        assert_eq!(fs::read_to_string(&file).unwrap(), before);
        assert_eq!(names(folder.path()), ["rig.toml"]);
    }

    #[test]
    fn what_cannot_be_written_is_named_before_and_after() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        fs::write(&file, "text").unwrap();
        for (place, remedy) in [
            (folder.path().join("none/rig.toml"), "make the folder first"),
            (file.join("rig.toml"), "make the folder first"),
            (folder.path().to_owned(), "that is a folder"),
        ] {
            let mut filled = RigDraft::new();
            filled.set_camera("a", Role::Ball, [640, 480]);
            for error in [
                args(&place).check().unwrap_err(),
                args(&place).write_rig(&filled).unwrap_err(),
            ] {
                assert!(error.to_string().contains(&place.display().to_string()), "{error}");
                assert!(error.hint().unwrap().contains(remedy), "{:?}", error.hint());
            }
        }
        assert_eq!(names(folder.path()), ["file"]);
    }

    #[test]
    fn a_folder_that_may_not_be_written_to_keeps_its_rig() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("rig.toml");
        args(&file).write_rig(&added(&file, "first")).unwrap();
        let before = fs::read_to_string(&file).unwrap();
        let lock = |mode| fs::set_permissions(folder.path(), fs::Permissions::from_mode(mode)).unwrap();
        lock(0o555);
        let result = args(&file).check();
        let written = args(&file).write_rig(&added(&file, "second"));
        lock(0o755);
        if result.is_ok() {
            // The administrator may write everywhere.
            assert!(written.is_ok());
            println!("SKIPPED: no folder is read-only to this user");
            return;
        }
        for error in [result.unwrap_err(), written.unwrap_err()] {
            assert_eq!(error.hint(), Some("name a file in a folder that you may write to"));
        }
        assert_eq!(fs::read_to_string(&file).unwrap(), before);
        assert_eq!(names(folder.path()), ["rig.toml"]);
    }

    #[test]
    fn a_full_disk_is_named_and_devices_stay_what_they_are() {
        let mut outputs = args(Path::new("/dev/null"));
        outputs.json = Some("/dev/full".into());
        outputs.check().unwrap();
        let error = outputs.write_json(&[1, 2]).unwrap_err();
        assert_eq!(error.to_string(), "cannot write `/dev/full`");
        assert_eq!(error.hint(), Some("make room on the disk"));
        assert!(!fs::metadata("/dev/full").unwrap().is_file());
        outputs.json = Some("/dev/null".into());
        let error = outputs.check().unwrap_err();
        assert!(matches!(error, OutputError::Clash { .. }) && error.is_bad_input());
    }

    #[test]
    fn whoever_reads_meanwhile_sees_a_whole_file() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("numbers");
        let (a, b) = (vec![b'a'; 300_000], vec![b'b'; 200_000]);
        replace(&file, &a).unwrap();
        std::thread::scope(|scope| {
            let writer = scope.spawn(|| {
                for _ in 0..20 {
                    replace(&file, &b).unwrap();
                    replace(&file, &a).unwrap();
                }
            });
            while !writer.is_finished() {
                let seen = fs::read(&file).unwrap();
                assert!(seen == a || seen == b, "{} bytes", seen.len());
            }
        });
        assert_eq!(names(folder.path()), ["numbers"]);
    }
}
