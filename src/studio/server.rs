//! The server: one thread that waits, and a few for what takes time.

use super::api;
use super::assets;
use super::desk::Desk;
use super::guard::{Guard, Refused};
use super::{Refusal, Reply};
use axum::body::{Body, Bytes};
use axum::extract::rejection::BytesRejection;
use axum::extract::{DefaultBodyLimit, Request, State};
use axum::http::{HeaderName, HeaderValue, StatusCode, Uri, header};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use axum::{Router, routing};
use std::io;
use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::thread::{Builder, JoinHandle};
use std::time::Duration;
use tokio::sync::oneshot;

/// Longest request body, bytes.
const MAX_BODY: usize = 256 * 1024;
/// But for a picture of up to 48 MB that is dropped in: it comes in base64.
const MAX_PICTURE: usize = 48 * 1024 * 1024 / 3 * 4 + MAX_BODY;
/// A header that says what a picture is of.
const ABOUT: HeaderName = HeaderName::from_static("x-about");
/// Requests that are worked on at once.
const MAX_CONCURRENT_REQUESTS: usize = 6;
/// How long requests may take when the server ends.
const SHUTDOWN_TIMEOUT: Duration = Duration::from_millis(300);

/// What every answer says to the browser: nothing but the page's own files is run, shown or asked.
const HEADERS: [(HeaderName, &str); 7] = [
    (
        header::CONTENT_SECURITY_POLICY,
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self'; \
         base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    ),
    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (header::X_FRAME_OPTIONS, "DENY"),
    (header::REFERRER_POLICY, "no-referrer"),
    (header::CACHE_CONTROL, "no-store"),
    (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
    (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
];

#[derive(Clone)]
struct Shared {
    desk: Arc<Desk>,
    guard: Arc<Guard>,
}

/// Serves the page until it is dropped.
pub(crate) struct Server {
    url: String,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    /// Begins to listen at `address`; `name` is the host that was asked for, if it is no address.
    ///
    /// # Errors
    /// When the address is taken or is not this computer's.
    pub(crate) fn start(address: SocketAddr, name: Option<&str>, desk: Desk) -> io::Result<Self> {
        let listener = TcpListener::bind(address)?;
        listener.set_nonblocking(true)?;
        let address = listener.local_addr()?;
        let guard = Arc::new(Guard::new(address, name)?);
        let host = name.map_or_else(|| address.to_string(), |name| format!("{name}:{}", address.port()));
        let url = format!("http://{host}/#{}", guard.key());
        let shared = Shared { desk: Arc::new(desk), guard };
        let runtime = tokio::runtime::Builder::new_current_thread()
            // Time too: after the limit of open files is reached, accepting waits for a moment.
            .enable_all()
            .max_blocking_threads(MAX_CONCURRENT_REQUESTS)
            .thread_name("studio work")
            .build()?;
        let (stop, stopped) = oneshot::channel::<()>();
        let listener = {
            let _inside = runtime.enter();
            tokio::net::TcpListener::from_std(listener)?
        };
        let thread = Builder::new().name("studio".to_owned()).spawn(move || {
            let served = axum::serve(listener, router(shared));
            runtime.spawn(async move { served.await });
            // Gone is as good as told.
            let _ = runtime.block_on(stopped);
            runtime.shutdown_timeout(SHUTDOWN_TIMEOUT);
        })?;
        Ok(Self { url, stop: Some(stop), thread: Some(thread) })
    }

    /// The address of the page, with its key.
    pub(crate) fn url(&self) -> &str {
        &self.url
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            // A panic there is told by the thread itself.
            let _ = thread.join();
        }
    }
}

fn router(shared: Shared) -> Router {
    Router::new()
        .route("/api/{*name}", routing::any(answer))
        .route("/api/board/keep", routing::any(answer).layer(DefaultBodyLimit::max(MAX_PICTURE)))
        .fallback(asset)
        .layer(DefaultBodyLimit::max(MAX_BODY))
        .layer(from_fn_with_state(shared.clone(), guarded))
        .with_state(shared)
}

async fn guarded(State(shared): State<Shared>, request: Request, next: Next) -> Response {
    let mut response = match shared.guard.check(request.method(), request.uri(), request.headers()) {
        Ok(()) => next.run(request).await,
        Err((status, words)) => refused((status, words)),
    };
    for (name, value) in HEADERS {
        response.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    response
}

fn refused((status, words): Refused) -> Response {
    error_response(&Refusal { status, words: words.to_owned() })
}

fn error_response(refusal: &Refusal) -> Response {
    let status = StatusCode::from_u16(refusal.status).unwrap_or(StatusCode::BAD_REQUEST);
    let body = serde_json::json!({ "error": refusal.words }).to_string();
    (status, [(header::CONTENT_TYPE, "application/json")], body).into_response()
}

async fn asset(uri: Uri) -> Response {
    match assets::find(uri.path()) {
        Some(asset) => ([(header::CONTENT_TYPE, asset.kind)], asset.bytes).into_response(),
        None => refused((404, "there is nothing here")),
    }
}

/// Asks the desk, in a thread of its own: pictures are decoded there.
async fn answer(State(shared): State<Shared>, uri: Uri, body: Result<Bytes, BytesRejection>) -> Response {
    let body = match body {
        Ok(body) => body,
        Err(error) => return error_response(&Refusal { status: error.status().as_u16(), words: error.body_text() }),
    };
    let desk = Arc::clone(&shared.desk);
    let work = move || {
        let name = uri.path().strip_prefix("/api/").unwrap_or_default();
        api::answer(&desk, name, &body)
    };
    let reply = match tokio::task::spawn_blocking(work).await {
        Ok(Ok(reply)) => reply,
        Ok(Err(refusal)) => return error_response(&refusal),
        Err(_) => return refused((500, "this failed within the program: please report it")),
    };
    match reply {
        Reply::Json(value) => ([(header::CONTENT_TYPE, "application/json")], value.to_string()).into_response(),
        Reply::Jpeg { bytes, about } => {
            let about = HeaderValue::from_str(&about).unwrap_or(HeaderValue::from_static(""));
            let headers = [(header::CONTENT_TYPE, HeaderValue::from_static("image/jpeg")), (ABOUT, about)];
            (headers, Body::from(bytes)).into_response()
        }
        Reply::Nothing => StatusCode::NO_CONTENT.into_response(),
    }
}
