//! Access control for the server of [`PublishSink`](super::PublishSink), which alone would let any web page in the
//! user's browser read along.
//!
//! In: connections at the public address. Each sends the head of an HTTP request; it is passed on to the server when
//! - its `Host` is an address, this computer's name or `localhost`: a page whose name was made to point here (DNS
//!   rebinding) sends that name, and
//! - it has no `Origin` (a program), or that of Foxglove, of this computer, or an allowed one.
//!
//! The server itself listens at an unguessable address of this computer. What this cannot keep out: programs, including
//! those on other computers if they can reach the public address.

use std::io::{self, Read as _, Write as _};
use std::net::{IpAddr, Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::thread::Builder;
use std::time::{Duration, Instant};

/// Longest head of a request, bytes.
const LONGEST_HEAD: usize = 16 * 1024;
/// Time that a client may take to send it.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(5);
/// Most simultaneous connections.
const MAX_CLIENTS: usize = 256;
/// How often an idle gate checks whether it should close.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// An open gate.
pub(super) struct Gate {
    address: SocketAddr,
    shared: Arc<Shared>,
}

struct Shared {
    rules: Rules,
    server: SocketAddr,
    closed: AtomicBool,
    clients: AtomicUsize,
    refused: AtomicU64,
}

/// Rules of admission.
struct Rules {
    /// Further allowed web pages, for example `https://lab.example.org`.
    origins: Vec<String>,
    /// Name of this computer.
    name: String,
}

/// An unguessable address of this computer, for the server behind the gate.
pub(super) fn hidden_address() -> IpAddr {
    // All of 127.0.0.0/8 is this computer; elsewhere only 127.0.0.1 is certain to exist.
    if cfg!(target_os = "linux") {
        let mut random = fastrand::Rng::new();
        IpAddr::V4(Ipv4Addr::new(127, random.u8(1..=254), random.u8(..), random.u8(1..=254)))
    } else {
        IpAddr::V4(Ipv4Addr::LOCALHOST)
    }
}

impl Gate {
    /// Listens at `address` for the server at `server`.
    ///
    /// # Errors
    /// When the address is in use, or not this computer's.
    pub(super) fn open(address: SocketAddr, server: SocketAddr, origins: &[String]) -> io::Result<Self> {
        let listener = TcpListener::bind(address)?;
        let address = listener.local_addr()?;
        listener.set_nonblocking(true)?;
        let origins = origins.iter().map(|origin| origin.trim_end_matches('/').to_ascii_lowercase()).collect();
        let shared = Arc::new(Shared {
            rules: Rules { origins, name: own_name() },
            server,
            closed: AtomicBool::new(false),
            clients: AtomicUsize::new(0),
            refused: AtomicU64::new(0),
        });
        let inside = Arc::clone(&shared);
        Builder::new().name("gate".to_owned()).spawn(move || inside.accept(&listener))?;
        Ok(Self { address, shared })
    }

    pub(super) fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for Gate {
    fn drop(&mut self) {
        self.shared.closed.store(true, Ordering::Relaxed);
        let refused = self.shared.refused.load(Ordering::Relaxed);
        if refused > 1 {
            tracing::warn!("ws://{}: {refused} connections were refused", self.address);
        }
    }
}

impl Shared {
    fn accept(self: Arc<Self>, listener: &TcpListener) {
        while !self.closed.load(Ordering::Relaxed) {
            match listener.accept() {
                Ok((client, _)) => {
                    let this = Arc::clone(&self);
                    if self.clients.fetch_add(1, Ordering::Relaxed) >= MAX_CLIENTS {
                        self.clients.fetch_sub(1, Ordering::Relaxed);
                        self.refuse(client, "503 Service Unavailable", "too many subscribers");
                        continue;
                    }
                    let serve = move || {
                        // A failure of one client does not affect the others.
                        let _ = this.serve(client);
                        this.clients.fetch_sub(1, Ordering::Relaxed);
                    };
                    if Builder::new().name("subscriber".to_owned()).spawn(serve).is_err() {
                        self.clients.fetch_sub(1, Ordering::Relaxed);
                    }
                }
                Err(_) => std::thread::sleep(POLL_INTERVAL),
            }
        }
    }

    fn serve(&self, mut client: TcpStream) -> io::Result<()> {
        client.set_nonblocking(false)?;
        let head = read_head(&mut client)?;
        if let Err(why) = self.rules.admits(&head) {
            self.refuse(client, "403 Forbidden", &why);
            return Ok(());
        }
        let mut server = TcpStream::connect_timeout(&self.server, REQUEST_TIMEOUT)?;
        for stream in [&client, &server] {
            stream.set_nodelay(true)?;
            stream.set_read_timeout(None)?;
        }
        server.write_all(&head)?;
        let (mut from_client, mut to_server) = (client.try_clone()?, server.try_clone()?);
        let up = Builder::new().name("subscriber".to_owned()).spawn(move || {
            let _ = io::copy(&mut from_client, &mut to_server);
            let _ = to_server.shutdown(Shutdown::Both);
        })?;
        let copied = io::copy(&mut server, &mut client);
        let _ = client.shutdown(Shutdown::Both);
        let _ = up.join();
        copied.map(drop)
    }

    fn refuse(&self, mut client: TcpStream, status: &str, why: &str) {
        if self.refused.fetch_add(1, Ordering::Relaxed) == 0 {
            tracing::warn!("a connection is refused: {why}; more are counted");
        }
        let _ = write!(client, "HTTP/1.1 {status}\r\nConnection: close\r\nContent-Length: 0\r\n\r\n");
        let _ = client.shutdown(Shutdown::Both);
    }
}

/// Reads up to the empty line that ends the head.
fn read_head(client: &mut TcpStream) -> io::Result<Vec<u8>> {
    let began = Instant::now();
    let mut head = Vec::new();
    let mut bytes = [0; 1024];
    while !head.windows(4).any(|four| four == b"\r\n\r\n") {
        let left = REQUEST_TIMEOUT.checked_sub(began.elapsed()).filter(|left| !left.is_zero());
        client.set_read_timeout(Some(left.ok_or(io::ErrorKind::TimedOut)?))?;
        let got = client.read(&mut bytes)?;
        if got == 0 || head.len() > LONGEST_HEAD {
            return Err(io::ErrorKind::InvalidData.into());
        }
        head.extend_from_slice(bytes.get(..got).unwrap_or_default());
    }
    Ok(head)
}

impl Rules {
    /// Whether a request is admitted; if not, why.
    fn admits(&self, head: &[u8]) -> Result<(), String> {
        let head = String::from_utf8_lossy(head);
        let all = |name: &str| -> Vec<String> {
            let lines = head.lines().skip(1).take_while(|line| !line.is_empty());
            let pairs = lines.filter_map(|line| line.split_once(':'));
            pairs
                .filter(|(key, _)| key.trim().eq_ignore_ascii_case(name))
                .map(|(_, value)| value.trim().to_ascii_lowercase())
                .collect()
        };
        match all("host").as_slice() {
            [host] if self.is_here(host_of(host)) => {}
            [host] => return Err(format!("`{}` is not a name of this computer", host.escape_debug())),
            _ => return Err("the request names no host, or several".to_owned()),
        }
        match all("origin").as_slice() {
            [] => Ok(()),
            [origin] if self.is_trusted(origin) => Ok(()),
            [origin, ..] => Err(format!("the web page {} may not subscribe (--allow-origin)", origin.escape_debug())),
        }
    }

    fn is_here(&self, host: &str) -> bool {
        let address = host.trim_start_matches('[').trim_end_matches(']').parse::<IpAddr>().is_ok();
        let named =
            || self.origins.iter().any(|origin| origin.split_once("://").is_some_and(|(_, o)| host_of(o) == host));
        address || host == "localhost" || self.is_own_name(host) || named()
    }

    fn is_own_name(&self, host: &str) -> bool {
        !self.name.is_empty() && (host == self.name || host.strip_suffix(".local") == Some(&self.name))
    }

    fn is_trusted(&self, origin: &str) -> bool {
        if self.origins.iter().any(|allowed| allowed == origin) {
            return true;
        }
        match origin.split_once("://") {
            Some(("http" | "https", rest)) => {
                let host = host_of(rest);
                let loopback = host.trim_matches(['[', ']']).parse::<IpAddr>().is_ok_and(|ip| ip.is_loopback());
                loopback || host == "localhost" || (origin.starts_with("https") && is_foxglove(host))
            }
            // An application's own pages, such as Foxglove's; `null` is the origin of a file or of a frame in any page.
            Some(_) => true,
            None => false,
        }
    }
}

fn is_foxglove(host: &str) -> bool {
    host == "foxglove.dev" || host.ends_with(".foxglove.dev")
}

/// Host without its port.
fn host_of(text: &str) -> &str {
    match text.rsplit_once(':') {
        Some((host, port)) if !port.is_empty() && port.bytes().all(|b| b.is_ascii_digit()) => host,
        _ => text,
    }
}

fn own_name() -> String {
    #[cfg(unix)]
    {
        rustix::system::uname().nodename().to_string_lossy().to_ascii_lowercase()
    }
    #[cfg(not(unix))]
    {
        String::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn admits(host: &str, origin: Option<&str>) -> bool {
        let rules = Rules { origins: vec!["https://lab.example.org".to_owned()], name: "tank".to_owned() };
        let origin = origin.map_or(String::new(), |origin| format!("Origin: {origin}\r\n"));
        rules.admits(format!("GET / HTTP/1.1\r\nHost: {host}\r\n{origin}\r\n").as_bytes()).is_ok()
    }

    #[test]
    fn programs_foxglove_and_this_computer_are_let_in_and_web_pages_are_not() {
        let here = "127.0.0.1:8765";
        for origin in [
            "https://app.foxglove.dev",
            "http://localhost:8080",
            "http://127.0.0.1:8765",
            "file://",
            "https://lab.example.org",
        ] {
            assert!(admits(here, Some(origin)), "{origin}");
        }
        assert!(
            admits(here, None) && admits("tank:8765", None) && admits("tank.local", None) && admits("[::1]:8765", None)
        );
        for origin in [
            "https://evil.example",
            "null",
            "http://app.foxglove.dev",
            "https://foxglove.dev.evil.example",
            "https://evilfoxglove.dev",
            "https://localhost.evil.example",
            "https://lab.example.org.evil.example",
        ] {
            assert!(!admits(here, Some(origin)), "{origin}");
        }
    }

    #[test]
    fn a_name_that_was_made_to_point_here_is_not_let_in() {
        assert!(!admits("evil.example:8765", None));
        assert!(!admits("evil.example:8765", Some("http://evil.example:8765")));
        assert!(!admits("127.0.0.1.evil.example", None));
        let rules = Rules { origins: Vec::new(), name: "tank".to_owned() };
        assert!(rules.admits(b"GET / HTTP/1.1\r\n\r\n").is_err());
        assert!(rules.admits(b"GET / HTTP/1.1\r\nHost: localhost\r\nHost: evil.example\r\n\r\n").is_err());
    }
}
