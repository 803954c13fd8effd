//! A real browser without a window, driven over its debugging socket (Chrome DevTools Protocol).

use std::io::{BufRead, BufReader};
use std::net::TcpStream;
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use nix::sys::signal::{Signal, killpg};
use nix::unistd::Pid;
use serde_json::{Value, json};
use tungstenite::protocol::WebSocketConfig;
use tungstenite::{Message, WebSocket, client};

use crate::program::skip::skip;

/// Programs that are tried, in order.
const PROGRAMS: [&str; 5] = ["chromium", "chromium-headless-shell", "chrome", "google-chrome", "chromium-browser"];
/// Largest message of the browser: a picture of a page.
const LARGEST: usize = 1 << 26;

pub struct Browser {
    child: Child,
    socket: WebSocket<TcpStream>,
    calls: u64,
    session: Option<String>,
    _profile: tempfile::TempDir,
}

impl Browser {
    /// Starts a browser; `None`, and the test is skipped, where there is none.
    pub fn start() -> Option<Browser> {
        let profile = tempfile::tempdir().unwrap();
        let start = |program: &&str| {
            let mut command = Command::new(program);
            command.args(["--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run"]);
            command.args(["--hide-scrollbars", "--remote-debugging-port=0", "--window-size=1280,800"]);
            command.arg(format!("--user-data-dir={}", profile.path().display())).arg("about:blank");
            // A group of its own, since the browser may be started by a script and starts processes itself.
            command.process_group(0).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().ok()
        };
        let Some(mut child) = PROGRAMS.iter().find_map(start) else {
            skip("browser", &format!("none of {} is installed", PROGRAMS.join(", ")));
            return None;
        };
        let mut lines = BufReader::new(child.stderr.take().unwrap());
        let mut line = String::new();
        let url = loop {
            line.clear();
            assert!(lines.read_line(&mut line).unwrap() > 0, "the browser has ended");
            if let Some(url) = line.trim().strip_prefix("DevTools listening on ") {
                break url.to_owned();
            }
        };
        std::thread::spawn(move || std::io::copy(&mut lines, &mut std::io::sink()));
        let address = url.trim_start_matches("ws://").split('/').next().unwrap();
        let stream = TcpStream::connect(address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        let config = WebSocketConfig::default().max_message_size(Some(LARGEST)).max_frame_size(Some(LARGEST));
        let (socket, _) = client::client_with_config(&url, stream, Some(config)).unwrap();
        Some(Browser { child, socket, calls: 0, session: None, _profile: profile })
    }

    pub fn call(&mut self, method: &str, params: Value) -> Value {
        self.calls += 1;
        let mut message = json!({ "id": self.calls, "method": method, "params": params });
        if let Some(session) = &self.session {
            message["sessionId"] = json!(session);
        }
        self.socket.send(Message::text(message.to_string())).unwrap();
        loop {
            let Message::Text(text) = self.socket.read().unwrap() else { continue };
            let answer: Value = serde_json::from_str(&text).unwrap();
            if answer["id"] == json!(self.calls) {
                assert!(answer["error"].is_null(), "{method}: {}", answer["error"]);
                return answer["result"].clone();
            }
        }
    }

    /// Opens a page in a tab of its own.
    pub fn open(&mut self, url: &str) {
        self.session = None;
        let target = self.call("Target.createTarget", json!({ "url": "about:blank" }))["targetId"].clone();
        let session = self.call("Target.attachToTarget", json!({ "targetId": target, "flatten": true }));
        self.session = session["sessionId"].as_str().map(str::to_owned);
        // Returns once the page has replaced the empty one.
        self.call("Page.navigate", json!({ "url": url }));
    }

    /// Evaluates JavaScript, and waits for what it promises.
    pub fn eval(&mut self, script: &str) -> Value {
        let params = json!({ "expression": script, "returnByValue": true, "awaitPromise": true });
        let result = self.call("Runtime.evaluate", params);
        assert!(result["exceptionDetails"].is_null(), "{script}: {}", result["exceptionDetails"]);
        result["result"]["value"].clone()
    }

    /// Waits until a condition holds, and returns the time \[ms\] since then.
    pub fn until(&mut self, condition: &str) -> f64 {
        let script = format!(
            "new Promise((done, fail) => {{ const began = performance.now(), look = () => {{ let holds = false; \
             try {{ holds = {condition} }} catch {{}} const ms = performance.now() - began; if (holds) done(ms); \
             else if (ms > 30000) fail(document.body.innerText.slice(-900)); else setTimeout(look, 4); }}; \
             look(); }})"
        );
        self.eval(&script).as_f64().unwrap_or_else(|| panic!("never: {condition}"))
    }

    pub fn press_space(&mut self) {
        for kind in ["rawKeyDown", "keyUp"] {
            let key = json!({ "type": kind, "key": " ", "code": "Space", "windowsVirtualKeyCode": 32 });
            self.call("Input.dispatchKeyEvent", key);
        }
    }

    /// Sets size and colour scheme as of another device.
    pub fn look_like(&mut self, width: u32, height: u32, scheme: &str) {
        let size = json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600 });
        self.call("Emulation.setDeviceMetricsOverride", size);
        let features = json!({ "features": [{ "name": "prefers-color-scheme", "value": scheme }] });
        self.call("Emulation.setEmulatedMedia", features);
    }

    /// Returns a picture of the page as PNG.
    pub fn picture(&mut self) -> Vec<u8> {
        let picture = self.call("Page.captureScreenshot", json!({ "format": "png" }));
        base64(picture["data"].as_str().unwrap())
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        let group = Pid::from_raw(i32::try_from(self.child.id()).expect("a process id"));
        let _ = killpg(group, Signal::SIGKILL);
        let _ = self.child.wait();
    }
}

fn base64(text: &str) -> Vec<u8> {
    let value = |byte: u8| match byte {
        b'A'..=b'Z' => byte - b'A',
        b'a'..=b'z' => byte - b'a' + 26,
        b'0'..=b'9' => byte - b'0' + 52,
        b'+' => 62,
        b'/' => 63,
        _ => 0,
    };
    let mut out = Vec::new();
    for four in text.as_bytes().chunks(4) {
        let bits = four.iter().fold(0u32, |bits, byte| bits << 6 | u32::from(value(*byte)));
        let padding = four.iter().filter(|byte| **byte == b'=').count();
        out.extend_from_slice(&bits.to_be_bytes()[1..4 - padding]);
    }
    out
}
