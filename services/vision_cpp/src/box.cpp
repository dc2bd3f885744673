#include "armsight/vision/box.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>

#include "armsight/vision/pool.hpp"

namespace armsight::vision {
namespace {

constexpr int kSteps = 40;
constexpr double kStepTolerance = 1e-6;  // metres
constexpr double kDifference = 1e-5;     // metres: a hundredth of a thousandth of a pixel, far above rounding
constexpr double kMinHalf = 1e-3;        // metres
constexpr double kTukey = 4.685;         // 95 % efficient for normal errors
// Before anything is known the outline may be several pixels off, and all points must pull.
constexpr double kStartSigmaPx = 8.0;
// No spread below this is believed: without multisampling a side that runs along the rows is off by up to half a pixel
// as a whole, and no point of it knows. They count as one point that errs by as much; with 4 samples this says too
// much, not too little.
constexpr double kPhaseSigmaPx = 0.3;
constexpr double kCorrelation = 25.0;

// Sides shorter than this have no point of their own; of longer ones their ends have none.
constexpr double kMinSidePx = 4.0;
constexpr double kMinOutlined = 0.4;  // points a pixel of the rest

double focal(const Camera& camera) { return std::sqrt(camera.K(0, 0) * camera.K(1, 1)); }

double cross(const Eigen::Vector2d& a, const Eigen::Vector2d& b) { return a.x() * b.y() - a.y() * b.x(); }

Eigen::Vector2d on_plane(const EdgePoint& point, double focal_px) {
    return point.ray.head<2>() * (focal_px / point.ray.z());
}

Box box_of(const Vector6& p) { return {.centre = p.head<3>(), .half = p.tail<3>()}; }

Vector6 parameters_of(const Box& box) {
    Vector6 p;
    p << box.centre, box.half;
    return p;
}

struct Normal {
    Matrix6 matrix = Matrix6::Zero();
    Vector6 right = Vector6::Zero();
    double cost = 0.0;
    int inliers = 0;
};

// Tukey's loss of one residual, and its weight.
struct Loss {
    double cost, weight;
};
Loss loss(double r, double sigma) {
    const double cutoff = kTukey * sigma;
    const double most = cutoff * cutoff / (6.0 * sigma * sigma);
    if (std::abs(r) >= cutoff) return {.cost = most, .weight = 0.0};
    const double t = 1.0 - (r / cutoff) * (r / cutoff);
    return {.cost = most * (1.0 - t * t * t), .weight = t * t / (sigma * sigma)};
}

std::optional<Normal> linearise(std::span<const BoxView> views, const Vector6& p, double sigma_px,
                                const std::optional<BoxPrior>& prior) {
    Normal normal;
    for (const BoxView& view : views) {
        const auto here = silhouette(*view.camera, box_of(p));
        if (!here) return std::nullopt;
        std::array<Silhouette, 6> moved;
        for (int i = 0; i < 6; ++i) {
            Vector6 q = p;
            q[i] += kDifference;
            const auto there = silhouette(*view.camera, box_of(q));
            if (!there) return std::nullopt;
            moved.at(static_cast<std::size_t>(i)) = *there;
        }
        const double f = focal(*view.camera);
        for (const EdgePoint& point : view.outline) {
            const Eigen::Vector2d at = on_plane(point, f);
            const double r = here->distance_px(at);
            const auto [cost, weight] = loss(r, sigma_px);
            normal.cost += cost;
            if (weight <= 0.0) continue;
            ++normal.inliers;
            Vector6 gradient;
            for (int i = 0; i < 6; ++i) {
                gradient[i] = (moved.at(static_cast<std::size_t>(i)).distance_px(at) - r) / kDifference;
            }
            normal.matrix += weight * gradient * gradient.transpose();
            normal.right -= weight * r * gradient;
        }
    }
    if (prior) {
        const Vector6 off = p - parameters_of(prior->box);
        normal.matrix += prior->information;
        normal.right -= prior->information * off;
        normal.cost += 0.5 * off.dot(prior->information * off);
    }
    return normal;
}

double robust_sigma_px(std::span<const BoxView> views, const Box& box, PoolVector<double>& residuals) {
    residuals.clear();
    for (const BoxView& view : views) {
        const auto outline = silhouette(*view.camera, box);
        if (!outline) return kStartSigmaPx;
        const double f = focal(*view.camera);
        for (const EdgePoint& point : view.outline) {
            residuals.push_back(std::abs(outline->distance_px(on_plane(point, f))));
        }
    }
    if (residuals.empty()) return kStartSigmaPx;
    const auto middle = residuals.begin() + static_cast<std::ptrdiff_t>(residuals.size() / 2);
    std::ranges::nth_element(residuals, middle);
    // 1.4826: from the median of absolute values to the standard deviation of normal errors
    return std::clamp(1.4826 * *middle, kPhaseSigmaPx, kStartSigmaPx);
}

}  // namespace

double Silhouette::area_px() const {
    double twice = 0.0;
    for (std::size_t i = 0; i < count; ++i) twice += cross(corners.at(i), corners.at((i + 1) % count));
    return 0.5 * std::abs(twice);
}

Eigen::Vector3d Silhouette::ray_of(std::size_t corner) const {
    const Eigen::Vector2d at = corners.at(corner) / focal_px;
    return {at.x(), at.y(), 1.0};
}

double Silhouette::radius_px() const {
    Eigen::Vector2d least = corners.front();
    Eigen::Vector2d most = corners.front();
    for (const Eigen::Vector2d& corner : std::span(corners).first(count)) {
        least = least.cwiseMin(corner);
        most = most.cwiseMax(corner);
    }
    return 0.5 * (most - least).maxCoeff();
}

double Silhouette::distance_px(const Eigen::Vector2d& point) const {
    double most = -std::numeric_limits<double>::infinity();
    for (std::size_t i = 0; i < count; ++i) {
        const Eigen::Vector2d side = corners.at((i + 1) % count) - corners.at(i);
        most = std::max(most, -cross(side, point - corners.at(i)) / std::max(side.norm(), 1e-12));
    }
    return most;
}

std::optional<Silhouette> silhouette(const Camera& camera, const Box& box) {
    std::array<Eigen::Vector2d, 8> points;
    const Eigen::Isometry3d to_camera = camera.T_world_camera.inverse();
    const double f = focal(camera);
    for (std::size_t i = 0; i < 8; ++i) {
        const Eigen::Vector3d signs((i & 1U) != 0 ? 1.0 : -1.0, (i & 2U) != 0 ? 1.0 : -1.0, (i & 4U) != 0 ? 1.0 : -1.0);
        const Eigen::Vector3d corner = to_camera * (box.centre + signs.cwiseProduct(box.half));
        if (!(corner.z() > 1e-3)) return std::nullopt;
        points.at(i) = corner.head<2>() * (f / corner.z());
    }
    // Andrew's monotone chain
    std::ranges::sort(points, [](const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
        return a.x() < b.x() || (a.x() == b.x() && a.y() < b.y());
    });
    std::array<Eigen::Vector2d, 16> hull;
    std::size_t count = 0;
    const auto add = [&](const Eigen::Vector2d& point, std::size_t base) {
        while (count >= base + 2 && cross(hull.at(count - 1) - hull.at(count - 2), point - hull.at(count - 1)) <= 0.0) {
            --count;
        }
        hull.at(count++) = point;
    };
    for (const Eigen::Vector2d& point : points) add(point, 0);
    const std::size_t lower = count - 1;
    for (std::size_t i = points.size() - 1; i-- > 0;) add(points.at(i), lower);
    --count;  // the first point again
    Silhouette result{.corners = {}, .count = count, .focal_px = f};
    std::copy_n(hull.begin(), count, result.corners.begin());
    return result;
}

std::optional<BoxFix> fit_box(std::span<const BoxView> views, const Box& start, const std::optional<BoxPrior>& prior) {
    Vector6 p = parameters_of(start);
    double sigma_px = kStartSigmaPx;
    double damping = 1e-3;
    PoolVector<double> residuals;
    auto normal = linearise(views, p, sigma_px, prior);
    for (int i = 0; i < kSteps; ++i) {
        if (!normal) return std::nullopt;
        Matrix6 damped = normal->matrix;
        damped.diagonal() *= 1.0 + damping;
        damped.diagonal().array() += 1e-9;
        const Vector6 step = damped.ldlt().solve(normal->right);
        if (!step.allFinite()) return std::nullopt;
        Vector6 next = p + step;
        next.tail<3>() = next.tail<3>().cwiseMax(kMinHalf);
        const auto there = linearise(views, next, sigma_px, prior);
        if (!there || there->cost > normal->cost) {
            damping *= 10.0;
            if (damping > 1e6) break;
            continue;
        }
        damping = std::max(damping * 0.1, 1e-9);
        const double moved = (next - p).norm();
        p = next;
        normal = there;
        const double previous_px = sigma_px;
        // never back up: what was left out as another body's stays out
        sigma_px = std::min(sigma_px, robust_sigma_px(views, box_of(p), residuals));
        if (sigma_px < previous_px) normal = linearise(views, p, sigma_px, prior);
        if (moved < kStepTolerance && sigma_px > 0.99 * previous_px) break;
    }
    normal = linearise(views, p, sigma_px * std::sqrt(kCorrelation), prior);
    if (!normal) return std::nullopt;
    const Eigen::FullPivLU<Matrix6> factor(normal->matrix);
    if (!factor.isInvertible()) return std::nullopt;
    const Matrix6 covariance = factor.inverse();
    const double most = covariance.diagonal().maxCoeff();
    if (!covariance.allFinite() || !(most < kMaxBoxSigma * kMaxBoxSigma)) return std::nullopt;
    return BoxFix{.box = box_of(p), .covariance = covariance, .sigma_px = sigma_px, .inliers = normal->inliers};
}

bool is_outlined(const BoxView& view, const Box& box, double tolerance_px) {
    const auto outline = silhouette(*view.camera, box);
    if (!outline) return false;
    const double f = focal(*view.camera);
    for (std::size_t i = 0; i < outline->count; ++i) {
        const Eigen::Vector2d& begin = outline->corners.at(i);
        const Eigen::Vector2d side = outline->corners.at((i + 1) % outline->count) - begin;
        const double length = side.norm();
        if (length < kMinSidePx) continue;
        const auto is_along = [&](const EdgePoint& point) {
            const Eigen::Vector2d to = on_plane(point, f) - begin;
            const double along = to.dot(side) / length;
            return along > 0.0 && along < length && std::abs(cross(side, to)) < tolerance_px * length;
        };
        const auto count = static_cast<double>(std::ranges::count_if(view.outline, is_along));
        if (count < kMinOutlined * (length - kMinSidePx)) return false;
    }
    return true;
}

double agreement(const BoxView& view, const Box& box, double tolerance_px) {
    const auto outline = silhouette(*view.camera, box);
    if (!outline || view.outline.empty()) return 0.0;
    const double f = focal(*view.camera);
    const auto agrees = [&](const EdgePoint& point) {
        return std::abs(outline->distance_px(on_plane(point, f))) <= tolerance_px;
    };
    return static_cast<double>(std::ranges::count_if(view.outline, agrees)) / static_cast<double>(view.outline.size());
}

}  // namespace armsight::vision
