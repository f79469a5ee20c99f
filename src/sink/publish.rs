//! [`PublishSink`]: the topics of the log over a WebSocket, for Foxglove and for programs (protocol `foxglove.sdk.v1`).
//!
//! A late subscriber immediately gets the last message of every topic it subscribes to: the rig and the last frame.
//! Every client has its own queue; one that does not read loses its oldest messages without affecting others. Message
//! times are the host's, as in the log.

use super::encoder::{Message, MessageEncoder, file_time_ns};
use super::gate::{Gate, hidden_address};
use super::{CurrentSample, PictureCount, Sink, SinkError};
use crate::estimate::Estimate;
use crate::log::schema::{ENCODING, Topic};
use crate::rig::Rig;
use crate::source::Picture;
use crate::tally::{Tally, Totals};
use foxglove::websocket::{ChannelView, Client, ServerListener};
use foxglove::{
    ChannelBuilder, Context, FoxgloveError, PartialMetadata, RawChannel, WebSocketServer, WebSocketServerHandle,
};
use parking_lot::Mutex;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

/// Longest queue of one client, messages: two seconds of 60 Hz on all topics.
const MAX_WAITING: usize = 600;
/// Time for the last messages to leave before the connections are closed.
const LEAVING: Duration = Duration::from_millis(100);

/// Serves subscribers.
pub struct PublishSink {
    /// `None` when finished.
    server: Option<(WebSocketServerHandle, Gate)>,
    address: SocketAddr,
    /// Keeps the channels alive.
    _context: Arc<Context>,
    board: Arc<LastMessages>,
    encoder: MessageEncoder,
    begun: bool,
    /// Host's time of the last frame, nanoseconds since 1970.
    last_ns: u64,
}

/// A message and its time, nanoseconds since 1970.
type Published = (u64, Vec<u8>);

/// The last message of each topic, in the order of [`Topic::ALL`].
struct LastMessages {
    channels: Vec<Arc<RawChannel>>,
    last: Mutex<Vec<Option<Published>>>,
}

impl PublishSink {
    /// Begins to listen at `address`. Web pages are admitted if they are Foxglove's or this computer's, or their origin
    /// is one of `origins`.
    ///
    /// # Errors
    /// [`SinkError::Publish`] when the address is in use or is not this computer's.
    pub fn listen(address: SocketAddr, origins: &[String], rig: &Rig) -> Result<Self, SinkError> {
        let refused = |reason: FoxgloveError| SinkError::Publish { address, reason: reason.to_string() };
        let context = Context::new();
        let channel = |topic: Topic| {
            let builder = ChannelBuilder::new(topic.name()).message_encoding(ENCODING).schema(topic.schema());
            builder.context(&context).build_raw().map_err(refused)
        };
        let channels: Vec<_> = Topic::ALL.into_iter().map(channel).collect::<Result<_, _>>()?;
        let board = Arc::new(LastMessages { last: Mutex::new(vec![None; channels.len()]), channels });
        let hidden = hidden_address();
        let server = WebSocketServer::new()
            .name(concat!("catoptra ", env!("CARGO_PKG_VERSION")))
            .bind(hidden.to_string(), 0)
            .message_backlog_size(MAX_WAITING)
            .listener(Arc::clone(&board) as Arc<dyn ServerListener>)
            .context(&context)
            .start_blocking()
            .map_err(refused)?;
        let inside = SocketAddr::new(hidden, server.port());
        let gate = Gate::open(address, inside, origins)
            .map_err(|error| SinkError::Publish { address, reason: error.to_string() })?;
        let address = gate.address();
        Ok(Self {
            server: Some((server, gate)),
            address,
            _context: context,
            board,
            encoder: MessageEncoder::new(rig),
            begun: false,
            last_ns: 1,
        })
    }

    /// The count of pictures goes into `/health`, as in the log's.
    #[must_use]
    pub fn with_picture_count(mut self, count: Arc<PictureCount>) -> Self {
        self.encoder.set_picture_count(count);
        self
    }

    /// Where it listens, with the port that the system chose if port 0 was requested.
    pub fn address(&self) -> SocketAddr {
        self.address
    }
}

impl LastMessages {
    fn publish(&self, message: Message, time_ns: u64) {
        let Some(at) = Topic::ALL.iter().position(|topic| *topic == message.topic) else { return };
        // The lock is held while publishing, so that a client that subscribes meanwhile gets it once, not twice.
        let mut last = self.last.lock();
        if let (Some(channel), Some(slot)) = (self.channels.get(at), last.get_mut(at)) {
            channel.log_with_meta(&message.bytes, PartialMetadata::with_log_time(time_ns));
            *slot = Some((time_ns, message.bytes));
        }
    }
}

impl ServerListener for LastMessages {
    fn on_subscribe(&self, client: Client, channel: ChannelView) {
        let last = self.last.lock();
        let Some(at) = self.channels.iter().position(|known| known.topic() == channel.topic()) else { return };
        if let (Some(channel), Some(Some((time_ns, bytes)))) = (self.channels.get(at), last.get(at)) {
            let time = PartialMetadata::with_log_time(*time_ns);
            channel.log_with_meta_to_sink(bytes, time, client.sink_id());
        }
    }
}

impl Sink for PublishSink {
    fn write(&mut self, estimate: &Estimate, _: Option<&Picture>) -> Result<(), SinkError> {
        let time_ns = file_time_ns(estimate.host.map_or(estimate.stamp.ns, |host| host.arrival_ns));
        self.last_ns = time_ns;
        if !self.begun {
            self.begun = true;
            self.encoder.rig(estimate.stamp.ns)?.into_iter().for_each(|message| self.board.publish(message, time_ns));
        }
        self.encoder.frame(estimate)?.into_iter().for_each(|message| self.board.publish(message, time_ns));
        Ok(())
    }

    fn write_current(&mut self, sample: &CurrentSample) -> Result<(), SinkError> {
        self.board.publish(MessageEncoder::current(sample)?, file_time_ns(sample.arrival_ns));
        Ok(())
    }

    fn write_totals(&mut self, totals: &Totals) -> Result<(), SinkError> {
        self.board.publish(self.encoder.totals(totals)?, self.last_ns);
        Ok(())
    }

    fn finish(&mut self, tally: &Tally) -> Result<(), SinkError> {
        self.write_totals(&tally.totals())?;
        if let Some((server, _gate)) = self.server.take() {
            std::thread::sleep(LEAVING);
            // Dropped without waiting: a client that never reads would block the end of the run for ever.
            drop(server.stop());
        }
        Ok(())
    }
}
