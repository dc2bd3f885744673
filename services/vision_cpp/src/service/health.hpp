#pragma once

#include <condition_variable>
#include <cstdint>
#include <map>
#include <mutex>
#include <string>
#include <thread>

#include "armsight/v1/health.pb.h"
#include "armsight/zenoh.hpp"
#include "service/connection.hpp"
#include "service/counters.hpp"

namespace armsight::vision::service {

/// Publishes `health/vision` once a second, and at once when the status changes; holds the liveliness token.
class HealthReporter {
  public:
    HealthReporter(const Connection& connection, const Counters& counters);
    ~HealthReporter();
    HealthReporter(const HealthReporter&) = delete;
    HealthReporter& operator=(const HealthReporter&) = delete;
    HealthReporter(HealthReporter&&) = delete;
    HealthReporter& operator=(HealthReporter&&) = delete;

    /// Sets the status and one line that says what is wrong and what to do.
    void report(v1::HealthStatus status, const std::string& detail = "");

    /// Sets a current value, such as `rate_hz`.
    void gauge(const std::string& name, double value);

  private:
    void publish();
    [[nodiscard]] std::string message() const;

    std::string robot_;
    const Counters& counters_;
    zenoh::Publisher publisher_;
    zenoh::LivelinessToken token_;
    std::string instance_;
    std::int64_t started_ns_;

    std::mutex mutex_;
    std::condition_variable changed_;
    v1::HealthStatus status_ = v1::HEALTH_STATUS_WAITING;
    std::string detail_ = "starting";
    std::map<std::string, double> gauges_;
    bool is_new_ = true;
    bool closing_ = false;
    std::thread thread_;
};

/// Unix nanoseconds now.
[[nodiscard]] std::int64_t wall_ns();

}  // namespace armsight::vision::service
