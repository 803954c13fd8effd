//! `murmurate lab up`: a laboratory in the background, or in the foreground until Ctrl-C.

use std::fs::{self, File};
use std::io::{BufRead, BufReader};
use std::os::unix::net::UnixListener;
use std::path::PathBuf;
use std::process::{Command, Stdio};

use anyhow::{Context, Result, anyhow};

use super::read;
use murmurate_lab::file::Laboratory;
use murmurate_lab::machine::{CaptureWriter, Carrier, Claim, Outside, needs, path};
use murmurate_robot::background_writer::{BackgroundWriter, Target};
use murmurate_robot::output::{FLUSH_TIMEOUT, print, talk};
use murmurate_robot::{BadInput, Ended, signals, this_program};

/// Flags of `murmurate lab up`.
#[derive(clap::Args)]
#[command(
    after_help = "Needs root, or CAP_NET_ADMIN and CAP_SYS_ADMIN; /dev/net/tun; and 'ip'. What a lab of the same name \
    has left after a crash is removed first. Exit codes: 0 the stations are up; 1 they cannot be made, and nothing \
    is left; 2 the file is wrong."
)]
pub struct Args {
    #[command(flatten)]
    source: Source,
    /// Stays until Ctrl-C or SIGTERM, and then prints the counters
    #[arg(long)]
    foreground: bool,
    /// Is the process in the background
    #[arg(long, hide = true)]
    behind: bool,
}

/// Laboratory file, and flags that concern it.
#[derive(clap::Args)]
pub struct Source {
    /// Laboratory file
    file: PathBuf,
    /// Writes every transmission to this file, as pcap with radiotap headers
    #[arg(long, value_name = "FILE")]
    capture: Option<PathBuf>,
}

impl Source {
    /// Reads and checks the laboratory file.
    pub fn read(&self) -> Result<Laboratory> {
        read(&self.file)
    }

    /// Opens the capture file, if there is one.
    pub fn capture(&self) -> Result<Option<Box<dyn CaptureWriter>>> {
        let Some(path) = &self.capture else { return Ok(None) };
        let target = Target::create(path).map_err(|e| BadInput(format!("cannot write '{}': {e}", path.display())))?;
        let writer = BackgroundWriter::open(target, None).context("cannot start a thread to write the capture")?;
        Ok(Some(Box::new(CaptureFile(writer))))
    }
}

/// Capture file, written by a thread of its own.
struct CaptureFile(BackgroundWriter);

impl CaptureWriter for CaptureFile {
    fn push(&self, piece: Vec<u8>) -> bool {
        self.0.push(piece)
    }

    fn flush(&self) {
        self.0.flush(FLUSH_TIMEOUT);
    }
}

/// Runs `lab up`.
pub fn run(args: &Args) -> Result<Ended> {
    let lab = args.source.read()?;
    needs::check()?;
    if args.foreground || args.behind { here(args, &lab) } else { behind(args, &lab) }
}

/// Returns the line that describes a laboratory that is up.
fn described(lab: &Laboratory) -> String {
    let last = lab.stations - 1;
    format!(
        "lab '{}' is up: stations 0 to {last}, {} to {}, on {} in the namespaces {} to {}",
        lab.name,
        lab.address(0),
        lab.address(last),
        lab.interface,
        lab.namespace(0),
        lab.namespace(last)
    )
}

/// Runs the laboratory in this process.
fn here(args: &Args, lab: &Laboratory) -> Result<Ended> {
    if args.behind {
        // Ctrl-C on the terminal, and its end, are not for this process.
        nix::unistd::setsid().context("cannot leave the terminal")?;
    }
    // Before anything is made: a signal that comes while the stations are made ends the lab as soon as they are.
    let (signal, stop) = signals::listen()?;
    let capture = args.source.capture()?;
    let claim = Claim::take(&lab.name, talk)?;
    let taps = claim.make(lab)?;
    let control = UnixListener::bind(path(&lab.name, "sock")).context("cannot make a socket in /run")?;
    let carrier = Carrier::new(lab, taps, capture, talk);
    if args.behind {
        print("up")?;
    } else {
        talk(&format!("{}; Ctrl-C removes it", described(lab)));
    }
    let report = carrier.carry(&Outside { control: Some(control), stop: &*stop })?;
    drop(claim);
    if args.behind {
        // A log with warnings stays for its reader.
        let log = path(&lab.name, "log");
        if fs::metadata(&log).is_ok_and(|about| about.len() == 0) {
            let _ = fs::remove_file(log);
        }
    } else {
        print(&report.to_string())?;
    }
    let interrupted = signal.load(std::sync::atomic::Ordering::Relaxed) == signal_hook::consts::SIGINT as usize;
    Ok(if interrupted && !args.behind { Ended::Interrupted } else { Ended::Done })
}

/// Starts the laboratory as a process in the background, and returns when its stations are up.
fn behind(args: &Args, lab: &Laboratory) -> Result<Ended> {
    let mut words = this_program()?.into_iter();
    let mut command = Command::new(words.next().expect("the program is one of them"));
    command.args(words).args(["lab", "up", "--behind"]).arg(&args.source.file);
    if let Some(capture) = &args.source.capture {
        command.arg("--capture").arg(capture);
    }
    let log = path(&lab.name, "log");
    fs::create_dir_all(log.parent().expect("it is in a folder")).context("cannot make a folder in /run")?;
    let file = File::options().create(true).append(true).open(&log);
    let file = file.with_context(|| format!("cannot write '{}'", log.display()))?;
    let before = file.metadata().map_or(0, |about| about.len()) as usize;
    let mut child = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(file).spawn();
    let child = child.as_mut().map_err(|error| anyhow!("cannot start the lab's process: {error}"))?;
    let mut line = String::new();
    let mut output = BufReader::new(child.stdout.take().expect("it is piped"));
    if output.read_line(&mut line).is_ok_and(|length| length > 0) {
        talk(&described(lab));
        talk(&format!(
            "'murmurate lab exec 0 --name {} -- COMMAND' runs a command in station 0, 'murmurate lab down \
             --name {}' removes all; its warnings are in {}",
            lab.name,
            lab.name,
            log.display()
        ));
        return Ok(Ended::Done);
    }
    let status = child.wait().context("cannot wait for the lab's process")?;
    let text = fs::read_to_string(&log).unwrap_or_default();
    let why = text.get(before..).unwrap_or_default().trim().trim_start_matches("error: ").to_owned();
    if status.code() == Some(2) { Err(BadInput(why).into()) } else { Err(anyhow!("{why} ({status})")) }
}
