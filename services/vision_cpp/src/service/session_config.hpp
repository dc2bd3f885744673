#pragma once

#include <cstdint>

#include "armsight/zenoh.hpp"
#include "service/settings.hpp"

namespace armsight::vision::service {

/// Bytes that every process which maps sim's pool of frames must be allowed to lock: the pool (6 MiB, see
/// proto/armsight/session.py) and Zenoh's own share.
inline constexpr std::uint64_t kSharedMemoryLockBytes = (6U << 20U) + 3U * (1U << 19U);

/// True when this process may lock that many bytes; with less, Zenoh loses frames without a word.
[[nodiscard]] bool may_lock(std::uint64_t bytes);

/// Zenoh's configuration for a client of the router: the file's values, with the same on top as every Python service
/// has (proto/armsight/session.py). Throws ConfigError.
[[nodiscard]] zenoh::Config session_config(const Settings& settings, bool shared_memory);

}  // namespace armsight::vision::service
