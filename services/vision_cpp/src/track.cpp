#include "armsight/vision/track.hpp"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <utility>

namespace armsight::vision {
namespace {

// The tip of a 6 m arm with a joint at 1 rad/s, one standard deviation: what is expected of a marker's velocity before
// it was seen twice.
constexpr double kSpeed = 6.0;  // m/s
// One standard deviation over a frame. The test motions need 1 m/s^2, a start or a stop at full speed more.
constexpr double kAcceleration = 5.0;
// A velocity is carried on for this long: then the arm is as likely to have turned.
constexpr double kCarrySeconds = 0.3;
// Across the whole workspace at full speed: more says nothing new.
constexpr double kMaxSeconds = 2.0;
// Squared distance from the past, in standard deviations, from which on it is no longer this motion's.
constexpr double kJump = 30.0;

}  // namespace

Track::State Track::ahead(const State& state, double seconds) {
    seconds = std::clamp(seconds, 0.0, kMaxSeconds);
    const double s2 = seconds * seconds;
    const Eigen::Matrix3d I = Eigen::Matrix3d::Identity();
    Matrix6 transition = Matrix6::Identity();
    transition.topRightCorner<3, 3>() = seconds * I;
    Matrix6 unknown;
    unknown << 0.25 * s2 * s2 * I, 0.5 * s2 * seconds * I, 0.5 * s2 * seconds * I, s2 * I;
    State result{
        .mean = state.mean,
        .covariance = transition * state.covariance * transition.transpose() + kAcceleration * kAcceleration * unknown};
    result.mean.head<3>() += std::min(seconds, kCarrySeconds) * state.mean.tail<3>();
    return result;
}

std::optional<Prior> Track::predict(std::int64_t capture_ns) const {
    if (!state_) return std::nullopt;
    const State state = ahead(*state_, age_s(capture_ns));
    return Prior{.position = state.mean.head<3>(), .covariance = state.covariance.topLeftCorner<3, 3>()};
}

double Track::age_s(std::int64_t capture_ns) const {
    return state_ ? static_cast<double>(capture_ns - seen_ns_) * 1e-9 : 0.0;
}

void Track::update(std::int64_t capture_ns, const Fix& fix) {
    std::optional<State> next;
    if (state_) {
        const State before = ahead(*state_, age_s(capture_ns));
        const Eigen::Matrix3d P = before.covariance.topLeftCorner<3, 3>();
        const Eigen::Matrix3d toward_velocity = before.covariance.bottomLeftCorner<3, 3>();
        // what is known of the position now: the fix alone when the past is in it already
        Eigen::Vector3d position = fix.position;
        Eigen::Matrix3d covariance = fix.covariance;
        const Eigen::Vector3d apart = fix.position - before.mean.head<3>();
        const Eigen::Matrix3d innovation = fix.has_prior ? P : Eigen::Matrix3d(P + fix.covariance);
        const Eigen::LDLT<Eigen::Matrix3d> factor(innovation);
        if (factor.isPositive() && apart.dot(factor.solve(apart)) < kJump) {
            if (!fix.has_prior) {
                const Eigen::Matrix3d gain = factor.solve(P).transpose();
                position = before.mean.head<3>() + gain * apart;
                covariance = P - gain * P;
            }
            // the velocity follows the position as far as the two go together
            const Eigen::Matrix3d follow = P.ldlt().solve(toward_velocity.transpose()).transpose();
            next.emplace();
            next->mean << position, before.mean.tail<3>() + follow * (position - before.mean.head<3>());
            const Eigen::Matrix3d cross = follow * covariance;
            next->covariance << covariance, cross.transpose(), cross,
                before.covariance.bottomRightCorner<3, 3>() - follow * (P - covariance) * follow.transpose();
        }
    }
    if (!next || !next->mean.allFinite() || !next->covariance.allFinite()) {
        next.emplace();
        next->mean << fix.position, Eigen::Vector3d::Zero();
        next->covariance.setZero();
        next->covariance.topLeftCorner<3, 3>() = fix.covariance;
        next->covariance.bottomRightCorner<3, 3>() = kSpeed * kSpeed * Eigen::Matrix3d::Identity();
    }
    state_ = std::move(next);
    seen_ns_ = capture_ns;
}

}  // namespace armsight::vision
