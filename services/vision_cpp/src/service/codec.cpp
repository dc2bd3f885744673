#include "service/codec.hpp"

#include <google/protobuf/io/coded_stream.h>
#include <google/protobuf/stubs/logging.h>
#include <google/protobuf/timestamp.pb.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "armsight/v1/description.pb.h"
#include "foxglove/CameraCalibration.pb.h"
#include "foxglove/FrameTransform.pb.h"
#include "foxglove/RawImage.pb.h"

namespace armsight::vision::service {
namespace {

constexpr std::int64_t kNsPerS = 1'000'000'000;
// Year 2262 is where nanoseconds leave 64 bits.
constexpr std::int64_t kMaxSeconds = std::numeric_limits<std::int64_t>::max() / kNsPerS - 1;
constexpr int kMaxMarkers = 64;
constexpr int kMaxCameras = 16;
constexpr double kOnAxisMetres = 1e-3;
constexpr double kMaxMetres = 1e4;  // farther than any camera of this use sees

enum class WireType : std::uint32_t { Varint = 0, Fixed64 = 1, Length = 2, Fixed32 = 5 };

template <typename Message>
Message parse(Bytes payload) {
    Message message;
    if (payload.size() > static_cast<std::size_t>(std::numeric_limits<int>::max()) ||
        !message.ParseFromArray(payload.data(), static_cast<int>(payload.size()))) {
        throw MalformedMessage("the bytes are not a " + Message::descriptor()->full_name());
    }
    return message;
}

std::int64_t nanoseconds(const google::protobuf::Timestamp& time) {
    if (time.seconds() < 0 || time.seconds() > kMaxSeconds || time.nanos() < 0 || time.nanos() >= kNsPerS) {
        throw MalformedMessage("the capture time is not a time after 1970");
    }
    return time.seconds() * kNsPerS + time.nanos();
}

bool is_name(const std::string& name) {
    const auto is_plain = [](char c) {
        return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_' || c == '-' ||
               c == '.';
    };
    return !name.empty() && name.size() <= 64 && std::ranges::all_of(name, is_plain);
}

// A length-delimited field's bytes, in place.
std::optional<Bytes> read_bytes(google::protobuf::io::CodedInputStream& stream, Bytes payload) {
    std::uint32_t length = 0;
    if (!stream.ReadVarint32(&length)) return std::nullopt;
    const auto position = static_cast<std::size_t>(stream.CurrentPosition());
    if (length > payload.size() - position || !stream.Skip(static_cast<int>(length))) return std::nullopt;
    return payload.subspan(position, length);
}

bool skip(google::protobuf::io::CodedInputStream& stream, Bytes payload, WireType type) {
    std::uint64_t ignored = 0;
    std::uint32_t ignored32 = 0;
    switch (type) {
        case WireType::Varint:
            return stream.ReadVarint64(&ignored);
        case WireType::Fixed64:
            return stream.ReadLittleEndian64(&ignored);
        case WireType::Fixed32:
            return stream.ReadLittleEndian32(&ignored32);
        case WireType::Length:
            return read_bytes(stream, payload).has_value();
    }
    return false;
}

Eigen::Vector3d color_of(const v1::Color& color) { return {color.red(), color.green(), color.blue()}; }

Eigen::Vector3d vector_of(const v1::Vector3& message) { return {message.x(), message.y(), message.z()}; }

// Where a marker stays whatever the joints do: fixed to the base, or on the first joint's axis.
std::optional<Eigen::Vector3d> fixed_place(const v1::ArmDescription& arm, const v1::Attachment& centre) {
    Eigen::Vector3d place = vector_of(centre.position());
    if (!centre.joint().empty()) {
        if (arm.joints().empty() || centre.joint() != arm.joints(0).name()) return std::nullopt;
        const Eigen::Vector3d axis = vector_of(arm.joints(0).axis());
        if (!((place - place.dot(axis) * axis).norm() < kOnAxisMetres)) return std::nullopt;
        place += vector_of(arm.joints(0).origin());
    }
    const auto& q = arm.world_from_base().rotation();
    const Eigen::Quaterniond rotation(q.w(), q.x(), q.y(), q.z());
    place = rotation.toRotationMatrix() * place + vector_of(arm.world_from_base().translation());
    const bool is_sane = std::abs(rotation.norm() - 1.0) < 1e-3 && (place.array().abs() < kMaxMetres).all();
    return is_sane ? std::optional(place) : std::nullopt;
}

MarkerModel decode_body(const v1::Body& body) {
    if (!is_name(body.name())) throw MalformedMessage("a body without a plain name");
    MarkerModel result{.name = body.name(), .radius = 0.0, .color = color_of(body.color()), .shape = Shape::Box};
    if (body.shape() == v1::SHAPE_BOX) return result;
    if (body.shape() != v1::SHAPE_SPHERE) throw MalformedMessage("body '" + body.name() + "' is of no known shape");
    if (!(body.radius_m() > 0.0) || body.radius_m() > kMaxMetres) {
        throw MalformedMessage("body '" + body.name() + "' needs a positive radius");
    }
    result.radius = body.radius_m();
    result.shape = Shape::Sphere;
    return result;
}

v1::MarkerStatus status_of(MarkerStatus status) {
    switch (status) {
        case MarkerStatus::Tracked:
            return v1::MARKER_STATUS_TRACKED;
        case MarkerStatus::PartlyOccluded:
            return v1::MARKER_STATUS_PARTLY_OCCLUDED;
        case MarkerStatus::OneView:
            return v1::MARKER_STATUS_ONE_VIEW;
        case MarkerStatus::Lost:
            break;
    }
    return v1::MARKER_STATUS_LOST;
}

}  // namespace

void silence_protobuf() { google::protobuf::SetLogHandler(nullptr); }

// protobuf's own parser would copy the pixels.
ImageMessage decode_image(Bytes payload) {
    using Raw = foxglove::RawImage;
    if (payload.size() > static_cast<std::size_t>(std::numeric_limits<int>::max())) {
        throw MalformedMessage("an image of more than 2 GiB");
    }
    google::protobuf::io::CodedInputStream stream(payload.data(), static_cast<int>(payload.size()));
    ImageMessage image{.capture_ns = 0, .width = 0, .height = 0, .step = 0, .encoding = {}, .data = {}};
    bool has_time = false;
    const auto fail = [] { return MalformedMessage("the bytes are not a foxglove.RawImage"); };
    while (const std::uint32_t tag = stream.ReadTag()) {
        const auto field = static_cast<int>(tag >> 3U);
        const auto type = static_cast<WireType>(tag & 7U);
        const auto fixed32 = [&](std::uint32_t& value) {
            if (type != WireType::Fixed32 || !stream.ReadLittleEndian32(&value)) throw fail();
        };
        const auto bytes = [&] {
            const auto found = type == WireType::Length ? read_bytes(stream, payload) : std::nullopt;
            if (!found) throw fail();
            return *found;
        };
        switch (field) {
            case Raw::kTimestampFieldNumber:
                image.capture_ns = nanoseconds(parse<google::protobuf::Timestamp>(bytes()));
                has_time = true;
                break;
            case Raw::kWidthFieldNumber:
                fixed32(image.width);
                break;
            case Raw::kHeightFieldNumber:
                fixed32(image.height);
                break;
            case Raw::kStepFieldNumber:
                fixed32(image.step);
                break;
            case Raw::kEncodingFieldNumber: {
                const Bytes text = bytes();
                image.encoding.assign(
                    text.begin(), text.begin() + static_cast<std::ptrdiff_t>(std::min<std::size_t>(text.size(), 64)));
                break;
            }
            case Raw::kDataFieldNumber:
                image.data = bytes();
                break;
            default:
                if (!skip(stream, payload, type)) throw fail();
        }
    }
    if (!stream.ConsumedEntireMessage()) throw fail();
    if (!has_time) throw MalformedMessage("an image without its capture time");
    return image;
}

Calibration decode_calibration(Bytes payload) {
    const auto message = parse<foxglove::CameraCalibration>(payload);
    if (message.k_size() != 9) throw MalformedMessage("a calibration needs the 9 numbers of K");
    Calibration result{.width = 0, .height = 0, .K = {}, .distortion = {}};
    constexpr auto kMax = static_cast<std::uint32_t>(std::numeric_limits<int>::max());
    result.width = static_cast<int>(std::min(message.width(), kMax));
    result.height = static_cast<int>(std::min(message.height(), kMax));
    for (int i = 0; i < 9; ++i) result.K(i / 3, i % 3) = message.k(i);
    const bool has_distortion = std::ranges::any_of(message.d(), [](double k) { return k != 0.0; });
    if (has_distortion && message.distortion_model() != "plumb_bob") {
        throw MalformedMessage("distortion model '" + message.distortion_model().substr(0, 32) +
                               "' is not known: plumb_bob is");
    }
    if (message.d_size() > 5) throw MalformedMessage("plumb_bob has at most 5 numbers of distortion");
    std::ranges::copy(message.d(), result.distortion.begin());
    return result;
}

Eigen::Isometry3d decode_pose(Bytes payload) {
    const auto message = parse<foxglove::FrameTransform>(payload);
    if (message.parent_frame_id() != "world") throw MalformedMessage("a camera's pose must have the parent 'world'");
    const auto& q = message.rotation();
    const auto& t = message.translation();
    const Eigen::Quaterniond rotation(q.w(), q.x(), q.y(), q.z());
    const Eigen::Vector3d translation(t.x(), t.y(), t.z());
    if (!(std::abs(rotation.norm() - 1.0) < 1e-3))
        throw MalformedMessage("a camera's rotation is not a unit quaternion");
    if (!(translation.array().abs() < kMaxMetres).all()) throw MalformedMessage("a camera's position is out of range");
    Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
    pose.linear() = rotation.normalized().toRotationMatrix();
    pose.translation() = translation;
    return pose;
}

Description decode_description(Bytes payload) {
    const auto message = parse<v1::ArmDescription>(payload);
    Description result;
    if (message.markers().empty()) throw MalformedMessage("a description without markers");
    if (message.markers_size() + message.bodies_size() > kMaxMarkers || message.cameras_size() > kMaxCameras) {
        throw MalformedMessage("a description with more than 64 markers and bodies or 16 cameras");
    }
    for (const auto& marker : message.markers()) {
        if (!is_name(marker.name())) throw MalformedMessage("a marker without a plain name");
        if (!(marker.radius_m() > 0.0) || marker.radius_m() > kMaxMetres) {
            throw MalformedMessage("marker '" + marker.name() + "' needs a positive radius");
        }
        result.markers.push_back({.name = marker.name(),
                                  .radius = marker.radius_m(),
                                  .color = color_of(marker.color()),
                                  .shape = Shape::Sphere,
                                  .fixed = fixed_place(message, marker.centre())});
    }
    for (const auto& body : message.bodies()) result.markers.push_back(decode_body(body));
    for (const auto& camera : message.cameras()) {
        if (!is_name(camera) || std::ranges::count(message.cameras(), camera) != 1) {
            throw MalformedMessage("cameras need plain names of their own");
        }
        result.cameras.push_back(camera);
    }
    return result;
}

namespace {

void set(v1::Vector3& message, const Eigen::Vector3d& vector) {
    message.set_x(vector.x());
    message.set_y(vector.y());
    message.set_z(vector.z());
}

}  // namespace

v1::JointPositions encode_positions(std::int64_t capture_ns, std::span<const MarkerEstimate> estimates,
                                    const Stages& stages) {
    v1::JointPositions message;
    message.mutable_capture_time()->set_seconds(capture_ns / kNsPerS);
    message.mutable_capture_time()->set_nanos(static_cast<std::int32_t>(capture_ns % kNsPerS));
    for (const MarkerEstimate& estimate : estimates) {
        auto& marker = *message.add_markers();
        marker.set_name(estimate.name);
        marker.set_status(status_of(estimate.status));
        if (estimate.position) {
            set(*marker.mutable_position(), *estimate.position);
            for (int i = 0; i < 9; ++i) marker.add_covariance(estimate.covariance(i / 3, i % 3));
        }
        if (const auto& extent = estimate.extent) set(*marker.mutable_extent(), *extent);
        const double whole = std::floor(estimate.age_s);
        marker.mutable_age()->set_seconds(static_cast<std::int64_t>(whole));
        marker.mutable_age()->set_nanos(
            static_cast<std::int32_t>(std::min(999'999'999.0, std::round((estimate.age_s - whole) * 1e9))));
        for (const Observation& observation : estimate.observations) {
            auto& camera = *marker.add_observations();
            camera.set_camera(observation.camera.data(), observation.camera.size());
            camera.set_u_px(observation.u);
            camera.set_v_px(observation.v);
            camera.set_radius_px(observation.radius_px);
            camera.set_area_px(observation.area_px);
            camera.set_visible(observation.visible);
        }
    }
    message.mutable_stages()->set_frames_sent_ns(stages.frames_sent_ns);
    message.mutable_stages()->set_vision_received_ns(stages.received_ns);
    message.mutable_stages()->set_vision_sent_ns(stages.sent_ns);
    return message;
}

v1::SetParametersRequest decode_set_parameters(Bytes payload) { return parse<v1::SetParametersRequest>(payload); }

v1::Parameters encode_parameters(std::int64_t now_ns, std::span<const v1::Parameter> parameters) {
    v1::Parameters message;
    message.mutable_time()->set_seconds(now_ns / kNsPerS);
    message.mutable_time()->set_nanos(static_cast<std::int32_t>(now_ns % kNsPerS));
    for (const v1::Parameter& parameter : parameters) *message.add_parameters() = parameter;
    return message;
}

std::uint64_t decode_sent_ns(Bytes attachment) {
    if (attachment.size() != sizeof(std::uint64_t)) return 0;
    std::uint64_t value = 0;
    for (std::size_t i = 0; i < attachment.size(); ++i) value |= std::uint64_t{attachment[i]} << (8 * i);
    return value;
}

}  // namespace armsight::vision::service
