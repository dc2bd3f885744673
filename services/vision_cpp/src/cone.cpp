#include "armsight/vision/cone.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <utility>

namespace armsight::vision {
namespace {

constexpr int kHypotheses = 64;        // finds three good points of 60 % good ones in all but 1e-7 of cases
constexpr double kMissed = 1e-7;       // as few as find them as surely where more are good
constexpr int kRefits = 3;             // inliers settle after two
constexpr double kMaxHalfAngle = 0.6;  // rad; a sphere nearer than two radii fills the picture
constexpr double kMinHalfAngle = 1e-4;

// Numerical Recipes' generator: the same hypotheses for the same points, on every machine.
class Lottery {
  public:
    std::size_t draw(std::size_t count) {
        state_ = state_ * 1664525U + 1013904223U;
        return static_cast<std::size_t>((std::uint64_t{state_} * count) >> 32U);
    }

  private:
    std::uint32_t state_ = 1;
};

// The rays lie within a fraction of a radian of each other: in their own frame, scaled by their spread, the three
// unknowns are of one size.
struct Frame {
    Eigen::Matrix3d rotation;  // rows: two directions across the mean ray, the mean ray
    double spread;

    explicit Frame(std::span<const EdgePoint> points) {
        Eigen::Vector3d mean = Eigen::Vector3d::Zero();
        for (const EdgePoint& point : points) mean += point.ray;
        mean.normalize();
        const Eigen::Vector3d across = mean.unitOrthogonal();
        rotation.row(0) = across;
        rotation.row(1) = mean.cross(across);
        rotation.row(2) = mean;
        double sum = 0.0;
        for (const EdgePoint& point : points) sum += (point.ray - mean).squaredNorm();
        spread = std::max(std::sqrt(sum / static_cast<double>(points.size())), 1e-9);
    }

    // Row of the linear system d . m = 1.
    [[nodiscard]] Eigen::Vector3d row(const Eigen::Vector3d& ray) const {
        const Eigen::Vector3d d = rotation * ray;
        return {d.x() / spread, d.y() / spread, d.z()};
    }
    [[nodiscard]] Eigen::Vector3d to_optical(const Eigen::Vector3d& scaled) const {
        return rotation.transpose() * Eigen::Vector3d(scaled.x() / spread, scaled.y() / spread, scaled.z());
    }
};

std::optional<Cone> from_normal(const Eigen::Vector3d& m) {
    const double length = m.norm();
    // m = axis / cos(half_angle) is longer than 1 by cos alone: below 1 no cone has these rays
    if (!(length > 1.0) || !m.allFinite()) return std::nullopt;
    const double half_angle = std::acos(1.0 / length);
    if (half_angle < kMinHalfAngle || half_angle > kMaxHalfAngle) return std::nullopt;
    return Cone{.axis = m / length, .half_angle = half_angle, .inliers = 0, .residual_px = 0.0};
}

double residual_px(const Cone& cone, const EdgePoint& point) {
    return vision::residual_px(point, cone.axis, cone.half_angle);
}

// Least squares over the points within `tolerance_px` of `guess`, or over all.
std::optional<Cone> solve(std::span<const EdgePoint> points, const Frame& frame, const Cone* guess,
                          double tolerance_px) {
    Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
    Eigen::Vector3d right = Eigen::Vector3d::Zero();
    int used = 0;
    for (const EdgePoint& point : points) {
        if (guess != nullptr && std::abs(residual_px(*guess, point)) > tolerance_px) continue;
        const Eigen::Vector3d row = frame.row(point.ray);
        normal += row * row.transpose();
        right += row;
        ++used;
    }
    if (used < 3) return std::nullopt;
    const Eigen::LDLT<Eigen::Matrix3d> factor(normal);
    if (factor.info() != Eigen::Success) return std::nullopt;
    return from_normal(frame.to_optical(factor.solve(right)));
}

// False, and no score, as soon as fewer than `at_least` points can agree.
bool score(Cone& cone, std::span<const EdgePoint> points, double tolerance_px, int at_least = 0) {
    double sum = 0.0;
    cone.inliers = 0;
    auto may_miss = std::ssize(points) - at_least;
    for (const EdgePoint& point : points) {
        const double r = residual_px(cone, point);
        if (std::abs(r) > tolerance_px) {
            if (--may_miss < 0) return false;
            continue;
        }
        ++cone.inliers;
        sum += r * r;
    }
    cone.residual_px = cone.inliers > 0 ? std::sqrt(sum / cone.inliers) : 0.0;
    return true;
}

// Draws of three points until all of one are good but for kMissed of cases, where this many of all points are.
int draws_needed(int good, std::size_t all) {
    if (std::cmp_equal(good, all)) return 0;
    const double share = good / static_cast<double>(all);
    const double missed = std::log1p(-share * share * share);
    return missed < 0.0 ? static_cast<int>(std::min<double>(kHypotheses, std::ceil(std::log(kMissed) / missed)))
                        : kHypotheses;
}

bool is_better(const Cone& a, const Cone& b) {
    return a.inliers > b.inliers || (a.inliers == b.inliers && a.residual_px < b.residual_px);
}

// Least squares over the points that agree, until they stay the same.
std::optional<Cone> polished(std::span<const EdgePoint> points, const Frame& frame, Cone best,
                             const ConeOptions& options) {
    score(best, points, options.tolerance_px);
    for (int i = 0; i < kRefits; ++i) {
        auto refit = solve(points, frame, &best, options.tolerance_px);
        if (!refit) break;
        score(*refit, points, options.tolerance_px);
        if (refit->inliers < best.inliers) break;
        const bool is_settled = i > 0 && refit->inliers == best.inliers;  // the same points give the same cone
        best = *refit;
        if (is_settled) break;
    }
    if (best.inliers < options.min_inliers) return std::nullopt;
    return best;
}

}  // namespace

std::optional<Cone> fit_cone(std::span<const EdgePoint> points, const ConeOptions& options) {
    if (points.size() < 3 || std::cmp_less(points.size(), options.min_inliers)) return std::nullopt;
    const Frame frame(points);

    std::optional<Cone> best = solve(points, frame, nullptr, 0.0);
    if (best) score(*best, points, options.tolerance_px);
    Lottery lottery;
    int draws = draws_needed(best ? best->inliers : 0, points.size());
    for (int i = 0; i < draws; ++i) {
        Eigen::Matrix3d rows;
        for (int k = 0; k < 3; ++k) rows.row(k) = frame.row(points[lottery.draw(points.size())].ray);
        Eigen::Matrix3d inverse;
        bool invertible = false;
        rows.computeInverseWithCheck(inverse, invertible, 1e-6);
        if (!invertible) continue;  // a point was drawn twice, or they are too close together
        auto cone = from_normal(frame.to_optical(inverse * Eigen::Vector3d::Ones()));
        if (!cone) continue;
        if (!score(*cone, points, options.tolerance_px, best ? best->inliers : 0)) continue;
        if (best && !is_better(*cone, *best)) continue;
        best = cone;
        draws = draws_needed(best->inliers, points.size());
    }
    if (!best) return std::nullopt;
    return polished(points, frame, *best, options);
}

std::optional<Cone> refine_cone(std::span<const EdgePoint> points, const Cone& known, const ConeOptions& options) {
    if (points.size() < 3) return std::nullopt;
    return polished(points, Frame(points), known, options);
}

}  // namespace armsight::vision
