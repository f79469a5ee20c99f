//! Requests to the studio's server over a plain connection, as from its page, and from pages and programs that it must
//! refuse.

#[cfg(unix)]
use super::command::signal;
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, ChildStderr, ChildStdout, Command, Stdio};
use std::time::Duration;

/// A studio that runs, until it is dropped.
pub(crate) struct Studio {
    child: Child,
    pub(crate) port: u16,
    pub(crate) key: String,
    /// What it prints must be read for as long as it runs.
    _out: (Option<BufReader<ChildStdout>>, Option<BufReader<ChildStderr>>),
}

/// An answer.
#[derive(Debug)]
pub(crate) struct Answer {
    pub(crate) status: u16,
    pub(crate) head: String,
    pub(crate) body: Vec<u8>,
}

impl Answer {
    pub(crate) fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap_or_else(|e| panic!("{e}: {}", String::from_utf8_lossy(&self.body)))
    }
}

impl Studio {
    /// `catoptra studio` in a folder.
    pub(crate) fn start(folder: &Path, args: &[&str]) -> Self {
        Self::start_by(Command::new(env!("CARGO_BIN_EXE_catoptra")), folder, args)
    }

    /// The same, where `command` is what runs it.
    pub(crate) fn start_by(mut command: Command, folder: &Path, args: &[&str]) -> Self {
        command.current_dir(folder).arg("studio").args(args).arg("--no-open").stdout(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let mut out = BufReader::new(child.stdout.take().unwrap());
        let mut line = String::new();
        out.read_line(&mut line).unwrap();
        let (port, key) = parts(&line);
        Self { child, port, key, _out: (Some(out), None) }
    }

    /// A live run that is shown: `command` is it, with `--studio`.
    pub(crate) fn of_live(mut command: Command) -> Self {
        let mut child = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        let mut said = BufReader::new(child.stderr.take().unwrap());
        let mut line = String::new();
        while !line.contains("http://") {
            line.clear();
            assert!(said.read_line(&mut line).unwrap() > 0, "the run ended before it said where it is shown");
        }
        let (port, key) = parts(&line);
        Self { child, port, key, _out: (None, Some(said)) }
    }

    /// Ends it as Ctrl-C does.
    #[cfg(unix)]
    pub(crate) fn interrupted(self) -> Option<i32> {
        assert!(signal(&self.child, "INT"));
        self.ended()
    }

    /// Waits until it ends by itself.
    pub(crate) fn ended(mut self) -> Option<i32> {
        if let Some(said) = &mut self._out.1 {
            let mut rest = String::new();
            said.read_to_string(&mut rest).unwrap();
            print!("{rest}");
        }
        self.child.wait().unwrap().code()
    }

    pub(crate) fn url(&self) -> String {
        format!("http://127.0.0.1:{}/#{}", self.port, self.key)
    }

    /// As the page asks.
    pub(crate) fn ask(&self, name: &str, body: &Value) -> Answer {
        let body = body.to_string();
        let head =
            format!("Host: 127.0.0.1:{}\r\nX-Catoptra-Key: {}\r\nContent-Type: application/json", self.port, self.key);
        let length = body.len();
        self.send(format!("POST /api/{name} HTTP/1.1\r\n{head}\r\nContent-Length: {length}\r\n\r\n{body}").as_bytes())
    }

    /// JSON that must come.
    pub(crate) fn json(&self, name: &str, body: &Value) -> Value {
        let answer = self.ask(name, body);
        assert_eq!(answer.status, 200, "{name} {body}: {}", String::from_utf8_lossy(&answer.body));
        answer.json()
    }

    pub(crate) fn get(&self, path: &str) -> Answer {
        self.send(format!("GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{}\r\n\r\n", self.port).as_bytes())
    }

    /// Sends bytes as they are; status 0 when the connection ends without an answer.
    pub(crate) fn send(&self, bytes: &[u8]) -> Answer {
        let mut stream = TcpStream::connect(("127.0.0.1", self.port)).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(300))).unwrap();
        // It may be refused before all of it is sent.
        let _ = stream.write_all(bytes);
        read(BufReader::new(stream))
    }

    /// Sends what must be refused with one of these; nothing of it may have an effect.
    pub(crate) fn refuses_all(&self) {
        let Self { port, key, .. } = self;
        let own = format!("Host: 127.0.0.1:{port}");
        let api = |head: &str, body: &str| {
            let length = body.len();
            format!("POST /api/state HTTP/1.1\r\n{head}\r\nContent-Length: {length}\r\n\r\n{body}")
        };
        let full = format!("{own}\r\nX-Catoptra-Key: {key}\r\nContent-Type: application/json");
        let keyed = format!("X-Catoptra-Key: {key}\r\nContent-Type: application/json");
        let wrong = "0".repeat(32);
        let huge_head = format!("{full}\r\nX-Pad: {}", "a".repeat(1 << 20));
        let requests: Vec<(&str, String, &[u16])> = vec![
            ("a foreign origin", api(&format!("{full}\r\nOrigin: https://evil.example"), "{}"), &[403]),
            ("a page in a frame without origin", api(&format!("{full}\r\nOrigin: null"), "{}"), &[403]),
            ("the same host on another port", api(&format!("{full}\r\nOrigin: http://127.0.0.1:1"), "{}"), &[403]),
            (
                "a foreign page's picture",
                format!("GET / HTTP/1.1\r\n{own}\r\nSec-Fetch-Site: cross-site\r\n\r\n"),
                &[403],
            ),
            ("a rebound name", api(&format!("Host: evil.example:{port}\r\n{keyed}"), "{}"), &[421]),
            ("a rebound name for the page", format!("GET / HTTP/1.1\r\nHost: evil.example:{port}\r\n\r\n"), &[421]),
            ("a name that begins well", api(&format!("Host: localhost.evil.example:{port}\r\n{keyed}"), "{}"), &[421]),
            ("no host", api(&keyed, "{}"), &[400]),
            ("two hosts", api(&format!("{full}\r\nHost: evil.example"), "{}"), &[400]),
            (
                "a target that names another host",
                format!("GET http://evil.example/ HTTP/1.1\r\n{own}\r\n\r\n"),
                &[400, 421],
            ),
            ("no key", api(&format!("{own}\r\nContent-Type: application/json"), "{}"), &[401]),
            (
                "a wrong key",
                api(&format!("{own}\r\nX-Catoptra-Key: {wrong}\r\nContent-Type: application/json"), "{}"),
                &[401],
            ),
            ("a form", api(&format!("{own}\r\nX-Catoptra-Key: {key}\r\nContent-Type: text/plain"), "{}"), &[415]),
            ("a link that changes something", format!("GET /api/run/veto HTTP/1.1\r\n{full}\r\n\r\n"), &[405]),
            ("a post to the page", format!("POST / HTTP/1.1\r\n{full}\r\nContent-Length: 0\r\n\r\n"), &[405]),
            ("a path that climbs", format!("GET /../../etc/passwd HTTP/1.1\r\n{own}\r\n\r\n"), &[404]),
            ("the same in disguise", format!("GET /%2e%2e/%2e%2e/etc/passwd HTTP/1.1\r\n{own}\r\n\r\n"), &[404]),
            (
                "a gigabyte",
                format!(
                    "POST /api/state HTTP/1.1\r\n{full}\r\nContent-Length: 1000000000\r\n\r\n{}",
                    "a".repeat(1 << 20)
                ),
                &[413],
            ),
            (
                "a gigabyte in pieces",
                format!(
                    "POST /api/state HTTP/1.1\r\n{full}\r\nTransfer-Encoding: chunked\r\n\r\n3B9ACA00\r\n{}",
                    "a".repeat(1 << 20)
                ),
                &[413],
            ),
            ("a huge head", api(&huge_head, "{}"), &[431, 400, 0]),
            (
                "a WebSocket, and frames that make no sense",
                format!(
                    "GET /api/watch HTTP/1.1\r\n{full}\r\nUpgrade: websocket\r\n\
                     Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n\u{1}\u{7f}\u{7f}"
                ),
                &[405],
            ),
            ("no HTTP at all", "\u{16}\u{3}\u{1}\u{2}\r\n\r\n".to_owned(), &[400, 0]),
            (
                "nonsense in place of JSON",
                format!("POST /api/watch HTTP/1.1\r\n{full}\r\nContent-Length: 9\r\n\r\n{{\"after\":"),
                &[400],
            ),
            (
                "JSON that is nested without end",
                {
                    let deep = "[".repeat(100_000);
                    format!("POST /api/watch HTTP/1.1\r\n{full}\r\nContent-Length: {}\r\n\r\n{deep}", deep.len())
                },
                &[400],
            ),
        ];
        assert!(requests.len() >= 20);
        for (what, request, expected) in requests {
            let answer = self.send(request.as_bytes());
            assert!(
                expected.contains(&answer.status),
                "{what}: {} {}",
                answer.status,
                String::from_utf8_lossy(&answer.body)
            );
            assert!(!answer.body.windows(5).any(|part| part == b"root:"), "{what}");
            if answer.status > 0 && answer.status != 431 && what != "no HTTP at all" {
                let head = answer.head.to_ascii_lowercase();
                let safe = head.contains("content-security-policy: default-src 'none'")
                    && head.contains("x-content-type-options: nosniff");
                assert!(safe || answer.status == 400, "{what}: {head}");
            }
        }
        assert_eq!(self.json("state", &json!({}))["version"], env!("CARGO_PKG_VERSION"), "it still answers");
    }
}

impl Drop for Studio {
    fn drop(&mut self) {
        // It may have ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn parts(line: &str) -> (u16, String) {
    let (_, rest) = line.trim().split_once("http://127.0.0.1:").unwrap_or_else(|| panic!("{line:?}"));
    let (port, key) = rest.split_once("/#").unwrap();
    (port.parse().unwrap(), key.to_owned())
}

fn read(mut stream: impl BufRead) -> Answer {
    let mut head = String::new();
    loop {
        let mut line = String::new();
        match stream.read_line(&mut line) {
            Ok(n) if n > 0 && line != "\r\n" => head.push_str(&line),
            _ => break,
        }
    }
    let status = head.split(' ').nth(1).and_then(|status| status.parse().ok()).unwrap_or(0);
    let length = head
        .to_ascii_lowercase()
        .split("content-length:")
        .nth(1)
        .and_then(|rest| rest.split('\r').next()?.trim().parse().ok());
    let mut body = vec![0; length.unwrap_or(0)];
    if stream.read_exact(&mut body).is_err() {
        body.clear();
    }
    Answer { status, head, body }
}
