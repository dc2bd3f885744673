#pragma once

#include <cstdint>
#include <span>

namespace armsight::vision {

/// Sum of all bytes, with the widest vectors that this processor has: nothing that looks at every pixel can be faster.
std::uint64_t sum_bytes(std::span<const std::uint8_t> bytes);

}  // namespace armsight::vision
