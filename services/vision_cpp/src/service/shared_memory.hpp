#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

namespace armsight::vision::service {

/// Bytes that a process which maps the pools of frames of so many robots' sims must be allowed to lock: the pools (6
/// MiB each, see proto/armsight/shared_memory.py) and Zenoh's own share.
[[nodiscard]] constexpr std::uint64_t shared_memory_lock_bytes(std::size_t robots) {
    constexpr std::uint64_t kPool = 6U << 20U;
    constexpr std::uint64_t kOwnShare = 3U << 19U;
    return robots * kPool + kOwnShare;
}

/// Room in /dev/shm for what a session keeps there.
inline constexpr std::uint64_t kSharedMemorySessionBytes = 1U << 20U;

/// True when this process may lock that many bytes; with less, Zenoh loses frames without a word.
[[nodiscard]] bool may_lock(std::uint64_t bytes);

/// What is in the way of shared memory with so many robots' sims, and what to do; empty where nothing is. Zenoh opens
/// no session where its segments find no room in `place`.
[[nodiscard]] std::string why_no_shared_memory(std::size_t robots, const std::string& place = "/dev/shm");

}  // namespace armsight::vision::service
