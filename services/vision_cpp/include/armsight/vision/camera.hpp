#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <optional>
#include <string>

namespace armsight::vision {

/// A calibrated camera, as it comes over the wire.
struct Camera {
    std::string name;
    int width, height;                 ///< pixels
    Eigen::Matrix3d K;                 ///< pixels; OpenCV's convention: integer values are pixel centres
    std::array<double, 5> distortion;  ///< plumb_bob: k1, k2, p1, p2, k3
    Eigen::Isometry3d T_world_camera;  ///< optical frame: x right, y down, z into the scene
};

/// Added once to pixels of the wire (integer = pixel centre) to get image coordinates, in which pixel (i, j) covers
/// [i, i+1] x [j, j+1].
inline constexpr double kWireToImage = 0.5;

/// True when a ray can be computed for every pixel: finite numbers in the range of lenses, cropped pictures and rooms,
/// sane size.
[[nodiscard]] bool is_usable(const Camera& camera);

/// Undistorted point on the plane z = 1 of the optical frame from a distorted one.
[[nodiscard]] Eigen::Vector2d undistort(const Camera& camera, const Eigen::Vector2d& distorted);

/// The inverse of undistort(), in closed form.
[[nodiscard]] Eigen::Vector2d distort(const Camera& camera, const Eigen::Vector2d& undistorted);

/// Unit ray in the optical frame through image coordinates (x, y).
[[nodiscard]] Eigen::Vector3d ray(const Camera& camera, double x, double y);

/// Image coordinates of a point in the optical frame; nothing when it is not in front of the camera.
[[nodiscard]] std::optional<Eigen::Vector2d> project(const Camera& camera, const Eigen::Vector3d& point);

/// The same in pixels of the wire.
[[nodiscard]] std::optional<Eigen::Vector2d> wire_pixel(const Camera& camera, const Eigen::Vector3d& point);

/// Pixels per radian for directions near a ray: f at the principal point, more towards the corners, where the image
/// plane is farther away and inclined (mean of the radial and the tangential scale).
[[nodiscard]] double pixels_per_radian(const Camera& camera, const Eigen::Vector3d& ray);

}  // namespace armsight::vision
