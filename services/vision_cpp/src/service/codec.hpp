#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <span>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include "armsight/v1/joints.pb.h"
#include "armsight/v1/parameters.pb.h"
#include "armsight/vision/description.hpp"
#include "armsight/vision/estimate.hpp"

namespace armsight::vision::service {

using Bytes = std::span<const std::uint8_t>;

/// Bytes from the bus that are not the message they should be, or one that cannot be used.
class MalformedMessage : public std::runtime_error {
  public:
    using std::runtime_error::runtime_error;
};

/// Keeps protobuf from writing lines of its own to stderr: what is malformed is counted, and told by whoever parsed it.
void silence_protobuf();

/// Fields of a foxglove.RawImage; `data` points into the message's bytes, which are never copied.
struct ImageMessage {
    std::int64_t capture_ns;
    std::uint32_t width, height, step;
    std::string encoding;
    Bytes data;
};
[[nodiscard]] ImageMessage decode_image(Bytes payload);

/// The part of a camera that foxglove.CameraCalibration tells.
struct Calibration {
    int width, height;
    Eigen::Matrix3d K;
    std::array<double, 5> distortion;
};
[[nodiscard]] Calibration decode_calibration(Bytes payload);

/// T_world_camera of a foxglove.FrameTransform with parent `world`.
[[nodiscard]] Eigen::Isometry3d decode_pose(Bytes payload);

/// The part of armsight.v1.ArmDescription that vision needs.
struct Description {
    std::vector<MarkerModel> markers;  ///< of the arm, then the bodies beside it
    std::vector<std::string> cameras;
};
[[nodiscard]] Description decode_description(Bytes payload);

/// Wall-clock times of the stages so far, Unix nanoseconds.
struct Stages {
    std::uint64_t frames_sent_ns, received_ns, sent_ns;
};
[[nodiscard]] v1::JointPositions encode_positions(std::int64_t capture_ns, std::span<const MarkerEstimate> estimates,
                                                  const Stages& stages);

[[nodiscard]] v1::SetParametersRequest decode_set_parameters(Bytes payload);
[[nodiscard]] v1::Parameters encode_parameters(std::int64_t now_ns, std::span<const v1::Parameter> parameters);

/// The 8 bytes (little-endian Unix nanoseconds) beside each frame; 0 when there are none.
[[nodiscard]] std::uint64_t decode_sent_ns(Bytes attachment);

}  // namespace armsight::vision::service
