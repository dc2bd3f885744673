#pragma once

#include <string>

#include "armsight/zenoh.hpp"
#include "service/settings.hpp"

namespace armsight::vision::service {

/// Zenoh's configuration for a client of the router: the file's values, with the same on top as every Python service
/// has (proto/armsight/session.py). `robot`: its name; empty: the file's or the default. Throws ConfigError.
[[nodiscard]] zenoh::Config session_config(const Settings& settings, const std::string& robot, bool shared_memory);

}  // namespace armsight::vision::service
