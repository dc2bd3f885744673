#include "armsight/vision/frame.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <random>
#include <string>
#include <variant>
#include <vector>

namespace armsight::vision {
namespace {

std::variant<Image, Refusal> validated(Bytes data, std::uint32_t width, std::uint32_t height, std::uint32_t step,
                                       std::string_view encoding) {
    return validate_image({&data, 1}, width, height, step, encoding);
}

std::string_view refusal(std::size_t bytes, std::uint32_t width, std::uint32_t height, std::uint32_t step,
                         std::string_view encoding) {
    const std::vector<std::uint8_t> data(bytes);
    const auto checked = validated(data, width, height, step, encoding);
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
    const auto checked = validated(data, 32, 32, 100, "rgb8");
    const auto& image = std::get<Image>(checked).view();
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
    const auto checked = validated(data, 32, 32, 96, "\x1b[31m\n\xff");
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
    const auto checked = validated(data, 32, 32, 100, "bgr8");
    const auto& image = std::get<Image>(checked).view();
    EXPECT_EQ(image.row(0), data.data());
    EXPECT_LE(image.row(31) + std::ptrdiff_t{image.step}, data.data() + data.size());
    EXPECT_EQ(image.format, PixelFormat::Bgr8);
    // the last row's padding is part of the image
    EXPECT_EQ(refusal(32 * 100 - 1, 32, 32, 100, "bgr8"), "image_refused_truncated");
}

TEST(Frame, RefusalOfALongEncodingStaysShort) {
    const std::vector<std::uint8_t> data(10);
    const auto checked = validated(data, 32, 32, 96, std::string(100'000, 'x'));
    EXPECT_LT(std::get<Refusal>(checked).text.size(), 200U);
}

// An image of `step` x `height` bytes that all differ from their neighbours, cut at random places, with some pieces
// empty.
struct InPieces {
    std::vector<std::uint8_t> whole;
    std::vector<std::vector<std::uint8_t>> copies;
    std::vector<Bytes> pieces;

    InPieces(std::mt19937& generator, std::size_t bytes, std::size_t longest) : whole(bytes) {
        std::ranges::generate(whole, [&] { return static_cast<std::uint8_t>(generator()); });
        for (std::size_t begin = 0; begin < bytes;) {
            const std::size_t end = std::min(bytes, begin + generator() % (longest + 1));
            copies.emplace_back(whole.begin() + static_cast<std::ptrdiff_t>(begin),
                                whole.begin() + static_cast<std::ptrdiff_t>(end));
            begin = end;
        }
        pieces.assign(copies.begin(), copies.end());
    }
};

TEST(Frame, InPiecesHasTheRowsOfTheWhole) {
    constexpr unsigned kSeed = 77;
    std::mt19937 generator(kSeed);
    for (const std::size_t longest : {1U, 7U, 99U, 100U, 101U, 250U, 5000U}) {
        const InPieces cut(generator, 32 * 100 + 5, longest);
        auto checked = validate_image(cut.pieces, 32, 32, 100, "rgb8");
        const Image image = std::get<Image>(std::move(checked));  // it may be moved
        int copied = 0;
        for (int y = 0; y < 32; ++y) {
            const std::uint8_t* row = image.view().row(y);
            ASSERT_TRUE(std::equal(row, row + 100, cut.whole.begin() + std::ptrdiff_t{y} * 100)) << longest << ' ' << y;
            copied += std::ranges::none_of(cut.pieces, [&](Bytes piece) {
                return row >= piece.data() && row + 100 <= piece.data() + piece.size();
            });
        }
        EXPECT_LT(copied, static_cast<int>(cut.pieces.size())) << "only what lies across two pieces";
        if (longest < 100) {
            EXPECT_EQ(copied, 32) << "no piece holds a row";
        } else if (longest > 1000) {
            EXPECT_LT(copied, 10) << "most rows stay where they are";
        }
        EXPECT_EQ(std::get<Refusal>(validate_image(std::span(cut.pieces), 32, 33, 100, "rgb8")).counter,
                  "image_refused_truncated");
    }
}

TEST(Frame, PartOfAnImageIsTheSameInOnePieceAndInMany) {
    std::mt19937 generator(78);
    const InPieces cut(generator, 40 * 128, 300);
    const Bytes whole(cut.whole);
    const auto in_one = validate_image({&whole, 1}, 32, 40, 128, "bgra8");
    const auto in_many = validate_image(cut.pieces, 32, 40, 128, "bgra8");
    const ImageView one = std::get<Image>(in_one).view().part(3, 5, 29, 31).part(2, 1, 20, 22);
    const ImageView many = std::get<Image>(in_many).view().part(3, 5, 29, 31).part(2, 1, 20, 22);
    ASSERT_EQ(one.width, 18);
    ASSERT_EQ(one.height, 21);
    ASSERT_EQ(many.width, 18);
    ASSERT_EQ(many.height, 21);
    for (int y = 0; y < 21; ++y) {
        EXPECT_EQ(one.row(y), whole.data() + (y + 6) * 128 + 5 * 4);
        EXPECT_TRUE(std::equal(one.row(y), one.row(y) + std::ptrdiff_t{18} * 4, many.row(y))) << y;
    }
}

}  // namespace
}  // namespace armsight::vision
