#include "sum.hpp"

#include <cstddef>

// Highway compiles this file once for each instruction set; HWY_ONCE below is what all of them share.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "sum.cpp"  // NOLINT(cppcoreguidelines-macro-usage)
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace armsight::vision::HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;

std::uint64_t sum(const std::uint8_t* bytes, std::size_t size) {
    std::uint64_t total = 0;
    std::size_t i = 0;
#if HWY_TARGET != HWY_SCALAR
    const hn::ScalableTag<std::uint8_t> d;
    const hn::Repartition<std::uint64_t, decltype(d)> wide;
    const std::size_t lanes = hn::Lanes(d);
    auto first = hn::Zero(wide);
    auto second = first;  // two sums, so that none waits for the other
    for (; i + 2 * lanes <= size; i += 2 * lanes) {
        first = hn::Add(first, hn::SumsOf8(hn::LoadU(d, bytes + i)));
        second = hn::Add(second, hn::SumsOf8(hn::LoadU(d, bytes + i + lanes)));
    }
    total = hn::GetLane(hn::SumOfLanes(wide, hn::Add(first, second)));
#endif
    for (; i < size; ++i) total += bytes[i];
    return total;
}

}  // namespace
}  // namespace armsight::vision::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace armsight::vision {

HWY_EXPORT(sum);

std::uint64_t sum_bytes(std::span<const std::uint8_t> bytes) {
    return HWY_DYNAMIC_DISPATCH(sum)(bytes.data(), bytes.size());
}

}  // namespace armsight::vision
#endif
