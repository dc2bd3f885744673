#include "armsight/vision/pool.hpp"

namespace armsight::vision {

std::pmr::memory_resource& frame_pool() {
    // never destroyed: whoever still holds memory when the process ends may give it back
    static auto* const kPool = new std::pmr::synchronized_pool_resource(
        {.max_blocks_per_chunk = 0, .largest_required_pool_block = std::size_t{1} << 20U});
    return *kPool;
}

}  // namespace armsight::vision
