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

}  // namespace
}  // namespace armsight::vision::service
