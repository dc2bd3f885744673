#include "scan.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstring>
#include <stdexcept>

// NOLINTBEGIN(cppcoreguidelines-macro-usage): Highway's way to be told
// Vectors whose size the compiler does not know cannot be members of structs: such processors have NEON as well.
#define HWY_DISABLED_TARGETS (HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128 | HWY_RVV)
// It compiles this file once for each instruction set; HWY_ONCE below is what all of them share.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "scan.cpp"
// NOLINTEND(cppcoreguidelines-macro-usage)
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace armsight::vision::HWY_NAMESPACE {
namespace {

// Pixels one by one: what is narrower than a vector, and processors that have none that Highway can use.
template <int kPixelSize>
void scan_pixels(const ImageView& image, std::span<const ColorCone> cones, int y, std::vector<MarkerMask>& masks) {
    const PixelLayout order = layout(image.format);
    for (int x = 0; x < image.width; ++x) {
        const std::uint8_t* p = image.row(y) + std::ptrdiff_t{x} * kPixelSize;
        const auto owner = std::ranges::find_if(
            cones, [&](const ColorCone& cone) { return cone.contains(p[order.red], p[order.green], p[order.blue]); });
        if (owner == cones.end()) continue;
        append_run(masks[static_cast<std::size_t>(owner - cones.begin())].runs, y, x, x + 1);
    }
}

#if HWY_TARGET == HWY_SCALAR || HWY_TARGET == HWY_EMU128

template <int kPixelSize>
void scan_rows(const ImageView& image, std::span<const ColorCone> cones, std::vector<MarkerMask>& masks) {
    for (int y = 0; y < image.height; ++y) scan_pixels<kPixelSize>(image, cones, y, masks);
}

#else

namespace hn = hwy::HWY_NAMESPACE;

// As many pixels as one word has bits.
using Pixels = hn::CappedTag<std::uint8_t, 64>;
using Wide = hn::RepartitionToWide<hn::RebindToSigned<Pixels> >;
using PixelVec = hn::Vec<Pixels>;
using WideVec = hn::Vec<Wide>;

template <class V>
struct Channels {
    V red, green, blue;
};

template <int kPixelSize>
HWY_INLINE Channels<PixelVec> load(const std::uint8_t* pixels, bool red_first) {
    const Pixels d;
    PixelVec first, green, third;
    if constexpr (kPixelSize == 4) {
        PixelVec alpha;
        hn::LoadInterleaved4(d, pixels, first, green, third, alpha);
    } else {
        hn::LoadInterleaved3(d, pixels, first, green, third);
    }
    return red_first ? Channels<PixelVec>{first, green, third} : Channels<PixelVec>{third, green, first};
}

HWY_INLINE WideVec dot(const ColorCone::Plane& plane, const Channels<WideVec>& p) {
    const Wide d;
    return hn::Add(hn::Add(hn::Mul(p.red, hn::Set(d, plane[0])), hn::Mul(p.green, hn::Set(d, plane[1]))),
                   hn::Mul(p.blue, hn::Set(d, plane[2])));
}

HWY_INLINE hn::Mask<Wide> has_hue(const ColorCone& cone, const Channels<WideVec>& p) {
    const Wide d;
    return hn::Gt(dot(cone.hue, p), hn::Set(d, static_cast<std::int16_t>(cone.floor - 1)));
}

HWY_INLINE hn::Mask<Wide> is_between(const ColorCone& cone, const Channels<WideVec>& p) {
    const Wide d;
    const auto least = hn::Min(hn::Min(dot(cone.saturation, p), dot(cone.left, p)), dot(cone.right, p));
    return hn::Gt(least, hn::Set(d, std::int16_t{-1}));
}

// One bit for each pixel, the first one lowest.
HWY_INLINE std::uint64_t bits(hn::Mask<Wide> lower, hn::Mask<Wide> upper) {
    const Wide d;
    std::array<std::uint8_t, 16> bytes{};
    const std::size_t size = hn::StoreMaskBits(d, lower, bytes.data());
    hn::StoreMaskBits(d, upper, bytes.data() + size);
    std::uint64_t result = 0;
    std::memcpy(&result, bytes.data(), sizeof(result));
    const std::size_t count = 2 * hn::Lanes(d);
    return count < 64 ? result & ((std::uint64_t{1} << count) - 1) : result;
}

void append_bits(std::vector<Run>& runs, int y, int x, std::uint64_t found) {
    while (found != 0) {
        const int begin = std::countr_zero(found);
        const int end = begin + std::countr_one(found >> static_cast<unsigned>(begin));
        append_run(runs, y, x + begin, x + end);
        found = end < 64 ? found & (~std::uint64_t{0} << static_cast<unsigned>(end)) : 0;
    }
}

void classify_block(std::span<const ColorCone> cones, const Channels<PixelVec>& p, int y, int x, std::uint64_t wanted,
                    std::vector<MarkerMask>& masks) {
    const Wide d;
    const hn::Half<Pixels> half;
    const Channels<WideVec> lower{hn::PromoteTo(d, hn::LowerHalf(half, p.red)),
                                  hn::PromoteTo(d, hn::LowerHalf(half, p.green)),
                                  hn::PromoteTo(d, hn::LowerHalf(half, p.blue))};
    const Channels<WideVec> upper{hn::PromoteTo(d, hn::UpperHalf(half, p.red)),
                                  hn::PromoteTo(d, hn::UpperHalf(half, p.green)),
                                  hn::PromoteTo(d, hn::UpperHalf(half, p.blue))};
    for (std::size_t i = 0; i < cones.size() && wanted != 0; ++i) {
        const auto lower_hue = has_hue(cones[i], lower);
        const auto upper_hue = has_hue(cones[i], upper);
        if (hn::AllFalse(d, hn::Or(lower_hue, upper_hue))) continue;
        const std::uint64_t found =
            bits(hn::And(lower_hue, is_between(cones[i], lower)), hn::And(upper_hue, is_between(cones[i], upper))) &
            wanted;
        append_bits(masks[i].runs, y, x, found);
        wanted &= ~found;
    }
}

// Set where a byte and the next one are channels of the same pixel, and neither is alpha.
template <int kPixelSize>
constexpr auto kSamePixel = [] {
    std::array<std::uint8_t, std::size_t{64} * kPixelSize> flags{};
    for (std::size_t i = 0; i < flags.size(); ++i) flags.at(i) = i % kPixelSize < 2 ? 255 : 0;
    return flags;
}();

// A first look at a whole block that takes no pixel apart: true where red and blue differ so little from green that
// nothing in it can have a colour. Reads one byte more than the block.
template <int kPixelSize>
class PlainBlock {
  public:
    explicit PlainBlock(int neutral)
        // |R - B| <= |R - G| + |G - B|: each may be half
        : half_(hn::Set(Pixels(), static_cast<std::uint8_t>(neutral / 2))), whole_(hn::Add(half_, half_)) {
        for (std::size_t i = 0; i < kPixelSize; ++i) {
            same_pixel_[i] =
                hn::MaskFromVec(hn::LoadU(Pixels(), kSamePixel<kPixelSize>.data() + i * hn::Lanes(Pixels())));
        }
    }

    // Of `kBlocks` blocks, one after the other.
    template <int kBlocks>
    [[nodiscard]] HWY_INLINE bool holds(const std::uint8_t* block) const {
        const Pixels d;
        auto largest = whole_;
        for (std::size_t i = 0; i < kBlocks * kPixelSize; ++i) {
            const auto here = hn::LoadU(d, block + i * hn::Lanes(d));
            const auto next = hn::LoadU(d, block + i * hn::Lanes(d) + 1);
            // -half <= difference <= half becomes 0 <= shifted <= whole, without a sign and with every byte used once
            const auto shifted = hn::Add(hn::Sub(here, next), half_);
            largest = hn::Max(largest, hn::IfThenElseZero(same_pixel_[i % kPixelSize], shifted));
        }
        return hn::AllTrue(d, hn::Eq(largest, whole_));
    }

  private:
    PixelVec half_, whole_;
    hn::Mask<Pixels> same_pixel_[kPixelSize];
};

template <int kPixelSize>
void scan_rows(const ImageView& image, std::span<const ColorCone> cones, std::vector<MarkerMask>& masks) {
    const Pixels d;
    const int lanes = static_cast<int>(hn::Lanes(d));
    const bool red_first = layout(image.format).red == 0;
    int neutral = 255;
    for (const ColorCone& cone : cones) neutral = std::min(neutral, cone.neutral);
    const auto limit = hn::Set(d, static_cast<std::uint8_t>(neutral));
    const PlainBlock<kPixelSize> plain(neutral);
    for (int y = 0; y < image.height; ++y) {
        if (image.width < lanes) {
            scan_pixels<kPixelSize>(image, cones, y, masks);
            continue;
        }
        const std::uint8_t* row = image.row(y);
        const int last = image.width - lanes;
        for (int done = 0; done < image.width;) {
            // most blocks of most pictures: background, ground, black links
            while (done + lanes < last && plain.template holds<2>(row + std::ptrdiff_t{done} * kPixelSize)) {
                done += 2 * lanes;
            }
            if (done < last && plain.template holds<1>(row + std::ptrdiff_t{done} * kPixelSize)) {
                done += lanes;
                continue;
            }
            // the rest of a row is taken with a whole vector that ends with it; what was seen before is dropped
            const int x = std::min(done, last);
            const auto dropped = static_cast<unsigned>(done - x);
            if (done >= image.width) break;
            done = x + lanes;
            const auto p = load<kPixelSize>(row + std::ptrdiff_t{x} * kPixelSize, red_first);
            const auto largest = hn::Max(hn::Max(p.red, p.green), p.blue);
            const auto least = hn::Min(hn::Min(p.red, p.green), p.blue);
            // noise alone makes no colour
            if (hn::AllTrue(d, hn::Eq(hn::Max(hn::Sub(largest, least), limit), limit))) continue;
            classify_block(cones, p, y, x, ~std::uint64_t{0} << dropped, masks);
        }
    }
}

#endif

void scan_image(const ImageView& image, std::span<const ColorCone> cones, std::vector<MarkerMask>& masks) {
    if (layout(image.format).size == 4) {
        scan_rows<4>(image, cones, masks);
    } else {
        scan_rows<3>(image, cones, masks);
    }
}

}  // namespace
}  // namespace armsight::vision::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace armsight::vision {

HWY_EXPORT(scan_image);

// NOLINTNEXTLINE(misc-const-correctness): what is called appends to the masks
void scan(const ImageView& image, std::span<const ColorCone> cones, std::vector<MarkerMask>& masks) {
    HWY_DYNAMIC_DISPATCH(scan_image)(image, cones, masks);
}

std::vector<std::string> scan_targets() {
    std::vector<std::string> names;
    for (const std::int64_t target : hwy::SupportedAndGeneratedTargets()) names.emplace_back(hwy::TargetName(target));
    return names;
}

void force_scan_target(const std::string& name) {
    hwy::SetSupportedTargetsForTest(0);
    std::int64_t wanted = 0;
    for (const std::int64_t target : hwy::SupportedAndGeneratedTargets()) {
        if (name == hwy::TargetName(target)) wanted = target;
    }
    if (wanted == 0 && !name.empty()) {
        throw std::invalid_argument("this processor or build has no instruction set '" + name + "'");
    }
    hwy::SetSupportedTargetsForTest(wanted);
    hwy::GetChosenTarget().DeInit();
}

}  // namespace armsight::vision
#endif
