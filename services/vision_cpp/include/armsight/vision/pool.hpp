#pragma once

#include <cstddef>
#include <memory_resource>
#include <type_traits>
#include <vector>

namespace armsight::vision {

/// What frames are worked on with comes from here, and goes back here: after the first frames the heap is left alone,
/// so that no frame waits for it. Lives as long as the process; safe from every thread.
[[nodiscard]] std::pmr::memory_resource& frame_pool();

/// Takes memory from frame_pool(). Has no state: containers with it are copied, moved and swapped like any other.
template <typename T>
class PoolAllocator {
  public:
    using value_type = T;
    using is_always_equal = std::true_type;

    PoolAllocator() = default;
    template <typename U>
    PoolAllocator(const PoolAllocator<U>& /*other*/) {}  // NOLINT(*-explicit-constructor): allocators convert

    [[nodiscard]] T* allocate(std::size_t count) {
        return static_cast<T*>(frame_pool().allocate(count * sizeof(T), alignof(T)));
    }
    void deallocate(T* memory, std::size_t count) {
        frame_pool().deallocate(static_cast<void*>(memory), count * sizeof(T), alignof(T));
    }

    friend bool operator==(const PoolAllocator& /*a*/, const PoolAllocator& /*b*/) { return true; }
};

template <typename T>
using PoolVector = std::vector<T, PoolAllocator<T>>;

}  // namespace armsight::vision
