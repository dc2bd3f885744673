#include "service/shared_memory.hpp"

#include <sys/resource.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include <fstream>
#include <string>

namespace armsight::vision::service {
namespace {

constexpr unsigned kCapIpcLock = 14;  // linux/capability.h

bool has_capability(unsigned number) {
    std::ifstream status("/proc/self/status");
    for (std::string line; std::getline(status, line);) {
        if (line.starts_with("CapEff:")) return ((std::stoull(line.substr(7), nullptr, 16) >> number) & 1U) != 0;
    }
    return false;
}

}  // namespace

bool may_lock(std::uint64_t bytes) {
    rlimit limit{};
    if (getrlimit(RLIMIT_MEMLOCK, &limit) != 0) return false;
    return limit.rlim_cur == RLIM_INFINITY || limit.rlim_cur >= bytes || has_capability(kCapIpcLock);
}

std::string why_no_shared_memory(std::size_t robots, const std::string& place) {
    if (const auto bytes = shared_memory_lock_bytes(robots); !may_lock(bytes)) {
        return "this process may lock less than " + std::to_string(bytes) + " bytes; raise `ulimit -l` to use it";
    }
    struct statvfs told{};
    if (statvfs(place.c_str(), &told) != 0 || access(place.c_str(), W_OK | X_OK) != 0) {
        return "there is no " + place + ", or this user can't write there";
    }
    const std::uint64_t free_bytes = std::uint64_t{told.f_bavail} * told.f_frsize;
    if (free_bytes < kSharedMemorySessionBytes) {
        return place + " has " + std::to_string(free_bytes) + " bytes free and " +
               std::to_string(kSharedMemorySessionBytes) + " are needed; in a container raise --shm-size";
    }
    return {};
}

}  // namespace armsight::vision::service
