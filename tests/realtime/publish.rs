//! Subscribers over WebSocket: late ones, some that never read, and many that come and go.

use crate::support::fixture;
use catoptra::sink::{CurrentSample, PublishSink, Sink};
use catoptra::tally::Tally;
use std::collections::BTreeMap;
use std::net::{SocketAddr, TcpStream};
use std::time::{Duration, Instant};
use tungstenite::client::IntoClientRequest as _;
use tungstenite::http::HeaderValue;
use tungstenite::{Message, WebSocket};

fn publisher() -> PublishSink {
    PublishSink::listen("127.0.0.1:0".parse().unwrap(), &[], &fixture::rig()).unwrap()
}

/// A client that has been told which topics there are, by name.
fn connected(address: SocketAddr) -> (WebSocket<TcpStream>, BTreeMap<String, u64>) {
    let stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
    let mut request = format!("ws://{address}").into_client_request().unwrap();
    request.headers_mut().insert("Sec-WebSocket-Protocol", HeaderValue::from_static("foxglove.sdk.v1"));
    let (mut socket, _) = tungstenite::client(request, stream).unwrap();
    loop {
        let Message::Text(text) = socket.read().unwrap() else { continue };
        let said: serde_json::Value = serde_json::from_str(&text).unwrap();
        if said["op"] == "advertise" {
            let channels = said["channels"].as_array().unwrap();
            let topic = |c: &serde_json::Value| (c["topic"].as_str().unwrap().to_owned(), c["id"].as_u64().unwrap());
            assert!(channels.iter().all(|c| c["encoding"] == "protobuf"), "{said}");
            return (socket, channels.iter().map(topic).collect());
        }
    }
}

fn subscribe(socket: &mut WebSocket<TcpStream>, channels: &[u64]) {
    let each = channels.iter().map(|id| serde_json::json!({"id": id, "channelId": id}));
    let request = serde_json::json!({"op": "subscribe", "subscriptions": each.collect::<Vec<_>>()});
    socket.send(Message::text(request.to_string())).unwrap();
}

/// Subscription and time of the next message.
fn next(socket: &mut WebSocket<TcpStream>) -> (u64, u64) {
    loop {
        if let Message::Binary(bytes) = socket.read().unwrap()
            && bytes[0] == 1
        {
            let id = u32::from_le_bytes(bytes[1..5].try_into().unwrap());
            return (id.into(), u64::from_le_bytes(bytes[5..13].try_into().unwrap()));
        }
    }
}

#[test]
fn who_joins_late_gets_the_rig_and_the_last_frame_at_once() {
    let mut publisher = publisher();
    for seq in 0..3 {
        publisher.write(&fixture::complete(seq, 1_000 + seq as i64), None).unwrap();
    }
    let (mut socket, topics) = connected(publisher.address());
    let wanted = ["/camera/calibration", "/tf", "/catheter/estimate", "/catheter/deflection", "/scene"];
    let ids = wanted.map(|topic| topics[topic]);
    subscribe(&mut socket, &ids);
    let got: BTreeMap<u64, u64> = (0..5).map(|_| next(&mut socket)).collect();
    // The rig was told with the first frame; of the frames the last is told.
    assert_eq!(ids.map(|id| got[&id]), [1_000, 1_000, 1_002, 1_002, 1_002]);
    publisher.write(&fixture::complete(3, 1_003), None).unwrap();
    assert_eq!(next(&mut socket).1, 1_003);
    // Currents too, as in the log.
    publisher
        .write_current(&CurrentSample { host_ns: 1_003, arrival_ns: 1_004, seq: None, current_a: vec![0.1] })
        .unwrap();
    subscribe(&mut socket, &[topics["/coil/current"]]);
    while next(&mut socket) != (topics["/coil/current"], 1_004) {}
    publisher.finish(&Tally::default()).unwrap();
}

#[test]
fn a_subscriber_that_never_reads_costs_nothing() {
    let mut publisher = publisher();
    let (mut deaf, topics) = connected(publisher.address());
    let (mut reader, _) = connected(publisher.address());
    subscribe(&mut deaf, &topics.values().copied().collect::<Vec<_>>());
    subscribe(&mut reader, &[topics["/catheter/deflection"]]);
    publisher.write(&fixture::complete(0, 1), None).unwrap();
    next(&mut reader);
    let began = Instant::now();
    // A minute of 60 Hz; some 40 MB for who reads all.
    for seq in 1..3600 {
        publisher.write(&fixture::complete(seq, 1 + seq as i64), None).unwrap();
    }
    assert!(began.elapsed() < Duration::from_secs(30), "{:?}", began.elapsed());
    // A client that reads gets new messages.
    while next(&mut reader).1 != 3600 {}
    publisher.finish(&Tally::default()).unwrap();
}

