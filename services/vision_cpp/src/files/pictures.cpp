#include "files/pictures.hpp"

#include <stb_image.h>
#include <stb_image_write.h>

#include <memory>
#include <span>
#include <string>

#include "armsight/vision/frame.hpp"

namespace armsight::vision::files {
namespace {

constexpr int kChannels = 3;

}  // namespace

Picture read_picture(const std::filesystem::path& path) {
    Picture result{.width = 0, .height = 0, .rgb = {}};
    int channels = 0;
    // before any memory is taken for it: a few bytes may claim to be a large picture
    constexpr int kMaxSide = kMaxImageSide;
    if (stbi_info(path.c_str(), &result.width, &result.height, &channels) != 0 &&
        (result.width > kMaxSide || result.height > kMaxSide)) {
        throw FileError(path.string() + " is larger than " + std::to_string(kMaxSide) + " pixels");
    }
    const std::unique_ptr<stbi_uc, void (*)(void*)> pixels(
        stbi_load(path.c_str(), &result.width, &result.height, &channels, kChannels), stbi_image_free);
    if (!pixels) {
        throw FileError(path.string() + " cannot be read as PNG or JPEG: " + stbi_failure_reason());
    }
    const auto size = static_cast<std::size_t>(result.width) * static_cast<std::size_t>(result.height) * kChannels;
    const std::span bytes(pixels.get(), size);
    result.rgb.assign(bytes.begin(), bytes.end());
    return result;
}

void write_png(const std::filesystem::path& path, const Picture& picture) {
    const int step = picture.width * kChannels;
    if (stbi_write_png(path.c_str(), picture.width, picture.height, kChannels, picture.rgb.data(), step) == 0) {
        throw FileError(path.string() + " cannot be written");
    }
}

}  // namespace armsight::vision::files
