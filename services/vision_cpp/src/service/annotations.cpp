#include "service/annotations.hpp"

#include <google/protobuf/timestamp.pb.h>

#include <string>

namespace armsight::vision::service {
namespace {

constexpr double kLinePx = 2.0;
constexpr double kPointPx = 1.0;
constexpr double kCentrePx = 3.0;
constexpr double kFontPx = 12.0;
constexpr double kMarginPx = 8.0;

struct Rgba {
    double r, g, b, a;
};
constexpr Rgba kWhite{1, 1, 1, 1};
constexpr Rgba kBlack{0, 0, 0, 1};

void set(foxglove::Color& color, const Rgba& value) {
    color.set_r(value.r);
    color.set_g(value.g);
    color.set_b(value.b);
    color.set_a(value.a);
}

void add_circle(foxglove::ImageAnnotations& result, const google::protobuf::Timestamp& time,
                const Eigen::Vector2d& centre, double radius_px) {
    auto& circle = *result.add_circles();
    *circle.mutable_timestamp() = time;
    circle.mutable_position()->set_x(centre.x());
    circle.mutable_position()->set_y(centre.y());
    circle.set_diameter(2.0 * radius_px);
    circle.set_thickness(kLinePx);
    set(*circle.mutable_fill_color(), {0, 0, 0, 0});
    set(*circle.mutable_outline_color(), kWhite);
}

void add_points(foxglove::ImageAnnotations& result, const google::protobuf::Timestamp& time,
                foxglove::PointsAnnotation::Type type, std::span<const Eigen::Vector2d> pixels, const Rgba& color,
                double thickness_px) {
    if (pixels.empty()) return;
    auto& points = *result.add_points();
    *points.mutable_timestamp() = time;
    points.set_type(type);
    points.set_thickness(thickness_px);
    set(*points.mutable_outline_color(), color);
    for (const Eigen::Vector2d& pixel : pixels) {
        auto& point = *points.add_points();
        point.set_x(pixel.x());
        point.set_y(pixel.y());
    }
}

void add_text(foxglove::ImageAnnotations& result, const google::protobuf::Timestamp& time, const Eigen::Vector2d& at,
              std::string words) {
    auto& text = *result.add_texts();
    *text.mutable_timestamp() = time;
    text.mutable_position()->set_x(at.x());
    text.mutable_position()->set_y(at.y());
    text.set_text(std::move(words));
    text.set_font_size(kFontPx);
    set(*text.mutable_text_color(), kWhite);
    set(*text.mutable_background_color(), {0, 0, 0, 0.6});
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
            if (observation.corners.empty()) {
                add_circle(result, time, {observation.u, observation.v}, observation.radius_px);
            } else {
                add_points(result, time, foxglove::PointsAnnotation::LINE_LOOP, observation.corners, kWhite, kLinePx);
            }
            add_points(result, time, foxglove::PointsAnnotation::POINTS, observation.inliers, kBlack, kPointPx);
            const Eigen::Vector2d centre(observation.u, observation.v);
            add_points(result, time, foxglove::PointsAnnotation::POINTS, {&centre, 1}, kWhite, kCentrePx);
            add_text(result, time, {observation.u + observation.radius_px + kLinePx, observation.v},
                     estimate.name + std::string(text_of(estimate.status)));
        }
    }
    if (result.texts().empty()) add_text(result, time, {kMarginPx, kFontPx}, "nothing seen");
    return result;
}

}  // namespace armsight::vision::service
