// All other messages that vision reads. The first byte says which; what is decoded must be usable or be refused.

#include <cstdlib>

#include "armsight/vision/camera.hpp"
#include "armsight/vision/pipeline.hpp"
#include "service/codec.hpp"
#include "service/rig.hpp"

namespace {

using namespace armsight::vision;

void try_description(service::Bytes payload, service::Rig& rig) {
    const auto description = service::decode_description(payload);
    rig.set(description);
    try {
        const Pipeline pipeline(description.markers);
    } catch (const std::invalid_argument&) {
        return;  // markers that cannot be told apart
    }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    if (size == 0) return 0;
    service::silence_protobuf();
    const service::Bytes payload(data + 1, size - 1);
    service::Rig rig;
    rig.set({.markers = {}, .cameras = {"1"}});
    try {
        switch (data[0] % 4) {
            case 0:
                rig.set("1", service::decode_calibration(payload));
                rig.set("1", Eigen::Isometry3d::Identity());
                break;
            case 1:
                rig.set("1", service::decode_pose(payload));
                break;
            case 2:
                try_description(payload, rig);
                break;
            default:
                (void)service::decode_sent_ns(payload);
        }
    } catch (const service::MalformedMessage&) {
        return 0;
    }
    (void)rig.missing();
    for (const Camera& camera : rig.cameras()) {
        if (is_usable(camera) && !ray(camera, 0.5 * camera.width, 0.5 * camera.height).allFinite()) std::abort();
    }
    return 0;
}
