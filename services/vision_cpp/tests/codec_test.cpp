#include "service/codec.hpp"

#include <gtest/gtest.h>

#include <limits>
#include <random>

#include "armsight/v1/description.pb.h"
#include "foxglove/CameraCalibration.pb.h"
#include "foxglove/FrameTransform.pb.h"
#include "foxglove/RawImage.pb.h"

namespace armsight::vision::service {
namespace {

Bytes bytes(const std::string& text) { return {reinterpret_cast<const std::uint8_t*>(text.data()), text.size()}; }

foxglove::RawImage image() {
    foxglove::RawImage message;
    message.mutable_timestamp()->set_seconds(1'700'000'000);
    message.mutable_timestamp()->set_nanos(123'456'789);
    message.set_frame_id("camera_1_optical");
    message.set_width(20);
    message.set_height(16);
    message.set_step(60);
    message.set_encoding("rgb8");
    std::string data(960, '\0');
    for (std::size_t i = 0; i < data.size(); ++i) data[i] = static_cast<char>(i * 7);
    message.set_data(data);
    return message;
}

foxglove::CameraCalibration calibration() {
    foxglove::CameraCalibration message;
    message.set_width(800);
    message.set_height(800);
    message.set_distortion_model("plumb_bob");
    for (const double k : {476.7, 0.0, 399.5, 0.0, 476.7, 399.5, 0.0, 0.0, 1.0}) message.add_k(k);
    return message;
}

v1::ArmDescription description() {
    v1::ArmDescription message;
    auto& marker = *message.add_markers();
    marker.set_name("green");
    marker.set_radius_m(0.7);
    marker.mutable_color()->set_green(1.0);
    message.add_cameras("1");
    message.add_cameras("2");
    return message;
}

TEST(DecodeImage, ReadsWhatProtobufWrote) {
    const std::string payload = image().SerializeAsString();
    const ImageMessage decoded = decode_image(bytes(payload));
    EXPECT_EQ(decoded.capture_ns, 1'700'000'000'123'456'789);
    EXPECT_EQ(decoded.width, 20U);
    EXPECT_EQ(decoded.height, 16U);
    EXPECT_EQ(decoded.step, 60U);
    EXPECT_EQ(decoded.encoding, "rgb8");
    EXPECT_EQ(std::string(decoded.data.begin(), decoded.data.end()), image().data());
    // in place: not a copy
    EXPECT_GE(decoded.data.data(), bytes(payload).data());
    EXPECT_LT(decoded.data.data(), bytes(payload).data() + payload.size());
}

TEST(DecodeImage, TruncatedMessagesAreMalformedOrLackTheirData) {
    const std::string payload = image().SerializeAsString();
    std::size_t malformed = 0;
    for (std::size_t length = 0; length < payload.size(); ++length) {
        const std::string cut = payload.substr(0, length);
        try {
            // only a cut between two fields leaves a message
            EXPECT_LE(decode_image(bytes(cut)).data.size(), image().data().size());
        } catch (const MalformedMessage&) {
            ++malformed;
        }
    }
    EXPECT_GE(malformed, payload.size() - 8);
}

TEST(DecodeImage, NoBytesCrashIt) {
    constexpr unsigned kSeed = 90210;
    SCOPED_TRACE("seed " + std::to_string(kSeed));
    std::mt19937 generator(kSeed);
    std::uniform_int_distribution<int> byte(0, 255);
    const std::string valid = image().SerializeAsString();
    int malformed = 0;
    for (int i = 0; i < 20'000; ++i) {
        std::string payload(static_cast<std::size_t>(i % 80), '\0');
        for (char& c : payload) c = static_cast<char>(byte(generator));
        if (i % 2 == 0) {  // a valid message with a few bytes changed reaches deeper
            payload = valid;
            for (int k = 0; k < 1 + i % 5; ++k) payload[generator() % 60] = static_cast<char>(byte(generator));
        }
        try {
            const ImageMessage decoded = decode_image(bytes(payload));
            ASSERT_LE(decoded.data.size(), payload.size());
        } catch (const MalformedMessage&) {
            ++malformed;
        }
    }
    EXPECT_GT(malformed, 5000);
    EXPECT_LT(malformed, 20'000);
}

TEST(DecodeImage, TimesThatAreNoneAreMalformed) {
    foxglove::RawImage message = image();
    message.clear_timestamp();
    EXPECT_THROW((void)decode_image(bytes(message.SerializeAsString())), MalformedMessage);
    message = image();
    message.mutable_timestamp()->set_seconds(-1);
    EXPECT_THROW((void)decode_image(bytes(message.SerializeAsString())), MalformedMessage);
    message.mutable_timestamp()->set_seconds(std::numeric_limits<std::int64_t>::max());
    EXPECT_THROW((void)decode_image(bytes(message.SerializeAsString())), MalformedMessage);
}

TEST(DecodeCalibration, TakesTheLensAndRefusesWhatItDoesNotKnow) {
    auto message = calibration();
    message.add_d(-0.2);
    const Calibration decoded = decode_calibration(bytes(message.SerializeAsString()));
    EXPECT_EQ(decoded.width, 800);
    EXPECT_EQ(decoded.K(0, 2), 399.5);
    EXPECT_EQ(decoded.distortion[0], -0.2);
    EXPECT_EQ(decoded.distortion[4], 0.0);

    message.set_distortion_model("fisheye");
    EXPECT_THROW((void)decode_calibration(bytes(message.SerializeAsString())), MalformedMessage);
    message = calibration();
    message.add_k(1.0);
    EXPECT_THROW((void)decode_calibration(bytes(message.SerializeAsString())), MalformedMessage);
    message = calibration();
    for (int i = 0; i < 8; ++i) message.add_d(0.0);
    EXPECT_THROW((void)decode_calibration(bytes(message.SerializeAsString())), MalformedMessage);
    EXPECT_THROW((void)decode_calibration({}), MalformedMessage);
}

TEST(DecodePose, RefusesOtherParentsAndNumbersThatAreNoPose) {
    foxglove::FrameTransform message;
    message.set_parent_frame_id("world");
    message.mutable_rotation()->set_w(1.0);
    message.mutable_translation()->set_x(18.0);
    EXPECT_EQ(decode_pose(bytes(message.SerializeAsString())).translation().x(), 18.0);
    message.mutable_translation()->set_x(std::numeric_limits<double>::quiet_NaN());
    EXPECT_THROW((void)decode_pose(bytes(message.SerializeAsString())), MalformedMessage);
    message.mutable_translation()->set_x(0.0);
    message.mutable_rotation()->set_w(2.0);
    EXPECT_THROW((void)decode_pose(bytes(message.SerializeAsString())), MalformedMessage);
    message.mutable_rotation()->set_w(1.0);
    message.set_parent_frame_id("base");
    EXPECT_THROW((void)decode_pose(bytes(message.SerializeAsString())), MalformedMessage);
}

TEST(DecodeDescription, NeedsMarkersWithNamesAndRadii) {
    EXPECT_EQ(decode_description(bytes(description().SerializeAsString())).markers[0].name, "green");
    EXPECT_THROW((void)decode_description({}), MalformedMessage);
    auto message = description();
    message.mutable_markers(0)->set_radius_m(0.0);
    EXPECT_THROW((void)decode_description(bytes(message.SerializeAsString())), MalformedMessage);
    message = description();
    message.mutable_markers(0)->set_name("a/b*");
    EXPECT_THROW((void)decode_description(bytes(message.SerializeAsString())), MalformedMessage);
    message = description();
    message.set_cameras(1, "1");
    EXPECT_THROW((void)decode_description(bytes(message.SerializeAsString())), MalformedMessage);
}

TEST(EncodePositions, CarriesEverythingAndNoPositionWhereThereIsNone) {
    std::vector<MarkerEstimate> estimates{
        {.name = "red",
         .status = MarkerStatus::OneView,
         .position = Eigen::Vector3d(1.0, 2.0, 3.0),
         .covariance = Eigen::Vector3d(1e-6, 2e-6, 3e-6).asDiagonal(),
         .age_s = 1.25,
         .observations = {{.camera = "1", .u = 10.5, .v = 20.5, .radius_px = 8.0, .area_px = 190.0, .visible = 0.9}}},
        {.name = "blue",
         .status = MarkerStatus::Lost,
         .position = std::nullopt,
         .covariance = Eigen::Matrix3d::Zero(),
         .age_s = 0.0,
         .observations = {}}};
    const auto message =
        encode_positions(5'000'000'007, estimates, {.frames_sent_ns = 1, .received_ns = 2, .sent_ns = 3});
    EXPECT_EQ(message.capture_time().seconds(), 5);
    EXPECT_EQ(message.capture_time().nanos(), 7);
    EXPECT_EQ(message.markers(0).status(), v1::MARKER_STATUS_ONE_VIEW);
    EXPECT_EQ(message.markers(0).position().y(), 2.0);
    EXPECT_EQ(message.markers(0).covariance(4), 2e-6);
    EXPECT_EQ(message.markers(0).age().seconds(), 1);
    EXPECT_EQ(message.markers(0).age().nanos(), 250'000'000);
    EXPECT_EQ(message.markers(0).observations(0).camera(), "1");
    EXPECT_FALSE(message.markers(1).has_position());
    EXPECT_EQ(message.markers(1).covariance_size(), 0);
    EXPECT_EQ(message.stages().vision_sent_ns(), 3U);
}

TEST(DecodeSentNs, IsLittleEndianAndZeroWithoutEightBytes) {
    const std::vector<std::uint8_t> stamp{1, 2, 0, 0, 0, 0, 0, 0};
    EXPECT_EQ(decode_sent_ns(stamp), 513U);
    EXPECT_EQ(decode_sent_ns({}), 0U);
}

}  // namespace
}  // namespace armsight::vision::service
