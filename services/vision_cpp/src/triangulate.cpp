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
// Metres. Each step is a tenth of the one before: what is left is a hundredth of what pixels can tell.
constexpr double kStepTolerance = 1e-5;
constexpr double kRoughStepTolerance = 3e-3;  // a quarter of a pixel in a picture of the whole arm
constexpr double kTukey = 4.685;              // 95 % efficient for normal errors
// Spread of edge points that no fit goes below: quantisation to 8 bits, 16 sub-pixel positions at 4 samples.
constexpr double kMinSigmaPx = 0.05;
constexpr double kStartSigmaPx = 0.5;  // before the spread is known
constexpr double kPerMedian = 1.4826;  // from the median of absolute values to the standard deviation of normal errors
constexpr double kOutlier = 4.0;       // standard deviations; one normal error in 16,000 is larger
// Errors of neighbouring edge points go together (both come from the same facets and samples): independent errors of
// the same spread would make the covariance this much too small. This and the shifts of views were measured on renders
// with 0 and 4 samples.
constexpr double kCorrelation = 1.2;
constexpr double kMaxConditionedVariance = 1e4;  // m^2; beyond it the position is not determined

// Standard deviation of normal errors whose absolute values these are, whatever lies among them that is none: where a
// sphere sinks into a bright body, a third of its edge points are not on its outline, and all on one side. Sorts.
double spread_of(std::span<double> sizes) {
    double sigma = 0.0;
    for (std::size_t count = 0; count != sizes.size();) {
        count = sizes.size();
        const auto middle = sizes.begin() + static_cast<std::ptrdiff_t>(count / 2);
        std::nth_element(sizes.begin(), middle, sizes.end());
        sigma = kPerMedian * *middle;
        const double cutoff = kOutlier * sigma;
        const auto outliers = std::partition(middle, sizes.end(), [&](double size) { return size <= cutoff; });
        sizes = {sizes.begin(), outliers};
    }
    return sigma;
}

// Gauss-Newton's equations, and what the covariance needs beside them.
struct Normal {
    Eigen::Matrix3d matrix = Eigen::Matrix3d::Zero();
    Eigen::Vector3d right = Eigen::Vector3d::Zero();
    Eigen::Matrix3d of_shifts = Eigen::Matrix3d::Zero();  ///< covariance of `right` when views shift by one pixel
    int inliers = 0;
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

// The fit of one sphere: what stays the same from step to step, and memory for the steps.
class SphereFit {
  public:
    SphereFit(std::span<const View> views, double radius, const std::optional<Prior>& prior)
        : views_(views), radius_(radius), prior_(prior) {
        std::size_t points = 0;
        for (const View& view : views) points += view.outline.size();
        residuals_.reserve(points);
        if (prior) information_ = prior->covariance.inverse();
    }

    // Steps until they are shorter than `tolerance`; false where a view has the sphere behind it or nothing
    // determines a step.
    [[nodiscard]] bool descend(Eigen::Vector3d& position, double tolerance) {
        for (int i = 0; i < kSteps; ++i) {
            const auto normal = linearise<false>(position, sigma_px_);
            if (!normal) return false;
            const Eigen::Vector3d step = normal->matrix.ldlt().solve(normal->right);
            if (!step.allFinite()) return false;
            position += step;
            const double previous = sigma_px_;
            if (residuals_.size() > 6) {
                sigma_px_ = std::clamp(spread_of(residuals_), kMinSigmaPx, kStartSigmaPx);
            }
            if (step.norm() < tolerance && std::abs(sigma_px_ - previous) < 0.01 * sigma_px_) break;
        }
        return true;
    }

    [[nodiscard]] double sigma_px() const { return sigma_px_; }

    // Nothing where a view has the sphere behind it.
    template <bool kWithShifts>
    [[nodiscard]] std::optional<Normal> linearise(const Eigen::Vector3d& position, double sigma_px) {
        Normal normal;
        residuals_.clear();
        for (const View& view : views_) {
            const Sight sight(*view.camera, position, radius_);
            if (!sight.is_valid(radius_)) return std::nullopt;
            add_outline<kWithShifts>(view, sight, sigma_px, normal);
            if (view.centre_sigma_px > 0.0) add_centre(view, sight, normal);
        }
        if (prior_) {
            normal.matrix += information_;
            normal.right += information_ * (prior_->position - position);
        }
        return normal;
    }

