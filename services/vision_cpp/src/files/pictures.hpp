#pragma once

#include <cstdint>
#include <filesystem>
#include <stdexcept>
#include <vector>

namespace armsight::vision::files {

/// A file that cannot be read, written or understood; says which one and why.
class FileError : public std::runtime_error {
  public:
    using std::runtime_error::runtime_error;
};

/// Pixels in rows without padding, 3 bytes each: red, green, blue.
struct Picture {
    int width, height;
    std::vector<std::uint8_t> rgb;
};

/// Reads a PNG or JPEG file of up to 8192 x 8192 pixels. Throws FileError.
[[nodiscard]] Picture read_picture(const std::filesystem::path& path);

/// Throws FileError.
void write_png(const std::filesystem::path& path, const Picture& picture);

}  // namespace armsight::vision::files
