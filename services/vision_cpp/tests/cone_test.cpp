#include "armsight/vision/cone.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <random>

namespace armsight::vision {
namespace {

constexpr double kFocal = 476.7;

// Exact rays of the outline of a sphere, over a part of the circle.
std::vector<EdgePoint> outline(const Eigen::Vector3d& centre, double radius, int count, double from = 0.0,
                               double until = 2.0 * std::numbers::pi) {
    const Eigen::Vector3d axis = centre.normalized();
    const double half_angle = std::asin(radius / centre.norm());
    const Eigen::Vector3d a = axis.unitOrthogonal();
    const Eigen::Vector3d b = axis.cross(a);
    std::vector<EdgePoint> points;
    for (int i = 0; i < count; ++i) {
        const double t = from + (until - from) * i / count;
        const Eigen::Vector3d across = std::cos(t) * a + std::sin(t) * b;
        points.push_back(
            {.ray = std::cos(half_angle) * axis + std::sin(half_angle) * across, .pixels_per_radian = kFocal});
    }
    return points;
}

void add_noise(std::vector<EdgePoint>& points, double sigma_px, unsigned seed) {
    std::mt19937 generator(seed);
    std::normal_distribution<double> noise(0.0, sigma_px / kFocal);
    for (EdgePoint& point : points) {
        point.ray += Eigen::Vector3d(noise(generator), noise(generator), noise(generator));
        point.ray.normalize();
    }
}

TEST(Cone, ExactRaysGiveTheSphereBackFromAnyArc) {
    const Eigen::Vector3d centre(3.0, -2.0, 17.0);
    for (const double until : {6.28, 3.0, 1.0}) {
        const auto cone = fit_cone(outline(centre, 0.4, 60, 0.3, 0.3 + until));
        ASSERT_TRUE(cone);
        EXPECT_NEAR((cone->axis - centre.normalized()).norm(), 0.0, 1e-9);
        EXPECT_NEAR(0.4 / std::sin(cone->half_angle), centre.norm(), 1e-5);
        EXPECT_EQ(cone->inliers, 60);
    }
}

TEST(Cone, AxisIsNearerThanTheNoiseOfOneEdgePoint) {
    auto points = outline({1.0, 1.0, 18.0}, 0.3, 40);
    add_noise(points, 0.1, 11);
    const auto cone = fit_cone(points);
    ASSERT_TRUE(cone);
    const double error_px = std::acos(std::min(1.0, cone->axis.dot(Eigen::Vector3d(1, 1, 18).normalized()))) * kFocal;
    EXPECT_LT(error_px, 3.0 * 0.1 * std::sqrt(2.0 / 40.0) * std::sqrt(2.0));
}

TEST(Cone, EdgesOfAnOccluderAreVotedOut) {
    const Eigen::Vector3d centre(0.5, 0.2, 18.0);
    auto points = outline(centre, 0.6, 40, 0.0, 4.0);
    // a straight edge through the disc, as a link's
    const Eigen::Vector3d axis = centre.normalized();
    const Eigen::Vector3d a = axis.unitOrthogonal();
    const Eigen::Vector3d b = axis.cross(a);
    for (int i = 0; i < 20; ++i) {
        points.push_back({.ray = (axis + 0.012 * a + (i - 10) * 0.002 * b).normalized(), .pixels_per_radian = kFocal});
    }
    add_noise(points, 0.05, 4);
    const auto cone = fit_cone(points);
    ASSERT_TRUE(cone);
    EXPECT_LT(std::acos(std::min(1.0, cone->axis.dot(axis))) * kFocal, 0.1);
    EXPECT_LT(cone->inliers, 45);
}

TEST(Cone, TooFewPointsOrNoneThatAgreeGiveNothing) {
    EXPECT_FALSE(fit_cone(outline({0, 0, 10}, 0.3, 7)));
    EXPECT_FALSE(fit_cone({}));
    std::mt19937 generator(2);
    std::uniform_real_distribution<double> anywhere(-0.3, 0.3);
    std::vector<EdgePoint> scattered;
    for (int i = 0; i < 20; ++i) {
        scattered.push_back({.ray = Eigen::Vector3d(anywhere(generator), anywhere(generator), 1.0).normalized(),
                             .pixels_per_radian = kFocal});
    }
    EXPECT_FALSE(fit_cone(scattered));
    const EdgePoint same{.ray = Eigen::Vector3d::UnitZ(), .pixels_per_radian = kFocal};
    EXPECT_FALSE(fit_cone(std::vector<EdgePoint>(30, same)));
}

TEST(Cone, SamePointsGiveTheSameBits) {
    auto points = outline({1.0, 1.0, 18.0}, 0.3, 40);
    add_noise(points, 0.5, 6);
    const auto first = fit_cone(points);
    const auto second = fit_cone(points);
    ASSERT_TRUE(first && second);
    EXPECT_EQ(first->axis, second->axis);
    EXPECT_EQ(first->half_angle, second->half_angle);
}

TEST(Cone, TwoFifthsOfTheEdgesMayBelongToSomethingElse) {
    const Eigen::Vector3d axis = Eigen::Vector3d(0.5, 0.2, 18.0).normalized();
    for (unsigned seed = 100; seed < 150; ++seed) {
        auto points = outline({0.5, 0.2, 18.0}, 0.6, 30);
        add_noise(points, 0.05, seed);
        std::mt19937 generator(seed);
        std::uniform_real_distribution<double> anywhere(-0.03, 0.03);
        for (int i = 0; i < 20; ++i) {
            points.push_back(
                {.ray = (axis + Eigen::Vector3d(anywhere(generator), anywhere(generator), 0.0)).normalized(),
                 .pixels_per_radian = kFocal});
        }
        std::shuffle(points.begin(), points.end(), generator);
        const auto cone = fit_cone(points);
        ASSERT_TRUE(cone) << "seed " << seed;
        // within its own tolerance: the outline may lean towards a stray point or two beside it
        EXPECT_LT(std::acos(std::min(1.0, cone->axis.dot(axis))) * kFocal, ConeOptions{}.tolerance_px)
            << "seed " << seed;
        EXPECT_GE(cone->inliers, 30) << "seed " << seed;
    }
}

TEST(Cone, AsksForAsManyInliersAsItIsTold) {
    const auto points = outline({0.0, 1.0, 10.0}, 0.3, 12);
    EXPECT_TRUE(fit_cone(points, {.min_inliers = 12}));
    EXPECT_FALSE(fit_cone(points, {.min_inliers = 13}));
}

TEST(Cone, ResidualIsTheSpreadOfTheNoise) {
    constexpr unsigned kSeed = 23;
    auto points = outline({1.0, 1.0, 18.0}, 0.6, 400);
    add_noise(points, 0.1, kSeed);
    const auto cone = fit_cone(points);
    ASSERT_TRUE(cone) << "seed " << kSeed;
    EXPECT_NEAR(cone->residual_px, 0.1, 0.02) << "seed " << kSeed;
    EXPECT_NEAR(cone->half_angle, std::asin(0.6 / Eigen::Vector3d(1, 1, 18).norm()), 0.03 / kFocal);
}

}  // namespace
}  // namespace armsight::vision
