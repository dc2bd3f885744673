#pragma once

#include <cstdint>
#include <string>

namespace armsight::vision::service {

/// Bytes that every process which maps sim's pool of frames must be allowed to lock: the pool (6 MiB, see
/// proto/armsight/shared_memory.py) and Zenoh's own share.
inline constexpr std::uint64_t kSharedMemoryLockBytes = (6U << 20U) + 3U * (1U << 19U);

/// Room in /dev/shm for what a session keeps there.
inline constexpr std::uint64_t kSharedMemorySessionBytes = 1U << 20U;

/// True when this process may lock that many bytes; with less, Zenoh loses frames without a word.
[[nodiscard]] bool may_lock(std::uint64_t bytes);

/// What is in the way of shared memory, and what to do; empty where nothing is. Zenoh opens no session where its
/// segments find no room in `place`.
[[nodiscard]] std::string why_no_shared_memory(const std::string& place = "/dev/shm");

}  // namespace armsight::vision::service