  private:
    // In the optical frame, and turned into the world's at the end. What changes a residual: the angle to the ray with
    // the centre's movement across the axis, the half angle with its movement along it.
    template <bool kWithShifts>
    void add_outline(const View& view, const Sight& sight, double sigma_px, Normal& normal) {
        const double tangent = std::sqrt(sight.distance * sight.distance - radius_ * radius_);
        const Eigen::Vector3d along = radius_ / (sight.distance * tangent) * sight.axis;
        const double per_distance = 1.0 / sight.distance;
        const double cutoff = kTukey * sigma_px;
        const double per_cutoff = 1.0 / cutoff;
        const double unit_weight = 1.0 / (sigma_px * sigma_px);
        Eigen::Matrix3d matrix = Eigen::Matrix3d::Zero();
        Eigen::Vector3d right = Eigen::Vector3d::Zero();
        Eigen::Matrix3d shifts = Eigen::Matrix3d::Zero();  // NOLINT(misc-const-correctness): if constexpr
        for (const EdgePoint& point : view.outline) {
            const Opening opening(point.ray, sight.axis);
            const double r = (opening.angle - sight.half_angle) * point.pixels_per_radian;
            residuals_.push_back(std::abs(r));
            if (std::abs(r) >= cutoff) continue;
            ++normal.inliers;
            const double t = r * per_cutoff;
            const double weight = (1.0 - t * t) * (1.0 - t * t) * unit_weight;
            const Eigen::Vector3d outward = opening.per_sine * (point.ray - opening.cosine * sight.axis);
            const Eigen::Vector3d gradient = point.pixels_per_radian * (along - per_distance * outward);
            const Eigen::Vector3d weighted = weight * gradient;
            matrix += weighted * gradient.transpose();
            right -= r * weighted;
            // a shift of the outline changes the residual by its part along the direction from the axis to the point
            if constexpr (kWithShifts) shifts += weighted * outward.transpose();
        }
        const Eigen::Matrix3d R = view.camera->T_world_camera.linear();
        normal.matrix += R * matrix * R.transpose();
        normal.right += R * right;
        if constexpr (kWithShifts) normal.of_shifts += R * (shifts * shifts.transpose()) * R.transpose();
    }

    static void add_centre(const View& view, const Sight& sight, Normal& normal) {
        const Eigen::Matrix3d R = view.camera->T_world_camera.linear();
        const double scale = view.centre_pixels_per_radian / view.centre_sigma_px;
        const Eigen::Matrix3d P = Eigen::Matrix3d::Identity() - sight.axis * sight.axis.transpose();
        const Eigen::Matrix3d J = -scale / sight.distance * P * R.transpose();
        normal.matrix += J.transpose() * J;
        normal.right -= J.transpose() * (scale * P * view.centre);
    }

    std::span<const View> views_;
    double radius_;
    const std::optional<Prior> prior_;
    Eigen::Matrix3d information_;
    PoolVector<double> residuals_;
    double sigma_px_ = kStartSigmaPx;
};

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
    SphereFit fit(views, radius, prior);
    Eigen::Vector3d position = start;
    if (!fit.descend(position, kStepTolerance)) return std::nullopt;
    const auto normal = fit.linearise<true>(position, fit.sigma_px() * std::sqrt(kCorrelation));
    if (!normal) return std::nullopt;
    bool invertible = false;
    Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
    normal->matrix.computeInverseWithCheck(covariance, invertible, 1e-12);
    const double shift_px = std::hypot(kViewShiftPx, kViewShiftOfSpread * fit.sigma_px());
    covariance += shift_px * shift_px * covariance * normal->of_shifts * covariance;
    if (!invertible || !covariance.allFinite() || !(covariance.trace() < kMaxConditionedVariance)) return std::nullopt;
    return Fix{.position = position,
               .covariance = covariance,
               .sigma_px = fit.sigma_px(),
               .inliers = normal->inliers,
               .has_prior = prior.has_value()};
}

std::optional<Eigen::Vector3d> rough_sphere(std::span<const View> views, double radius, const Eigen::Vector3d& start) {
    SphereFit fit(views, radius, std::nullopt);
    Eigen::Vector3d position = start;
    if (!fit.descend(position, kRoughStepTolerance)) return std::nullopt;
    return position;
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
