#pragma once

#include <stop_token>
#include <string>
#include <thread>

#include "armsight/zenoh.hpp"
#include "service/counters.hpp"
#include "service/parameters.hpp"

namespace armsight::vision::service {

/// Answers what is in force and takes new values, by threads of its own; publishes every change.
class ParameterServer {
  public:
    /// `configuration`: what the service was started with, one JSON object. The session and the counters outlive this.
    ParameterServer(const zenoh::Session& session, Tunables start, std::string configuration, Counters& counters);

    [[nodiscard]] Tunables in_force() const { return parameters_.in_force(); }

  private:
    void tell();
    void answer(const zenoh::Query& query) const;
    void take(const zenoh::Query& query);

    std::string configuration_;
    Counters& counters_;
    Parameters parameters_;
    zenoh::Publisher told_;
    zenoh::Queryable asked_;
    zenoh::Queryable set_;
    std::jthread asked_thread_;
    std::jthread set_thread_;
};

}  // namespace armsight::vision::service
