#include "armsight/vision/triangulate.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "armsight/vision/pool.hpp"

namespace armsight::vision {
namespace {

constexpr int kSteps = 15;
constexpr double kStepTolerance = 1e-7;  // metres: a hundredth of what pixels can tell
constexpr double kTukey = 4.685;         // 95 % efficient for normal errors
// Spread of edge points that no fit goes below: quantisation to 8 bits, 16 sub-pixel positions at 4 samples.
constexpr double kMinSigmaPx = 0.05;
constexpr double kStartSigmaPx = 0.5;  // before the spread is known
// Errors of neighbouring edge points go together (both come from the same facets and samples): independent errors of
// the same spread would make the covariance this much too small. This and the shifts of views were measured on renders
// with 0 and 4 samples.
constexpr double kCorrelation = 1.2;
constexpr double kMaxConditionedVariance = 1e4;  // m^2; beyond it the position is not determined

double median(PoolVector<double>& values) {
    const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
    std::nth_element(values.begin(), middle, values.end());
    return *middle;
}

struct Normal {
    Eigen::Matrix3d matrix = Eigen::Matrix3d::Zero();
    Eigen::Vector3d right = Eigen::Vector3d::Zero();
    Eigen::Matrix3d of_shifts = Eigen::Matrix3d::Zero();  ///< covariance of `right` when views shift by one pixel
    PoolVector<double> residuals;
    int inliers = 0;
    bool in_front = true;
};

// Where a sphere at `position` lies for one camera.
struct Sight {
    Eigen::Vector3d axis;  // unit, optical frame
    double distance;
    double half_angle;

