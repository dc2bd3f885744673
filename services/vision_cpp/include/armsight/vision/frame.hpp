#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

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

using Bytes = std::span<const std::uint8_t>;

/// Pixels that somebody else owns, wrapped and never copied. Made by validate_image(), which guarantees that every
/// row lies within the bytes that came.
struct ImageView {
    Bytes data;         ///< rows one after the other; unused where there are `rows`
    int width, height;  ///< pixels
    int step;           ///< bytes from one row to the next in `data`, padding included
    PixelFormat format;
    const std::uint8_t* const* rows = nullptr;  ///< where each row begins, if they lie apart
    std::ptrdiff_t left = 0;                    ///< bytes of each of `rows` before the image

    [[nodiscard]] const std::uint8_t* row(int y) const {
        if (rows != nullptr) return rows[y] + left;
        return data.data() + static_cast<std::size_t>(y) * static_cast<std::size_t>(step);
    }

    /// The pixels from (x0, y0) up to, without, (x1, y1), which must lie within the image.
    [[nodiscard]] ImageView part(int x0, int y0, int x1, int y1) const;
};

/// An image whose bytes came in one piece or several, as over a network. Rows stay where they are, but for those that
/// lie across two pieces: these are copied.
class Image {
  public:
    /// `shape`: everything but the bytes, of which `pieces` has enough.
    Image(std::span<const Bytes> pieces, ImageView shape);

    /// Valid for as long as both the pieces and this object are, wherever it is moved.
    [[nodiscard]] const ImageView& view() const { return view_; }

    Image(Image&&) = default;
    Image& operator=(Image&&) = default;
    Image(const Image&) = delete;
    Image& operator=(const Image&) = delete;
    ~Image() = default;

  private:
    void find_rows(std::span<const Bytes> pieces);

    ImageView view_;
    std::vector<const std::uint8_t*> rows_;
    std::vector<std::uint8_t> copied_;
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
[[nodiscard]] std::variant<Image, Refusal> validate_image(std::span<const Bytes> pieces, std::uint32_t width,
                                                          std::uint32_t height, std::uint32_t step,
                                                          std::string_view encoding);

}  // namespace armsight::vision
