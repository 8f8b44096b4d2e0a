//! Sends a stream to a server or an address, and retries until it is accepted.

use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender};
use std::sync::{Arc, Mutex, PoisonError, mpsc};
use std::thread::JoinHandle;
use std::time::Duration;

use gstreamer::prelude::*;
use gstreamer::{ClockTime, MessageType, MessageView, Pipeline, State};
use gstreamer_app::AppSrc;
use panoscope_base::secret::{SecretError, redact, resolve};
use panoscope_media::{MediaError, make};

use super::fanout::{Fanout, Payload, SOURCE};

/// Pause before the first retry; it doubles up to [`MAX_REST`].
const FIRST_REST: Duration = Duration::from_millis(500);
/// Maximum pause between retries.
const MAX_REST: Duration = Duration::from_secs(8);
/// An attempt that lasted this long has worked: the next pause is short again.
const WORKED_AFTER: Duration = Duration::from_secs(5);
/// Interval at which a running attempt is checked.
const LOOK_EVERY: ClockTime = ClockTime::from_mseconds(200);

/// Destination of a stream.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Target {
    /// Address of a server that accepts recordings.
    Rtsp(String),
    /// RTP packets to a host and port.
    Udp {
        /// Host name or address.
        host: String,
        /// UDP port.
        port: u16,
    },
}

/// Why the address of a [`Target`] is invalid; `shown` is the address without its password.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum TargetError {
    /// A quote or a space would end the text of a pipeline.
    #[error("`{shown}` is not a valid address: it contains a space or a quote")]
    Quoted { shown: String },
    /// UDP without `:PORT`.
    #[error("`{shown}` has no port")]
    NoPort { shown: String },
    /// The port is 0, too large or not a number.
    #[error("`{shown}` has no port from 1 to 65535")]
    BadPort { shown: String },
    /// UDP without a host.
    #[error("`{shown}` has no host")]
    NoHost { shown: String },
    /// Neither RTSP nor UDP.
    #[error("`{shown}` is not an address that a stream can be sent to")]
    Unknown { shown: String },
}

impl Target {
    /// Parses an address.
    ///
    /// # Errors
    /// The address is invalid.
    pub fn parse(text: &str) -> Result<Self, TargetError> {
        let shown = redact(text).into_owned();
        if text.chars().any(|c| c.is_whitespace() || "\"'!\\".contains(c)) {
            return Err(TargetError::Quoted { shown });
        }
        match text.split_once("://") {
            Some(("rtsp", rest)) if !rest.is_empty() && !rest.starts_with('/') => Ok(Self::Rtsp(text.to_owned())),
            Some(("udp", rest)) => {
                let Some((host, port)) = rest.rsplit_once(':') else { return Err(TargetError::NoPort { shown }) };
                let port = port.parse::<u16>().ok().filter(|&port| port > 0);
                let Some(port) = port else { return Err(TargetError::BadPort { shown }) };
                let host = host.trim_start_matches('[').trim_end_matches(']');
                if host.is_empty() {
                    return Err(TargetError::NoHost { shown });
                }
                Ok(Self::Udp { host: host.to_owned(), port })
            }
            _ => Err(TargetError::Unknown { shown }),
        }
    }

    fn element(&self) -> &'static str {
        match self {
            Self::Rtsp(_) => "rtspclientsink",
            Self::Udp { .. } => "udpsink",
        }
    }

    fn text(&self, payload: Payload) -> String {
        match self {
            // By itself it would connect again while its other thread still sends, and crash.
            Self::Rtsp(_) => format!("{SOURCE} ! rtspclientsink name=sink protocols=tcp udp-reconnect=false"),
            Self::Udp { .. } => {
                format!("{SOURCE} ! {} ! udpsink name=sink sync=false async=false", payload.text("payload"))
            }
        }
    }

    /// Sets the sink's destination. The secrets of an address are read here.
    fn configure(&self, sink: &gstreamer::Element) -> Result<(), SecretError> {
        match self {
            Self::Rtsp(url) => sink.set_property("location", &*resolve(url)?),
            Self::Udp { host, port } => {
                sink.set_property("host", host);
                sink.set_property("port", i32::from(*port));
            }
        }
        Ok(())
    }
}

impl std::fmt::Display for Target {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Rtsp(url) => f.write_str(&redact(url)),
            Self::Udp { host, port } => write!(f, "udp://{host}:{port}"),
        }
    }
}

