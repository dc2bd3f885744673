#pragma once

#include <atomic>
#include <optional>
#include <string>

#include "armsight/zenoh.hpp"
#include "service/settings.hpp"

namespace armsight::vision::service {

/// One robot's place on the bus. A session each: what a flood of one robot's frames fills are that session's queues and
/// its link, and the router lets each session do what the certificate may do with its robot, no more.
struct Connection {
    std::string robot;  ///< the namespace in force
    zenoh::Session session;
    bool shared_memory;
};

/// Waits for the router as long as it takes; returns nothing once `stop` is set. Goes without shared memory where that
/// can't be had, and says why. `robot`: one of the settings' robots. Throws ConfigError.
[[nodiscard]] std::optional<Connection> connect(const Settings& settings, const std::string& robot, bool shared_memory,
                                                const std::atomic<bool>& stop);

}  // namespace armsight::vision::service
