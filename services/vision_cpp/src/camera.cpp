#include "armsight/vision/camera.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "armsight/vision/frame.hpp"

namespace armsight::vision {
namespace {

// Newton on a smooth, nearly linear function: 3 to 4 steps reach 1e-12 for real lenses, the rest is margin.
constexpr int kUndistortSteps = 10;
constexpr double kUndistortTolerance = 1e-13;  // on the plane z = 1: far below a pixel
constexpr double kMinDepth = 1e-6;             // metres
// Focal lengths in sides of the image: from nearly 180 degrees of view to a thousandth of one.
constexpr double kMinFocal = 1e-3;
constexpr double kMaxFocal = 1e5;
// Far beyond every lens, cropped picture and room: what is finite and larger would only overflow later.
constexpr double kMaxSkew = 1.0;   // of the focal length
constexpr double kMaxShift = 1e3;  // of the principal point, in sides of the image
constexpr double kMaxDistortion = 1e6;
constexpr double kMaxDistance = 1e6;  // metres from the world's origin

bool has_distortion(const Camera& camera) {
    return std::ranges::any_of(camera.distortion, [](double k) { return k != 0.0; });
}

}  // namespace

bool is_usable(const Camera& camera) {
    const auto sane_side = [](int side) {
        return std::cmp_greater_equal(side, kMinImageSide) && std::cmp_less_equal(side, kMaxImageSide);
    };
    const auto sane_focal = [](double focal, int side) { return focal > kMinFocal * side && focal < kMaxFocal * side; };
    const auto sane_centre = [](double centre, int side) { return std::abs(centre) <= kMaxShift * side; };
    const Eigen::Matrix3d& K = camera.K;
    return sane_side(camera.width) && sane_side(camera.height) && K.allFinite() && sane_focal(K(0, 0), camera.width) &&
           sane_focal(K(1, 1), camera.height) && std::abs(K(0, 1)) <= kMaxSkew * K(0, 0) &&
           sane_centre(K(0, 2), camera.width) && sane_centre(K(1, 2), camera.height) &&
           std::ranges::all_of(camera.distortion, [](double k) { return std::abs(k) <= kMaxDistortion; }) &&
           camera.T_world_camera.matrix().allFinite() && camera.T_world_camera.translation().norm() <= kMaxDistance;
}

Eigen::Vector2d distort(const Camera& camera, const Eigen::Vector2d& undistorted) {
    const auto& [k1, k2, p1, p2, k3] = camera.distortion;
    const double x = undistorted.x();
    const double y = undistorted.y();
    const double r2 = x * x + y * y;
    const double radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
    return {x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y};
}

Eigen::Vector2d undistort(const Camera& camera, const Eigen::Vector2d& distorted) {
    if (!has_distortion(camera)) return distorted;
    const auto& [k1, k2, p1, p2, k3] = camera.distortion;
    Eigen::Vector2d point = distorted;
    for (int i = 0; i < kUndistortSteps; ++i) {
        const double x = point.x();
        const double y = point.y();
        const double r2 = x * x + y * y;
        const double radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        const double slope = 2.0 * (k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3));  // d radial / d(r2), times 2
        Eigen::Matrix2d jacobian;
        jacobian << radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x, slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y,
            slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y, radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x;
        const double determinant = jacobian.determinant();
        if (!(std::abs(determinant) > 1e-9)) break;  // folded over: the lens model means nothing here
        const Eigen::Vector2d delta = jacobian.inverse() * (distorted - distort(camera, point));
        if (!delta.allFinite()) break;
        point += delta;
        if (delta.squaredNorm() < kUndistortTolerance * kUndistortTolerance) break;
    }
    return point;
}

Eigen::Vector3d ray(const Camera& camera, double x, double y) {
    const Eigen::Matrix3d& K = camera.K;
    const double v = (y - kWireToImage - K(1, 2)) / K(1, 1);
    const double u = (x - kWireToImage - K(0, 2) - K(0, 1) * v) / K(0, 0);
    const Eigen::Vector2d point = undistort(camera, {u, v});
    const double scale = 1.0 / std::sqrt(point.squaredNorm() + 1.0);
    return {scale * point.x(), scale * point.y(), scale};
}

std::optional<Eigen::Vector2d> project(const Camera& camera, const Eigen::Vector3d& point) {
    if (!(point.z() > kMinDepth)) return std::nullopt;
    const Eigen::Matrix3d& K = camera.K;
    const Eigen::Vector2d d = distort(camera, point.head<2>() / point.z());
    return Eigen::Vector2d(K(0, 0) * d.x() + K(0, 1) * d.y() + K(0, 2) + kWireToImage,
                           K(1, 1) * d.y() + K(1, 2) + kWireToImage);
}

std::optional<Eigen::Vector2d> wire_pixel(const Camera& camera, const Eigen::Vector3d& point) {
    auto pixel = project(camera, point);
    if (pixel) *pixel -= Eigen::Vector2d::Constant(kWireToImage);
    return pixel;
}

double pixels_per_radian(const Camera& camera, const Eigen::Vector3d& ray) {
    const double f = std::sqrt(camera.K(0, 0) * camera.K(1, 1));
    const double cos_off_axis = std::max(ray.z(), 0.1);
    // f / cos tangentially, f / cos^2 radially
    return f / (cos_off_axis * std::sqrt(cos_off_axis));
}

}  // namespace armsight::vision
