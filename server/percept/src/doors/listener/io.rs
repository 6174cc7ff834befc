//! A socket that notes what happens on it, for the one who watches the connection.

use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::task::{Context, Poll, ready};
use std::time::{Duration, Instant};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

/// What was seen of a socket.
pub(super) struct Traffic {
    begin: Instant,
    /// Bytes that came.
    received: AtomicU64,
    /// Milliseconds after `begin`, plus one, since when a write waits for the peer to read; 0 if none does.
    write_waits: AtomicU64,
}

impl Traffic {
    pub(super) fn new() -> Arc<Self> {
        Arc::new(Self { begin: Instant::now(), received: AtomicU64::new(0), write_waits: AtomicU64::new(0) })
    }

    /// Bytes that came so far.
    pub(super) fn received(&self) -> u64 {
        self.received.load(Relaxed)
    }

    /// How long a write has been waiting.
    pub(super) fn write_waits(&self) -> Option<Duration> {
        let since = self.write_waits.load(Relaxed).checked_sub(1)?;
        Some(self.begin.elapsed().saturating_sub(Duration::from_millis(since)))
    }

    fn wrote<T>(&self, polled: &Poll<T>) {
        if polled.is_ready() {
            self.write_waits.store(0, Relaxed);
        } else if self.write_waits.load(Relaxed) == 0 {
            let since = u64::try_from(self.begin.elapsed().as_millis()).unwrap_or(u64::MAX - 1);
            self.write_waits.store(since + 1, Relaxed);
        }
    }
}

/// The socket.
pub(super) struct Watched<S> {
    pub(super) socket: S,
    pub(super) traffic: Arc<Traffic>,
}

impl<S: AsyncRead + Unpin> AsyncRead for Watched<S> {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let before = buf.filled().len();
        ready!(Pin::new(&mut self.socket).poll_read(cx, buf))?;
        self.traffic.received.fetch_add((buf.filled().len() - before) as u64, Relaxed);
        Poll::Ready(Ok(()))
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for Watched<S> {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &[u8]) -> Poll<io::Result<usize>> {
        let wrote = Pin::new(&mut self.socket).poll_write(cx, buf);
        self.traffic.wrote(&wrote);
        wrote
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bufs: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let wrote = Pin::new(&mut self.socket).poll_write_vectored(cx, bufs);
        self.traffic.wrote(&wrote);
        wrote
    }

    fn is_write_vectored(&self) -> bool {
        self.socket.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        let flushed = Pin::new(&mut self.socket).poll_flush(cx);
        self.traffic.wrote(&flushed);
        flushed
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.socket).poll_shutdown(cx)
    }
}
