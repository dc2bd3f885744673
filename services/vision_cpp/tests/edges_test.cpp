#include "armsight/vision/edges.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "scene.hpp"

namespace armsight::vision {
namespace {

struct Found {
    Outline outline;
    double worst_px = 0.0;   // distance of the farthest point from the true outline
    double middle_px = 0.0;  // mean signed distance
};

Found find(const testing::Scene& scene, const testing::Picture& picture, const Camera& camera) {
    const std::vector<MarkerModel> markers{{.name = "red", .radius = 1.0, .color = {1.0, 0.0, 0.0}}};
    const auto cones = color_cones(markers);
    std::vector<MarkerMask> masks;
    classify(picture.view(), cones, masks);
    const Eigen::Vector3d c = camera.T_world_camera.inverse() * scene.spheres[0].centre;
    const double half_angle = std::asin(scene.spheres[0].radius / c.norm());
    const Disc disc{.centre = *project(camera, c), .radius = half_angle * pixels_per_radian(camera, c.normalized())};
    Found found;
    EdgeScratch scratch;
    find_edges(picture.view(), camera, cones[0], masks[0], disc, scratch, found.outline);
    for (const EdgePoint& point : found.outline.points) {
        const double angle = std::acos(std::clamp(point.ray.dot(c.normalized()), -1.0, 1.0));
        const double off = (angle - half_angle) * point.pixels_per_radian;
        found.worst_px = std::max(found.worst_px, std::abs(off));
        found.middle_px += off / static_cast<double>(found.outline.points.size());
    }
    return found;
}

TEST(Edges, OutlineOfAFreeSphereIsExactToAFewHundredthsOfAPixel) {
    const Camera camera = testing::front_camera();
    const testing::Scene scene{.spheres = {{{0.3, 1.7, 7.2}, 0.4, {1.0, 0.0, 0.0}}}, .capsules = {}};
    const Found found = find(scene, testing::draw(scene, camera, 8), camera);
    EXPECT_GT(found.outline.points.size(), 30U);
    EXPECT_LT(found.worst_px, 0.15);
    EXPECT_LT(std::abs(found.middle_px), 0.03);
}

TEST(Edges, EdgesSharedWithALinkAreLeftOut) {
    const Camera camera = testing::front_camera();
    testing::Scene scene{.spheres = {{{0.0, 0.0, 6.5}, 0.6, {1.0, 0.0, 0.0}}}, .capsules = {}};
    const auto whole = find(scene, testing::draw(scene, camera, 6), camera).outline.points.size();
    scene.capsules.push_back({{1.5, 0.2, 3.0}, {1.5, 0.2, 9.0}, 0.25});
    const Found found = find(scene, testing::draw(scene, camera, 6), camera);
    EXPECT_LT(found.outline.points.size(), whole);
    EXPECT_GT(found.outline.points.size(), whole / 3);
    EXPECT_LT(found.worst_px, 0.25) << "an edge of the link was taken for the sphere's";
}

TEST(Edges, UnmixingTellsShares) {
    const Eigen::Vector3d red(200.0, 10.0, 10.0);
    const Eigen::Vector3d grey(180.0, 180.0, 180.0);
    const auto unmixing = Unmixing::of(red, grey);
    ASSERT_TRUE(unmixing);
    const Mix mix = (*unmixing)(0.3 * red + 0.7 * grey);
    EXPECT_NEAR(mix.foreground, 0.3, 1e-12);
    EXPECT_NEAR(mix.background, 0.7, 1e-12);
    EXPECT_FALSE(Unmixing::of(grey, 0.5 * grey)) << "two greys can't be told apart";
}

TEST(Edges, MarkersAtTheBorderOfTheImageDoNotReadBeyondIt) {
    const Camera camera = testing::front_camera(64);
    for (const double y : {-15.2, -14.0, 14.6, 15.4}) {
        const testing::Scene scene{.spheres = {{{0.0, y, 6.0}, 1.5, {1.0, 0.0, 0.0}}}, .capsules = {}};
        const Found found = find(scene, testing::draw(scene, camera, 3), camera);
        EXPECT_LT(found.worst_px, 1.5);
    }
}

TEST(Edges, OutlineHasNoBiasWhereverItLiesBetweenThePixels) {
    const Camera camera = testing::front_camera(400);
    double bias = 0.0;
    constexpr int kPlaces = 20;
    for (int i = 0; i < kPlaces; ++i) {
        // steps of 0.37 and 0.23 pixels
        const Eigen::Vector3d centre(0.0, 0.2 + 0.028 * i, 6.1 + 0.0174 * i);
        const testing::Scene scene{.spheres = {{centre, 0.6, {1.0, 0.0, 0.0}}}, .capsules = {}};
        const Found found = find(scene, testing::draw(scene, camera, 8), camera);
        EXPECT_LT(std::abs(found.middle_px), 0.05) << "place " << i;
        bias += found.middle_px / kPlaces;
    }
    EXPECT_LT(std::abs(bias), 0.02);
}

TEST(Edges, DimLightDoesNotMoveTheOutline) {
    const Camera camera = testing::front_camera();
    const testing::Scene scene{
        .spheres = {{{0.3, 1.7, 7.2}, 0.4, {0.35, 0.0, 0.0}}}, .capsules = {}, .background = 0.3};
    const Found found = find(scene, testing::draw(scene, camera, 8), camera);
    EXPECT_GT(found.outline.points.size(), 30U);
    EXPECT_LT(found.worst_px, 0.2);
    EXPECT_LT(std::abs(found.middle_px), 0.03);
}

TEST(Edges, BlackBackgroundGivesNoOutline) {
    const Camera camera = testing::front_camera();
    const testing::Scene scene{
        .spheres = {{{0.3, 1.7, 7.2}, 0.4, {1.0, 0.0, 0.0}}}, .capsules = {}, .background = 0.05};
    const Found found = find(scene, testing::draw(scene, camera, 4), camera);
    EXPECT_TRUE(found.outline.points.empty());
    EXPECT_GT(found.outline.area, 100) << "the patch itself is seen";
}

TEST(Edges, EdgesSharedWithAnotherMarkerAreLeftOut) {
    const Camera camera = testing::front_camera();
    testing::Scene scene{.spheres = {{{0.0, 0.0, 6.5}, 0.6, {1.0, 0.0, 0.0}}}, .capsules = {}};
    const auto whole = find(scene, testing::draw(scene, camera, 6), camera).outline.points.size();
    scene.spheres.push_back({{1.5, 0.5, 6.6}, 0.5, {0.0, 0.0, 1.0}});
    const Found found = find(scene, testing::draw(scene, camera, 6), camera);
    EXPECT_LT(found.outline.points.size(), whole);
    EXPECT_GT(found.outline.points.size(), whole / 3);
    EXPECT_LT(found.worst_px, 0.25) << "an edge of the blue marker was taken for the red one's";
}

TEST(Edges, TheRimOfAMarkerBehindIsNotTakenForBackground) {
    const Camera camera = testing::front_camera();
    for (const Eigen::Vector3d& color : {Eigen::Vector3d(0.0, 1.0, 1.0), Eigen::Vector3d(0.0, 0.0, 1.0)}) {
        // 2 pixels wide on one side, 4 on the other
        const testing::Scene scene{
            .spheres = {{{0.0, 0.0, 6.5}, 0.6, {1.0, 0.0, 0.0}}, {{-1.5, 0.04, 6.5}, 0.77, color}}, .capsules = {}};
        const Found found = find(scene, testing::draw(scene, camera, 6), camera);
        EXPECT_LT(found.worst_px, 0.25) << "an edge between three colours was measured: " << color.transpose();
    }
}

TEST(Edges, TheBorderOfALinkBehindIsNotTakenForTheOutline) {
    const Camera camera = testing::front_camera();
    // a part of a pixel of it shows on one side: all of it and what lies next to it were more than a pixel
    for (const double beyond : {0.0, 0.004, 0.012, 0.02, 0.024}) {
        const testing::Scene scene{.spheres = {{{0.0, 0.0, 6.5}, 0.5, {1.0, 0.0, 0.0}}},
                                   .capsules = {{{-0.6, 0.2 + beyond, 3.0}, {-0.6, 0.2 + beyond, 10.0}, 0.3}}};
        const Found found = find(scene, testing::draw(scene, camera, 6), camera);
        EXPECT_GT(found.outline.points.size(), 20U);
        EXPECT_LT(found.worst_px, 0.65) << beyond;
    }
}

TEST(Edges, OrderOfChannelsMakesNoDifference) {
    const Camera camera = testing::front_camera(400);
    const testing::Scene scene{.spheres = {{{0.3, 1.7, 7.2}, 0.6, {1.0, 0.0, 0.0}}}, .capsules = {}};
    const testing::Picture picture = testing::draw(scene, camera, 4);
    const auto expected = find(scene, picture, camera).outline.points;
    ASSERT_GT(expected.size(), 20U);
    for (const PixelFormat format : {PixelFormat::Bgr8, PixelFormat::Rgba8, PixelFormat::Bgra8}) {
        const auto points = find(scene, testing::converted(picture, format, 3), camera).outline.points;
        ASSERT_EQ(points.size(), expected.size());
        for (std::size_t i = 0; i < points.size(); ++i) EXPECT_NEAR((points[i].ray - expected[i].ray).norm(), 0, 1e-12);
    }
}

}  // namespace
}  // namespace armsight::vision
