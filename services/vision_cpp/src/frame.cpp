#include "armsight/vision/frame.hpp"

#include <algorithm>
#include <optional>

namespace armsight::vision {
namespace {

// A row of the widest image with four channels, and as much padding again.
constexpr std::uint32_t kMaxStep = kMaxImageSide * 4 * 2;
constexpr std::size_t kMaxQuotedEncoding = 32;

std::optional<PixelFormat> parse_encoding(std::string_view encoding) {
    if (encoding == "rgb8") return PixelFormat::Rgb8;
    if (encoding == "bgr8") return PixelFormat::Bgr8;
    if (encoding == "rgba8") return PixelFormat::Rgba8;
    if (encoding == "bgra8") return PixelFormat::Bgra8;
    return std::nullopt;
}

// The text comes from the bus and goes into logs: short and printable.
std::string printable(std::string_view text) {
    std::string result(text.substr(0, kMaxQuotedEncoding));
    std::ranges::replace_if(result, [](char c) { return c < ' ' || c > '~'; }, '?');
    return result;
}

}  // namespace

std::variant<ImageView, Refusal> validate_image(std::span<const std::uint8_t> data, std::uint32_t width,
                                                std::uint32_t height, std::uint32_t step, std::string_view encoding) {
    const auto format = parse_encoding(encoding);
    if (!format) {
        return Refusal{.counter = "image_refused_encoding",
                       .text = "encoding '" + printable(encoding) + "' is not one of rgb8, bgr8, rgba8, bgra8"};
    }
    if (width < kMinImageSide || height < kMinImageSide || width > kMaxImageSide || height > kMaxImageSide) {
        return Refusal{.counter = "image_refused_size",
                       .text = "size " + std::to_string(width) + " x " + std::to_string(height) + " is not within " +
                               std::to_string(kMinImageSide) + " to " + std::to_string(kMaxImageSide) + " pixels"};
    }
    const std::uint32_t row_bytes = width * static_cast<std::uint32_t>(layout(*format).size);
    if (step < row_bytes || step > kMaxStep) {
        return Refusal{.counter = "image_refused_step",
                       .text = "step " + std::to_string(step) + " does not hold a row of " + std::to_string(row_bytes) +
                               " bytes (at most " + std::to_string(kMaxStep) + ")"};
    }
    const std::uint64_t needed = std::uint64_t{step} * height;
    if (needed > data.size()) {
        return Refusal{.counter = "image_refused_truncated",
                       .text = "step x height is " + std::to_string(needed) + " bytes, but the data has " +
                               std::to_string(data.size())};
    }
    return ImageView{.data = data,
                     .width = static_cast<int>(width),
                     .height = static_cast<int>(height),
                     .step = static_cast<int>(step),
                     .format = *format};
}

}  // namespace armsight::vision
