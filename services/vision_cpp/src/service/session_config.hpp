#pragma once

#include "armsight/zenoh.hpp"
#include "service/settings.hpp"

namespace armsight::vision::service {

/// Zenoh's configuration for a client of the router: the file's values, with the same on top as every Python service
/// has (proto/armsight/session.py). Throws ConfigError.
[[nodiscard]] zenoh::Config session_config(const Settings& settings, bool shared_memory);

}  // namespace armsight::vision::service
