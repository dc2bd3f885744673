#include "search.hpp"

#include <gtest/gtest.h>

#include <array>
#include <string>
#include <vector>

#include "armsight/vision/classify.hpp"
#include "armsight/vision/pipeline.hpp"
#include "scene.hpp"

namespace armsight::vision {
namespace {

using testing::Picture;

constexpr std::int64_t kFramePeriodNs = 33'000'000;

Picture red_ball(const Eigen::Vector3d& centre) {
    testing::Scene scene;
    const auto red = testing::arm_markers().at(3);
    scene.spheres.push_back({centre, red.radius, red.color});
    return testing::draw(scene, testing::front_camera());
}

TEST(Search, ARegionAroundTheMarkerGivesWhatTheWholeFrameGives) {
    const Picture picture = testing::with_noise(red_ball({1.0, 0.0, 6.0}), 2.0, 3);
    const auto cones = color_cones(testing::arm_markers());
    std::vector<MarkerMask> all;
    classify(picture.view(), cones, all);
    ASSERT_EQ(all[3].components.size(), 1U);
    const Component& ball = all[3].components.front();
    const Disc disc{.centre = ball.centroid(), .radius = 0.5 * (ball.x1 - ball.x0)};
    MarkerMask mask;
    std::vector<MarkerMask> scratch;
    EXPECT_TRUE(classify_region(classify, picture.view(), cones[3],
                                region_around(picture.view(), disc, 2.0 * disc.radius), mask, scratch));
    EXPECT_EQ(mask.runs, all[3].runs);
    EXPECT_EQ(mask.components, all[3].components);
    EXPECT_FALSE(classify_region(classify, picture.view(), cones[3],
                                 region_around(picture.view(), disc, 0.5 * disc.radius), mask, scratch))
        << "the ball goes on beyond";
    EXPECT_TRUE(
        classify_region(classify, picture.view(), cones[3], {.x0 = 5, .y0 = 5, .x1 = 5, .y1 = 80}, mask, scratch));
    EXPECT_TRUE(mask.runs.empty());
}

TEST(Search, RegionsEndWhereTheImageEnds) {
    const Picture picture = red_ball({0.0, 0.0, 5.0});
    const Region corner = region_around(picture.view(), {.centre = {2.0, 799.0}, .radius = 5.0}, 10.0);
    EXPECT_EQ(corner.x0, 0);
    EXPECT_EQ(corner.x1, 12);
    EXPECT_EQ(corner.y0, 789);
    EXPECT_EQ(corner.y1, 800);
    const Region outside = region_around(picture.view(), {.centre = {-1e9, 50.0}, .radius = 5.0}, 10.0);
    EXPECT_EQ(outside.x0, outside.x1);
}

// Counts the pixels that a pipeline reads, and gives it the same arm again and again, moved.
class TrackedSearch : public ::testing::Test {
  protected:
    [[nodiscard]] static std::vector<Picture> pictures(double moved, bool red_is_there) {
        const auto markers = testing::arm_markers();
        const std::array<Eigen::Vector3d, 4> centres{
            {{0.0, 0.0, 0.85}, {0.1, 0.2 + moved, 4.8}, {1.4, -0.9 + moved, 7.1}, {3.1 - moved, 1.1, 8.0 - moved}}};
        testing::Scene scene;
        for (std::size_t i = 0; i < markers.size(); ++i) {
            if (i == 3 && !red_is_there) continue;
            scene.spheres.push_back({centres.at(i), markers[i].radius, markers[i].color});
        }
        return {testing::draw(scene, testing::front_camera()), testing::draw(scene, testing::side_camera())};
    }

    std::vector<MarkerEstimate> see(Pipeline& pipeline, double moved, bool red_is_there = true) {
        const auto seen = pictures(moved, red_is_there);
        const std::array<CameraFrame, 2> frames{CameraFrame{.camera = cameras_.data(), .image = seen[0].view()},
                                                CameraFrame{.camera = &cameras_[1], .image = seen[1].view()}};
        pixels_read_ = 0;
        now_ns_ += kFramePeriodNs;
        return pipeline.process(now_ns_, frames);
    }

    [[nodiscard]] Classifier counting() {
        return [this](const ImageView& image, std::span<const ColorCone> cones, std::vector<MarkerMask>& masks) {
            pixels_read_ += static_cast<long>(image.width) * image.height;
            classify(image, cones, masks);
        };
    }

    static void expect_same(const std::vector<MarkerEstimate>& a, const std::vector<MarkerEstimate>& b) {
        ASSERT_EQ(a.size(), b.size());
        for (std::size_t i = 0; i < a.size(); ++i) {
            EXPECT_EQ(a[i].status, b[i].status) << a[i].name;
            ASSERT_TRUE(a[i].position && b[i].position) << a[i].name;
            EXPECT_EQ(*a[i].position, *b[i].position) << a[i].name;
            EXPECT_EQ(a[i].covariance, b[i].covariance) << a[i].name;
        }
    }

    static constexpr long kBothFrames = 2L * 800 * 800;
    long pixels_read_ = 0;

  private:
    std::array<Camera, 2> cameras_{testing::front_camera(), testing::side_camera()};
    std::int64_t now_ns_ = 0;
};

TEST_F(TrackedSearch, ReadsAPartOfTheFramesAndGivesTheSame) {
    Pipeline tracking(testing::arm_markers(), counting());
    (void)see(tracking, 0.0);
    EXPECT_EQ(pixels_read_, kBothFrames);
    for (int i = 1; i < 8; ++i) {
        const double moved = 0.02 * i;
        const auto tracked = see(tracking, moved);
        EXPECT_LT(pixels_read_, kBothFrames / 3) << i;
        Pipeline afresh(testing::arm_markers());
        expect_same(tracked, see(afresh, moved));
    }
    EXPECT_LT(pixels_read_, kBothFrames / 10) << "by now the speed is known";
}

TEST_F(TrackedSearch, WhatIsNotWhereItShouldBeIsLookedForEverywhere) {
    Pipeline tracking(testing::arm_markers(), counting());
    for (int i = 0; i < 4; ++i) (void)see(tracking, 0.0);
    const auto jumped = see(tracking, 1.5);
    EXPECT_GE(pixels_read_, kBothFrames);
    Pipeline afresh(testing::arm_markers());
    expect_same(jumped, see(afresh, 1.5));
}

TEST_F(TrackedSearch, AMarkerThatIsGoneIsLookedForEverywhereUntilItIsBack) {
    Pipeline tracking(testing::arm_markers(), counting());
    for (int i = 0; i < 4; ++i) (void)see(tracking, 0.0);
    for (int i = 0; i < 3; ++i) {
        EXPECT_EQ(see(tracking, 0.0, false).at(3).status, MarkerStatus::Lost);
        EXPECT_GE(pixels_read_, kBothFrames);
    }
    EXPECT_EQ(see(tracking, 0.0).at(3).status, MarkerStatus::Tracked);
    EXPECT_GE(pixels_read_, kBothFrames);
    (void)see(tracking, 0.0);
    EXPECT_LT(pixels_read_, kBothFrames / 3);
}

TEST_F(TrackedSearch, AfterAResetAllIsRead) {
    Pipeline tracking(testing::arm_markers(), counting());
    for (int i = 0; i < 4; ++i) (void)see(tracking, 0.0);
    tracking.reset();
    (void)see(tracking, 0.0);
    EXPECT_EQ(pixels_read_, kBothFrames);
}

}  // namespace
}  // namespace armsight::vision
