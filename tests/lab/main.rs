//! The command `lab` with real network namespaces and TAP interfaces. Needs root, `ip` and /dev/net/tun; skips with a
//! notice where they are missing. What a refusal says is checked everywhere.

#[path = "../program/mod.rs"]
mod program;

use std::io::{BufRead, BufReader, Read, Write};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use murmurate_lab::report::LabReport;
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use program::skip::skip;
use program::{murmurate, refuses, run, text};
use tempfile::TempDir;

/// Prints a line past the capture of test output.
fn report(line: &str) {
    let _ = writeln!(std::io::stderr(), "lab: {line}");
}

/// Returns whether a lab can be made here; says what is missing otherwise.
fn possible() -> bool {
    let root = nix::unistd::geteuid().is_root();
    let tun = std::fs::OpenOptions::new().read(true).write(true).open("/dev/net/tun").is_ok();
    let ip = Command::new("ip").arg("-V").output().is_ok();
    if !(root && tun && ip) {
        skip("lab", "a lab needs root, /dev/net/tun and the program 'ip'");
    }
    root && tun && ip
}

/// A laboratory file of its own name, so that tests may run at the same time.
struct File {
    folder: TempDir,
    name: String,
}

impl File {
    fn new(tag: &str, text: &str) -> File {
        let (folder, name) = (TempDir::new().unwrap(), format!("mt{}{tag}", std::process::id()));
        std::fs::write(folder.path().join("lab.toml"), format!("name = \"{name}\"\n{text}")).unwrap();
        File { folder, name }
    }

    fn path(&self, file: &str) -> String {
        self.folder.path().join(file).to_string_lossy().into_owned()
    }

    /// Runs a subcommand on this laboratory by its name; returns stdout if it succeeds.
    fn on(&self, args: &[&str], then: &[&str]) -> Result<String, String> {
        let output = run(&[args, &["--name", &self.name], then].concat());
        if output.status.success() { Ok(text(&output.stdout)) } else { Err(text(&output.stderr)) }
    }

    fn status(&self) -> LabReport {
        serde_json::from_str(&self.on(&["lab", "status", "--json"], &[]).expect("it is up")).expect("a report")
    }

    fn left(&self) -> bool {
        let entries = |folder: &str| {
            let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
            entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect::<Vec<_>>()
        };
        let named = |file: &String| file.contains(&self.name) && !file.ends_with(".log");
        entries("/run/netns").iter().chain(&entries("/run/murmurate")).any(named)
    }

    /// Starts the laboratory in the foreground, and waits until it is up.
    fn foreground(&self) -> Child {
        let mut command = murmurate(&["lab", "up", "--foreground", &self.path("lab.toml")]);
        let mut child = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("it starts");
        let mut lines = BufReader::new(child.stderr.take().unwrap());
        let mut said = String::new();
        while !said.contains(" is up: ") {
            assert!(lines.read_line(&mut said).unwrap() > 0, "it has ended before it was up: {said}");
        }
        std::thread::spawn(move || lines.lines().map_while(Result::ok).for_each(|line| report(&line)));
        child
    }
}

/// Removes what a failed test leaves.
impl Drop for File {
    fn drop(&mut self) {
        let _ = self.on(&["lab", "down"], &[]);
        let _ = std::fs::remove_file(format!("/run/murmurate/lab-{}.log", self.name));
    }
}

fn signal(child: &Child, signal: Signal) {
    kill(Pid::from_raw(child.id() as i32), signal).unwrap();
}

#[test]
fn a_wrong_file_is_refused_by_field_and_line() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("lab.toml").to_string_lossy().into_owned();
    std::fs::write(&path, "stations = 3\n[radio]\nretries = 3\nnoise_loss = 1.5\n").unwrap();
    refuses(&["lab", "up", &path], &["lab.toml", "radio.noise_loss (line 4)", "1.5"]);
    std::fs::write(&path, "stations = 3\nrange = 2\n").unwrap();
    refuses(&["lab", "run", &path, "--", "true"], &["line 2", "(range)", "unknown field"]);
    std::fs::write(&path, "stations = 3\n").unwrap();
    refuses(&["lab", "run", &path], &["no station has a command"]);
    refuses(&["lab", "status", "--name", "nowhere"], &["no lab 'nowhere' is up", "lab up"]);
    refuses(&["lab", "exec", "0", "--name", "nowhere", "--", "true"], &["no lab 'nowhere' is up"]);
}

