#include "armsight/vision/triangulate.hpp"

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <cmath>
#include <numbers>
#include <random>

#include "scene.hpp"

namespace armsight::vision {
namespace {

std::vector<EdgePoint> outline(const Camera& camera, const Eigen::Vector3d& centre_world, double radius, int count,
                               double sigma_px, std::mt19937& generator) {
    const Eigen::Vector3d centre = camera.T_world_camera.inverse() * centre_world;
    const Eigen::Vector3d axis = centre.normalized();
    const double half_angle = std::asin(radius / centre.norm());
    const Eigen::Vector3d a = axis.unitOrthogonal();
    const Eigen::Vector3d b = axis.cross(a);
    std::normal_distribution<double> noise(0.0, sigma_px);
    std::vector<EdgePoint> points;
    for (int i = 0; i < count; ++i) {
        const double t = 2.0 * std::numbers::pi * i / count;
        const double ppr = pixels_per_radian(camera, axis);
        const double angle = half_angle + (sigma_px > 0.0 ? noise(generator) / ppr : 0.0);
        points.push_back({.ray = std::cos(angle) * axis + std::sin(angle) * (std::cos(t) * a + std::sin(t) * b),
                          .pixels_per_radian = ppr});
    }
    return points;
}

View view(const Camera& camera, const std::vector<EdgePoint>& points) {
    return {.camera = &camera,
            .outline = points,
            .centre = Eigen::Vector3d::UnitZ(),
            .centre_sigma_px = 0.0,
            .centre_pixels_per_radian = 1.0};
}

TEST(Triangulate, RaysThatMeetGiveTheirPoint) {
    const Eigen::Vector3d point(1.0, -2.0, 5.0);
    std::vector<Ray> rays;
    for (const Eigen::Vector3d& eye :
         {Eigen::Vector3d(18, 0, 6), Eigen::Vector3d(0, -18, 6), Eigen::Vector3d(9, 9, 12)}) {
        rays.push_back({.origin = eye, .direction = (point - eye).normalized()});
        if (rays.size() < 2) continue;
        const auto found = triangulate(rays);
        ASSERT_TRUE(found);
        EXPECT_NEAR((*found - point).norm(), 0.0, 1e-12);
    }
}

TEST(Triangulate, ParallelRaysAndPointsBehindACameraGiveNothing) {
    const Ray ray{.origin = {0, 0, 0}, .direction = {0, 0, 1}};
    EXPECT_FALSE(triangulate(std::vector<Ray>{ray}));
    EXPECT_FALSE(triangulate(std::vector<Ray>{ray, {.origin = {1, 0, 0}, .direction = {0, 0, 1}}}));
    const Eigen::Vector3d diverging = Eigen::Vector3d(1, 0, 1).normalized();
    EXPECT_FALSE(triangulate(std::vector<Ray>{ray, {.origin = {1, 0, 0}, .direction = diverging}}));
}

TEST(FitSphere, ExactOutlinesGiveTheExactCentre) {
    const Camera front = testing::front_camera();
    const Camera side = testing::side_camera();
    const Eigen::Vector3d centre(2.0, 1.5, 7.0);
    std::mt19937 generator(1);
    const auto a = outline(front, centre, 0.4, 30, 0.0, generator);
    const auto b = outline(side, centre, 0.4, 30, 0.0, generator);
    const std::vector<View> views{view(front, a), view(side, b)};
    const auto fix = fit_sphere(views, 0.4, centre + Eigen::Vector3d(0.05, -0.05, 0.05));
    ASSERT_TRUE(fix);
    EXPECT_NEAR((fix->position - centre).norm(), 0.0, 1e-8);
    EXPECT_EQ(fix->inliers, 60);
}

TEST(FitSphere, OneViewTellsItsDepthByTheRadius) {
    const Camera front = testing::front_camera();
    const Eigen::Vector3d centre(0.0, 1.0, 6.5);
    std::mt19937 generator(1);
    const auto points = outline(front, centre, 0.6, 40, 0.0, generator);
    const std::vector<View> views{view(front, points)};
    const auto fix = fit_sphere(views, 0.6, centre + Eigen::Vector3d(0.5, 0.0, 0.0));
    ASSERT_TRUE(fix);
    EXPECT_NEAR((fix->position - centre).norm(), 0.0, 1e-6);
    // weak along the line of sight (x), strong across it
    EXPECT_GT(fix->covariance(0, 0), 30.0 * fix->covariance(1, 1));
}

TEST(FitSphere, CovarianceIsThatOfRepeatedNoise) {
    const Camera front = testing::front_camera();
    const Camera side = testing::side_camera();
    const Eigen::Vector3d centre(-1.0, 0.5, 5.0);
    std::mt19937 generator(17);
    Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
    Eigen::Matrix3d told = Eigen::Matrix3d::Zero();
    constexpr int kRuns = 400;
    for (int i = 0; i < kRuns; ++i) {
        const auto a = outline(front, centre, 0.4, 40, 0.15, generator);
        const auto b = outline(side, centre, 0.4, 40, 0.15, generator);
        const std::vector<View> views{view(front, a), view(side, b)};
        const auto fix = fit_sphere(views, 0.4, centre);
        ASSERT_TRUE(fix);
        const Eigen::Vector3d error = fix->position - centre;
        scatter += error * error.transpose() / kRuns;
        told += fix->covariance / kRuns;
    }
    // told is for errors that go together along the outline and from view to view: more than these independent ones
    for (int axis = 0; axis < 3; ++axis) {
        EXPECT_GT(told(axis, axis), 1.2 * scatter(axis, axis));
        EXPECT_LT(told(axis, axis), 5.0 * scatter(axis, axis));
    }
}

TEST(FitSphere, WildEdgePointsMoveItLittle) {
    const Camera front = testing::front_camera();
    const Camera side = testing::side_camera();
    const Eigen::Vector3d centre(2.0, 1.5, 7.0);
    std::mt19937 generator(3);
    auto a = outline(front, centre, 0.4, 30, 0.05, generator);
    const auto b = outline(side, centre, 0.4, 30, 0.05, generator);
    for (std::size_t i = 0; i < 6; ++i) a[i].ray = (a[i].ray + Eigen::Vector3d(0.005, 0.004, 0.0)).normalized();
    const std::vector<View> views{view(front, a), view(side, b)};
    const auto fix = fit_sphere(views, 0.4, centre);
    ASSERT_TRUE(fix);
    EXPECT_LT((fix->position - centre).norm(), 0.003);
}

TEST(FitSphere, WhereASphereSinksIntoABrightBodyTheSpreadIsThatOfTheOthers) {
    const Camera front = testing::front_camera();
    const Camera side = testing::side_camera();
    const Eigen::Vector3d centre(0.0, 0.0, 0.5);
    std::mt19937 generator(5);
    auto a = outline(front, centre, 0.8, 90, 0.1, generator);
    auto b = outline(side, centre, 0.8, 90, 0.1, generator);
    const auto undisturbed = fit_sphere(std::vector<View>{view(front, a), view(side, b)}, 0.8, centre);
    ASSERT_TRUE(undisturbed);
    for (auto* points : {&a, &b}) {
        for (std::size_t i = 0; i < 30; ++i) {  // the body's border leaves the outline and comes back to it
            EdgePoint& point = (*points)[i];
            const double inwards = 4.0 * std::sin(std::numbers::pi * static_cast<double>(i) / 30.0);
            const Eigen::Vector3d axis = ((*points)[0].ray + (*points)[45].ray).normalized();
            point.ray = (point.ray - inwards / point.pixels_per_radian * (point.ray - axis).normalized()).normalized();
        }
    }
    const auto fix = fit_sphere(std::vector<View>{view(front, a), view(side, b)}, 0.8, centre);
    ASSERT_TRUE(fix);
    EXPECT_NEAR(fix->sigma_px, undisturbed->sigma_px, 0.25 * undisturbed->sigma_px);
}

TEST(FitSphere, NothingDeterminedGivesNothing) {
    const Camera front = testing::front_camera();
    const std::vector<View> none{view(front, {})};
    EXPECT_FALSE(fit_sphere(none, 0.4, {0.0, 0.0, 5.0}));
    std::mt19937 generator(3);
    const auto points = outline(front, {0.0, 0.0, 6.0}, 0.4, 30, 0.0, generator);
    const std::vector<View> behind{view(front, points)};
    EXPECT_FALSE(fit_sphere(behind, 0.4, {40.0, 0.0, 6.0})) << "a start behind the camera";
}

TEST(Triangulate, RaysWithinAMilliradianAreParallel) {
    const auto pair = [](double angle) {
        const Eigen::Vector3d point(0.0, 0.0, 20.0);
        const Eigen::Vector3d beside(20.0 * std::tan(angle), 0.0, 0.0);
        return std::vector<Ray>{{.origin = {0, 0, 0}, .direction = {0, 0, 1}},
                                {.origin = beside, .direction = (point - beside).normalized()}};
    };
    EXPECT_FALSE(triangulate(pair(0.0005)));
    const auto found = triangulate(pair(0.003));
    ASSERT_TRUE(found);
    EXPECT_NEAR((*found - Eigen::Vector3d(0, 0, 20)).norm(), 0.0, 1e-6);
}

TEST(Triangulate, RaysThatPassEachOtherMeetHalfWay) {
    const std::vector<Ray> rays{{.origin = {-5.0, 0.0, 0.0}, .direction = {1, 0, 0}},
                                {.origin = {0.0, -5.0, 0.4}, .direction = {0, 1, 0}}};
    const auto found = triangulate(rays);
    ASSERT_TRUE(found);
    EXPECT_NEAR((*found - Eigen::Vector3d(0.0, 0.0, 0.2)).norm(), 0.0, 1e-12);
}

TEST(FitSphere, CovarianceComesFromTheNumericSlopesOfTheResiduals) {
    const Camera front = testing::front_camera();
    const Camera side = testing::side_camera();
    const Eigen::Vector3d centre(2.0, 1.5, 7.0);
    constexpr double kRadius = 0.4;
    std::mt19937 generator(1);
    const auto a = outline(front, centre, kRadius, 30, 0.0, generator);
    const auto b = outline(side, centre, kRadius, 17, 0.0, generator);
    const std::vector<View> views{view(front, a), view(side, b)};
    const auto fix = fit_sphere(views, kRadius, centre);
    ASSERT_TRUE(fix);

    // reference/vision.md: f (angle(d, axis) - asin(radius / distance)), here differentiated numerically
    const auto residual = [&](const View& v, const EdgePoint& point, const Eigen::Vector3d& position) {
        const Eigen::Vector3d c = v.camera->T_world_camera.inverse() * position;
        const double angle = std::atan2(c.cross(point.ray).norm(), c.dot(point.ray));
        return point.pixels_per_radian * (angle - std::asin(kRadius / c.norm()));
    };
    Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
    constexpr double kStep = 1e-5;
    Eigen::Matrix3d of_shifts = Eigen::Matrix3d::Zero();
    for (const View& v : views) {
        Eigen::Matrix3d shifts = Eigen::Matrix3d::Zero();
        for (const EdgePoint& point : v.outline) {
            Eigen::Vector3d by_shift;  // of the image by a pixel along each axis of the optical frame
            for (int axis = 0; axis < 3; ++axis) {
                EdgePoint shifted = point;
                shifted.ray += kStep / point.pixels_per_radian * Eigen::Vector3d::Unit(axis);
                by_shift[axis] = (residual(v, shifted, centre) - residual(v, point, centre)) / kStep;
            }
            Eigen::Vector3d slope;
            for (int axis = 0; axis < 3; ++axis) {
                const Eigen::Vector3d h = kStep * Eigen::Vector3d::Unit(axis);
                slope[axis] = (residual(v, point, centre + h) - residual(v, point, centre - h)) / (2.0 * kStep);
            }
            normal += slope * slope.transpose();
            shifts += slope * by_shift.transpose();
        }
        of_shifts += shifts * shifts.transpose();
    }
    const Eigen::Matrix3d inverse = normal.inverse();
    const double shift_px = std::hypot(kViewShiftPx, kViewShiftOfSpread * fix->sigma_px);
    const Eigen::Matrix3d by_shifts = shift_px * shift_px * inverse * of_shifts * inverse;
    // the shape is the slopes' alone; the scale is one number, the assumed variance of an edge point
    const Eigen::Matrix3d shape = (fix->covariance - by_shifts) * normal;
    const double variance = shape.trace() / 3.0;
    // a shift goes across the axis in the one and across each ray in the other, 1 degree apart
    EXPECT_NEAR((shape / variance - Eigen::Matrix3d::Identity()).norm(), 0.0, 2e-3);
    EXPECT_GE(variance, fix->sigma_px * fix->sigma_px);
}

TEST(FitSphere, ConvergesFromAnyStartWithinAPixelOrTwo) {
    const Camera front = testing::front_camera();
    const Camera side = testing::side_camera();
    constexpr unsigned kSeed = 8;
    std::mt19937 generator(kSeed);
    std::uniform_real_distribution<double> place(-3.0, 3.0);
    std::normal_distribution<double> off(0.0, 0.02);  // metres; a pixel is 38 mm
    for (int i = 0; i < 200; ++i) {
        const Eigen::Vector3d centre(place(generator), place(generator), 6.0 + place(generator));
        const auto a = outline(front, centre, 0.3, 24, 0.0, generator);
        const auto b = outline(side, centre, 0.3, 24, 0.0, generator);
        const std::vector<View> views{view(front, a), view(side, b)};
        const Eigen::Vector3d start = centre + Eigen::Vector3d(off(generator), off(generator), off(generator));
        const auto fix = fit_sphere(views, 0.3, start);
        ASSERT_TRUE(fix) << "seed " << kSeed << " run " << i;
        EXPECT_NEAR((fix->position - centre).norm(), 0.0, 1e-7) << "seed " << kSeed << " run " << i;
    }
}

TEST(FitSphere, PriorAddsItsInformation) {
    const Camera front = testing::front_camera();
    const Eigen::Vector3d centre(0.0, 1.0, 6.5);
    std::mt19937 generator(1);
    const auto points = outline(front, centre, 0.6, 40, 0.0, generator);
    const std::vector<View> views{view(front, points)};
    const auto alone = fit_sphere(views, 0.6, centre);
    const Prior prior{.position = centre, .covariance = 1e-4 * Eigen::Matrix3d::Identity()};
    const auto both = fit_sphere(views, 0.6, centre, prior);
    ASSERT_TRUE(alone && both);
    const auto least = [](const Eigen::Matrix3d& m) {
        return Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(m).eigenvalues().minCoeff();
    };
    EXPECT_GT(least(prior.covariance - both->covariance), 0.0) << "the view knows something in every direction";
    EXPECT_GT(least(alone->covariance - both->covariance), -1e-9) << "and the prior takes nothing away";
    // a prior far along the line of sight, where the view knows little, pulls; one across it hardly does
    const auto pulled = [&](const Eigen::Vector3d& by) {
        const Prior elsewhere{.position = centre + by, .covariance = 1e-2 * Eigen::Matrix3d::Identity()};
        const auto fix = fit_sphere(views, 0.6, centre, elsewhere);
        return fix ? (fix->position - centre).norm() : 1e9;
    };
    EXPECT_LT(pulled({0.0, 0.02, 0.0}), 0.001);
    EXPECT_GT(pulled({0.02, 0.0, 0.0}), pulled({0.0, 0.02, 0.0}) * 3.0);
}

TEST(FitSphere, MiddlesAloneGiveThePointWhereTheyMeet) {
    const Camera front = testing::front_camera();
    const Camera side = testing::side_camera();
    const Eigen::Vector3d centre(1.0, -0.5, 5.0);
    std::vector<View> views{view(front, {}), view(side, {})};
    for (View& v : views) {
        v.centre = (v.camera->T_world_camera.inverse() * centre).normalized();
        v.centre_sigma_px = 4.0;
        v.centre_pixels_per_radian = pixels_per_radian(*v.camera, v.centre);
    }
    const auto fix = fit_sphere(views, 0.4, centre + Eigen::Vector3d(0.2, -0.3, 0.1));
    ASSERT_TRUE(fix);
    EXPECT_NEAR((fix->position - centre).norm(), 0.0, 1e-5);
    // 4 pixels of 38 mm, each of x and y seen by one camera
    EXPECT_NEAR(std::sqrt(fix->covariance(0, 0)), 4.0 * 0.038, 0.03);
    EXPECT_NEAR(std::sqrt(fix->covariance(1, 1)), 4.0 * 0.038, 0.03);
    EXPECT_LT(fix->covariance(2, 2), 0.7 * fix->covariance(0, 0)) << "both see z";
}

TEST(Agreement, IsTheShareOfEdgesOnTheOutline) {
    const Camera front = testing::front_camera();
    const Eigen::Vector3d centre(0.0, 1.0, 6.0);
    std::mt19937 generator(1);
    auto points = outline(front, centre, 0.5, 40, 0.0, generator);
    EXPECT_EQ(agreement(view(front, points), 0.5, centre, 0.5), 1.0);
    const Eigen::Vector3d axis = (front.T_world_camera.inverse() * centre).normalized();
    for (std::size_t i = 0; i < 10; ++i) points[i].ray = axis;  // in the middle: a radius away from the outline
    EXPECT_DOUBLE_EQ(agreement(view(front, points), 0.5, centre, 0.5), 0.75);
    EXPECT_EQ(agreement(view(front, {}), 0.5, centre, 0.5), 0.0);
    EXPECT_EQ(agreement(view(front, points), 0.5, {40.0, 0.0, 6.0}, 0.5), 0.0) << "behind the camera";
}

}  // namespace
}  // namespace armsight::vision
