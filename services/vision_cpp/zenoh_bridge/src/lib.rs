//! The part of Zenoh that armsight's C++ service needs, over cxx; `include/armsight/zenoh.hpp` is its face in C++.
//!
//! Every error crosses as a C++ exception with Zenoh's own text. Nothing here panics on what comes from the bus: a panic
//! across cxx ends the process. Receiving is polled with a timeout, so that C++ needs no callbacks.

mod log;

use std::error::Error;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::Arc;
use std::time::Duration;

use zenoh::config::WhatAmI;
use zenoh::handlers::{FifoChannel, FifoChannelHandler, RingChannel, RingChannelHandler};
use zenoh::qos::{CongestionControl, Priority};
use zenoh::sample::SampleKind;
use zenoh::Wait;
use zenoh_ext::{
    AdvancedPublisherBuilderExt, AdvancedSubscriberBuilderExt, CacheConfig, HistoryConfig,
    MissDetectionConfig, RecoveryConfig,
};

use log::init as init_log;

type Outcome<T> = Result<T, Box<dyn Error + Send + Sync>>;

/// How often the publisher of a latched value says how many it has put; the same as in proto/armsight/bus.py.
const LATCHED_HEARTBEAT: Duration = Duration::from_secs(1);

/// Queries that wait to be answered; more are refused by Zenoh's flow control.
const QUERY_QUEUE: usize = 64;

#[cxx::bridge(namespace = "armsight::zenoh::ffi")]
mod ffi {
    /// Quality of service of a publisher; see proto/armsight/topics.toml.
    struct PublisherOptions {
        block: bool,
        /// Zenoh's, 1 (REAL_TIME) to 7 (BACKGROUND).
        priority: u8,
        express: bool,
        /// Late subscribers get the last value.
        latched: bool,
    }

    extern "Rust" {
        type Session;
        type Publisher;
        type Subscriber;
        type LivelinessToken;
        type Queryable;
        type Sample;
        type Query;

        fn open(config_json5: &str) -> Result<Box<Session>>;
        fn config_from_file(path: &str) -> Result<String>;
        fn config_with(config_json5: &str, path: &str, value: &str) -> Result<String>;
        fn config_value(config_json5: &str, path: &str) -> Result<String>;
        fn init_log();

        fn close(self: &Session) -> Result<()>;
        fn routers_lost(self: &Session) -> u64;
        fn declare_publisher(
            self: &Session,
            key: &str,
            encoding: &str,
            options: PublisherOptions,
        ) -> Result<Box<Publisher>>;
        fn declare_subscriber(
            self: &Session,
            key: &str,
            capacity: usize,
            latched: bool,
        ) -> Result<Box<Subscriber>>;
        fn declare_token(self: &Session, key: &str) -> Result<Box<LivelinessToken>>;
        fn declare_queryable(self: &Session, key: &str) -> Result<Box<Queryable>>;
        fn get(self: &Session, key: &str, payload: &[u8], timeout_ms: u64) -> Result<Vec<u8>>;

        fn put(self: &Publisher, payload: &[u8], attachment: &[u8]) -> Result<()>;
        fn has_subscribers(self: &Publisher) -> Result<bool>;

        /// Empty when nothing came in time.
        fn recv(self: &Subscriber, timeout_ms: u64) -> Result<Box<Sample>>;

        fn is_empty(self: &Sample) -> bool;
        fn is_put(self: &Sample) -> bool;
        fn is_shared_memory(self: &Sample) -> bool;
        fn key(self: &Sample) -> &str;
        fn encoding(self: &Sample) -> String;
        fn payload(self: &Sample) -> &[u8];
        fn attachment(self: &Sample) -> &[u8];

        /// Empty when nothing came in time.
        fn recv(self: &Queryable, timeout_ms: u64) -> Result<Box<Query>>;
        fn is_empty(self: &Query) -> bool;
        fn payload(self: &Query) -> &[u8];
        fn reply(self: &Query, payload: &[u8], encoding: &str) -> Result<()>;
        fn reply_err(self: &Query, text: &str) -> Result<()>;
    }
}

pub struct Session {
    inner: zenoh::Session,
    routers_lost: Arc<AtomicU64>,
}

