#include "service/reader.hpp"

#include <chrono>
#include <exception>
#include <utility>

#include "service/codec.hpp"
#include "service/keys.hpp"
#include "service/logs.hpp"

namespace armsight::vision::service {
namespace {

constexpr std::chrono::milliseconds kPoll{500};  // how soon a stop is seen

}  // namespace

Reader::Reader(const Connection& connection, const topics::Topic& topic, const std::string& name, Counters& counters,
               Handler handler)
    : robot_(connection.robot),
      topic_(topic),
      counters_(counters),
      handler_(std::move(handler)),
      subscriber_(connection.session.declare_subscriber(
          key_for(topic.key, name), {.capacity = topic.ring, .latched = topic.delivery == topics::Delivery::Latched})),
      thread_([this](const std::stop_token& stop) { read(stop); }) {}

void Reader::read(const std::stop_token& stop) {
    while (!stop.stop_requested()) {
        try {
            if (auto sample = subscriber_.recv(kPoll)) handle(std::move(*sample));
        } catch (const zenoh::ZException&) {
            break;  // the session is closed
        }
    }
    has_ended_ = true;
}

void Reader::handle(zenoh::Sample sample) {
    if (!sample.is_put()) return;
    const std::string key(sample.get_keyexpr());
    try {
        const std::string encoding = sample.get_encoding();
        if (encoding != topic_.encoding) {
            throw MalformedMessage("encoding '" + encoding.substr(0, 80) + "' instead of '" +
                                   std::string(topic_.encoding) + "'");
        }
        handler_(std::move(sample));
    } catch (const MalformedMessage& error) {
        const auto total = counters_.add("malformed_" + std::string(topic_.name));
        if (is_worth_a_line(total)) {
            log_warning("ignored a malformed message",
                        {{"robot", robot_}, {"key", key}, {"reason", error.what()}, {"total", total}});
        }
    } catch (const std::exception& error) {
        counters_.add("failed_" + std::string(topic_.name));
        log_error("handling a sample failed", {{"robot", robot_}, {"key", key}, {"reason", error.what()}});
    }
}

}  // namespace armsight::vision::service
