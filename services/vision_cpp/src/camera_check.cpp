#include "armsight/vision/camera_check.hpp"

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

namespace armsight::vision {
namespace {

// Of views: some two seconds of four markers at 30 Hz.
constexpr std::size_t kKept = 256;
constexpr std::size_t kEnough = 48;
// Less of a sphere in view, and where its middle is becomes a question of what hides it.
constexpr double kSeen = 0.6;
// With noise of 8 grey levels, in the dark, medians stay below 0.09.
constexpr double kMostPx = 0.3;
// Markers over which it is judged whether cameras agree at all.
constexpr std::size_t kJudged = 512;
// Of these cameras that are right see most together; cameras that are not, none but by chance.
constexpr double kLeastTogether = 0.05;
// Who saw as good as nothing is not wrong but covered.
constexpr double kLeastSeen = 0.02;

std::optional<double> residual_px(const Observation& seen, const Camera& camera, const Eigen::Vector3d& position) {
    const auto expected = project(camera, camera.T_world_camera.inverse() * position);
    if (!expected) return std::nullopt;
    return (*expected - Eigen::Vector2d(seen.u + kWireToImage, seen.v + kWireToImage)).norm();
}

std::string rounded(double px) {
    const long tenths = std::lround(px * 10.0);
    return std::to_string(tenths / 10) + "." + std::to_string(tenths % 10);
}

}  // namespace

void CameraCheck::Ring::add(double px) {
    if (px_.size() < kKept) {
        px_.push_back(px);
    } else {
        px_[next_] = px;
        next_ = (next_ + 1) % kKept;
    }
}

std::optional<double> CameraCheck::Ring::median() const {
    if (px_.size() < kEnough) return std::nullopt;
    std::vector<double> values = px_;
    const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
    std::ranges::nth_element(values, middle);
    return *middle;
}

void CameraCheck::add(std::span<const MarkerEstimate> estimates, std::span<const MarkerModel> markers,
                      std::span<const Camera> cameras) {
    for (std::size_t i = 0; i < std::min(estimates.size(), markers.size()); ++i) {
        const MarkerEstimate& estimate = estimates[i];
        if (markers[i].shape != Shape::Sphere || !estimate.position || estimate.observations.empty()) continue;
        const bool is_together = estimate.observations.size() > 1;
        if (cameras.size() > 1) (is_together ? together_ : alone_) += 1;
        for (const Observation& seen : estimate.observations) {
            const auto camera = std::ranges::find(cameras, seen.camera, &Camera::name);
            if (camera == cameras.end()) continue;
            Seen& own = by_camera_[camera->name];
            ++own.total;
            if (seen.visible < kSeen) continue;
            const auto apart = residual_px(seen, *camera, *estimate.position);
            if (is_together && apart) own.together.add(*apart);
            if (const auto& fixed = markers[i].fixed) {
                if (const auto off = residual_px(seen, *camera, *fixed)) own.fixed.add(*off);
            }
        }
    }
    if (together_ + alone_ < 2 * kJudged) return;
    // half of what was seen is old enough
    together_ /= 2;
    alone_ /= 2;
    for (auto& [name, own] : by_camera_) own.total /= 2;
}

std::map<std::string, double> CameraCheck::residuals_px() const {
    std::map<std::string, double> result;
    for (const auto& [name, own] : by_camera_) {
        const auto together = own.together.median();
        const auto fixed = own.fixed.median();
        if (together || fixed) result.emplace(name, std::max(together.value_or(0.0), fixed.value_or(0.0)));
    }
    return result;
}

std::string CameraCheck::trouble() const {
    for (const auto& [name, own] : by_camera_) {
        const double off = own.fixed.median().value_or(0.0);
        if (off < kMostPx) continue;
        return "camera " + name + " sees what never moves " + rounded(off) +
               " px from where it is described: it has moved, or its calibration is wrong";
    }
    const std::size_t judged = together_ + alone_;
    if (judged >= kJudged && static_cast<double>(together_) < kLeastTogether * static_cast<double>(judged)) {
        const auto saw = std::ranges::count_if(by_camera_, [&](const auto& entry) {
            return static_cast<double>(entry.second.total) > kLeastSeen * static_cast<double>(judged);
        });
        if (saw > 1) {
            return "no two cameras put the markers in the same place: one has moved, or its calibration is wrong";
        }
    }
    for (const auto& [name, own] : by_camera_) {
        const double apart = own.together.median().value_or(0.0);
        if (apart < kMostPx) continue;
        return "camera " + name + " is " + rounded(apart) +
               " px off what all cameras together make of the markers: one has moved, or its calibration is wrong";
    }
    return {};
}

}  // namespace armsight::vision
