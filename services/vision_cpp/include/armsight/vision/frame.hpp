#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <variant>

namespace armsight::vision {

/// Order of the 8-bit channels of one pixel.
enum class PixelFormat { Rgb8, Bgr8, Rgba8, Bgra8 };

/// Where the channels of one pixel lie, in bytes from its first.
struct PixelLayout {
    int size;
    int red, green, blue;
};

[[nodiscard]] constexpr PixelLayout layout(PixelFormat format) {
    switch (format) {
        case PixelFormat::Bgr8:
            return {3, 2, 1, 0};
        case PixelFormat::Rgba8:
            return {4, 0, 1, 2};
        case PixelFormat::Bgra8:
            return {4, 2, 1, 0};
        case PixelFormat::Rgb8:
            break;
    }
    return {3, 0, 1, 2};
}

/// Pixels that somebody else owns, wrapped and never copied. Made by validate_image(), which guarantees that every
/// row lies within `data`.
struct ImageView {
    std::span<const std::uint8_t> data;
    int width, height;  ///< pixels
    int step;           ///< bytes from one row to the next, padding included
    PixelFormat format;

    [[nodiscard]] const std::uint8_t* row(int y) const {
        return data.data() + static_cast<std::size_t>(y) * static_cast<std::size_t>(step);
    }
};

/// Why an image is not used.
struct Refusal {
    std::string_view counter;  ///< name of the health counter, e.g. `image_refused_size`
    std::string text;          ///< one line for a person: what was wrong, what was expected
};

inline constexpr std::uint32_t kMinImageSide = 16;  ///< pixels; no marker can be measured in less
inline constexpr std::uint32_t kMaxImageSide =
    8192;  ///< pixels; beyond any camera of this use, and keeps sums in range

/// Checks the header of an image against its bytes. Nothing in it is trusted: it comes from the bus.
[[nodiscard]] std::variant<ImageView, Refusal> validate_image(std::span<const std::uint8_t> data, std::uint32_t width,
                                                              std::uint32_t height, std::uint32_t step,
                                                              std::string_view encoding);

}  // namespace armsight::vision