#[test]
fn without_privileges_the_refusal_names_what_is_missing() {
    if !nix::unistd::geteuid().is_root() || Command::new("setpriv").arg("--version").output().is_err() {
        return skip("setpriv", "the program 'setpriv' drops capabilities of root");
    }
    let file = File::new("p", "stations = 2\n");
    let output = Command::new("setpriv")
        .args(["--bounding-set", "-net_admin", "--inh-caps", "-net_admin", env!("CARGO_BIN_EXE_murmurate")])
        .args(["lab", "up", &file.path("lab.toml")])
        .output()
        .expect("it starts");
    assert_eq!(output.status.code(), Some(1));
    let said = text(&output.stderr);
    assert!(said.contains("CAP_NET_ADMIN") && said.contains("root"), "{said}");
    assert!(!file.left());
}

#[test]
fn stations_ping_each_other_over_the_channel_and_all_is_gone_afterwards() {
    if !possible() {
        return;
    }
    let file = File::new("a", "stations = 3\n[radio]\nchannel = \"ad-hoc\"\n");
    let capture = file.path("all.pcap");
    let output = run(&["lab", "up", &file.path("lab.toml"), "--capture", &capture]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let again = run(&["lab", "up", &file.path("lab.toml")]);
    assert_eq!(again.status.code(), Some(2));
    assert!(text(&again.stderr).contains("is up already"), "{}", text(&again.stderr));
    let said =
        file.on(&["lab", "exec", "1"], &["--", "sh", "-c", "echo $LAB_STATION of $LAB_STATIONS at $LAB_ADDRESS"]);
    assert_eq!(said.unwrap(), "1 of 3 at 10.77.0.2\n");
    let sends = "import socket as s, os; u = s.socket(s.AF_INET, s.SOCK_DGRAM); \
                 [u.sendto(b'x' * 100, ('10.77.0.3', 9)) for _ in range(20)]";
    file.on(&["lab", "exec", "0"], &["--", "python3", "-c", sends]).expect("python3 sends");
    let code = run(&["lab", "exec", "0", "--name", &file.name, "--", "sh", "-c", "exit 7"]).status.code();
    assert_eq!(code, Some(7), "the exit code is the command's");
    let status = file.status();
    // A request of address resolution, its answer, the datagrams, and what ICMP says of the closed port.
    assert!((21..=40).contains(&status.stations[0].radio.offered), "{status:?}");
    assert!(status.stations[2].radio.received >= 21, "{status:?}");
    assert_eq!(status.stations.iter().map(|station| station.unwritten).sum::<u64>(), 0);
    assert!(status.radio.airtime_ns > 0 && status.lateness.deliveries >= 22, "{status:?}");
    let other = format!("not-{}", file.name);
    for command in ["down", "status"] {
        refuses(
            &["lab", command, "--name", &other],
            &[&format!("no lab '{other}' is up"), &format!("'{}'", file.name)],
        );
    }
    assert_eq!(file.status().stations.len(), 3, "the lab stays");
    file.on(&["lab", "down"], &[]).expect("it ends");
    assert!(!file.left());
    let bytes = std::fs::read(&capture).unwrap();
    assert!(bytes.len() > 20 * 150, "{} bytes", bytes.len());
    reads_as_80211(&capture);
}

/// Checks a capture with `tshark` or `tcpdump`, where there is one.
fn reads_as_80211(path: &str) {
    let fields = ["-T", "fields", "-e", "wlan.fc.type_subtype", "-e", "radiotap.datarate", "-e", "udp.length"];
    if let Ok(output) =
        Command::new("tshark").args(["-r", path, "-Y", "udp.dstport == 9 && !icmp"]).args(fields).output()
    {
        let said = text(&output.stdout);
        assert_eq!(said.lines().count(), 20, "{said}{}", text(&output.stderr));
        assert!(said.lines().all(|line| line.starts_with("0x0028\t54\t108")), "{said}");
    } else if let Ok(output) = Command::new("tcpdump").args(["-r", path, "-n"]).output() {
        let said = text(&output.stdout);
        assert!(said.lines().filter(|line| line.contains("10.77.0.3.9: UDP, length 100")).count() >= 20, "{said}");
    } else {
        skip("tcpdump", "the capture is not read: there is neither tshark nor tcpdump");
    }
}

#[test]
fn a_run_starts_a_command_in_every_station_and_reports() {
    if !possible() {
        return;
    }
    let file =
        File::new("r", "stations = 2\nstatic_arp = true\n[[station]]\nnumber = 1\ncommand = [\"sleep\", \"0.3\"]\n");
    let send = "import socket as s; s.socket(s.AF_INET, s.SOCK_DGRAM).sendto(b'x', ('10.77.0.2', 9))";
    let path = file.path("lab.toml");
    let output = run(&["lab", "run", &path, "--json", "--", "python3", "-c", send]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let counters: LabReport = serde_json::from_slice(&output.stdout).expect("a report");
    assert!(counters.stations[0].radio.offered >= 1 && counters.stations[1].radio.received >= 1, "{counters:?}");
    let relayed = counters.access_point.expect("there is an access point by default").transmissions;
    assert!(relayed >= 1, "{counters:?}");
    let failed = run(&["lab", "run", &path, "--", "sh", "-c", "echo from here >&2; exit 3"]);
    assert_eq!(failed.status.code(), Some(1));
    let said = text(&failed.stderr);
    assert!(said.contains("0 | from here") && said.contains("station 0 has failed (exit status: 3)"), "{said}");
    assert!(text(&failed.stdout).contains("station  address"), "{}", text(&failed.stdout));
    let limited = run(&["lab", "run", &path, "--seconds", "0.2", "--", "sleep", "60"]);
    assert!(limited.status.success(), "ended by --seconds is no failure: {}", text(&limited.stderr));
    assert!(!file.left());
}

#[test]
fn ctrl_c_and_kill_leave_nothing_and_a_lost_interface_stops_nobody_else() {
    if !possible() {
        return;
    }
    let file = File::new("k", "stations = 3\nstatic_arp = true\ncable = \"10.78.0.0\"\n");
    let mut child = file.foreground();
    file.on(&["lab", "exec", "0"], &["--", "ip", "link", "del", "wlan0"]).expect("root may");
    let send = |to: u16| {
        format!("import socket as s; s.socket(s.AF_INET, s.SOCK_DGRAM).sendto(b'x', ('10.77.0.{}', 9))", to + 1)
    };
    for to in [0, 2] {
        file.on(&["lab", "exec", "1"], &["--", "python3", "-c", &send(to)]).expect("station 1 goes on");
    }
    let status = file.status();
    assert_eq!(status.stations.iter().map(|station| station.gone).collect::<Vec<_>>(), [true, false, false]);
    assert!(status.stations[2].radio.received >= 1, "{status:?}");
    signal(&child, Signal::SIGINT);
    assert_eq!(child.wait().unwrap().code(), Some(130));
    assert!(!file.left());

    let mut child = file.foreground();
    let mut stays =
        Command::new("ip").args(["netns", "exec", &format!("{}1", file.name), "sleep", "1000"]).spawn().unwrap();
    signal(&child, Signal::SIGKILL);
    child.wait().unwrap();
    assert!(file.left() && Path::new("/run/netns").join(format!("{}-cable", file.name)).exists());
    let mut child = file.foreground();
    assert!(!stays.wait().unwrap().success(), "a program of the lab that was killed is ended");
    assert_eq!(file.status().stations.len(), 3);
    file.on(&["lab", "down"], &[]).expect("it ends");
    child.wait().unwrap();
    assert!(!file.left());
}

#[test]
fn a_namespace_of_somebody_else_is_not_touched() {
    if !possible() {
        return;
    }
    let file = File::new("o", "stations = 2\n");
    let foreign = format!("{}1", file.name);
    assert!(Command::new("ip").args(["netns", "add", &foreign]).status().unwrap().success());
    let output = run(&["lab", "up", &file.path("lab.toml")]);
    assert_eq!(output.status.code(), Some(1));
    assert!(text(&output.stderr).contains(&foreign), "{}", text(&output.stderr));
    let there = Path::new("/run/netns").join(&foreign).exists();
    assert!(Command::new("ip").args(["netns", "del", &foreign]).status().unwrap().success());
    assert!(there && !file.left());
}

/// Returns the blocks of a page in one language, each with the paragraph before it.
fn blocks<'a>(page: &'a str, language: &str) -> Vec<(&'a str, &'a str)> {
    let fence = format!("```{language}\n");
    let parts = page.match_indices(&fence).map(|(at, _)| {
        let before = page[..at].trim_end().rsplit("\n\n").next().unwrap();
        let text = &page[at + fence.len()..];
        (before, &text[..text.find("```").expect("a block ends")])
    });
    parts.collect()
}

#[test]
fn every_command_of_the_page_works() {
    let busy = Path::new("/run/netns/lab0").exists() || Path::new("/run/netns/robots0").exists();
    let ping = Command::new("ping").arg("-V").output().is_ok();
    if !possible() {
        return;
    }
    if busy || !ping {
        return skip("ping", "the page's commands need the program 'ping', and its names to be free");
    }
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let page = std::fs::read_to_string(root.join("docs/lab.md")).unwrap();
    let folder = TempDir::new().unwrap();
    for (before, block) in blocks(&page, "toml") {
        let name = before.split('`').skip(1).step_by(2).find(|span| span.ends_with(".toml")).expect("it has a name");
        std::fs::write(folder.path().join(name), block).unwrap();
    }
    std::os::unix::fs::symlink(root.join("teams"), folder.path().join("teams")).unwrap();
    std::os::unix::fs::symlink(env!("CARGO_BIN_EXE_murmurate"), folder.path().join("murmurate")).unwrap();
    let shell = |line: &str| {
        let path = format!("{}:{}", folder.path().display(), std::env::var("PATH").unwrap());
        let output =
            Command::new("sh").args(["-c", line]).current_dir(folder.path()).env("PATH", path).output().unwrap();
        // How true the lab is on a machine that runs other tests is not asked here.
        let code = output.status.code();
        let fits = code == Some(0) || line.contains("lab check") && code == Some(1);
        assert!(fits, "{line}: {code:?}\n{}{}", text(&output.stdout), text(&output.stderr));
        text(&output.stdout)
    };
    shell("murmurate key new --out team.key");
    let mut ran = 0;
    for (_, block) in blocks(&page, "sh") {
        for line in block.lines().filter(|line| line.starts_with("murmurate ")) {
            let said = shell(line);
            assert!(!line.contains("launch") || said.contains("success "), "{line}: {said}");
            ran += 1;
        }
    }
    assert!(ran >= 6, "the page has {ran} commands");
}

/// Returns the body of a page of the server at `address`; empty if it does not answer.
fn page(address: &str, path: &str) -> String {
    let mut body = String::new();
    if let Ok(mut stream) = std::net::TcpStream::connect(address) {
        let _ = write!(stream, "GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n");
        let _ = stream.read_to_string(&mut body);
    }
    body
}

#[test]
fn the_page_of_a_team_in_a_lab_is_at_a_station_of_its_own() {
    if !possible() {
        return;
    }
    let file = File::new("w", "stations = 6\npreset = \"wifi\"\ncable = \"10.78.0.0\"\n");
    let (lab, key) = (file.path("lab.toml"), file.path("team.key"));
    assert!(run(&["key", "new", "--out", &key]).status.success());
    let team = concat!(env!("CARGO_MANIFEST_DIR"), "/../../teams/onboard-infra.toml");
    let args = ["launch", team, "--lab", &lab, "--key-file", &key, "--watch", "--quiet"];
    refuses(&args, &["--watch", "stations = 7", "lab.toml"]);
    let text = std::fs::read_to_string(&lab).unwrap().replace("stations = 6", "stations = 7");
    std::fs::write(&lab, text).unwrap();
    let mut child = murmurate(&args).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("it starts");
    let lines = BufReader::new(child.stderr.take().unwrap()).lines();
    let mut lines = lines.map_while(Result::ok).inspect(|line| report(line));
    let address =
        lines.find_map(|line| line.split_once("http://").map(|(_, rest)| rest.trim_end_matches('/').to_owned()));
    let address = address.expect("it says where the page is");
    std::thread::spawn(move || lines.for_each(drop));
    let hears_all = || {
        let metrics = page(&address, "/metrics");
        (0..5).all(|robot| metrics.contains(&format!("robot=\"{robot}\"")))
    };
    let began = std::time::Instant::now();
    while !hears_all() {
        assert!(began.elapsed().as_secs() < 60, "the page does not hear all robots: {}", page(&address, "/metrics"));
        assert!(child.try_wait().unwrap().is_none(), "the team has ended");
        std::thread::yield_now();
    }
    signal(&child, Signal::SIGINT);
    assert_eq!(child.wait().unwrap().code(), Some(130));
    assert!(!file.left());
}

#[test]
fn real_time_is_virtual_time_at_a_moderate_load() {
    if !possible() {
        return;
    }
    // A machine that is busy with other tests is late; the bars themselves are for `just full-lab`.
    let output = run(&["lab", "check", "--stations", "3", "--loads", "30", "--seconds", "2", "--json"]);
    let rows: Vec<serde_json::Value> =
        text(&output.stdout).lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(rows.len(), 2, "{}", text(&output.stderr));
    for row in rows {
        let number = |name: &str| row[name].as_f64().unwrap();
        assert!((number("delivered") - number("delivered_virtual")).abs() < 0.1, "{row}");
        assert!(number("p50_ms") >= 0.9 * number("p50_virtual_ms"), "no frame comes before its time: {row}");
    }
}
