//! Files that are attached to a record, in a temporary folder while the record is replayed.

use std::fs::Permissions;
use std::io;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use murmurate_record::reader::Opened;
use murmurate_record::share::ACCEPTED;
use tempfile::TempDir;

/// Files attached to a record, written into a temporary folder that is removed at the end.
pub struct Files {
    folder: TempDir,
    /// Name of each file in the record, with the path of the written file.
    pub files: Vec<(String, PathBuf)>,
}

impl Files {
    /// Writes the files attached to a record into a new temporary folder.
    pub fn extract(opened: &Opened) -> io::Result<Files> {
        // The files may be confidential, and the folder stays if this program is killed.
        let folder = tempfile::Builder::new()
            .prefix("murmurate-replay-")
            .permissions(Permissions::from_mode(0o700))
            .tempdir()
            .map_err(|error| failed(&error, "cannot make a folder for the record's files"))?;
        let mut files = Files { folder, files: Vec::new() };
        let named: Vec<_> = opened.attached.iter().filter(|(name, _)| name != ACCEPTED).collect();
        let mut folders: Vec<&Path> = Vec::new();
        for (index, (name, content)) in named.into_iter().enumerate() {
            let last = Path::new(name).file_name().map_or("file".into(), |last| last.to_string_lossy().into_owned());
            // The name comes from the record, which may be from an untrusted source.
            let last: String = last.chars().filter(|c| c.is_ascii_alphanumeric() || "-_.".contains(*c)).collect();
            let last = &last[last.len().saturating_sub(100)..];
            // Files that were beside each other stay so: a policy's contract names its graphs.
            let parent = Path::new(name).parent().unwrap_or(Path::new(""));
            let place = folders.iter().position(|folder| *folder == parent).unwrap_or_else(|| {
                folders.push(parent);
                folders.len() - 1
            });
            let folder = files.folder().join(place.to_string());
            std::fs::create_dir_all(&folder)
                .map_err(|error| failed(&error, &format!("cannot make '{}'", folder.display())))?;
            let path = Some(folder.join(last)).filter(|path| !last.is_empty() && !path.exists());
            let path = path.unwrap_or_else(|| folder.join(format!("{index}-{last}")));
            std::fs::write(&path, content)
                .map_err(|error| failed(&error, &format!("cannot write '{}'", path.display())))?;
            files.files.push((name.clone(), path));
        }
        Ok(files)
    }

    /// Returns the folder that holds the files.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Returns the name of the team file of a host's record, as given on the command line; `None` if no file is
    /// attached. It is the first file that `LiveRecord` attaches.
    pub fn team_file(&self) -> Option<&str> {
        self.files.first().map(|(name, _)| &**name)
    }

    /// Returns the path of the extracted policy file of a host's record, the second file that `LiveRecord` attaches;
    /// `None` if the policy was given as a name in the registry.
    pub fn policy(&self) -> Option<&Path> {
        self.files.get(1).map(|(_, path)| &**path)
    }

    /// Returns the recorded command-line arguments, with the names of attached files replaced by the paths of the
    /// extracted files.
    pub fn in_place(&self, arguments: &[String]) -> Vec<String> {
        let replaced = |argument: &String| {
            for (name, path) in &self.files {
                if argument == name {
                    return path.to_string_lossy().into_owned();
                }
                if let Some(flag) = argument.strip_suffix(name).filter(|flag| flag.ends_with('=')) {
                    return format!("{flag}{}", path.display());
                }
                // A policy file of a study may have a handling of its own.
                if let Some(handling) = argument.strip_prefix(name).filter(|rest| rest.starts_with('@')) {
                    return format!("{}{handling}", path.display());
                }
            }
            argument.clone()
        };
        arguments.iter().map(replaced).collect()
    }
}

/// Returns an error that begins with the attempted operation.
fn failed(error: &io::Error, tried: &str) -> io::Error {
    io::Error::new(error.kind(), format!("{tried}: {error}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use murmurate::trial::Trial;
    use murmurate_record::file::{Beginning, RecordFile};
    use murmurate_record::identity::Identity;
    use murmurate_record::reader;
    use murmurate_record::stage::Stage;

    #[test]
    fn arguments_name_the_extracted_files_which_vanish_at_the_end() {
        let folder = tempfile::TempDir::new().unwrap();
        let path = folder.path().join("a.mcap");
        let identity = Identity::here("1f", Vec::new(), "");
        let attached = [("teams/a.toml", "team"), ("../../b c.toml", "policy")];
        let attached = attached.map(|(name, text)| (name.to_owned(), text.as_bytes().to_vec()));
        let stage = Stage::of(&Trial::preset("sim", "passage").unwrap());
        RecordFile::create(&path, &Beginning { identity, attached: Vec::new() }, &stage).unwrap().finish().unwrap();
        let opened = Opened { attached: attached.to_vec(), ..reader::open(&path).unwrap() };
        let files = Files::extract(&opened).unwrap();
        assert_eq!(files.team_file(), Some("teams/a.toml"));
        let policy = files.policy().unwrap().to_owned();
        assert_eq!(std::fs::read_to_string(&policy).unwrap(), "policy");
        assert!(policy.starts_with(files.folder()) && policy.ends_with("1/bc.toml"), "{}", policy.display());
        let given = ["--team=teams/a.toml", "../../b c.toml@held", "teams/a.toml.old"].map(str::to_owned);
        let placed = files.in_place(&given);
        assert_eq!(placed[0], format!("--team={}", files.folder().join("0/a.toml").display()));
        assert_eq!(placed[1], format!("{}@held", policy.display()));
        assert_eq!(placed[2], given[2]);
        drop(files);
        assert!(!policy.exists());
    }
}
