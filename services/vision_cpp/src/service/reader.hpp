#pragma once

#include <functional>
#include <string>
#include <thread>

#include "armsight/topics.hpp"
#include "armsight/zenoh.hpp"
#include "service/counters.hpp"

namespace armsight::vision::service {

/// Takes the samples of one key by a thread of its own and hands over those that carry the key's message. What is not
/// such a message, by its encoding or because the handler throws MalformedMessage, is counted and left out.
class Reader {
  public:
    using Handler = std::function<void(zenoh::Sample)>;

    Reader(const zenoh::Session& session, const topics::Topic& topic, const std::string& name, Counters& counters,
           Handler handler);

  private:
    void read(const std::stop_token& stop);
    void handle(zenoh::Sample sample);

    topics::Topic topic_;
    Counters& counters_;
    Handler handler_;
    zenoh::Subscriber subscriber_;
    std::jthread thread_;  // last: it starts when all else is there and is joined before all else goes
};

}  // namespace armsight::vision::service
