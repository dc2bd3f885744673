#include "armsight/vision/camera.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <cmath>
#include <limits>

#include "scene.hpp"

namespace armsight::vision {
namespace {

TEST(Camera, CentreOfTheMiddlePixelLooksAlongTheAxis) {
    Camera camera = testing::camera_at({0, 0, 0}, {1, 0, 0}, 801, 601, 500);
    // pixel 400 is the middle one of 801; it covers [400, 401], its centre is at 400.5
    const Eigen::Vector3d d = ray(camera, 400.5, 300.5);
    EXPECT_NEAR((d - Eigen::Vector3d::UnitZ()).norm(), 0.0, 1e-15);
    // half a pixel away is visibly elsewhere: the mistake that costs 19 mm at 18 m
    EXPECT_GT((ray(camera, 400.0, 300.5) - Eigen::Vector3d::UnitZ()).norm(), 0.5 / 500 * 0.99);
}

TEST(Camera, RayInvertsProjectionWithAndWithoutDistortion) {
    Camera camera = testing::front_camera();
    for (const auto& distortion :
         {std::array<double, 5>{}, std::array<double, 5>{-0.25, 0.08, 0.001, -0.0007, -0.01}}) {
        camera.distortion = distortion;
        for (double x = 20.0; x < 800.0; x += 95.0) {
            for (double y = 20.0; y < 800.0; y += 95.0) {
                const auto back = project(camera, 7.0 * ray(camera, x, y));
                ASSERT_TRUE(back);
                EXPECT_NEAR(back->x(), x, 1e-8);
                EXPECT_NEAR(back->y(), y, 1e-8);
            }
        }
    }
}

TEST(Camera, NothingBehindItIsProjected) {
    EXPECT_FALSE(project(testing::front_camera(), {0.0, 0.0, -3.0}));
    EXPECT_FALSE(project(testing::front_camera(), {0.0, 0.0, 0.0}));
}

TEST(Camera, PixelsPerRadianAgreeWithADifferenceOfRays) {
    const Camera camera = testing::front_camera();
    for (const double x : {400.0, 600.0, 780.0}) {
        const Eigen::Vector3d d = ray(camera, x, 400.0);
        const double tangential = 1.0 / std::acos(d.dot(ray(camera, x, 401.0)));
        const double radial = 1.0 / std::acos(d.dot(ray(camera, x + 1.0, 400.0)));
        EXPECT_NEAR(pixels_per_radian(camera, d), std::sqrt(tangential * radial), 0.02 * radial);
    }
}

TEST(Camera, UnusableNumbersAreFound) {
    EXPECT_TRUE(is_usable(testing::front_camera()));
    Camera camera = testing::front_camera();
    camera.K(0, 0) = 0.0;
    EXPECT_FALSE(is_usable(camera));
    camera = testing::front_camera();
    camera.distortion[2] = std::numeric_limits<double>::quiet_NaN();
    EXPECT_FALSE(is_usable(camera));
    camera = testing::front_camera();
    camera.width = 1 << 20;
    EXPECT_FALSE(is_usable(camera));
}

// OpenCV's documentation of plumb_bob, term by term, in the wire's pixels (integer = centre).
Eigen::Vector2d documented_pixel(const Camera& camera, const Eigen::Vector3d& point) {
    const auto [k1, k2, p1, p2, k3] = camera.distortion;
    const double x = point.x() / point.z();
    const double y = point.y() / point.z();
    const double r = std::hypot(x, y);
    const double radial = 1.0 + k1 * std::pow(r, 2) + k2 * std::pow(r, 4) + k3 * std::pow(r, 6);
    const double x_distorted = x * radial + 2.0 * p1 * x * y + p2 * (std::pow(r, 2) + 2.0 * x * x);
    const double y_distorted = y * radial + p1 * (std::pow(r, 2) + 2.0 * y * y) + 2.0 * p2 * x * y;
    return (camera.K * Eigen::Vector3d(x_distorted, y_distorted, 1.0)).head<2>();
}

TEST(Camera, ProjectionIsOpenCvsModelHalfAPixelOn) {
    Camera camera = testing::camera_at({0, 0, 0}, {1, 0, 0}, 640, 480, 500);
    camera.K(1, 1) = 520.0;  // nothing symmetric: swapped axes or coefficients show
    camera.K(0, 1) = 1.5;
    camera.K(0, 2) = 301.0;
    camera.distortion = {-0.21, 0.07, 0.002, -0.003, 0.015};
    for (const double x : {-0.5, -0.1, 0.3}) {
        for (const double y : {-0.35, 0.0, 0.4}) {
            const Eigen::Vector3d point(3.0 * x, 3.0 * y, 3.0);
            const auto pixel = project(camera, point);
            ASSERT_TRUE(pixel);
            EXPECT_NEAR((*pixel - documented_pixel(camera, point) - Eigen::Vector2d(0.5, 0.5)).norm(), 0.0, 1e-10);
            EXPECT_NEAR((ray(camera, pixel->x(), pixel->y()) - point.normalized()).norm(), 0.0, 1e-10);
        }
    }
}

TEST(Camera, PixelsPerRadianAreTheNumericScaleOfAreasAnywhere) {
    Camera camera = testing::camera_at({0, 0, 0}, {1, 0, 0}, 800, 600, 450);
    camera.K(1, 1) = 470.0;
    constexpr double kStep = 1e-6;
    for (const Eigen::Vector3d& towards :
         {Eigen::Vector3d(0, 0, 1), Eigen::Vector3d(0.6, 0.5, 1), Eigen::Vector3d(-0.8, 0.1, 1)}) {
        const Eigen::Vector3d d = towards.normalized();
        const Eigen::Vector3d a = d.unitOrthogonal();
        const Eigen::Vector3d b = d.cross(a);
        Eigen::Matrix2d slope;
        slope.col(0) = (*project(camera, d + kStep * a) - *project(camera, d - kStep * a)) / (2.0 * kStep);
        slope.col(1) = (*project(camera, d + kStep * b) - *project(camera, d - kStep * b)) / (2.0 * kStep);
        const double scale = std::sqrt(std::abs(slope.determinant()));
        EXPECT_NEAR(pixels_per_radian(camera, d), scale, 1e-6 * scale);
    }
}

TEST(Camera, EveryKindOfUnusableNumberIsFound) {
    const auto usable_after = [](auto&& change) {
        Camera camera = testing::front_camera();
        change(camera);
        return is_usable(camera);
    };
    constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
    EXPECT_TRUE(usable_after([](Camera& c) { c.width = c.height = 16; }));
    EXPECT_TRUE(usable_after([](Camera& c) { c.width = c.height = 8192; }));
    EXPECT_FALSE(usable_after([](Camera& c) { c.width = 15; }));
    EXPECT_FALSE(usable_after([](Camera& c) { c.height = 8193; }));
    EXPECT_FALSE(usable_after([](Camera& c) { c.height = -800; }));
    EXPECT_FALSE(usable_after([](Camera& c) { c.K(1, 1) = -476.7; }));
    EXPECT_FALSE(
        usable_after([](Camera& c) { c.K(0, 0) = 1e-319; }));  // found by fuzzing: a ray through it is infinite
    EXPECT_FALSE(usable_after([](Camera& c) { c.K(1, 1) = 1e300; }));
    EXPECT_FALSE(usable_after([](Camera& c) { c.K(0, 2) = kNan; }));
    EXPECT_FALSE(usable_after([](Camera& c) { c.K(1, 2) = -1e9; }));
    EXPECT_FALSE(usable_after([](Camera& c) { c.K(0, 1) = 1e250; }));  // found by fuzzing as well
    EXPECT_TRUE(usable_after([](Camera& c) { c.K(0, 1) = 0.5; }));
    EXPECT_TRUE(usable_after([](Camera& c) { c.K(0, 2) = -5000.0; }));  // a crop far beside the optical axis
    EXPECT_FALSE(usable_after([](Camera& c) { c.distortion[0] = 1e200; }));
    EXPECT_FALSE(usable_after([](Camera& c) { c.T_world_camera.translation().x() = 1e300; }));
    EXPECT_FALSE(usable_after([](Camera& c) { c.distortion[4] = std::numeric_limits<double>::infinity(); }));
    EXPECT_FALSE(usable_after([](Camera& c) { c.T_world_camera.translation().z() = kNan; }));
    EXPECT_FALSE(usable_after([](Camera& c) { c.T_world_camera.linear()(2, 1) = kNan; }));
}

}  // namespace
}  // namespace armsight::vision
