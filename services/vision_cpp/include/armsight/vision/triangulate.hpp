#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>

#include "armsight/vision/camera.hpp"
#include "armsight/vision/edges.hpp"

namespace armsight::vision {

using Vector6 = Eigen::Matrix<double, 6, 1>;
using Matrix6 = Eigen::Matrix<double, 6, 6>;

/// A line of sight in the world frame.
struct Ray {
    Eigen::Vector3d origin;     ///< metres
    Eigen::Vector3d direction;  ///< unit
};

/// The point nearest to all rays by least squares of the distances. Two rays or more.
/// Returns nothing when they are parallel within a milliradian or meet behind a camera.
[[nodiscard]] std::optional<Eigen::Vector3d> triangulate(std::span<const Ray> rays);

/// What one camera contributes to a sphere's position.
struct View {
    const Camera* camera;
    std::span<const EdgePoint> outline;  ///< may be empty: then `centre` alone counts
    Eigen::Vector3d centre;              ///< unit ray towards the middle of the visible part, optical frame
    double centre_sigma_px;              ///< of that ray; 0 leaves it out
    double centre_pixels_per_radian;
};

/// A position known beforehand.
struct Prior {
    Eigen::Vector3d position;    ///< world frame, metres
    Eigen::Matrix3d covariance;  ///< m^2
};

/// All edge points of a view move together, one standard deviation in each direction: by shading this much, and by
/// where pixels happen to lie this share of the points' spread.
inline constexpr double kViewShiftPx = 0.008;
inline constexpr double kViewShiftOfSpread = 0.03;

/// Position of a sphere's centre.
struct Fix {
    Eigen::Vector3d position;    ///< world frame, metres
    Eigen::Matrix3d covariance;  ///< m^2, from the normal matrix and what shifts of whole views add
    double sigma_px;             ///< robust spread of the edge points around the outline
    int inliers;                 ///< edge points that agree, all views
    bool has_prior = false;      ///< whether what was known beforehand is in it
};

/// Fits one sphere of known radius to its outlines in all views together: Gauss-Newton on
/// f (angle(d, axis) - asin(radius / distance)) for every edge ray d, with Tukey weights, from `start` (world frame).
/// Returns nothing when it does not converge in front of every camera or when nothing determines the position.
[[nodiscard]] std::optional<Fix> fit_sphere(std::span<const View> views, double radius, const Eigen::Vector3d& start,
                                            const std::optional<Prior>& prior = std::nullopt);

/// The same position to about a quarter of a pixel, in fewer steps: where to look for the outline itself.
[[nodiscard]] std::optional<Eigen::Vector3d> rough_sphere(std::span<const View> views, double radius,
                                                          const Eigen::Vector3d& start);

/// Share of a view's edge points within `tolerance_px` of the outline of a sphere at `position`; 0 without points.
[[nodiscard]] double agreement(const View& view, double radius, const Eigen::Vector3d& position, double tolerance_px);

}  // namespace armsight::vision
