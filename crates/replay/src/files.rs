//! Files that are attached to a record, in a temporary folder while the record is replayed.

use std::fs::Permissions;
use std::io;
use std::os::unix::fs::PermissionsExt;
use std::path::{Component, Path, PathBuf};

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
        let places: Vec<Place> = named.iter().map(|(name, _)| Place::of(Path::new(name))).collect();
        let up = places.iter().map(|place| place.up).max().unwrap_or(0);
        // Stands for the names of folders that no attached file says.
        let mut above = "above".to_owned();
        while places.iter().any(|place| place.parts.contains(&above)) {
            above.push('_');
        }
        for (index, ((name, content), place)) in named.into_iter().zip(places).enumerate() {
            let folder = place.folder(files.folder(), (up, &above));
            std::fs::create_dir_all(&folder)
                .map_err(|error| failed(&error, &format!("cannot make '{}'", folder.display())))?;
            let last = place.parts.last().map_or("file", String::as_str);
            let path = Some(folder.join(last)).filter(|path| !path.exists());
            let numbered = |number: usize| folder.join(format!("{number}-{last}"));
            let path = path.or_else(|| (index..).map(numbered).find(|path| !path.exists())).expect("numbers go on");
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

    /// Returns the path of the extracted file that had this path when it was attached; `None` if there is none.
    pub fn extracted(&self, name: &Path) -> Option<&Path> {
        let found = self.files.iter().find(|(attached, _)| Path::new(attached) == name);
        found.map(|(_, path)| &**path)
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

/// Place of an attached file relative to the folder in which its program ran. Extracted files have the same places to
/// each other, since files name others: a policy's contract its graphs, roles their policies.
struct Place {
    /// Number of folders above that in which the program ran.
    up: usize,
    /// Names of folders from there, and of the file.
    parts: Vec<String>,
}

impl Place {
    fn of(name: &Path) -> Place {
        let mut place = Place { up: 0, parts: Vec::new() };
        for component in name.components() {
            match component {
                Component::ParentDir if place.parts.is_empty() => place.up += 1,
                Component::ParentDir => drop(place.parts.pop()),
                // The name comes from the record, which may be from an untrusted source.
                Component::Normal(name) => place.parts.push(plain(&name.to_string_lossy())),
                Component::CurDir | Component::RootDir | Component::Prefix(_) => {}
            }
        }
        place
    }

    /// Returns the folder of the file within `root`, in which the program's folder is `up` folders deep, each of which
    /// is called `above`.
    fn folder(&self, root: &Path, (up, above): (usize, &str)) -> PathBuf {
        let above = std::iter::repeat_n(above, up - self.up);
        let parents = self.parts.iter().rev().skip(1).rev();
        root.join("files").join(above.collect::<PathBuf>()).join(parents.collect::<PathBuf>())
    }
}

/// Returns a name of a file or folder without control characters, of at most 60 characters: its end.
fn plain(name: &str) -> String {
    let plain: Vec<char> = name.chars().filter(|c| !c.is_control()).collect();
    let last: String = plain[plain.len().saturating_sub(60)..].iter().collect();
    // A name that was made of others' characters may have become one that leads upwards.
    if last.chars().all(|c| c == '.') { "file".to_owned() } else { last }
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
        let policy = files.extracted(Path::new("../../b c.toml")).expect("it is attached").to_owned();
        assert_eq!(std::fs::read_to_string(&policy).unwrap(), "policy");
        assert!(policy.starts_with(files.folder()) && policy.ends_with("files/b c.toml"), "{}", policy.display());
        let from_team =
            files.extracted(Path::new("teams/a.toml")).expect("it is attached").with_file_name("../../../b c.toml");
        assert_eq!(
            std::fs::read_to_string(from_team).expect("it is there"),
            "policy",
            "files have their places to each other"
        );
        let given = ["--team=teams/a.toml", "../../b c.toml@held", "teams/a.toml.old"].map(str::to_owned);
        let placed = files.in_place(&given);
        assert_eq!(placed[0], format!("--team={}", files.folder().join("files/above/above/teams/a.toml").display()));
        assert_eq!(placed[1], format!("{}@held", policy.display()));
        assert_eq!(placed[2], given[2]);
        drop(files);
        assert!(!policy.exists());
    }
}
