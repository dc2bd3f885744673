#include "service/health.hpp"

#include <chrono>
#include <random>

#include "armsight/topics.hpp"
#include "service/keys.hpp"
#include "service/logs.hpp"

namespace armsight::vision::service {
namespace {

constexpr std::chrono::seconds kPeriod{1};
constexpr const char* kVersion = "0.1.0";

std::string random_name() {
    std::random_device device;
    constexpr std::string_view kDigits = "0123456789abcdef";
    std::string name(12, '0');
    for (char& c : name) c = kDigits[device() % kDigits.size()];
    return name;
}

void set_time(google::protobuf::Timestamp& time, std::int64_t ns) {
    time.set_seconds(ns / 1'000'000'000);
    time.set_nanos(static_cast<std::int32_t>(ns % 1'000'000'000));
}

}  // namespace

std::int64_t wall_ns() {
    return std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::system_clock::now().time_since_epoch())
        .count();
}

HealthReporter::HealthReporter(const Connection& connection, const Counters& counters)
    : robot_(connection.robot),
      counters_(counters),
      publisher_(connection.session.declare_publisher(key_for(topics::kHealth.key, "vision"), topics::kHealth.encoding,
                                                      options_of(topics::kHealth))),
      token_(connection.session.declare_token(key_for(topics::kHealth.key, "vision"))),
      instance_(random_name()),
      started_ns_(wall_ns()),
      thread_([this] { publish(); }) {}

HealthReporter::~HealthReporter() {
    {
        const std::scoped_lock lock(mutex_);
        closing_ = true;
    }
    changed_.notify_all();
    thread_.join();
}

void HealthReporter::report(v1::HealthStatus status, const std::string& detail) {
    {
        const std::scoped_lock lock(mutex_);
        if (status == status_ && detail == detail_) return;
        status_ = status;
        detail_ = detail;
        is_new_ = true;
    }
    log_info("health", {{"robot", robot_}, {"status", v1::HealthStatus_Name(status)}, {"detail", detail}});
    changed_.notify_all();
}

void HealthReporter::gauge(const std::string& name, double value) {
    const std::scoped_lock lock(mutex_);
    gauges_[name] = value;
}

void HealthReporter::publish() {
    std::unique_lock lock(mutex_);
    while (!closing_) {
        is_new_ = false;
        const std::string payload = message();
        lock.unlock();
        try {
            publisher_.put(zenoh::as_bytes(payload));
        } catch (const zenoh::ZException&) {
            return;  // the session is closed
        }
        lock.lock();
        changed_.wait_for(lock, kPeriod, [this] { return closing_ || is_new_; });
    }
}

std::string HealthReporter::message() const {
    v1::Health health;
    health.set_service("vision");
    health.set_status(status_);
    health.set_detail(detail_);
    health.set_instance(instance_);
    set_time(*health.mutable_started(), started_ns_);
    set_time(*health.mutable_now(), wall_ns());
    for (const auto& [name, total] : counters_.snapshot()) (*health.mutable_counters())[name] = total;
    for (const auto& [name, value] : gauges_) (*health.mutable_gauges())[name] = value;
    health.set_version(kVersion);
    return health.SerializeAsString();
}

}  // namespace armsight::vision::service
