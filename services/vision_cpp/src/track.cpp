#include "armsight/vision/track.hpp"

#include <algorithm>

namespace armsight::vision {
namespace {

// How fast an unseen marker may have moved, one standard deviation: the tip of a 6 m arm with a joint at 1 rad/s.
constexpr double kDriftMetresPerSecond = 6.0;
constexpr double kMaxDriftMetres = 12.0;  // across the whole workspace: more says nothing new

}  // namespace

std::optional<Prior> Track::predict(std::int64_t capture_ns) const {
    if (!last_) return std::nullopt;
    const double drift = std::min(kMaxDriftMetres, kDriftMetresPerSecond * age_s(capture_ns));
    return Prior{.position = last_->position,
                 .covariance = last_->covariance + drift * drift * Eigen::Matrix3d::Identity()};
}

double Track::age_s(std::int64_t capture_ns) const {
    return last_ ? static_cast<double>(capture_ns - seen_ns_) * 1e-9 : 0.0;
}

void Track::update(std::int64_t capture_ns, const Eigen::Vector3d& position, const Eigen::Matrix3d& covariance) {
    last_ = Prior{.position = position, .covariance = covariance};
    seen_ns_ = capture_ns;
}

}  // namespace armsight::vision
