// The whole way of a frame from the bytes of the bus to positions: whatever the bytes, no fault, and an answer for
// every marker.

#include <array>
#include <cmath>
#include <cstdlib>
#include <variant>

#include "armsight/vision/frame.hpp"
#include "armsight/vision/pipeline.hpp"
#include "service/codec.hpp"

namespace {

using namespace armsight::vision;

constexpr int kMaxPixels = 200 * 200;  // larger pictures only make it slow

Camera camera(const ImageView& image, double x, double y) {
    Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
    pose.translation() = Eigen::Vector3d(x, y, -5.0);
    Eigen::Matrix3d K = Eigen::Matrix3d::Identity();
    K(0, 0) = K(1, 1) = image.height;
    K(0, 2) = 0.5 * (image.width - 1);
    K(1, 2) = 0.5 * (image.height - 1);
    return {
        .name = "1", .width = image.width, .height = image.height, .K = K, .distortion = {}, .T_world_camera = pose};
}

void check(const MarkerEstimate& estimate) {
    const bool is_finite = !estimate.position || (estimate.position->allFinite() && estimate.covariance.allFinite());
    const bool is_seen = estimate.status != MarkerStatus::Lost;
    if (!is_finite || (is_seen && !estimate.position) || std::isnan(estimate.age_s)) std::abort();
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    static Pipeline pipeline({{.name = "red", .radius = 0.2, .color = {1.0, 0.0, 0.0}},
                              {.name = "green", .radius = 0.4, .color = {0.0, 1.0, 0.0}},
                              {.name = "blue", .radius = 0.3, .color = {0.0, 0.0, 1.0}},
                              {.name = "ball", .radius = 0.3, .color = {1.0, 0.0, 1.0}},
                              {.name = "crate", .radius = 0.0, .color = {1.0, 0.0, 1.0}, .shape = Shape::Box}});
    service::ImageMessage message{};
    try {
        message = service::decode_image({data, size});
    } catch (const service::MalformedMessage&) {
        return 0;
    }
    const auto checked = validate_image(message.data, message.width, message.height, message.step, message.encoding);
    const auto* image = std::get_if<ImageView>(&checked);
    if (image == nullptr || image->width * image->height > kMaxPixels) return 0;
    pipeline.reset();
    const std::array<Camera, 2> cameras{camera(*image, 0.0, 0.0), camera(*image, 0.8, 0.1)};
    const std::array<CameraFrame, 2> both{CameraFrame{.camera = cameras.data(), .image = *image},
                                          CameraFrame{.camera = &cameras[1], .image = *image}};
    for (const auto& estimate : pipeline.process(1, both)) check(estimate);
    for (const auto& estimate : pipeline.process(2, std::span(both).first(1))) check(estimate);
    return 0;
}
