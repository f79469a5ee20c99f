//! Who is let in.
//!
//! - `Host` must name this server: a page that has its own name point here (DNS rebinding) is refused.
//! - `Origin` and `Sec-Fetch-Site`, where a browser sends them, must be those of this page: other pages are refused.
//! - What is behind `/api/` needs the key of this start, which only who reads the program's output has, as a header:
//!   other pages cannot send that, nor can other users of this computer.

use axum::http::header::{CONTENT_TYPE, HOST, ORIGIN};
use axum::http::{HeaderMap, Method, Uri};
use std::net::{IpAddr, SocketAddr};

/// The header with the key.
const KEY: &str = "x-catoptra-key";

/// Bytes of the key.
const KEY_BYTES: usize = 16;

/// Knows the server's names and its key.
#[derive(Debug)]
pub(super) struct Guard {
    address: SocketAddr,
    /// A host that was named on the command line.
    name: Option<String>,
    key: String,
}

/// Why a request is refused: status, and words.
pub(super) type Refused = (u16, &'static str);

impl Guard {
    /// # Errors
    /// When the system has no random numbers.
    pub(super) fn new(address: SocketAddr, name: Option<&str>) -> std::io::Result<Self> {
        let mut bytes = [0; KEY_BYTES];
        getrandom::fill(&mut bytes).map_err(std::io::Error::other)?;
        let key = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
        Ok(Self { address, name: name.map(str::to_ascii_lowercase), key })
    }

    pub(super) fn key(&self) -> &str {
        &self.key
    }

    /// Judges a request by all but its body.
    pub(super) fn check(&self, method: &Method, uri: &Uri, headers: &HeaderMap) -> Result<(), Refused> {
        let mut hosts = headers.get_all(HOST).iter();
        let host = match (hosts.next().and_then(|host| host.to_str().ok()), hosts.next()) {
            (Some(host), None) => host,
            _ => return Err((400, "one Host header is needed")),
        };
        if !self.is_ours(host) || uri.authority().is_some_and(|authority| authority.as_str() != host) {
            return Err((421, "this is not the host that was asked for"));
        }
        let ours = |origin: &str| origin.strip_prefix("http://").is_some_and(|of| of.eq_ignore_ascii_case(host));
        if headers.get_all(ORIGIN).iter().any(|origin| !origin.to_str().is_ok_and(ours)) {
            return Err((403, "pages from elsewhere are not served"));
        }
        let site = headers.get_all("sec-fetch-site").iter();
        if site.into_iter().any(|site| !["same-origin", "none"].contains(&site.to_str().unwrap_or(""))) {
            return Err((403, "pages from elsewhere are not served"));
        }
        if uri.path().starts_with("/api/") {
            if method != Method::POST {
                return Err((405, "only POST is answered here"));
            }
            let json = |kind: &str| kind.split(';').next().is_some_and(|kind| kind.trim() == "application/json");
            if !headers.get(CONTENT_TYPE).is_some_and(|kind| kind.to_str().is_ok_and(json)) {
                return Err((415, "only application/json is read here"));
            }
            let given = headers.get(KEY).map(|key| key.as_bytes()).unwrap_or_default();
            if !same(given, self.key.as_bytes()) {
                return Err((401, "the key is missing or wrong: open the address that the program printed"));
            }
        } else if method != Method::GET && method != Method::HEAD {
            return Err((405, "only GET is answered here"));
        }
        Ok(())
    }

    /// Whether a `Host` means this server. Addresses cannot be rebound: where all are listened to, any will do.
    fn is_ours(&self, host: &str) -> bool {
        let host = host.to_ascii_lowercase();
        let (name, port) = match host.rsplit_once(':') {
            Some((name, port)) if !port.ends_with(']') => (name, port.parse::<u16>().ok()),
            _ => (host.as_str(), Some(80)),
        };
        if port != Some(self.address.port()) {
            return false;
        }
        let literal = name.strip_prefix('[').and_then(|name| name.strip_suffix(']')).unwrap_or(name);
        match literal.parse::<IpAddr>() {
            Ok(ip) => ip.is_loopback() || ip == self.address.ip() || self.address.ip().is_unspecified(),
            Err(_) => name == "localhost" || self.name.as_deref() == Some(name),
        }
    }
}

/// Compares in a time that does not tell where two differ.
fn same(a: &[u8], b: &[u8]) -> bool {
    a.len() == b.len() && a.iter().zip(b).fold(0, |off, (a, b)| off | (a ^ b)) == 0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn guard(address: &str, name: Option<&str>) -> Guard {
        Guard { key: "abc".to_owned(), ..Guard::new(address.parse().unwrap(), name).unwrap() }
    }

    #[test]
    fn only_names_that_cannot_be_rebound_are_hosts() {
        let own = guard("127.0.0.1:8000", None);
        for host in ["127.0.0.1:8000", "localhost:8000", "LOCALHOST:8000", "[::1]:8000", "127.0.0.2:8000"] {
            assert!(own.is_ours(host), "{host}");
        }
        let others = [
            "127.0.0.1",
            "127.0.0.1:8001",
            "evil.example:8000",
            "localhost.evil.example:8000",
            "10.0.0.1:8000",
            "",
            ":",
            "[::1]",
            "localhost:8000:8000",
        ];
        for host in others {
            assert!(!own.is_ours(host), "{host}");
        }
        let named = guard("10.1.2.3:80", Some("Lab.example"));
        assert!(named.is_ours("lab.example") && named.is_ours("10.1.2.3:80") && !named.is_ours("other.example"));
        assert!(
            guard("0.0.0.0:90", None).is_ours("10.9.8.7:90") && !guard("0.0.0.0:90", None).is_ours("evil.example:90")
        );
    }

    #[test]
    fn two_starts_have_two_keys() {
        let key = || Guard::new("127.0.0.1:1".parse().unwrap(), None).unwrap().key;
        let (a, b) = (key(), key());
        assert!(a != b && a.len() == 2 * KEY_BYTES, "{a} {b}");
        assert!(same(b"abc", b"abc") && !same(b"abc", b"abd") && !same(b"ab", b"abc") && !same(b"", b"abc"));
    }
}