    Sight(const Camera& camera, const Eigen::Vector3d& position, double radius)
        : axis(camera.T_world_camera.inverse() * position),
          distance(axis.norm()),
          half_angle(distance > radius ? std::asin(radius / distance) : 0.0) {
        axis /= distance;
    }
    [[nodiscard]] bool is_valid(double radius) const { return distance > 1.001 * radius && axis.z() > 0.0; }
};

void add_view(const View& view, double radius, const Eigen::Vector3d& position, double sigma_px, Normal& normal) {
    const Sight sight(*view.camera, position, radius);
    if (!sight.is_valid(radius)) {
        normal.in_front = false;
        return;
    }
    const Eigen::Matrix3d R = view.camera->T_world_camera.linear();
    const double tangent = std::sqrt(sight.distance * sight.distance - radius * radius);
    const Eigen::Vector3d along = radius / (sight.distance * tangent) * sight.axis;
    const double cutoff = kTukey * sigma_px;
    Eigen::Matrix3d shifts = Eigen::Matrix3d::Zero();
    for (const EdgePoint& point : view.outline) {
        const double r = residual_px(point, sight.axis, sight.half_angle);
        normal.residuals.push_back(std::abs(r));
        if (std::abs(r) >= cutoff) continue;
        ++normal.inliers;
        const double t = r / cutoff;
        const double weight = (1.0 - t * t) * (1.0 - t * t) / (sigma_px * sigma_px);
        const double cos_angle = point.ray.dot(sight.axis);
        const double sin_angle = std::sqrt(std::max(0.0, 1.0 - cos_angle * cos_angle));
        // d angle / d centre is across the axis, towards the ray and shrinking; d half_angle / d centre along the axis
        const Eigen::Vector3d across =
            -(point.ray - cos_angle * sight.axis) / (sight.distance * std::max(sin_angle, 1e-9));
        const Eigen::Vector3d gradient = point.pixels_per_radian * (R * (across + along));
        normal.matrix += weight * gradient * gradient.transpose();
        normal.right -= weight * r * gradient;
        // a shift of the outline changes the residual by its part along the direction from the axis to the point
        shifts += weight / std::max(sin_angle, 1e-9) * gradient * (point.ray - cos_angle * sight.axis).transpose();
    }
    normal.of_shifts += shifts * shifts.transpose();
    if (view.centre_sigma_px > 0.0) {
        const double scale = view.centre_pixels_per_radian / view.centre_sigma_px;
        const Eigen::Matrix3d P = Eigen::Matrix3d::Identity() - sight.axis * sight.axis.transpose();
        const Eigen::Matrix3d J = -scale / sight.distance * P * R.transpose();
        normal.matrix += J.transpose() * J;
        normal.right -= J.transpose() * (scale * P * view.centre);
    }
}

Normal linearise(std::span<const View> views, double radius, const Eigen::Vector3d& position, double sigma_px,
                 const std::optional<Prior>& prior) {
    Normal normal;
    for (const View& view : views) add_view(view, radius, position, sigma_px, normal);
    if (prior) {
        const Eigen::Matrix3d information = prior->covariance.inverse();
        normal.matrix += information;
        normal.right += information * (prior->position - position);
    }
    return normal;
}

}  // namespace

std::optional<Eigen::Vector3d> triangulate(std::span<const Ray> rays) {
    Eigen::Matrix3d A = Eigen::Matrix3d::Zero();
    Eigen::Vector3d b = Eigen::Vector3d::Zero();
    for (const Ray& ray : rays) {
        const Eigen::Matrix3d P = Eigen::Matrix3d::Identity() - ray.direction * ray.direction.transpose();
        A += P;
        b += P * ray.origin;
    }
    const Eigen::LDLT<Eigen::Matrix3d> factor(A);
    // the smallest eigenvalue is about sin^2 of the angle between the rays
    if (rays.size() < 2 || !(A.determinant() > 1e-6)) return std::nullopt;
    Eigen::Vector3d point = factor.solve(b);
    if (!point.allFinite()) return std::nullopt;
    for (const Ray& ray : rays) {
        if (ray.direction.dot(point - ray.origin) <= 0.0) return std::nullopt;
    }
    return point;
}

std::optional<Fix> fit_sphere(std::span<const View> views, double radius, const Eigen::Vector3d& start,
                              const std::optional<Prior>& prior) {
    Eigen::Vector3d position = start;
    double sigma_px = kStartSigmaPx;
    Normal normal;
    for (int i = 0; i < kSteps; ++i) {
        normal = linearise(views, radius, position, sigma_px, prior);
        if (!normal.in_front) return std::nullopt;
        const Eigen::LDLT<Eigen::Matrix3d> factor(normal.matrix);
        const Eigen::Vector3d step = factor.solve(normal.right);
        if (!step.allFinite()) return std::nullopt;
        position += step;
        const double previous_sigma_px = sigma_px;
        if (normal.residuals.size() > 6) {
            // 1.4826: from the median of absolute values to the standard deviation of normal errors
            sigma_px = std::clamp(1.4826 * median(normal.residuals), kMinSigmaPx, kStartSigmaPx);
        }
        if (step.norm() < kStepTolerance && std::abs(sigma_px - previous_sigma_px) < 0.01 * sigma_px) break;
    }
    normal = linearise(views, radius, position, sigma_px * std::sqrt(kCorrelation), prior);
    if (!normal.in_front) return std::nullopt;
    bool invertible = false;
    Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
    normal.matrix.computeInverseWithCheck(covariance, invertible, 1e-12);
    const double shift_px = std::hypot(kViewShiftPx, kViewShiftOfSpread * sigma_px);
    covariance += shift_px * shift_px * covariance * normal.of_shifts * covariance;
    if (!invertible || !covariance.allFinite() || !(covariance.trace() < kMaxConditionedVariance)) return std::nullopt;
    return Fix{.position = position,
               .covariance = covariance,
               .sigma_px = sigma_px,
               .inliers = normal.inliers,
               .has_prior = prior.has_value()};
}

double agreement(const View& view, double radius, const Eigen::Vector3d& position, double tolerance_px) {
    const Sight sight(*view.camera, position, radius);
    if (view.outline.empty() || !sight.is_valid(radius)) return 0.0;
    const auto agrees = [&](const EdgePoint& point) {
        return std::abs(residual_px(point, sight.axis, sight.half_angle)) <= tolerance_px;
    };
    return static_cast<double>(std::ranges::count_if(view.outline, agrees)) / static_cast<double>(view.outline.size());
}

}  // namespace armsight::vision
