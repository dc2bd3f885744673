#include "armsight/vision/classify.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <opencv2/imgproc.hpp>
#include <random>

#include "scene.hpp"

namespace armsight::vision {
namespace {

using testing::Picture;

// Noise in dark and bright colours of every hue: the hardest picture for a colour test.
Picture colorful(unsigned seed) {
    Picture picture{.bytes = std::vector<std::uint8_t>(200 * 150 * 3),
                    .width = 200,
                    .height = 150,
                    .step = 600,
                    .format = PixelFormat::Rgb8};
    std::mt19937 generator(seed);
    std::uniform_int_distribution<int> level(0, 255);
    for (int y = 0; y < picture.height; y += 5) {
        for (int x = 0; x < picture.width; x += 5) {
            const int color[3] = {level(generator), level(generator), level(generator)};
            for (int i = 0; i < 25; ++i) {
                for (int c = 0; c < 3; ++c) {
                    picture.bytes[static_cast<std::size_t>((y + i / 5) * 600 + (x + i % 5) * 3 + c)] =
                        static_cast<std::uint8_t>(color[c]);
                }
            }
        }
    }
    return picture;
}

cv::Mat mask_of(const MarkerMask& mask, int width, int height) {
    cv::Mat image = cv::Mat::zeros(height, width, CV_8U);
    for (const Run& run : mask.runs) image(cv::Rect(run.x0, run.y, run.x1 - run.x0, 1)).setTo(255);
    return image;
}

// The same decision in floating point, by angle and share of chroma, for pixels that are not at a border of it.
enum class Judgement { Yes, No, Border };
Judgement judge(const MarkerModel& marker, double red, double green, double blue) {
    const auto chroma = [](const Eigen::Vector3d& p) { return Eigen::Vector3d(p.array() - p.sum() / 3.0); };
    const Eigen::Vector3d wanted = chroma(marker.color);
    const Eigen::Vector3d pixel(red, green, blue);
    const Eigen::Vector3d c = chroma(pixel);
    if (c.norm() < 1.0) return Judgement::No;
    const double along = c.dot(wanted.normalized());
    const double angle = std::acos(std::clamp(along / c.norm(), -1.0, 1.0)) * 180.0 / std::numbers::pi;
    const double saturation = along / std::max(1.0, pixel.sum()) / (wanted.norm() / marker.color.sum());
    if (angle > 21.0 || along < 13.0 || saturation < 0.28) return Judgement::No;
    if (angle < 19.0 && along > 15.0 && saturation > 0.32) return Judgement::Yes;
    return Judgement::Border;
}

TEST(Classify, MasksAreThoseOfTheFloatingPointRule) {
    constexpr unsigned kSeed = 71;
    const Picture picture = colorful(kSeed);
    const auto markers = testing::arm_markers();
    std::vector<MarkerMask> masks;
    classify(picture.view(), color_cones(markers), masks);
    int decided = 0;
    for (std::size_t i = 0; i < markers.size(); ++i) {
        const cv::Mat mask = mask_of(masks[i], picture.width, picture.height);
        for (int y = 0; y < picture.height; ++y) {
            for (int x = 0; x < picture.width; ++x) {
                const std::uint8_t* p = picture.bytes.data() + y * picture.step + x * 3;
                const Judgement judgement = judge(markers[i], p[0], p[1], p[2]);
                if (judgement == Judgement::Border) continue;
                ++decided;
                ASSERT_EQ(mask.at<std::uint8_t>(y, x) != 0, judgement == Judgement::Yes)
                    << markers[i].name << " " << int{p[0]} << " " << int{p[1]} << " " << int{p[2]} << " seed " << kSeed;
            }
        }
    }
    EXPECT_GT(decided, 100'000);
}

TEST(Classify, ComponentsAreThoseOfOpenCv) {
    const Picture picture = colorful(5);
    std::vector<MarkerMask> masks;
    classify(picture.view(), color_cones(testing::arm_markers()), masks);
    for (const MarkerMask& mask : masks) {
        cv::Mat labels;
        cv::Mat stats;
        cv::Mat centroids;
        const int count =
            cv::connectedComponentsWithStats(mask_of(mask, picture.width, picture.height), labels, stats, centroids, 8);
        ASSERT_EQ(static_cast<int>(mask.components.size()), count - 1);
        ASSERT_GT(count, 10);
        for (const vision::Run& run : mask.runs) {
            const Component& component = mask.components[static_cast<std::size_t>(run.component)];
            const int label = labels.at<int>(run.y, run.x0);
            EXPECT_EQ(component.area, stats.at<int>(label, cv::CC_STAT_AREA));
            EXPECT_EQ(component.x0, stats.at<int>(label, cv::CC_STAT_LEFT));
            EXPECT_EQ(component.x1, stats.at<int>(label, cv::CC_STAT_LEFT) + stats.at<int>(label, cv::CC_STAT_WIDTH));
            EXPECT_EQ(component.y0, stats.at<int>(label, cv::CC_STAT_TOP));
            EXPECT_EQ(component.y1, stats.at<int>(label, cv::CC_STAT_TOP) + stats.at<int>(label, cv::CC_STAT_HEIGHT));
            EXPECT_NEAR(component.centroid().x(), centroids.at<double>(label, 0) + 0.5, 1e-9);
            EXPECT_NEAR(component.centroid().y(), centroids.at<double>(label, 1) + 0.5, 1e-9);
        }
    }
}

TEST(Classify, OrderOfChannelsAndPaddingMakeNoDifference) {
    const Picture picture = colorful(9);
    const auto cones = color_cones(testing::arm_markers());
    std::vector<MarkerMask> expected;
    classify(picture.view(), cones, expected);
    for (const PixelFormat format : {PixelFormat::Bgr8, PixelFormat::Rgba8, PixelFormat::Bgra8}) {
        for (const int padding : {0, 7}) {
            const Picture other = testing::converted(picture, format, padding);
            std::vector<MarkerMask> masks;
            classify(other.view(), cones, masks);
            for (std::size_t i = 0; i < masks.size(); ++i) {
                EXPECT_EQ(cv::norm(mask_of(masks[i], 200, 150), mask_of(expected[i], 200, 150), cv::NORM_L1), 0.0);
            }
        }
    }
}

TEST(Classify, SensorNoiseOnGreyIsNoMarker) {
    testing::Scene scene;
    for (const double grey : {0.02, 0.2, 0.7}) {
        scene.background = grey;
        const Picture picture = testing::with_noise(testing::draw(scene, testing::front_camera(320), 1), 4.0, 3);
        std::vector<MarkerMask> masks;
        classify(picture.view(), color_cones(testing::arm_markers()), masks);
        for (const MarkerMask& mask : masks) {
            // a few pixels at four standard deviations, none of them beside another
            for (const Component& component : mask.components) EXPECT_LT(component.area, 6);
        }
    }
}

TEST(Classify, MarkersThatCannotBeToldApartAreRefusedByName) {
    const auto expect_refused = [](const std::vector<MarkerModel>& markers, const std::string& name) {
        try {
            (void)color_cones(markers);
            FAIL() << "accepted";
        } catch (const std::invalid_argument& error) {
            EXPECT_NE(std::string(error.what()).find(name), std::string::npos) << error.what();
        }
    };
    expect_refused({{.name = "smoke", .radius = 1.0, .color = {0.5, 0.5, 0.52}}}, "smoke");
    expect_refused({{.name = "cherry", .radius = 1.0, .color = {1, 0, 0}},
                    {.name = "rust", .radius = 1.0, .color = {0.9, 0.05, 0.03}}},
                   "rust");
    expect_refused({{.name = "void", .radius = 1.0, .color = {0, 0, 0}}}, "void");
}

// Blocks without colour are skipped: one pixel of it must be found in every place of a block and in the rest of a row.
TEST(Classify, OnePixelOfColourIsFoundWhereverItLies) {
    const auto cones = color_cones(testing::arm_markers());
    for (const PixelFormat format : {PixelFormat::Rgb8, PixelFormat::Bgr8, PixelFormat::Rgba8, PixelFormat::Bgra8}) {
        for (int x = 0; x < 101; ++x) {
            Picture grey{.bytes = std::vector<std::uint8_t>(101 * 16 * 3, 10),
                         .width = 101,
                         .height = 16,
                         .step = 303,
                         .format = PixelFormat::Rgb8};
            grey.bytes[static_cast<std::size_t>(7 * 303 + x * 3)] = 28;  // dark red, just above the least chroma
            const Picture picture = testing::converted(grey, format, 5);
            std::vector<MarkerMask> masks;
            classify(picture.view(), cones, masks);
            ASSERT_EQ(masks[3].runs.size(), 1U) << "x " << x << " format " << static_cast<int>(format);
            EXPECT_EQ(masks[3].runs[0].x0, x);
            EXPECT_EQ(masks[3].runs[0].x1, x + 1);
            EXPECT_EQ(masks[3].runs[0].y, 7);
            for (std::size_t other = 0; other < 3; ++other) EXPECT_TRUE(masks[other].runs.empty());
        }
    }
}

TEST(Classify, BetweenNeighbouringHuesTheNearerOneDecides) {
    const std::vector<MarkerModel> markers{{.name = "red", .radius = 1.0, .color = {1.0, 0.0, 0.0}},
                                           {.name = "orange", .radius = 1.0, .color = {1.0, 0.45, 0.0}}};
    const auto cones = color_cones(markers);
    const auto angle_to = [](const Eigen::Vector3d& color, const Eigen::Vector3d& pixel) {
        const Eigen::Vector3d a = color.array() - color.mean();
        const Eigen::Vector3d b = pixel.array() - pixel.mean();
        return std::acos(std::clamp(a.normalized().dot(b.normalized()), -1.0, 1.0)) * 180.0 / std::numbers::pi;
    };
    int seen = 0;
    for (int r = 0; r < 256; r += 5) {
        for (int g = 0; g < 256; g += 5) {
            for (int b = 0; b < 256; b += 5) {
                const bool red = cones[0].contains(r, g, b);
                const bool orange = cones[1].contains(r, g, b);
                if (!red && !orange) continue;
                ++seen;
                const Eigen::Vector3d pixel(r, g, b);
                const double nearer = angle_to(markers[1].color, pixel) - angle_to(markers[0].color, pixel);
                if (std::abs(nearer) < 1.0) continue;  // whole numbers round the border by a fraction of a degree
                ASSERT_NE(red, orange) << r << " " << g << " " << b;
                ASSERT_EQ(red, nearer > 0.0) << r << " " << g << " " << b;
            }
        }
    }
    EXPECT_GT(seen, 1000);
}

TEST(Classify, PictureBeforeIsForgotten) {
    const auto cones = color_cones(testing::arm_markers());
    std::vector<MarkerMask> masks;
    classify(colorful(3).view(), cones, masks);
    const Picture grey{.bytes = std::vector<std::uint8_t>(64 * 32 * 3, 90),
                       .width = 64,
                       .height = 32,
                       .step = 192,
                       .format = PixelFormat::Rgb8};
    classify(grey.view(), cones, masks);
    for (const MarkerMask& mask : masks) {
        EXPECT_TRUE(mask.runs.empty());
        EXPECT_TRUE(mask.components.empty());
    }
}

TEST(Classify, SpeckleDoesNotTakeAllMemory) {
    Picture speckle{.bytes = std::vector<std::uint8_t>(1024 * 600 * 3, 60),
                    .width = 1024,
                    .height = 600,
                    .step = 3072,
                    .format = PixelFormat::Rgb8};
    for (std::size_t i = 0; i < speckle.bytes.size(); i += 6) speckle.bytes[i] = 255;  // every second pixel red
    std::vector<MarkerMask> masks;
    classify(speckle.view(), color_cones(testing::arm_markers()), masks);
    EXPECT_EQ(masks[3].runs.size(), kMaxRuns);
    std::int64_t area = 0;
    for (const Component& component : masks[3].components) area += component.area;
    EXPECT_EQ(area, static_cast<std::int64_t>(kMaxRuns));
}

TEST(ColorThresholds, DecideWhichPixelsAreOfAMarker) {
    const auto markers = testing::arm_markers();
    const auto green = std::ranges::find(markers, "green", &MarkerModel::name) - markers.begin();
    const auto cone = [&](const ColorThresholds& thresholds) {
        return color_cones(markers, thresholds).at(static_cast<std::size_t>(green));
    };
    EXPECT_TRUE(cone({}).contains(20, 60, 20));
    EXPECT_FALSE(cone({.chroma_floor = 60.0}).contains(20, 60, 20)) << "too near to grey";
    EXPECT_FALSE(cone({.saturation_share = 0.8}).contains(20, 60, 20)) << "too pale";
    EXPECT_TRUE(cone({}).contains(60, 200, 20));
    EXPECT_FALSE(cone({.hue_half_width_deg = 5.0}).contains(60, 200, 20)) << "another green";
}

}  // namespace
}  // namespace armsight::vision
