#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>

#include "rust/cxx.h"
#include "zenoh_bridge/src/lib.rs.h"

/// The part of Zenoh that armsight's C++ needs, in zenoh-cpp's words. Handles are move-only and undeclare themselves.
/// What fails throws ZException with Zenoh's own text. Receiving is polled: nothing calls back into C++.
namespace armsight::zenoh {

using ZException = rust::Error;
using Bytes = std::span<const std::uint8_t>;
using Milliseconds = std::chrono::milliseconds;

namespace detail {

inline rust::Slice<const std::uint8_t> slice(Bytes bytes) { return {bytes.data(), bytes.size()}; }
inline rust::Str str(std::string_view text) { return {text.data(), text.size()}; }
inline Bytes bytes(rust::Slice<const std::uint8_t> slice) { return {slice.data(), slice.size()}; }
inline std::uint64_t count(Milliseconds timeout) { return static_cast<std::uint64_t>(timeout.count()); }

}  // namespace detail

/// Bytes of a string, to put.
inline Bytes as_bytes(std::string_view text) {
    return {reinterpret_cast<const std::uint8_t*>(text.data()), text.size()};
}

/// A session's configuration: Zenoh's JSON5, value by value.
class Config {
  public:
    /// Zenoh's defaults.
    Config() = default;

    /// A file, with comments and all. Throws when there is none or it isn't a Zenoh configuration.
    static Config from_file(std::string_view path) {
        return Config(std::string(ffi::config_from_file(detail::str(path))));
    }

    /// Sets the value (JSON5) at a path such as `transport/shared_memory/enabled`; Zenoh checks both.
    void insert_json5(std::string_view path, std::string_view value) {
        json5_ = std::string(ffi::config_with(json5_, detail::str(path), detail::str(value)));
    }

    /// The value at a path, as JSON.
    [[nodiscard]] std::string get_json(std::string_view path) const {
        return std::string(ffi::config_value(json5_, detail::str(path)));
    }

    [[nodiscard]] const std::string& json5() const { return json5_; }

  private:
    explicit Config(std::string json5) : json5_(std::move(json5)) {}
    std::string json5_ = "{}";
};

/// One received value; its payload is Zenoh's own memory (shared memory, where both sides have it) for as long as this
/// object lives.
class Sample {
  public:
    explicit Sample(rust::Box<ffi::Sample> inner) : inner_(std::move(inner)) {}
    [[nodiscard]] bool is_put() const { return inner_->is_put(); }
    [[nodiscard]] bool is_shared_memory() const { return inner_->is_shared_memory(); }
    [[nodiscard]] std::string_view get_keyexpr() const {
        const rust::Str key = inner_->key();
        return {key.data(), key.size()};
    }
    [[nodiscard]] std::string get_encoding() const { return std::string(inner_->encoding()); }
    [[nodiscard]] Bytes get_payload() const { return detail::bytes(inner_->payload()); }
    [[nodiscard]] Bytes get_attachment() const { return detail::bytes(inner_->attachment()); }

  private:
    rust::Box<ffi::Sample> inner_;
};

class Publisher {
  public:
    explicit Publisher(rust::Box<ffi::Publisher> inner) : inner_(std::move(inner)) {}
    void put(Bytes payload, Bytes attachment = {}) const {
        inner_->put(detail::slice(payload), detail::slice(attachment));
    }
    /// Whether anybody listens now.
    [[nodiscard]] bool has_subscribers() const { return inner_->has_subscribers(); }

  private:
    rust::Box<ffi::Publisher> inner_;
};

/// Keeps the newest samples in a ring; a full one pushes out the oldest and delays nobody.
class Subscriber {
  public:
    explicit Subscriber(rust::Box<ffi::Subscriber> inner) : inner_(std::move(inner)) {}
    /// The oldest sample kept; nothing when none comes in time. Throws once the session is closed.
    [[nodiscard]] std::optional<Sample> recv(Milliseconds timeout) const {
        auto sample = inner_->recv(detail::count(timeout));
        if (sample->is_empty()) return std::nullopt;
        return Sample(std::move(sample));
    }

  private:
    rust::Box<ffi::Subscriber> inner_;
};

class LivelinessToken {
  public:
    explicit LivelinessToken(rust::Box<ffi::LivelinessToken> inner) : inner_(std::move(inner)) {}

  private:
    rust::Box<ffi::LivelinessToken> inner_;
};

/// A question that waits for its answer.
class Query {
  public:
    explicit Query(rust::Box<ffi::Query> inner) : inner_(std::move(inner)) {}
    [[nodiscard]] Bytes get_payload() const { return detail::bytes(inner_->payload()); }
    void reply(Bytes payload, std::string_view encoding) const {
        inner_->reply(detail::slice(payload), detail::str(encoding));
    }
    void reply_err(std::string_view text) const { inner_->reply_err(detail::str(text)); }

  private:
    rust::Box<ffi::Query> inner_;
};

class Queryable {
  public:
    explicit Queryable(rust::Box<ffi::Queryable> inner) : inner_(std::move(inner)) {}
    /// The next question; nothing when none comes in time. Throws once the session is closed.
    [[nodiscard]] std::optional<Query> recv(Milliseconds timeout) const {
        auto query = inner_->recv(detail::count(timeout));
        if (query->is_empty()) return std::nullopt;
        return Query(std::move(query));
    }

  private:
    rust::Box<ffi::Queryable> inner_;
};

using ffi::PublisherOptions;

struct SubscriberOptions {
    std::size_t capacity = 1;  ///< samples kept, the newest
    bool latched = false;      ///< ask publishers, late ones too, for their last value
};

class Session {
  public:
    /// Throws at once when nobody listens at the configuration's endpoints.
    static Session open(const Config& config) { return Session(ffi::open(config.json5())); }

    [[nodiscard]] Publisher declare_publisher(std::string_view key, std::string_view encoding,
                                              PublisherOptions options) const {
        return Publisher(inner_->declare_publisher(detail::str(key), detail::str(encoding), options));
    }
    [[nodiscard]] Subscriber declare_subscriber(std::string_view key, SubscriberOptions options) const {
        return Subscriber(inner_->declare_subscriber(detail::str(key), options.capacity, options.latched));
    }
    [[nodiscard]] LivelinessToken declare_token(std::string_view key) const {
        return LivelinessToken(inner_->declare_token(detail::str(key)));
    }
    [[nodiscard]] Queryable declare_queryable(std::string_view key) const {
        return Queryable(inner_->declare_queryable(detail::str(key)));
    }
    /// Asks and returns the first answer's payload. Throws with the text of a refusal, or when nobody answers in time.
    [[nodiscard]] std::string get(std::string_view key, Bytes payload, Milliseconds timeout) const {
        const auto answer = inner_->get(detail::str(key), detail::slice(payload), detail::count(timeout));
        return {reinterpret_cast<const char*>(answer.data()), answer.size()};
    }
    /// How often since it was opened; it connects again by itself.
    [[nodiscard]] std::uint64_t routers_lost() const { return inner_->routers_lost(); }
    /// Ends every recv(). Call it before main returns.
    void close() const { inner_->close(); }

  private:
    explicit Session(rust::Box<ffi::Session> inner) : inner_(std::move(inner)) {}
    rust::Box<ffi::Session> inner_;
};

/// Zenoh's own log on stderr: errors only, unless RUST_LOG says otherwise.
inline void init_log() { ffi::init_log(); }

}  // namespace armsight::zenoh
