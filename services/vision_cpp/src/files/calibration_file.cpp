#include "files/calibration_file.hpp"

#include <google/protobuf/util/json_util.h>

#include <fstream>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>

#include "armsight/v1/description.pb.h"
#include "files/pictures.hpp"
#include "foxglove/CameraCalibration.pb.h"
#include "foxglove/FrameTransform.pb.h"
#include "service/codec.hpp"
#include "service/rig.hpp"

namespace armsight::vision::files {
namespace {

using nlohmann::json;

const json& part(const json& whole, const char* name) {
    const auto found = whole.is_object() ? whole.find(name) : whole.end();
    if (found == whole.end()) throw FileError("there is no \"" + std::string(name) + "\"");
    return *found;
}

template <typename Message>
Message message_of(const json& part) {
    Message message;
    const auto status = google::protobuf::util::JsonStringToMessage(part.dump(), &message);
    if (!status.ok()) {
        throw FileError("no " + Message::descriptor()->full_name() + ": " + std::string(status.message()));
    }
    return message;
}

// By way of the bytes that the bus would carry: the checks are the same then.
template <typename Message, typename Result>
Result decoded(const Message& message, Result (*decode)(service::Bytes)) {
    const std::string text = message.SerializeAsString();
    // NOLINTNEXTLINE(cppcoreguidelines-pro-type-reinterpret-cast): a string's characters are bytes
    return decode({reinterpret_cast<const std::uint8_t*>(text.data()), text.size()});
}

Calibrated calibrated(const json& root) {
    service::Rig rig;
    auto description = message_of<v1::ArmDescription>(part(root, "description"));
    const json& cameras = part(root, "cameras");
    if (!cameras.is_object() || cameras.empty()) throw FileError("\"cameras\" is not an object with cameras by name");
    description.clear_cameras();
    for (const auto& [name, camera] : cameras.items()) {
        description.add_cameras(name);
        const auto calibration = message_of<foxglove::CameraCalibration>(part(camera, "calibration"));
        rig.set(name, decoded(calibration, service::decode_calibration));
        rig.set(name, decoded(message_of<foxglove::FrameTransform>(part(camera, "pose")), service::decode_pose));
    }
    auto known = decoded(description, service::decode_description);
    Calibrated result{.markers = known.markers, .cameras = {}};
    rig.set(std::move(known));
    result.cameras = rig.cameras();
    for (const Camera& camera : result.cameras) {
        if (!is_usable(camera)) throw FileError("the calibration of camera " + camera.name + " cannot be used");
    }
    return result;
}

}  // namespace

Calibrated read_calibration(const std::filesystem::path& path) {
    std::ifstream file(path);
    if (!file) throw FileError(path.string() + " cannot be read");
    try {
        return calibrated(json::parse(file));
    } catch (const json::exception& error) {
        throw FileError(path.string() + " is not JSON: " + error.what());
    } catch (const std::runtime_error& error) {  // FileError and MalformedMessage
        throw FileError(path.string() + ": " + error.what());
    }
}

}  // namespace armsight::vision::files
