#include "armsight/vision/camera_check.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <string>
#include <vector>

namespace armsight::vision {
namespace {

Camera camera(const std::string& name, double angle) {
    Camera result{.name = name,
                  .width = 800,
                  .height = 800,
                  .K = (Eigen::Matrix3d() << 480, 0, 399.5, 0, 480, 399.5, 0, 0, 1).finished(),
                  .distortion = {},
                  .T_world_camera = Eigen::Isometry3d::Identity()};
    result.T_world_camera.linear() = Eigen::AngleAxisd(angle, Eigen::Vector3d::UnitY()).toRotationMatrix();
    result.T_world_camera.translation() = result.T_world_camera.linear() * Eigen::Vector3d(0, 0, -18);
    return result;
}

const std::vector<Camera> kCameras{camera("1", 0.0), camera("2", M_PI / 2)};
const std::vector<MarkerModel> kMarkers{
    {.name = "red", .radius = 0.3, .color = {1, 0, 0}},
    {.name = "box", .radius = 0.0, .color = {1, 0.5, 0}, .shape = Shape::Box},
};

// Seen by the first so many cameras, camera 2 off by so many pixels.
std::vector<MarkerEstimate> answer(std::size_t views, double off_px, double visible = 1.0) {
    std::vector<MarkerEstimate> result(2);
    for (auto& estimate : result) {
        estimate.position = Eigen::Vector3d(0.5, -1.0, 0.3);
        for (std::size_t i = 0; i < views; ++i) {
            const auto pixel = wire_pixel(kCameras[i], kCameras[i].T_world_camera.inverse() * *estimate.position);
            const double off = i == 1 ? off_px : 0.0;
            estimate.observations.push_back({.camera = kCameras[i].name,
                                             .u = pixel->x() + 0.6 * off,
                                             .v = pixel->y() - 0.8 * off,
                                             .radius_px = 8,
                                             .area_px = 200,
                                             .visible = visible,
                                             .corners = {},
                                             .inliers = {}});
        }
    }
    for (auto& observation : result[1].observations) observation.u += 50;  // a box's are another matter
    return result;
}

TEST(CameraCheck, SaysNothingBeforeItSawEnough) {
    CameraCheck check;
    for (int i = 0; i < 20; ++i) check.add(answer(2, 5.0), kMarkers, kCameras);
    EXPECT_TRUE(check.residuals_px().empty());
    EXPECT_EQ(check.trouble(), "");
}

TEST(CameraCheck, IsContentWithCamerasThatAgree) {
    CameraCheck check;
    for (int i = 0; i < 2000; ++i) check.add(answer(i % 10 == 0 ? 1 : 2, i % 7 == 0 ? 3.0 : 0.1), kMarkers, kCameras);
    EXPECT_NEAR(check.residuals_px().at("2"), 0.1, 1e-9) << "the middle of many: a few that are hidden don't count";
    EXPECT_NEAR(check.residuals_px().at("1"), 0.0, 1e-9);
    EXPECT_EQ(check.trouble(), "");
}

TEST(CameraCheck, NoticesACameraThatIsOffTheOthers) {
    CameraCheck check;
    for (int i = 0; i < 100; ++i) check.add(answer(2, 0.0), kMarkers, kCameras);
    ASSERT_EQ(check.trouble(), "");
    for (int i = 0; i < 256; ++i) check.add(answer(2, 0.74), kMarkers, kCameras);  // now it is moved
    EXPECT_NE(check.trouble().find("camera 2 is 0.7 px off"), std::string::npos) << check.trouble();
    for (int i = 0; i < 256; ++i) check.add(answer(2, 0.05), kMarkers, kCameras);  // and moved back
    EXPECT_EQ(check.trouble(), "");
}

TEST(CameraCheck, KnowsBetterByAMarkerThatNeverMoves) {
    auto markers = kMarkers;
    markers[0].fixed = Eigen::Vector3d(0.5, -1.0, 0.3);
    CameraCheck check;
    for (int i = 0; i < 300; ++i) check.add(answer(2, 0.0), markers, kCameras);
    ASSERT_EQ(check.trouble(), "");
    // both cameras agree on a place, and it is not the marker's: camera 1 has turned in the plane of both rays
    auto displaced = answer(2, 0.0);
    for (auto& estimate : displaced) {
        estimate.position->x() += 0.03;
        estimate.observations[0].u += 480.0 * 0.03 / 18.3;
    }
    for (int i = 0; i < 300; ++i) check.add(displaced, markers, kCameras);
    EXPECT_NE(check.trouble().find("camera 1 sees what never moves 0.8 px"), std::string::npos) << check.trouble();
    EXPECT_NEAR(check.residuals_px().at("1"), 0.79, 0.01);
    EXPECT_LT(check.residuals_px().at("2"), 0.1);
}

TEST(CameraCheck, OneCameraIsJudgedByAMarkerThatNeverMoves) {
    auto markers = kMarkers;
    markers[0].fixed = Eigen::Vector3d(0.5, -1.0, 0.3 + 1.0);
    CameraCheck check;
    for (int i = 0; i < 300; ++i) check.add(answer(1, 0.0), markers, std::vector<Camera>{kCameras[0]});
    EXPECT_NE(check.trouble().find("camera 1"), std::string::npos) << check.trouble();
}

TEST(CameraCheck, LeavesOutWhatIsHalfHidden) {
    CameraCheck check;
    for (int i = 0; i < 500; ++i) check.add(answer(2, 2.0, 0.5), kMarkers, kCameras);
    EXPECT_TRUE(check.residuals_px().empty());
    EXPECT_EQ(check.trouble(), "");
}

TEST(CameraCheck, SaysThatNoTwoAgreeWhereEachSeesMarkersAlone) {
    CameraCheck check;
    auto by_second = answer(2, 0.0);
    for (auto& estimate : by_second) estimate.observations.erase(estimate.observations.begin());
    for (int i = 0; i < 600; ++i) check.add(i % 3 == 0 ? by_second : answer(1, 0.0), kMarkers, kCameras);
    EXPECT_NE(check.trouble().find("no two cameras"), std::string::npos) << check.trouble();
    for (int i = 0; i < 600; ++i) check.add(answer(2, 0.0), kMarkers, kCameras);
    EXPECT_EQ(check.trouble(), "");
}

TEST(CameraCheck, ACoveredCameraIsNotAMovedOne) {
    CameraCheck check;
    for (int i = 0; i < 2000; ++i) check.add(answer(1, 0.0), kMarkers, kCameras);
    EXPECT_EQ(check.trouble(), "");
}

TEST(CameraCheck, OneCameraHasNobodyToAgreeWith) {
    CameraCheck check;
    const std::vector<Camera> one{kCameras[0]};
    for (int i = 0; i < 2000; ++i) check.add(answer(1, 0.0), kMarkers, one);
    EXPECT_EQ(check.trouble(), "");
}

TEST(CameraCheck, ForgetsWhenCamerasAreOthers) {
    CameraCheck check;
    for (int i = 0; i < 300; ++i) check.add(answer(2, 2.0), kMarkers, kCameras);
    ASSERT_NE(check.trouble(), "");
    check.reset();
    EXPECT_EQ(check.trouble(), "");
}

}  // namespace
}  // namespace armsight::vision
