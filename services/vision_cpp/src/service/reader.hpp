#pragma once

#include <atomic>
#include <functional>
#include <string>
#include <thread>

#include "armsight/topics.hpp"
#include "armsight/zenoh.hpp"
#include "service/connection.hpp"
#include "service/counters.hpp"

namespace armsight::vision::service {

/// Takes the samples of one key by a thread of its own and hands over those that carry the key's message. What is not
/// such a message, by its encoding or because the handler throws MalformedMessage, is counted and left out.
class Reader {
  public:
    using Handler = std::function<void(zenoh::Sample)>;

    Reader(const Connection& connection, const topics::Topic& topic, const std::string& name, Counters& counters,
           Handler handler);

    /// Its thread ends soon; nobody waits for it.
    void request_stop() { thread_.request_stop(); }
    /// Whether nothing is waited for when this goes.
    [[nodiscard]] bool has_ended() const { return has_ended_; }

  private:
    void read(const std::stop_token& stop);
    void handle(zenoh::Sample sample);

    std::string robot_;
    topics::Topic topic_;
    Counters& counters_;
    Handler handler_;
    zenoh::Subscriber subscriber_;
    std::atomic<bool> has_ended_{false};
    std::jthread thread_;  // last: it starts when all else is there and is joined before all else goes
};

}  // namespace armsight::vision::service
