#include "service/rig.hpp"

#include <gtest/gtest.h>

namespace armsight::vision::service {
namespace {

Description two_cameras() {
    return {.markers = {{.name = "red", .radius = 0.3, .color = {1, 0, 0}}}, .cameras = {"1", "2"}};
}

TEST(Rig, SaysWhatIsMissingInWhateverOrderThingsCome) {
    Rig rig;
    EXPECT_NE(rig.missing().find("description"), std::string::npos);
    rig.set("2", Eigen::Isometry3d::Identity());
    rig.set(two_cameras());
    EXPECT_EQ(rig.missing(), "no calibration of camera 1 yet");
    const Calibration calibration{.width = 640, .height = 480, .K = Eigen::Matrix3d::Identity(), .distortion = {}};
    rig.set("1", calibration);
    EXPECT_EQ(rig.missing(), "no pose of camera 1 yet");
    rig.set("1", Eigen::Isometry3d::Identity());
    EXPECT_EQ(rig.missing(), "no calibration of camera 2 yet");
    EXPECT_EQ(rig.cameras().size(), 1U);
    rig.set("2", calibration);
    EXPECT_EQ(rig.missing(), "");
    EXPECT_EQ(rig.cameras()[1].name, "2");
    EXPECT_EQ(rig.size_of("1"), std::pair(640, 480));
    EXPECT_FALSE(rig.size_of("3"));
}

TEST(Rig, MadeUpCameraNamesDoNotFillTheMemory) {
    Rig rig;
    for (int i = 0; i < 64; ++i) rig.set("camera" + std::to_string(i), Eigen::Isometry3d::Identity());
    EXPECT_THROW(rig.set("one too many", Eigen::Isometry3d::Identity()), MalformedMessage);
    EXPECT_NO_THROW(rig.set("camera3", Eigen::Isometry3d::Identity()));
}

TEST(Rig, OneCameraCannotMeasure) {
    Rig rig;
    Description description = two_cameras();
    description.cameras.pop_back();
    rig.set(description);
    EXPECT_NE(rig.missing().find("fewer than two cameras"), std::string::npos);
}

TEST(Rig, EverySetIsANewVersion) {
    Rig rig;
    auto before = rig.version();
    const auto expect_newer = [&] {
        EXPECT_NE(rig.version(), before);
        before = rig.version();
    };
    rig.set(two_cameras());
    expect_newer();
    rig.set("1", Eigen::Isometry3d::Identity());
    expect_newer();
    rig.set("1", Calibration{.width = 640, .height = 480, .K = Eigen::Matrix3d::Identity(), .distortion = {}});
    expect_newer();
}

TEST(Rig, CameraIsWhatWasToldLast) {
    Rig rig;
    rig.set(two_cameras());
    rig.set("1", Calibration{.width = 640, .height = 480, .K = Eigen::Matrix3d::Identity(), .distortion = {}});
    rig.set("1", Calibration{.width = 800, .height = 600, .K = 2.0 * Eigen::Matrix3d::Identity(), .distortion = {0.1}});
    Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
    pose.translation().x() = 18.0;
    rig.set("1", pose);
    const auto cameras = rig.cameras();
    ASSERT_EQ(cameras.size(), 1U);
    EXPECT_EQ(cameras[0].name, "1");
    EXPECT_EQ(cameras[0].width, 800);
    EXPECT_EQ(cameras[0].height, 600);
    EXPECT_EQ(cameras[0].K(0, 0), 2.0);
    EXPECT_EQ(cameras[0].distortion[0], 0.1);
    EXPECT_EQ(cameras[0].T_world_camera.translation().x(), 18.0);
}

TEST(Rig, CamerasThatTheDescriptionDoesNotNameAreLeftOut) {
    Rig rig;
    rig.set(two_cameras());
    rig.set("9", Calibration{.width = 640, .height = 480, .K = Eigen::Matrix3d::Identity(), .distortion = {}});
    rig.set("9", Eigen::Isometry3d::Identity());
    EXPECT_TRUE(rig.cameras().empty());
}

}  // namespace
}  // namespace armsight::vision::service
