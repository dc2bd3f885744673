#include "armsight/vision/camera.hpp"

#include <gtest/gtest.h>

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

}  // namespace
}  // namespace armsight::vision
