#include "service/codec.hpp"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <limits>
#include <random>

#include "armsight/v1/description.pb.h"
#include "foxglove/CameraCalibration.pb.h"
#include "foxglove/FrameTransform.pb.h"
#include "foxglove/RawImage.pb.h"

namespace armsight::vision::service {
namespace {

Bytes bytes(const std::string& text) { return {reinterpret_cast<const std::uint8_t*>(text.data()), text.size()}; }

// protobuf writes a line on stderr for every string that is not UTF-8: thousands of them would hide a failure.
class Quiet {
  public:
    Quiet() { ::testing::internal::CaptureStderr(); }
    ~Quiet() { (void)::testing::internal::GetCapturedStderr(); }
    Quiet(const Quiet&) = delete;
    Quiet& operator=(const Quiet&) = delete;
};

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

TEST(DecodeDescription, SaysWhichMarkersNeverMove) {
    auto message = description();
    message.mutable_world_from_base()->mutable_translation()->set_z(0.5);
    message.mutable_world_from_base()->mutable_rotation()->set_z(1.0);  // half a turn
    message.clear_joints();
    for (const char* name : {"first", "second"}) {
        auto& joint = *message.add_joints();
        joint.set_name(name);
        joint.mutable_origin()->set_x(1.0);
        joint.mutable_axis()->set_z(1.0);
    }
    const auto taken = [&](const std::string& joint, double x, double z) {
        auto& centre = *message.mutable_markers(0)->mutable_centre();
        centre.set_joint(joint);
        centre.mutable_position()->set_x(x);
        centre.mutable_position()->set_z(z);
        return decode_description(bytes(message.SerializeAsString())).markers[0].fixed;
    };
    ASSERT_TRUE(taken("", 2.0, 3.0));
    EXPECT_TRUE(taken("", 2.0, 3.0)->isApprox(Eigen::Vector3d(-2.0, 0.0, 3.5)));
    ASSERT_TRUE(taken("first", 0.0, 3.0)) << "on the axis";
    EXPECT_TRUE(taken("first", 0.0, 3.0)->isApprox(Eigen::Vector3d(-1.0, 0.0, 3.5)));
    EXPECT_FALSE(taken("first", 0.1, 3.0)) << "beside the axis";
    EXPECT_FALSE(taken("second", 0.0, 3.0));
    EXPECT_FALSE(taken("", 1e9, 3.0));
    message.mutable_world_from_base()->mutable_rotation()->set_z(3.0);
    EXPECT_FALSE(taken("", 2.0, 3.0)) << "no rotation";
}

TEST(DecodeDescription, BodiesComeAfterTheMarkers) {
    auto message = description();
    auto& sphere = *message.add_bodies();
    sphere.set_name("ball");
    sphere.set_shape(v1::SHAPE_SPHERE);
    sphere.set_radius_m(0.4);
    auto& box = *message.add_bodies();
    box.set_name("crate");
    box.set_shape(v1::SHAPE_BOX);
    const auto taken = decode_description(bytes(message.SerializeAsString())).markers;
    const auto count = static_cast<std::size_t>(message.markers_size());
    ASSERT_EQ(taken.size(), count + 2);
    EXPECT_EQ(taken[count].shape, Shape::Sphere);
    EXPECT_EQ(taken[count].radius, 0.4);
    EXPECT_EQ(taken[count + 1].name, "crate");
    EXPECT_EQ(taken[count + 1].shape, Shape::Box);

    const auto expect_refused = [&] {
        EXPECT_THROW((void)decode_description(bytes(message.SerializeAsString())), MalformedMessage);
    };
    sphere.set_radius_m(0.0);
    expect_refused();
    sphere.set_radius_m(0.4);
    box.set_shape(v1::SHAPE_UNSPECIFIED);
    expect_refused();
    box.set_shape(v1::SHAPE_BOX);
    box.set_name("");
    expect_refused();
}

TEST(EncodePositions, CarriesEverythingAndNoPositionWhereThereIsNone) {
    std::vector<MarkerEstimate> estimates{{.name = "red",
                                           .status = MarkerStatus::OneView,
                                           .position = Eigen::Vector3d(1.0, 2.0, 3.0),
                                           .covariance = Eigen::Vector3d(1e-6, 2e-6, 3e-6).asDiagonal(),
                                           .extent = Eigen::Vector3d(0.8, 0.4, 0.2),
                                           .age_s = 1.25,
                                           .observations = {{.camera = "1",
                                                             .u = 10.5,
                                                             .v = 20.5,
                                                             .radius_px = 8.0,
                                                             .area_px = 190.0,
                                                             .visible = 0.9,
                                                             .corners = {},
                                                             .inliers = {}}}},
                                          {.name = "blue",
                                           .status = MarkerStatus::Lost,
                                           .position = std::nullopt,
                                           .covariance = Eigen::Matrix3d::Zero(),
                                           .extent = std::nullopt,
                                           .age_s = 0.0,
                                           .observations = {}}};
    const auto message =
        encode_positions(5'000'000'007, estimates, {.frames_sent_ns = 1, .received_ns = 2, .sent_ns = 3});
    EXPECT_EQ(message.capture_time().seconds(), 5);
    EXPECT_EQ(message.capture_time().nanos(), 7);
    EXPECT_EQ(message.markers(0).status(), v1::MARKER_STATUS_ONE_VIEW);
    EXPECT_EQ(message.markers(0).position().y(), 2.0);
    EXPECT_EQ(message.markers(0).covariance(4), 2e-6);
    EXPECT_EQ(message.markers(0).extent().z(), 0.2);
    EXPECT_FALSE(message.markers(1).has_extent());
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

TEST(DecodeImage, SkipsFieldsOfALaterVersion) {
    std::string payload = image().SerializeAsString();
    payload += std::string("\xb8\x3e\x96\x01", 4);                           // field 999, varint
    payload += std::string("\xb9\x3e\x01\x02\x03\x04\x05\x06\x07\x08", 10);  // 64 bits
    payload += std::string("\xba\x3e\x03xyz", 6);                            // bytes
    payload += std::string("\xbd\x3e\x01\x02\x03\x04", 6);                   // 32 bits
    foxglove::RawImage judge;
    ASSERT_TRUE(judge.ParseFromString(payload)) << "the test's own bytes are wrong";
    const ImageMessage decoded = decode_image(bytes(payload));
    EXPECT_EQ(decoded.width, 20U);
    EXPECT_EQ(decoded.data.size(), 960U);
}

// protobuf's own parser judges: what both accept must say the same.
TEST(DecodeImage, AgreesWithProtobufOnChangedMessages) {
    const Quiet quiet;
    constexpr unsigned kSeed = 4711;
    SCOPED_TRACE("seed " + std::to_string(kSeed));
    std::mt19937 generator(kSeed);
    const std::string valid = image().SerializeAsString();
    int both = 0;
    for (int i = 0; i < 20'000; ++i) {
        std::string payload = valid;
        for (int k = 0; k < 1 + i % 2; ++k) payload[generator() % 60] = static_cast<char>(generator() % 256);
        foxglove::RawImage judge;
        if (!judge.ParseFromString(payload)) continue;
        try {
            const ImageMessage decoded = decode_image(bytes(payload));
            ++both;
            ASSERT_EQ(decoded.capture_ns, judge.timestamp().seconds() * 1'000'000'000 + judge.timestamp().nanos());
            // a field number that was changed makes a field unknown to both
            ASSERT_EQ(decoded.width, judge.width());
            ASSERT_EQ(decoded.height, judge.height());
            ASSERT_EQ(decoded.step, judge.step());
            ASSERT_EQ(decoded.encoding, judge.encoding());
            ASSERT_EQ(std::string(decoded.data.begin(), decoded.data.end()), judge.data());
        } catch (const MalformedMessage&) {
        }
    }
    EXPECT_GT(both, 5000);
}

TEST(DecodeImage, TimesAtTheirLimitsAreExact) {
    foxglove::RawImage message = image();
    const auto decoded_ns = [&](std::int64_t seconds, std::int32_t nanos) {
        message.mutable_timestamp()->set_seconds(seconds);
        message.mutable_timestamp()->set_nanos(nanos);
        return decode_image(bytes(message.SerializeAsString())).capture_ns;
    };
    EXPECT_EQ(decoded_ns(0, 0), 0);
    EXPECT_EQ(decoded_ns(1, 999'999'999), 1'999'999'999);
    EXPECT_EQ(decoded_ns(9'000'000'000, 1), 9'000'000'000'000'000'001);
    EXPECT_THROW((void)decoded_ns(1, 1'000'000'000), MalformedMessage);
    EXPECT_THROW((void)decoded_ns(1, -1), MalformedMessage);
    EXPECT_THROW((void)decoded_ns(9'223'372'037, 0), MalformedMessage);
}

// Truncated, changed and random bytes, for every message that comes from the bus.
template <typename Decode>
void expect_decoded_or_malformed(const std::string& valid, unsigned seed, const Decode& decode) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    const Quiet quiet;
    std::mt19937 generator(seed);
    const auto feed = [&](const std::string& payload) {
        try {
            decode(bytes(payload));
        } catch (const MalformedMessage& error) {
            EXPECT_STRNE(error.what(), "");
        }
    };
    EXPECT_NO_THROW(decode(bytes(valid)));
    for (std::size_t length = 0; length < valid.size(); ++length) feed(valid.substr(0, length));
    for (int i = 0; i < 20'000; ++i) {
        std::string payload = i % 2 == 0 ? valid : std::string(generator() % 80, '\0');
        if (i % 2 == 0) {
            for (int k = 0; k < 1 + i % 5; ++k) {
                payload[generator() % payload.size()] = static_cast<char>(generator() % 256);
            }
        } else {
            for (char& c : payload) c = static_cast<char>(generator() % 256);
        }
        feed(payload);
    }
}

TEST(DecodeCalibration, NoBytesCrashIt) {
    auto message = calibration();
    message.add_d(-0.2);
    expect_decoded_or_malformed(message.SerializeAsString(), 101, [](Bytes b) { (void)decode_calibration(b); });
}

TEST(DecodePose, NoBytesCrashItAndWhatIsTakenIsAPose) {
    foxglove::FrameTransform message;
    message.set_parent_frame_id("world");
    message.set_child_frame_id("camera_1_optical");
    message.mutable_rotation()->set_w(0.6);
    message.mutable_rotation()->set_z(0.8);
    message.mutable_translation()->set_x(18.0);
    message.mutable_translation()->set_z(6.0);
    expect_decoded_or_malformed(message.SerializeAsString(), 102, [](Bytes b) {
        const Eigen::Isometry3d pose = decode_pose(b);
        EXPECT_TRUE(pose.matrix().allFinite());
        EXPECT_LT((pose.linear().transpose() * pose.linear() - Eigen::Matrix3d::Identity()).norm(), 1e-9);
    });
}

TEST(DecodeDescription, NoBytesCrashItAndWhatIsTakenIsUsable) {
    expect_decoded_or_malformed(description().SerializeAsString(), 103, [](Bytes b) {
        const Description taken = decode_description(b);
        EXPECT_FALSE(taken.markers.empty());
        for (const MarkerModel& marker : taken.markers) {
            EXPECT_EQ(marker.radius > 0.0, marker.shape == Shape::Sphere);
        }
    });
}

TEST(DecodePose, NumbersThatAreNoneAreRefusedInEveryPlace) {
    const auto pose = [](const std::array<double, 7>& numbers) {
        foxglove::FrameTransform message;
        message.set_parent_frame_id("world");
        message.mutable_translation()->set_x(numbers[0]);
        message.mutable_translation()->set_y(numbers[1]);
        message.mutable_translation()->set_z(numbers[2]);
        message.mutable_rotation()->set_x(numbers[3]);
        message.mutable_rotation()->set_y(numbers[4]);
        message.mutable_rotation()->set_z(numbers[5]);
        message.mutable_rotation()->set_w(numbers[6]);
        return decode_pose(bytes(message.SerializeAsString()));
    };
    const std::array<double, 7> good{18.0, 0.0, 6.0, 0.0, 0.0, 0.6, 0.8};
    EXPECT_NO_THROW((void)pose(good));
    constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
    constexpr double kInfinity = std::numeric_limits<double>::infinity();
    for (std::size_t i = 0; i < good.size(); ++i) {
        for (const double bad : {kNan, kInfinity, -kInfinity, 1e300}) {
            auto numbers = good;
            numbers[i] = bad;
            EXPECT_THROW((void)pose(numbers), MalformedMessage) << "number " << i << " is " << bad;
        }
    }
}

TEST(DecodePose, RotationIsTheQuaternionsInTheOrderOfTheMessage) {
    foxglove::FrameTransform message;
    message.set_parent_frame_id("world");
    message.mutable_rotation()->set_z(std::sqrt(0.5));  // a quarter turn about z
    message.mutable_rotation()->set_w(std::sqrt(0.5));
    message.mutable_translation()->set_y(-18.0);
    const Eigen::Isometry3d pose = decode_pose(bytes(message.SerializeAsString()));
    EXPECT_NEAR((pose * Eigen::Vector3d::UnitX() - Eigen::Vector3d(0.0, -17.0, 0.0)).norm(), 0.0, 1e-12);
}

TEST(DecodeCalibration, KIsRowByRow) {
    foxglove::CameraCalibration message;
    message.set_width(640);
    message.set_height(480);
    for (int i = 1; i <= 9; ++i) message.add_k(i);
    message.set_distortion_model("plumb_bob");
    for (int i = 1; i <= 5; ++i) message.add_d(0.1 * i);
    const Calibration decoded = decode_calibration(bytes(message.SerializeAsString()));
    EXPECT_EQ(decoded.width, 640);
    EXPECT_EQ(decoded.height, 480);
    EXPECT_EQ(decoded.K(0, 1), 2.0);
    EXPECT_EQ(decoded.K(1, 0), 4.0);
    EXPECT_EQ(decoded.K(1, 2), 6.0);
    for (std::size_t i = 0; i < 5; ++i) EXPECT_DOUBLE_EQ(decoded.distortion[i], 0.1 * static_cast<double>(i + 1));
}

TEST(DecodeDescription, TakesAsManyAsItSaysAndNoMore) {
    const auto with = [](int markers, int cameras) {
        v1::ArmDescription message;
        for (int i = 0; i < markers; ++i) {
            auto& marker = *message.add_markers();
            marker.set_name("m" + std::to_string(i));
            marker.set_radius_m(0.1);
        }
        for (int i = 0; i < cameras; ++i) message.add_cameras("c" + std::to_string(i));
        return decode_description(bytes(message.SerializeAsString()));
    };
    EXPECT_EQ(with(64, 16).markers.size(), 64U);
    EXPECT_EQ(with(64, 16).cameras.size(), 16U);
    EXPECT_THROW((void)with(65, 2), MalformedMessage);
    EXPECT_THROW((void)with(1, 17), MalformedMessage);
}

TEST(DecodeDescription, RadiiThatAreNoneAreRefused) {
    for (const double radius :
         {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity(), -0.1}) {
        auto message = description();
        message.mutable_markers(0)->set_radius_m(radius);
        EXPECT_THROW((void)decode_description(bytes(message.SerializeAsString())), MalformedMessage) << radius;
    }
}

TEST(EncodePositions, SurvivesTheWire) {
    Eigen::Matrix3d covariance;
    covariance << 1, 2, 3, 4, 5, 6, 7, 8, 9;
    const auto estimate = [&](const std::string& name, MarkerStatus status) {
        return MarkerEstimate{.name = name,
                              .status = status,
                              .position = Eigen::Vector3d(1.5, -2.5, 3.5),
                              .covariance = covariance,
                              .extent = std::nullopt,
                              .age_s = 0.0,
                              .observations = {{.camera = "1",
                                                .u = 10.5,
                                                .v = 20.25,
                                                .radius_px = 8.0,
                                                .area_px = 190.0,
                                                .visible = 0.9,
                                                .corners = {},
                                                .inliers = {}},
                                               {.camera = "2",
                                                .u = 1.0,
                                                .v = 2.0,
                                                .radius_px = 3.0,
                                                .area_px = 4.0,
                                                .visible = 0.5,
                                                .corners = {},
                                                .inliers = {}}}};
    };
    const std::vector<MarkerEstimate> estimates{
        estimate("green", MarkerStatus::Tracked), estimate("yellow", MarkerStatus::PartlyOccluded),
        estimate("blue", MarkerStatus::OneView), estimate("red", MarkerStatus::Lost)};
    const std::string wire =
        encode_positions(1'700'000'000'999'999'999, estimates, {.frames_sent_ns = 11, .received_ns = 22, .sent_ns = 33})
            .SerializeAsString();
    v1::JointPositions message;
    ASSERT_TRUE(message.ParseFromString(wire));
    EXPECT_EQ(message.capture_time().seconds(), 1'700'000'000);
    EXPECT_EQ(message.capture_time().nanos(), 999'999'999);
    ASSERT_EQ(message.markers_size(), 4);
    const std::array statuses{v1::MARKER_STATUS_TRACKED, v1::MARKER_STATUS_PARTLY_OCCLUDED, v1::MARKER_STATUS_ONE_VIEW,
                              v1::MARKER_STATUS_LOST};
    for (int i = 0; i < 4; ++i) {
        const auto& marker = message.markers(i);
        EXPECT_EQ(marker.name(), estimates[static_cast<std::size_t>(i)].name);
        EXPECT_EQ(marker.status(), statuses[static_cast<std::size_t>(i)]);
        EXPECT_EQ(marker.position().x(), 1.5);
        EXPECT_EQ(marker.position().y(), -2.5);
        EXPECT_EQ(marker.position().z(), 3.5);
        ASSERT_EQ(marker.covariance_size(), 9);
        for (int k = 0; k < 9; ++k) EXPECT_EQ(marker.covariance(k), k + 1) << "row by row";
        ASSERT_EQ(marker.observations_size(), 2);
        EXPECT_EQ(marker.observations(0).u_px(), 10.5);
        EXPECT_EQ(marker.observations(0).v_px(), 20.25);
        EXPECT_EQ(marker.observations(0).radius_px(), 8.0);
        EXPECT_EQ(marker.observations(0).area_px(), 190.0);
        EXPECT_EQ(marker.observations(0).visible(), 0.9);
        EXPECT_EQ(marker.observations(1).camera(), "2");
    }
    EXPECT_EQ(message.stages().frames_sent_ns(), 11U);
    EXPECT_EQ(message.stages().vision_received_ns(), 22U);
    EXPECT_EQ(message.stages().vision_sent_ns(), 33U);
}

TEST(EncodePositions, AgeIsAlwaysAValidDuration) {
    for (const double age_s : {0.0, 1e-10, 0.033333333, 0.9999999999, 1.9999999996, 3600.5}) {
        const std::vector<MarkerEstimate> estimates{{.name = "red",
                                                     .status = MarkerStatus::Lost,
                                                     .position = std::nullopt,
                                                     .covariance = Eigen::Matrix3d::Zero(),
                                                     .extent = std::nullopt,
                                                     .age_s = age_s,
                                                     .observations = {}}};
        const auto message = encode_positions(0, estimates, {.frames_sent_ns = 0, .received_ns = 0, .sent_ns = 0});
        const auto& age = message.markers(0).age();
        EXPECT_GE(age.nanos(), 0);
        EXPECT_LT(age.nanos(), 1'000'000'000);
        EXPECT_NEAR(static_cast<double>(age.seconds()) + 1e-9 * age.nanos(), age_s, 2e-9);
    }
}

}  // namespace
}  // namespace armsight::vision::service