#[test]
fn a_thousand_subscribers_that_come_and_vanish_leave_nothing_behind() {
    let mut publisher = publisher();
    let address = publisher.address();
    let crowd = std::thread::spawn(move || {
        for k in 0..1000 {
            match k % 3 {
                // A whole client, a handshake that is never finished, a connection without a word.
                0 => {
                    let (mut socket, topics) = connected(address);
                    subscribe(&mut socket, &[topics["/catheter/estimate"]]);
                }
                1 => {
                    let mut stream = TcpStream::connect(address).unwrap();
                    std::io::Write::write_all(&mut stream, b"GET / HTTP/1.1\r\nUpgr").unwrap();
                }
                _ => drop(TcpStream::connect(address).unwrap()),
            }
        }
    });
    let (mut seq, mut longest) = (0, Duration::ZERO);
    while !crowd.is_finished() {
        let began = Instant::now();
        publisher.write(&fixture::complete(seq, 1 + seq as i64), None).unwrap();
        longest = longest.max(began.elapsed());
        seq += 1;
        std::thread::sleep(Duration::from_millis(2));
    }
    crowd.join().unwrap();
    assert!(longest < Duration::from_secs(1), "a row took {longest:?}");
    let (mut socket, topics) = connected(address);
    subscribe(&mut socket, &[topics["/catheter/deflection"]]);
    assert_eq!(next(&mut socket).1, seq);
    publisher.finish(&Tally::default()).unwrap();
}

#[test]
fn an_address_that_is_taken_is_named() {
    let publisher = publisher();
    let error = PublishSink::listen(publisher.address(), &[], &fixture::rig()).err().unwrap().to_string();
    assert!(error.contains(&publisher.address().to_string()) && error.contains("--publish"), "{error}");
}

/// What the server answers to a request for a WebSocket with these headers.
fn answer(address: SocketAddr, host: &str, origin: Option<&str>) -> String {
    use std::io::{Read as _, Write as _};
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
    let origin = origin.map_or(String::new(), |origin| format!("Origin: {origin}\r\n"));
    let request = format!(
        "GET / HTTP/1.1\r\nHost: {host}\r\n{origin}Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n\
         Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n"
    );
    stream.write_all(request.as_bytes()).unwrap();
    let mut bytes = [0; 12];
    stream.read_exact(&mut bytes).unwrap();
    String::from_utf8_lossy(&bytes).into_owned()
}

#[test]
fn web_pages_of_others_may_not_read_along() {
    let origins = ["https://lab.example.org".to_owned()];
    let mut publisher = PublishSink::listen("127.0.0.1:0".parse().unwrap(), &origins, &fixture::rig()).unwrap();
    let address = publisher.address();
    let here = address.to_string();
    for origin in
        [None, Some("https://app.foxglove.dev"), Some("https://lab.example.org"), Some("http://localhost:3000")]
    {
        assert_eq!(answer(address, &here, origin), "HTTP/1.1 101", "{origin:?}");
    }
    for origin in ["https://evil.example", "null", "http://evil.example:8765"] {
        assert_eq!(answer(address, &here, Some(origin)), "HTTP/1.1 403", "{origin}");
    }
    // A name that was made to point here.
    assert_eq!(answer(address, &format!("evil.example:{}", address.port()), None), "HTTP/1.1 403");
    publisher.finish(&Tally::default()).unwrap();
}

#[test]
fn connections_that_are_no_websockets_cost_nothing() {
    use std::io::Write as _;
    let mut publisher = publisher();
    let mut idle = Vec::new();
    for k in 0..400_u32 {
        let mut stream = TcpStream::connect(publisher.address()).unwrap();
        let rubbish: Vec<u8> = (0..k).map(|i| (i * k) as u8).collect();
        let _ = stream.write_all(&rubbish);
        if k % 8 == 0 {
            idle.push(stream);
        }
    }
    let began = Instant::now();
    publisher.write(&fixture::complete(0, 1_000), None).unwrap();
    assert!(began.elapsed() < Duration::from_secs(1));
    let (mut socket, topics) = connected(publisher.address());
    subscribe(&mut socket, &[topics["/catheter/deflection"]]);
    assert_eq!(next(&mut socket).1, 1_000);
    publisher.finish(&Tally::default()).unwrap();
}
