#include "service/annotations.hpp"

#include <google/protobuf/timestamp.pb.h>

#include <string>

namespace armsight::vision::service {
namespace {

constexpr double kLinePx = 2.0;
constexpr double kFontPx = 12.0;

void set(foxglove::Color& color, double r, double g, double b, double a) {
    color.set_r(r);
    color.set_g(g);
    color.set_b(b);
    color.set_a(a);
}

std::string_view text_of(MarkerStatus status) {
    switch (status) {
        case MarkerStatus::Tracked:
            return "";
        case MarkerStatus::PartlyOccluded:
            return " (partly hidden)";
        case MarkerStatus::OneView:
            return " (one view)";
        case MarkerStatus::Lost:
            break;
    }
    return " (lost)";
}

}  // namespace

foxglove::ImageAnnotations annotate(std::int64_t capture_ns, std::string_view camera,
                                    std::span<const MarkerEstimate> estimates) {
    foxglove::ImageAnnotations result;
    google::protobuf::Timestamp time;
    time.set_seconds(capture_ns / 1'000'000'000);
    time.set_nanos(static_cast<std::int32_t>(capture_ns % 1'000'000'000));
    for (const MarkerEstimate& estimate : estimates) {
        for (const Observation& observation : estimate.observations) {
            if (observation.camera != camera) continue;
            auto& circle = *result.add_circles();
            *circle.mutable_timestamp() = time;
            circle.mutable_position()->set_x(observation.u);
            circle.mutable_position()->set_y(observation.v);
            circle.set_diameter(2.0 * observation.radius_px);
            circle.set_thickness(kLinePx);
            set(*circle.mutable_fill_color(), 0, 0, 0, 0);
            set(*circle.mutable_outline_color(), 1, 1, 1, 1);
            auto& text = *result.add_texts();
            *text.mutable_timestamp() = time;
            text.mutable_position()->set_x(observation.u + observation.radius_px + kLinePx);
            text.mutable_position()->set_y(observation.v);
            text.set_text(estimate.name + std::string(text_of(estimate.status)));
            text.set_font_size(kFontPx);
            set(*text.mutable_text_color(), 1, 1, 1, 1);
            set(*text.mutable_background_color(), 0, 0, 0, 0.6);
        }
    }
    return result;
}

}  // namespace armsight::vision::service
