#include "service/annotations.hpp"

#include <gtest/gtest.h>

#include "armsight/vision/estimate.hpp"

namespace armsight::vision::service {
namespace {

MarkerEstimate seen_by(const Observation& observation) {
    return {.name = "red",
            .status = MarkerStatus::PartlyOccluded,
            .position = Eigen::Vector3d::Zero(),
            .covariance = Eigen::Matrix3d::Zero(),
            .extent = std::nullopt,
            .age_s = 0.0,
            .observations = {observation}};
}

Observation at(double u, double v) {
    return {.camera = "1",
            .u = u,
            .v = v,
            .radius_px = 8.0,
            .area_px = 200.0,
            .visible = 0.9,
            .corners = {},
            .inliers = {}};
}

TEST(Annotate, DrawsOutlineInliersAndCentreOfASphere) {
    Observation observation = at(100.25, 50.5);
    observation.inliers = {{108.0, 50.0}, {100.0, 58.0}};
    const std::vector estimates{seen_by(observation)};
    const auto message = annotate(5'000'000'007, "1", estimates);
    ASSERT_EQ(message.circles_size(), 1);
    EXPECT_EQ(message.circles(0).position().x(), 100.25);
    EXPECT_EQ(message.circles(0).position().y(), 50.5);
    EXPECT_EQ(message.circles(0).diameter(), 16.0);
    EXPECT_EQ(message.circles(0).timestamp().seconds(), 5);
    EXPECT_EQ(message.circles(0).timestamp().nanos(), 7);
    ASSERT_EQ(message.points_size(), 2);
    EXPECT_EQ(message.points(0).type(), foxglove::PointsAnnotation::POINTS);
    ASSERT_EQ(message.points(0).points_size(), 2);
    EXPECT_EQ(message.points(0).points(1).y(), 58.0);
    ASSERT_EQ(message.points(1).points_size(), 1);
    EXPECT_EQ(message.points(1).points(0).x(), 100.25);
    ASSERT_EQ(message.texts_size(), 1);
    EXPECT_EQ(message.texts(0).text(), "red (partly hidden)");
}

TEST(Annotate, DrawsABoxByItsCorners) {
    Observation observation = at(10.0, 10.0);
    observation.corners = {{5.0, 5.0}, {15.0, 5.0}, {15.0, 15.0}, {5.0, 15.0}};
    const std::vector estimates{seen_by(observation)};
    const auto message = annotate(1, "1", estimates);
    EXPECT_EQ(message.circles_size(), 0);
    ASSERT_EQ(message.points_size(), 2);
    EXPECT_EQ(message.points(0).type(), foxglove::PointsAnnotation::LINE_LOOP);
    ASSERT_EQ(message.points(0).points_size(), 4);
    EXPECT_EQ(message.points(0).points(2).x(), 15.0);
    EXPECT_EQ(message.points(1).points_size(), 1) << "the centre";
}

TEST(Annotate, SaysThatACameraSawNothing) {
    const std::vector estimates{seen_by(at(10.0, 10.0))};
    const auto message = annotate(1, "2", estimates);
    EXPECT_EQ(message.circles_size(), 0);
    EXPECT_EQ(message.points_size(), 0);
    ASSERT_EQ(message.texts_size(), 1) << "leaves out what another camera saw";
    EXPECT_EQ(message.texts(0).text(), "nothing seen");
    EXPECT_EQ(message.texts(0).timestamp().nanos(), 1);
}

}  // namespace
}  // namespace armsight::vision::service
