#include "armsight/vision/box.hpp"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>
#include <random>
#include <stdexcept>
#include <vector>

#include "armsight/vision/pipeline.hpp"
#include "scene.hpp"

namespace armsight::vision {
namespace {

using testing::Picture;
using testing::Scene;

constexpr std::int64_t kFrame = 33'333'333;
const Eigen::Vector3d kOrange(1.0, 0.5, 0.0);
const Eigen::Vector3d kHalf(0.4, 0.2, 0.2);
constexpr double kRadius = 0.4;

// The exercise's: beside the arm's markers an orange sphere and an orange box.
struct Rig {
    std::vector<Camera> cameras{testing::front_camera(), testing::side_camera()};
    Pipeline pipeline{models()};
    std::vector<std::size_t> looking{0, 1};

    static std::vector<MarkerModel> models() {
        auto result = testing::arm_markers();
        result.push_back({.name = "sphere", .radius = kRadius, .color = kOrange});
        result.push_back({.name = "box", .radius = 0.0, .color = kOrange, .shape = Shape::Box});
        return result;
    }
    // The last two: sphere and box.
    std::vector<MarkerEstimate> look(const Scene& scene, std::int64_t capture_ns, double noise = 0.0) {
        std::vector<Picture> pictures;
        std::vector<CameraFrame> frames;
        pictures.reserve(2);
        for (const std::size_t i : looking) {
            Picture drawn = testing::draw(scene, cameras[i], 4);
            pictures.push_back(noise > 0.0 ? testing::with_noise(std::move(drawn), noise, 31) : std::move(drawn));
            frames.push_back({.camera = &cameras[i], .image = pictures.back().view()});
        }
        auto all = pipeline.process(capture_ns, frames);
        all.erase(all.begin(), all.begin() + 4);
        return all;
    }
};

Scene both(const Eigen::Vector3d& sphere, const Eigen::Vector3d& box) {
    Scene scene;
    scene.spheres.push_back({.centre = sphere, .radius = kRadius, .color = kOrange});
    scene.cuboids.push_back({.centre = box, .half = kHalf, .color = kOrange});
    return scene;
}

double distance(const MarkerEstimate& estimate, const Eigen::Vector3d& truth) {
    return estimate.position ? (*estimate.position - truth).norm() : 1e9;
}

TEST(Box, SilhouetteIsTheHullOfTheCorners) {
    const Camera camera = testing::front_camera();
    const Box box{.centre = {0.0, 0.0, 6.0}, .half = {1.0, 0.5, 0.25}};
    const auto outline = silhouette(camera, box);
    ASSERT_TRUE(outline);
    // a corner lies on the outline, the middle as far inside as the nearest side is away
    for (std::size_t i = 0; i < outline->count; ++i)
        EXPECT_NEAR(outline->distance_px(outline->corners.at(i)), 0.0, 1e-9);
    const Eigen::Vector3d middle = camera.T_world_camera.inverse() * box.centre;
    EXPECT_LT(outline->distance_px(camera.K(0, 0) * middle.head<2>() / middle.z()), -5.0);
    EXPECT_GT(outline->area_px(), 300.0);
    const Box behind{.centre = camera.T_world_camera * Eigen::Vector3d(0.0, 0.0, -3.0), .half = box.half};
    EXPECT_FALSE(silhouette(camera, behind));
}

TEST(Box, SphereAndBoxOfOneColourAreToldApartByShape) {
    std::mt19937 generator(41);
    std::uniform_real_distribution<double> z(5.0, 9.0);
    std::uniform_real_distribution<double> left(-3.0, -0.5);
    std::uniform_real_distribution<double> right(0.5, 3.0);
    double surprise = 0.0;
    constexpr int kScenes = 12;
    for (int i = 0; i < kScenes; ++i) {
        Rig rig;
        const Eigen::Vector3d sphere(left(generator), left(generator), z(generator));
        const Eigen::Vector3d box(right(generator), right(generator), z(generator));
        const auto found = rig.look(both(sphere, box), kFrame);
        EXPECT_NE(found[0].status, MarkerStatus::Lost) << i;
        EXPECT_NE(found[1].status, MarkerStatus::Lost) << i;
        EXPECT_LT(distance(found[0], sphere), 0.01) << i;
        EXPECT_LT(distance(found[1], box), 0.02) << i;
        ASSERT_TRUE(found[1].extent) << i;
        EXPECT_LT((*found[1].extent - 2.0 * kHalf).norm(), 0.03) << i << ": " << found[1].extent->transpose();
        EXPECT_FALSE(found[0].extent);
        const Eigen::Vector3d off = *found[1].position - box;
        surprise += off.dot(found[1].covariance.inverse() * off) / (3.0 * kScenes);
    }
    EXPECT_LT(surprise, 3.0);  // 1 for a covariance that is right
}

TEST(Box, WhereTheSphereIsHiddenABoxAtItsHeightIsNotTakenForIt) {
    const Eigen::Vector3d sphere(-0.875, 2.088, 7.835);
    for (const double height : {7.4, 7.5, 7.6}) {
        Scene scene = both(sphere, {0.9, 3.753, height});
        scene.capsules.push_back({{-0.697, -2.0, 7.0}, {-0.697, -2.0, 7.9}, 0.6});  // between it and the side camera
        Rig rig;
        const auto found = rig.look(scene, kFrame);
        EXPECT_TRUE(found[0].status == MarkerStatus::Lost || distance(found[0], sphere) < 0.2) << height;
    }
}

TEST(Box, NoiseCostsMillimetres) {
    Rig rig;
    const Eigen::Vector3d sphere(0.5, -1.0, 7.0);
    const Eigen::Vector3d box(2.0, 1.5, 7.5);
    const auto found = rig.look(both(sphere, box), kFrame, 4.0);
    EXPECT_LT(distance(found[0], sphere), 0.02);
    EXPECT_LT(distance(found[1], box), 0.03);
}

TEST(Box, MergedWithTheSphereItIsMeasuredByWhatWasKnownBefore) {
    const Eigen::Vector3d sphere(0.0, 0.0, 7.0);
    // on its way to a place beside the sphere for camera 1 and partly in front of it for camera 2
    const Eigen::Vector3d box(0.4, 0.5, 7.2);
    const Eigen::Vector3d velocity(0.03, 0.03, 0.03);  // metres a frame
    Rig rig;
    EXPECT_EQ(rig.look(both(sphere, box), kFrame)[1].status, MarkerStatus::Lost);
    rig.pipeline.reset();
    for (int i = 0; i <= 40; i += 5) {
        const Eigen::Vector3d at = box + (40 - i) * velocity;
        const auto found = rig.look(both(sphere, at), (i + 1) * kFrame);
        EXPECT_LT(distance(found[0], sphere), 0.03) << i;
        EXPECT_NE(found[1].status, MarkerStatus::Lost) << i;
        EXPECT_LT(distance(found[1], at), 0.1) << i;
    }
}

TEST(Box, WhatIsNotThereIsLost) {
    const Eigen::Vector3d place(0.5, -1.0, 7.0);
    Scene scene = both(place, {2.0, 1.5, 7.5});
    scene.cuboids.clear();
    auto found = Rig{}.look(scene, kFrame);
    EXPECT_EQ(found[0].status, MarkerStatus::Tracked);
    EXPECT_EQ(found[1].status, MarkerStatus::Lost);
    EXPECT_FALSE(found[1].position);
    scene = both({2.0, 1.5, 7.5}, place);
    scene.spheres.clear();
    found = Rig{}.look(scene, kFrame);
    EXPECT_EQ(found[0].status, MarkerStatus::Lost);
    EXPECT_FALSE(found[0].position);
    EXPECT_EQ(found[1].status, MarkerStatus::Tracked);
}

TEST(Box, OneViewNeedsToHaveSeenTheExtentBefore) {
    const Eigen::Vector3d sphere(0.5, -1.0, 7.0);
    const Eigen::Vector3d box(2.0, 1.5, 7.5);
    Rig rig;
    rig.looking = {0};
    EXPECT_EQ(rig.look(both(sphere, box), kFrame)[1].status, MarkerStatus::Lost);
    rig.looking = {0, 1};
    ASSERT_NE(rig.look(both(sphere, box), 2 * kFrame)[1].status, MarkerStatus::Lost);
    rig.looking = {0};
    const auto found = rig.look(both(sphere, box), 3 * kFrame);
    EXPECT_EQ(found[1].status, MarkerStatus::OneView);
    EXPECT_LT(distance(found[1], box), 0.1);
    rig.looking = {};
    const auto lost = rig.look(both(sphere, box), 4 * kFrame);
    EXPECT_EQ(lost[1].status, MarkerStatus::Lost);
    EXPECT_TRUE(lost[1].extent);
    EXPECT_GT(lost[1].age_s, 0.0);
}

TEST(Box, TwoOfTheSameShapeAndColourAreRefused) {
    auto models = Rig::models();
    models.push_back({.name = "other", .radius = 0.0, .color = kOrange, .shape = Shape::Box});
    EXPECT_THROW(Pipeline{models}, std::invalid_argument);
}

}  // namespace
}  // namespace armsight::vision
