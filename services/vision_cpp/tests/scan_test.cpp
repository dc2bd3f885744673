#include "scan.hpp"

#include <gtest/gtest.h>

#include <random>

#include "armsight/vision/opencv_classify.hpp"
#include "scene.hpp"

namespace armsight::vision {
namespace {

using testing::Picture;

constexpr std::array kFormats{PixelFormat::Rgb8, PixelFormat::Bgr8, PixelFormat::Rgba8, PixelFormat::Bgra8};

// Every kind of pixel: noise, grey with noise, and the markers' own colours at every brightness, in short stretches.
Picture random_picture(std::mt19937& generator, int width, int height) {
    const auto draw = [&](int low, int high) { return std::uniform_int_distribution<int>(low, high)(generator); };
    Picture picture{.bytes = {}, .width = width, .height = height, .step = width * 3, .format = PixelFormat::Rgb8};
    const auto markers = testing::arm_markers();
    const int pixels = width * height;
    while (static_cast<int>(picture.bytes.size()) < 3 * pixels) {
        const int kind = draw(0, 2);
        const int stretch = draw(1, 40);
        const int level = draw(0, 255);
        const auto& color = markers[static_cast<std::size_t>(draw(0, static_cast<int>(markers.size()) - 1))].color;
        for (int i = 0; i < stretch; ++i) {
            for (int c = 0; c < 3; ++c) {
                const int value = kind == 0   ? draw(0, 255)
                                  : kind == 1 ? level + draw(-12, 12)
                                              : static_cast<int>(level * color[c]) + draw(0, 30);
                picture.bytes.push_back(static_cast<std::uint8_t>(std::clamp(value, 0, 255)));
            }
        }
    }
    picture.bytes.resize(static_cast<std::size_t>(3 * pixels));
    return picture;
}

// One byte a pixel: 0, or 1 + the first cone that contains it.
std::vector<int> owners(const Picture& rgb, std::span<const ColorCone> cones) {
    std::vector<int> result;
    for (std::size_t i = 0; i < rgb.bytes.size(); i += 3) {
        const auto owner = std::ranges::find_if(cones, [&](const ColorCone& cone) {
            return cone.contains(rgb.bytes[i], rgb.bytes[i + 1], rgb.bytes[i + 2]);
        });
        result.push_back(owner == cones.end() ? 0 : 1 + static_cast<int>(owner - cones.begin()));
    }
    return result;
}

std::vector<int> owners(const std::vector<MarkerMask>& masks, int width, int height) {
    std::vector<int> result(static_cast<std::size_t>(width * height), 0);
    for (std::size_t i = 0; i < masks.size(); ++i) {
        for (const vision::Run& run : masks[i].runs) {
            for (int x = run.x0; x < run.x1; ++x) {
                int& owner = result[static_cast<std::size_t>(run.y * width + x)];
                EXPECT_EQ(owner, 0) << "pixel " << x << ", " << run.y << " has two owners";
                owner = 1 + static_cast<int>(i);
            }
        }
    }
    return result;
}

bool is_sorted_and_apart(const std::vector<vision::Run>& runs) {
    return std::ranges::adjacent_find(runs, [](const vision::Run& a, const vision::Run& b) {
               return b.y < a.y || (b.y == a.y && b.x0 <= a.x1);
           }) == runs.end();
}

class OnEveryTarget : public ::testing::TestWithParam<std::string> {
  protected:
    void SetUp() override { force_scan_target(GetParam()); }
    void TearDown() override { force_scan_target(""); }
};

TEST_P(OnEveryTarget, EveryPixelBelongsToTheFirstConeThatContainsIt) {
    constexpr unsigned kSeed = 20;
    std::mt19937 generator(kSeed);
    const auto cones = color_cones(testing::arm_markers());
    std::vector<MarkerMask> masks;
    int of_markers = 0;
    for (int round = 0; round < 300; ++round) {
        // widths below, at and around every vector's length, rows that end in the middle of one
        const int width = 16 + round % 150;
        const int height = 16 + round % 3;
        const Picture rgb = random_picture(generator, width, height);
        const PixelFormat format = kFormats.at(static_cast<std::size_t>(round) % kFormats.size());
        // without padding on the last row: reading beyond it is caught by the sanitizers
        const Picture picture = testing::converted(rgb, format, round % 7);
        masks.assign(cones.size(), {});
        scan(picture.view(), cones, masks);
        const auto expected = owners(rgb, cones);
        ASSERT_EQ(owners(masks, width, height), expected) << "width " << width << " seed " << kSeed;
        for (const MarkerMask& mask : masks) ASSERT_TRUE(is_sorted_and_apart(mask.runs));
        of_markers += static_cast<int>(std::ranges::count_if(expected, [](int owner) { return owner != 0; }));
    }
    EXPECT_GT(of_markers, 50'000);
}

TEST_P(OnEveryTarget, NoColourAtAllIsDecidedOtherwise) {
    // all 2^24 colours, one row of a picture for each red and green
    const auto cones = color_cones(testing::arm_markers());
    Picture picture{.bytes = std::vector<std::uint8_t>(std::size_t{256} * 256 * 3),
                    .width = 256,
                    .height = 256,
                    .step = 768,
                    .format = PixelFormat::Rgb8};
    std::vector<MarkerMask> masks;
    for (int red = 0; red < 256; ++red) {
        for (int green = 0; green < 256; ++green) {
            for (int blue = 0; blue < 256; ++blue) {
                auto* p = picture.bytes.data() + green * 768 + blue * 3;
                p[0] = static_cast<std::uint8_t>(red);
                p[1] = static_cast<std::uint8_t>(green);
                p[2] = static_cast<std::uint8_t>(blue);
            }
        }
        masks.assign(cones.size(), {});
        scan(picture.view(), cones, masks);
        ASSERT_EQ(owners(masks, 256, 256), owners(picture, cones)) << "red " << red;
    }
}

INSTANTIATE_TEST_SUITE_P(Scan, OnEveryTarget, ::testing::ValuesIn(scan_targets()),
                         [](const auto& test) { return test.param; });

TEST(Scan, UnknownTargetIsRefused) { EXPECT_THROW(force_scan_target("ABACUS"), std::invalid_argument); }

TEST(Scan, PixelsMoveWithThePicture) {
    std::mt19937 generator(4);
    const auto cones = color_cones(testing::arm_markers());
    const Picture whole = random_picture(generator, 150, 40);
    std::vector<MarkerMask> masks(cones.size());
    scan(whole.view(), cones, masks);
    const auto expected = owners(masks, whole.width, whole.height);
    for (int dx = 1; dx < 70; dx += 3) {
        ImageView part = whole.view();
        part.data = part.data.subspan(static_cast<std::size_t>(3 * dx));
        part.width -= dx;
        masks.assign(cones.size(), {});
        scan(part, cones, masks);
        const auto found = owners(masks, part.width, part.height);
        for (int y = 0; y < part.height; ++y) {
            for (int x = 0; x < part.width; ++x) {
                ASSERT_EQ(found[static_cast<std::size_t>(y * part.width + x)],
                          expected[static_cast<std::size_t>(y * whole.width + x + dx)])
                    << "shift " << dx;
            }
        }
    }
}

TEST(OpenCv, MasksAndComponentsAreTheSame) {
    constexpr unsigned kSeed = 31;
    std::mt19937 generator(kSeed);
    const auto cones = color_cones(testing::arm_markers());
    std::vector<MarkerMask> ours;
    std::vector<MarkerMask> theirs;
    for (int round = 0; round < 60; ++round) {
        const Picture picture =
            testing::converted(random_picture(generator, 16 + 3 * round, 90),
                               kFormats.at(static_cast<std::size_t>(round) % kFormats.size()), round % 5);
        classify(picture.view(), cones, ours);
        classify_opencv(picture.view(), cones, theirs);
        for (std::size_t i = 0; i < cones.size(); ++i) {
            ASSERT_EQ(ours[i].runs, theirs[i].runs) << "marker " << i << " round " << round << " seed " << kSeed;
            ASSERT_EQ(ours[i].components, theirs[i].components) << "marker " << i << " round " << round;
        }
    }
}

TEST(OpenCv, DecidesEveryColourLikeThePlanes) {
    const auto cones = color_cones(testing::arm_markers());
    Picture picture{.bytes = std::vector<std::uint8_t>(std::size_t{256} * 256 * 3),
                    .width = 256,
                    .height = 256,
                    .step = 768,
                    .format = PixelFormat::Rgb8};
    std::vector<MarkerMask> masks;
    for (int red = 0; red < 256; red += 5) {
        for (int green = 0; green < 256; ++green) {
            for (int blue = 0; blue < 256; ++blue) {
                auto* p = picture.bytes.data() + green * 768 + blue * 3;
                p[0] = static_cast<std::uint8_t>(red);
                p[1] = static_cast<std::uint8_t>(green);
                p[2] = static_cast<std::uint8_t>(blue);
            }
        }
        classify_opencv(picture.view(), cones, masks);
        ASSERT_EQ(owners(masks, 256, 256), owners(picture, cones)) << "red " << red;
    }
}

TEST(OpenCv, OpeningRemovesSpeckle) {
    Picture picture{.bytes = std::vector<std::uint8_t>(std::size_t{64} * 48 * 3, 90),
                    .width = 64,
                    .height = 48,
                    .step = 192,
                    .format = PixelFormat::Rgb8};
    const auto paint = [&](int x, int y) { picture.bytes[static_cast<std::size_t>(y * 192 + x * 3)] = 250; };
    paint(5, 5);
    for (int y = 20; y < 30; ++y) {
        for (int x = 20; x < 30; ++x) paint(x, y);
    }
    std::vector<MarkerMask> masks;
    classify_opencv(picture.view(), color_cones(testing::arm_markers()), masks, 3);
    ASSERT_EQ(masks[3].components.size(), 1U);
    EXPECT_EQ(masks[3].components[0].area, 100);
}

}  // namespace
}  // namespace armsight::vision
