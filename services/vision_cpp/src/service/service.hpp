#pragma once

#include <atomic>

#include "armsight/zenoh.hpp"
#include "service/settings.hpp"

namespace armsight::vision::service {

/// Waits for the router as long as it takes, then measures frames until `stop`. Returns the exit code.
int run(const Settings& settings, const std::atomic<bool>& stop);

/// Asks a running service for its parameters: 0 when it answers, 1 when not (for container health checks).
int probe(const Settings& settings);

}  // namespace armsight::vision::service
