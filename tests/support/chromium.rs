//! Headless Chromium, driven over its debugging pipe: messages in JSON, each terminated by a zero byte. Tests include this file as a module.

#![allow(dead_code, reason = "each test uses a part of it")]

use std::io::{BufRead, BufReader, Write};
use std::net::UdpSocket;
use std::path::PathBuf;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use serde_json::{Value, json};

/// Time limit for a reply.
const PATIENCE: Duration = Duration::from_secs(60);

/// Whether Chromium is installed.
pub fn is_there() -> bool {
    Command::new("chromium").arg("--version").output().is_ok_and(|output| output.status.success())
}

/// Whether this machine has a route to other machines. Without one Chromium does not connect by WebRTC, not even to this machine.
pub fn has_network() -> bool {
    // Connecting a UDP socket looks up the route and sends nothing; the address is for documentation.
    UdpSocket::bind("0.0.0.0:0").and_then(|socket| socket.connect("192.0.2.1:9")).is_ok()
}

/// A browser; killed when dropped.
pub struct Browser {
    child: Child,
    requests: ChildStdin,
    replies: Receiver<Value>,
    next_id: u64,
    profile: PathBuf,
}

/// An open page.
pub struct Page(String);

impl Browser {
    pub fn start(name: &str) -> Self {
        let profile = std::env::temp_dir().join(format!("panoscope-chromium-{name}-{}", std::process::id()));
        // The pipe of a browser is its file descriptors 3 and 4.
        let mut command = Command::new("sh");
        command.args(["-c", r#"exec chromium "$@" 3<&0 4>&1 1>&2"#, "sh"]);
        command.args(["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"]);
        command.args(["--disable-background-networking", "--disable-component-update", "--disable-sync"]);
        command.arg("--remote-debugging-pipe").arg(format!("--user-data-dir={}", profile.display()));
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::null());
        let mut child = command.spawn().unwrap();
        let requests = child.stdin.take().unwrap();
        let output = BufReader::new(child.stdout.take().unwrap());
        let (sender, replies) = channel();
        std::thread::spawn(move || {
            for message in output.split(0).map_while(Result::ok) {
                let message: Value = serde_json::from_slice(&message).expect("JSON from Chromium");
                if message.get("id").is_some() && sender.send(message).is_err() {
                    return;
                }
            }
        });
        Self { child, requests, replies, next_id: 1, profile }
    }

    fn call(&mut self, method: &str, params: &Value, session: Option<&str>) -> Value {
        let id = self.next_id;
        self.next_id += 1;
        let mut request = json!({ "id": id, "method": method, "params": params });
        if let Some(session) = session {
            request["sessionId"] = session.into();
        }
        self.requests.write_all(request.to_string().as_bytes()).unwrap();
        self.requests.write_all(&[0]).unwrap();
        let end = Instant::now() + PATIENCE;
        loop {
            let left = end.saturating_duration_since(Instant::now());
            let reply = self.replies.recv_timeout(left).unwrap_or_else(|error| panic!("{method}: {error}"));
            if reply["id"] == id {
                assert!(reply.get("error").is_none(), "{method}: {reply}");
                return reply["result"].clone();
            }
        }
    }

    /// Opens a page in a new tab.
    pub fn open(&mut self, url: &str) -> Page {
        let target = self.call("Target.createTarget", &json!({ "url": url }), None);
        let attach = json!({ "targetId": target["targetId"], "flatten": true });
        Page(self.call("Target.attachToTarget", &attach, None)["sessionId"].as_str().unwrap().to_owned())
    }

    /// Value of a JavaScript expression in a page; promises are awaited.
    pub fn evaluate(&mut self, page: &Page, expression: &str) -> Value {
        let params = json!({ "expression": expression, "returnByValue": true, "awaitPromise": true });
        let result = self.call("Runtime.evaluate", &params, Some(&page.0));
        assert!(result.get("exceptionDetails").is_none(), "{expression}: {result}");
        result["result"]["value"].clone()
    }

    /// Kills it without a clean shutdown.
    pub fn kill(mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        // Killed already, or it ends now.
        let _ = self.child.kill();
        let _ = self.child.wait();
        let _ = std::fs::remove_dir_all(&self.profile);
    }
}