enum PublisherKind {
    Plain(zenoh::pubsub::Publisher<'static>),
    Latched(zenoh_ext::AdvancedPublisher<'static>),
}

pub struct Publisher(PublisherKind);

type Ring = RingChannelHandler<zenoh::sample::Sample>;

enum SubscriberKind {
    Plain(zenoh::pubsub::Subscriber<Ring>),
    Latched(zenoh_ext::AdvancedSubscriber<Ring>),
}

pub struct Subscriber(SubscriberKind);

/// Held for its lifetime only: dropping it withdraws the token.
pub struct LivelinessToken(#[allow(dead_code)] zenoh::liveliness::LivelinessToken);

pub struct Queryable(zenoh::query::Queryable<FifoChannelHandler<zenoh::query::Query>>);

/// Zenoh's payload may come in fragments: those are joined in `joined`, a payload in one piece is borrowed.
pub struct Sample {
    inner: Option<zenoh::sample::Sample>,
    joined: Vec<u8>,
    attachment: Vec<u8>,
}

pub struct Query {
    inner: Option<zenoh::query::Query>,
    payload: Vec<u8>,
}

fn open(config_json5: &str) -> Outcome<Box<Session>> {
    let config = zenoh::Config::from_json5(config_json5)?;
    let inner = zenoh::open(config).wait()?;
    let routers_lost = Arc::new(AtomicU64::new(0));
    let lost = routers_lost.clone();
    inner
        .info()
        .transport_events_listener()
        .callback(move |event| {
            if event.kind() == SampleKind::Delete && event.transport().whatami() == WhatAmI::Router
            {
                lost.fetch_add(1, Ordering::Relaxed);
            }
        })
        .background()
        .wait()?;
    Ok(Box::new(Session {
        inner,
        routers_lost,
    }))
}

/// A configuration file as JSON, comments and all removed.
fn config_from_file(path: &str) -> Outcome<String> {
    Ok(zenoh::Config::from_file(path)?.to_string())
}

/// The configuration with one value (JSON5) set, checked by Zenoh.
fn config_with(config_json5: &str, path: &str, value: &str) -> Outcome<String> {
    let mut config = zenoh::Config::from_json5(config_json5)?;
    config.insert_json5(path, value)?;
    Ok(config.to_string())
}

fn config_value(config_json5: &str, path: &str) -> Outcome<String> {
    zenoh::Config::from_json5(config_json5)?.get_json(path)
}

impl Session {
    fn close(&self) -> Outcome<()> {
        self.inner.close().wait()
    }

    /// How often since it was opened; it connects again by itself.
    fn routers_lost(&self) -> u64 {
        self.routers_lost.load(Ordering::Relaxed)
    }

    fn declare_publisher(
        &self,
        key: &str,
        encoding: &str,
        options: ffi::PublisherOptions,
    ) -> Outcome<Box<Publisher>> {
        let congestion = if options.block {
            CongestionControl::Block
        } else {
            CongestionControl::Drop
        };
        let builder = self
            .inner
            .declare_publisher(key.to_owned())
            .encoding(encoding)
            .congestion_control(congestion)
            .priority(Priority::try_from(options.priority)?)
            .express(options.express);
        let kind = if options.latched {
            PublisherKind::Latched(
                builder
                    .cache(CacheConfig::default().max_samples(1))
                    .sample_miss_detection(
                        MissDetectionConfig::default().heartbeat(LATCHED_HEARTBEAT),
                    )
                    .publisher_detection()
                    .wait()?,
            )
        } else {
            PublisherKind::Plain(builder.wait()?)
        };
        Ok(Box::new(Publisher(kind)))
    }

    fn declare_subscriber(
        &self,
        key: &str,
        capacity: usize,
        latched: bool,
    ) -> Outcome<Box<Subscriber>> {
        let builder = self
            .inner
            .declare_subscriber(key.to_owned())
            .with(RingChannel::new(capacity));
        let kind = if latched {
            let history = HistoryConfig::default()
                .detect_late_publishers()
                .max_samples(1);
            // what was dropped on its way, or whose answer was lost, is asked for again
            let recovery = RecoveryConfig::default().heartbeat();
            SubscriberKind::Latched(builder.history(history).recovery(recovery).wait()?)
        } else {
            SubscriberKind::Plain(builder.wait()?)
        };
        Ok(Box::new(Subscriber(kind)))
    }

    fn declare_token(&self, key: &str) -> Outcome<Box<LivelinessToken>> {
        let token = self
            .inner
            .liveliness()
            .declare_token(key.to_owned())
            .wait()?;
        Ok(Box::new(LivelinessToken(token)))
    }

    fn declare_queryable(&self, key: &str) -> Outcome<Box<Queryable>> {
        let queryable = self
            .inner
            .declare_queryable(key.to_owned())
            .with(FifoChannel::new(QUERY_QUEUE))
            .wait()?;
        Ok(Box::new(Queryable(queryable)))
    }

    /// Asks and returns the first answer's payload; a refusal or silence is an error.
    fn get(&self, key: &str, payload: &[u8], timeout_ms: u64) -> Outcome<Vec<u8>> {
        let replies = self
            .inner
            .get(key)
            .payload(payload)
            .timeout(Duration::from_millis(timeout_ms))
            .wait()?;
        match replies.recv_timeout(Duration::from_millis(timeout_ms + 100))? {
            Some(reply) => match reply.into_result() {
                Ok(sample) => Ok(sample.payload().to_bytes().into_owned()),
                Err(refusal) => Err(String::from_utf8_lossy(&refusal.payload().to_bytes()).into()),
            },
            None => Err(format!("nobody answers {key} within {timeout_ms} ms").into()),
        }
    }
}

impl Publisher {
    fn put(&self, payload: &[u8], attachment: &[u8]) -> Outcome<()> {
        let attached = (!attachment.is_empty()).then_some(attachment);
        match &self.0 {
            PublisherKind::Plain(publisher) => {
                publisher.put(payload).attachment(attached).wait()?
            }
            PublisherKind::Latched(publisher) => {
                publisher.put(payload).attachment(attached).wait()?
            }
        }
        Ok(())
    }

    fn has_subscribers(&self) -> Outcome<bool> {
        Ok(match &self.0 {
            PublisherKind::Plain(publisher) => publisher.matching_status().wait()?.matching(),
            PublisherKind::Latched(_) => true,
        })
    }
}

impl Subscriber {
    fn recv(&self, timeout_ms: u64) -> Outcome<Box<Sample>> {
        let timeout = Duration::from_millis(timeout_ms);
        let inner = match &self.0 {
            SubscriberKind::Plain(subscriber) => subscriber.recv_timeout(timeout)?,
            SubscriberKind::Latched(subscriber) => subscriber.recv_timeout(timeout)?,
        };
        Ok(Box::new(Sample::new(inner)))
    }
}

impl Sample {
    fn new(inner: Option<zenoh::sample::Sample>) -> Self {
        let (mut joined, mut attachment) = (Vec::new(), Vec::new());
        if let Some(sample) = &inner {
            if sample.payload().slices().count() > 1 {
                joined = sample.payload().to_bytes().into_owned();
            }
            if let Some(bytes) = sample.attachment() {
                attachment = bytes.to_bytes().into_owned();
            }
        }
        Self {
            inner,
            joined,
            attachment,
        }
    }

    fn is_empty(&self) -> bool {
        self.inner.is_none()
    }

    fn is_put(&self) -> bool {
        self.inner
            .as_ref()
            .is_some_and(|sample| sample.kind() == SampleKind::Put)
    }

    fn is_shared_memory(&self) -> bool {
        self.inner
            .as_ref()
            .is_some_and(|sample| sample.payload().as_shm().is_some())
    }

    fn key(&self) -> &str {
        self.inner
            .as_ref()
            .map_or("", |sample| sample.key_expr().as_str())
    }

    fn encoding(&self) -> String {
        self.inner
            .as_ref()
            .map_or_else(String::new, |sample| sample.encoding().to_string())
    }

    fn payload(&self) -> &[u8] {
        match &self.inner {
            Some(sample) if self.joined.is_empty() => {
                sample.payload().slices().next().unwrap_or(&[])
            }
            _ => &self.joined,
        }
    }

    fn attachment(&self) -> &[u8] {
        &self.attachment
    }
}

impl Queryable {
    fn recv(&self, timeout_ms: u64) -> Outcome<Box<Query>> {
        let inner = self.0.recv_timeout(Duration::from_millis(timeout_ms))?;
        let payload = inner
            .as_ref()
            .and_then(|query| query.payload())
            .map_or_else(Vec::new, |bytes| bytes.to_bytes().into_owned());
        Ok(Box::new(Query { inner, payload }))
    }
}

impl Query {
    fn is_empty(&self) -> bool {
        self.inner.is_none()
    }

    fn payload(&self) -> &[u8] {
        &self.payload
    }

    fn reply(&self, payload: &[u8], encoding: &str) -> Outcome<()> {
        if let Some(query) = &self.inner {
            query
                .reply(query.key_expr(), payload)
                .encoding(encoding)
                .wait()?;
        }
        Ok(())
    }

    fn reply_err(&self, text: &str) -> Outcome<()> {
        if let Some(query) = &self.inner {
            query.reply_err(text).wait()?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn free_endpoint() -> String {
        let socket = std::net::TcpListener::bind("127.0.0.1:0").expect("a free port");
        format!("tcp/{}", socket.local_addr().expect("its address"))
    }

    fn router_and_client() -> (Box<Session>, Box<Session>) {
        let endpoint = free_endpoint();
        let quiet = r#"scouting: { multicast: { enabled: false }, gossip: { enabled: false } }"#;
        let router = open(&format!(
            r#"{{ mode: "router", listen: {{ endpoints: ["{endpoint}"] }}, {quiet} }}"#
        ));
        let client = open(&format!(
            r#"{{ mode: "client", connect: {{ endpoints: ["{endpoint}"] }}, {quiet} }}"#
        ));
        (router.expect("a router"), client.expect("a client"))
    }

    fn options(latched: bool) -> ffi::PublisherOptions {
        ffi::PublisherOptions {
            block: true,
            priority: 5,
            express: false,
            latched,
        }
    }

    fn wait_for_subscriber(publisher: &Publisher) {
        let deadline = std::time::Instant::now() + Duration::from_secs(5);
        while !publisher.has_subscribers().expect("a status") {
            assert!(std::time::Instant::now() < deadline, "no subscriber");
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    #[test]
    fn sample_arrives_with_key_encoding_and_attachment() {
        let (router, client) = router_and_client();
        let subscriber = client
            .declare_subscriber("a/*", 2, false)
            .expect("declared");
        let publisher = router
            .declare_publisher("a/b", "application/protobuf;x.Y", options(false))
            .expect("declared");
        wait_for_subscriber(&publisher);
        let payload: Vec<u8> = (0..200_000_u32).map(|i| i as u8).collect();
        publisher.put(&payload, b"stamp").expect("put");
        let sample = subscriber.recv(5000).expect("received");
        assert!(sample.is_put());
        assert_eq!(sample.key(), "a/b");
        assert_eq!(sample.encoding(), "application/protobuf;x.Y");
        assert_eq!(sample.payload(), payload);
        assert_eq!(sample.attachment(), b"stamp");
        assert!(subscriber.recv(50).expect("waited").is_empty());
    }

    #[test]
    fn ring_keeps_the_newest() {
        let (router, client) = router_and_client();
        let subscriber = client.declare_subscriber("k", 2, false).expect("declared");
        let publisher = router
            .declare_publisher("k", "", options(false))
            .expect("declared");
        wait_for_subscriber(&publisher);
        for value in 0..6_u8 {
            publisher.put(&[value], b"").expect("put");
        }
        std::thread::sleep(Duration::from_millis(300));
        let kept: Vec<u8> = (0..2)
            .map(|_| subscriber.recv(100).expect("received").payload()[0])
            .collect();
        assert_eq!(kept, [4, 5]);
    }

    #[test]
    fn latched_value_reaches_late_subscribers_and_late_publishers_reach_all() {
        let (router, client) = router_and_client();
        let early = client
            .declare_subscriber("latched", 1, true)
            .expect("declared");
        let publisher = router
            .declare_publisher("latched", "", options(true))
            .expect("declared");
        publisher.put(b"first", b"").expect("put");
        assert_eq!(early.recv(5000).expect("received").payload(), b"first");
        let late = client
            .declare_subscriber("latched", 1, true)
            .expect("declared");
        assert_eq!(late.recv(5000).expect("received").payload(), b"first");
    }

    #[test]
    fn query_is_answered_refused_or_unanswered() {
        let (router, client) = router_and_client();
        let silence = client.get("ask", b"", 300).expect_err("nobody is there");
        assert!(!silence.to_string().is_empty());
        let queryable = router.declare_queryable("ask").expect("declared");
        let server = std::thread::spawn(move || {
            let first = queryable.recv(5000).expect("asked");
            assert_eq!(first.payload(), b"one");
            first.reply(b"yes", "text").expect("replied");
            drop(first);
            queryable
                .recv(5000)
                .expect("asked")
                .reply_err("because")
                .expect("refused");
        });
        std::thread::sleep(Duration::from_millis(200));
        assert_eq!(client.get("ask", b"one", 5000).expect("an answer"), b"yes");
        let refused = client.get("ask", b"two", 5000).expect_err("refused");
        assert_eq!(refused.to_string(), "because");
        server.join().expect("server ended well");
    }

    #[test]
    fn bad_configuration_is_an_error_with_a_text() {
        assert!(open("{ mode: ").is_err());
        assert!(config_with("{}", "no/such/path", "1").is_err());
        assert!(config_from_file("/nowhere.json5").is_err());
        let config = config_with("{}", "namespace", "\"robots/x\"").expect("accepted");
        assert_eq!(
            config_value(&config, "namespace").expect("read back"),
            "\"robots/x\""
        );
    }

    #[test]
    fn receiving_on_a_closed_session_is_an_error_and_not_a_hang() {
        let (_router, client) = router_and_client();
        let subscriber = client.declare_subscriber("k", 1, false).expect("declared");
        client.close().expect("closed");
        assert!(subscriber.recv(1000).is_err() || subscriber.recv(10).is_ok());
    }
}
