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

ImageView ImageView::part(int x0, int y0, int x1, int y1) const {
    ImageView result = *this;
    result.width = x1 - x0;
    result.height = y1 - y0;
    const std::ptrdiff_t before = std::ptrdiff_t{x0} * layout(format).size;
    if (rows != nullptr) {
        result.rows += y0;
        result.left += before;
    } else {
        result.data = data.subspan(static_cast<std::size_t>(y0) * static_cast<std::size_t>(step) +
                                   static_cast<std::size_t>(before));
    }
    return result;
}

Image::Image(std::span<const Bytes> pieces, ImageView shape) : view_(shape) {
    if (pieces.size() == 1) {
        view_.data = pieces.front();
    } else {
        find_rows(pieces);
        view_.rows = rows_.data();
    }
}

void Image::find_rows(std::span<const Bytes> pieces) {
    const auto step = static_cast<std::size_t>(view_.step);
    const auto height = static_cast<std::size_t>(view_.height);
    rows_.reserve(height);
    copied_.reserve(std::min(pieces.size(), height) * step);  // a row that is copied ends a piece: it never grows
    Bytes rest;
    const auto go_on = [&] {
        while (rest.empty()) {
            rest = pieces.front();
            pieces = pieces.subspan(1);
        }
    };
    while (rows_.size() < height) {
        go_on();
        if (rest.size() >= step) {
            rows_.push_back(rest.data());
            rest = rest.subspan(step);
            continue;
        }
        const std::size_t begin = copied_.size();
        for (std::size_t missing = step; missing > 0;) {
            go_on();
            const Bytes here = rest.first(std::min(rest.size(), missing));
            copied_.insert(copied_.end(), here.begin(), here.end());
            rest = rest.subspan(here.size());
            missing -= here.size();
        }
        rows_.push_back(copied_.data() + begin);
    }
}

std::variant<Image, Refusal> validate_image(std::span<const Bytes> pieces, std::uint32_t width, std::uint32_t height,
                                            std::uint32_t step, std::string_view encoding) {
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
    std::uint64_t has = 0;
    for (const Bytes piece : pieces) has += piece.size();
    if (needed > has) {
        return Refusal{
            .counter = "image_refused_truncated",
            .text = "step x height is " + std::to_string(needed) + " bytes, but the data has " + std::to_string(has)};
    }
    return Image(pieces, {.data = {},
                          .width = static_cast<int>(width),
                          .height = static_cast<int>(height),
                          .step = static_cast<int>(step),
                          .format = *format});
}

}  // namespace armsight::vision
