#include "armsight/vision/frame.hpp"

#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <limits>
#include <string>
#include <vector>

namespace armsight::vision {
namespace {

std::string_view refusal(std::size_t bytes, std::uint32_t width, std::uint32_t height, std::uint32_t step,
                         std::string_view encoding) {
    const std::vector<std::uint8_t> data(bytes);
    const auto checked = validate_image(data, width, height, step, encoding);
    const auto* refused = std::get_if<Refusal>(&checked);
    return refused == nullptr ? "" : refused->counter;
}

TEST(Frame, WholeImagesOfEveryEncodingAreTaken) {
    EXPECT_EQ(refusal(640 * 480 * 3, 640, 480, 640 * 3, "rgb8"), "");
    EXPECT_EQ(refusal(640 * 480 * 3, 640, 480, 640 * 3, "bgr8"), "");
    EXPECT_EQ(refusal(640 * 480 * 4, 640, 480, 640 * 4, "rgba8"), "");
    EXPECT_EQ(refusal(640 * 480 * 4, 640, 480, 640 * 4, "bgra8"), "");
}

TEST(Frame, PaddingAfterEachRowIsKeptOut) {
    const std::vector<std::uint8_t> data(100 * 32);
    const auto checked = validate_image(data, 32, 32, 100, "rgb8");
    const auto& image = std::get<ImageView>(checked);
    EXPECT_EQ(image.row(1) - image.row(0), 100);
}

TEST(Frame, WhatDoesNotFitIsRefusedByReason) {
    EXPECT_EQ(refusal(32 * 32 * 3, 32, 32, 96, "mono8"), "image_refused_encoding");
    EXPECT_EQ(refusal(32 * 32 * 3, 32, 32, 96, ""), "image_refused_encoding");
    EXPECT_EQ(refusal(0, 0, 0, 0, "rgb8"), "image_refused_size");
    EXPECT_EQ(refusal(100, 15, 32, 96, "rgb8"), "image_refused_size");
    EXPECT_EQ(refusal(100, 32, 100'000, 96, "rgb8"), "image_refused_size");
    EXPECT_EQ(refusal(32 * 32 * 3, 32, 32, 95, "rgb8"), "image_refused_step");
    EXPECT_EQ(refusal(32 * 32 * 3, 32, 32, std::numeric_limits<std::uint32_t>::max(), "rgb8"), "image_refused_step");
    EXPECT_EQ(refusal(32 * 32 * 3 - 1, 32, 32, 96, "rgb8"), "image_refused_truncated");
    // width x height x 3 beyond 32 bits must not wrap around to something small
    EXPECT_EQ(refusal(1000, 8192, 8192, 8192 * 8, "rgba8"), "image_refused_truncated");
}

TEST(Frame, RefusalsQuoteNothingUnprintable) {
    const std::vector<std::uint8_t> data(10);
    const auto checked = validate_image(data, 32, 32, 96, "\x1b[31m\n\xff");
    for (const char c : std::get<Refusal>(checked).text) EXPECT_TRUE(c >= ' ' && c <= '~') << static_cast<int>(c);
}

TEST(Frame, SizesAtTheirLimitsAreTakenAndOneBeyondIsNot) {
    EXPECT_EQ(refusal(16 * 16 * 3, 16, 16, 48, "rgb8"), "");
    EXPECT_EQ(refusal(15 * 16 * 3, 16, 15, 48, "rgb8"), "image_refused_size");
    EXPECT_EQ(refusal(8192 * 16 * 4, 8192, 16, 8192 * 4, "bgra8"), "");
    EXPECT_EQ(refusal(8193 * 16 * 4, 8193, 16, 8193 * 4, "bgra8"), "image_refused_size");
    EXPECT_EQ(refusal(16 * 8193 * 3, 16, 8193, 48, "rgb8"), "image_refused_size");
    EXPECT_EQ(refusal(32 * 32 * 4, 32, 32, 127, "rgba8"), "image_refused_step") << "a row of four channels";
}

TEST(Frame, EveryRowLiesWithinTheBytesThatCame) {
    // 5 bytes more than needed, 4 of padding a row: the view may not reach beyond any of it
    const std::vector<std::uint8_t> data(32 * 100 + 5);
    const auto checked = validate_image(data, 32, 32, 100, "bgr8");
    const auto& image = std::get<ImageView>(checked);
    EXPECT_EQ(image.row(0), data.data());
    EXPECT_LE(image.row(31) + std::ptrdiff_t{image.step}, data.data() + data.size());
    EXPECT_EQ(image.format, PixelFormat::Bgr8);
    // the last row's padding is part of the image
    EXPECT_EQ(refusal(32 * 100 - 1, 32, 32, 100, "bgr8"), "image_refused_truncated");
}

TEST(Frame, RefusalOfALongEncodingStaysShort) {
    const std::vector<std::uint8_t> data(10);
    const auto checked = validate_image(data, 32, 32, 96, std::string(100'000, 'x'));
    EXPECT_LT(std::get<Refusal>(checked).text.size(), 200U);
}

}  // namespace
}  // namespace armsight::vision