/// Sends a stream until it is dropped.
pub struct Push {
    error: Arc<Mutex<Option<String>>>,
    /// Dropped to stop the thread.
    stop: Option<Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Push {
    /// Starts a thread that sends the packets of `fanout`.
    ///
    /// # Errors
    /// An element is missing, or the system refuses a thread.
    pub fn start(target: Target, payload: Payload, fanout: &Arc<Fanout>) -> Result<Self, panoscope_node::NodeError> {
        make(target.element())?;
        let error = Arc::new(Mutex::new(None));
        let (stop, stopped) = mpsc::channel();
        let (own_error, fanout) = (Arc::clone(&error), Arc::clone(fanout));
        let run = move || keep_sending(&target, payload, &fanout, &own_error, &stopped);
        let thread = std::thread::Builder::new().name("stream-push".to_owned()).spawn(run)?;
        Ok(Self { error, stop: Some(stop), thread: Some(thread) })
    }

    /// Why the stream is not being sent; `None` while it is.
    pub fn error(&self) -> Option<String> {
        self.error.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

impl Drop for Push {
    fn drop(&mut self) {
        self.stop = None;
        if let Some(thread) = self.thread.take() {
            // A panic was printed when it happened.
            let _ = thread.join();
        }
    }
}

fn keep_sending(
    target: &Target,
    payload: Payload,
    fanout: &Fanout,
    error: &Mutex<Option<String>>,
    stopped: &Receiver<()>,
) {
    let set = |text: Option<String>| *error.lock().unwrap_or_else(PoisonError::into_inner) = text;
    let mut rest = FIRST_REST;
    loop {
        let begin = std::time::Instant::now();
        let reason = match send(target, payload, fanout, stopped, &set) {
            Ok(()) => return,
            Err(reason) => reason,
        };
        if begin.elapsed() > WORKED_AFTER {
            rest = FIRST_REST;
        }
        let rest_s = rest.as_secs_f64();
        set(Some(format!(
            "cannot send the stream to {target}: {}; retrying in {rest_s} s",
            redact(&reason.to_string())
        )));
        if stopped.recv_timeout(rest) != Err(RecvTimeoutError::Timeout) {
            return;
        }
        rest = (rest * 2).min(MAX_REST);
    }
}

/// Sends until it fails, or returns `Ok` when it is stopped.
fn send(
    target: &Target,
    payload: Payload,
    fanout: &Fanout,
    stopped: &Receiver<()>,
    set: &dyn Fn(Option<String>),
) -> Result<(), MediaError> {
    let failed = |reason: String| MediaError::Encoder { encoder: target.element().to_owned(), reason };
    let pipeline = gstreamer::parse::launch(&target.text(payload)).map_err(|error| failed(error.to_string()))?;
    let pipeline =
        pipeline.downcast::<Pipeline>().map_err(|_| failed("GStreamer cannot build the pipeline".to_owned()))?;
    let (source, sink) = (pipeline.by_name("source"), pipeline.by_name("sink"));
    let source = source.and_then(|source| source.downcast::<AppSrc>().ok());
    let (Some(source), Some(sink), Some(bus)) = (source, sink, pipeline.bus()) else {
        return Err(failed("the pipeline is not complete".to_owned()));
    };
    target.configure(&sink).map_err(|error| failed(error.to_string()))?;
    let ends = [MessageType::Error, MessageType::Eos];
    let reason = |message: &gstreamer::Message| match message.view() {
        MessageView::Error(error) => Some(MediaError::from(error)),
        _ => None,
    };
    let started = pipeline.set_state(State::Playing);
    let id = fanout.add(source);
    let result = if started.is_err() {
        Err(bus.iter_filtered(&ends).find_map(|m| reason(&m)).unwrap_or_else(|| failed("it does not start".to_owned())))
    } else {
        loop {
            if let Some(message) = bus.timed_pop_filtered(LOOK_EVERY, &ends) {
                break reason(&message).map_or(Ok(()), Err);
            }
            if pipeline.state(ClockTime::ZERO).1 == State::Playing {
                set(None);
            }
            if stopped.try_recv() == Err(mpsc::TryRecvError::Disconnected) {
                break Ok(());
            }
        }
    };
    fanout.remove(id);
    // Stopping cannot fail in a way that anybody could repair.
    let _ = pipeline.set_state(State::Null);
    result
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_read() {
        assert_eq!(Target::parse("rtsp://host:554/a"), Ok(Target::Rtsp("rtsp://host:554/a".to_owned())));
        let udp = |host: &str, port| Ok(Target::Udp { host: host.to_owned(), port });
        assert_eq!(Target::parse("udp://10.0.0.1:5000"), udp("10.0.0.1", 5000));
        assert_eq!(Target::parse("udp://[::1]:5000"), udp("::1", 5000));
        for (text, problem) in [
            ("udp://host", "has no port"),
            ("udp://host:0", "from 1 to 65535"),
            ("udp://:5000", "has no host"),
            ("http://host/a", "is not an address"),
            ("rtsp://", "is not an address"),
            ("rtsp://a b", "contains a space"),
        ] {
            let message = Target::parse(text).unwrap_err().to_string();
            assert!(message.contains(problem) && message.contains(text), "{text}: {message}");
        }
        let hidden = "rtsp://***@host/a";
        assert_eq!(Target::parse("rtsp://u:geheim@host/a").unwrap().to_string(), hidden);
        assert!(Target::parse("http://u:geheim@host/a").unwrap_err().to_string().contains("`http://***@host/a`"));
    }
}
