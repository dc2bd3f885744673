#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <optional>
#include <span>

#include "armsight/vision/camera.hpp"
#include "armsight/vision/edges.hpp"
#include "armsight/vision/triangulate.hpp"

namespace armsight::vision {

/// A box with its sides along the axes of the world.
struct Box {
    Eigen::Vector3d centre;  ///< world frame, metres
    Eigen::Vector3d half;    ///< half of its extent along each axis, metres
};

/// What one camera contributes to a box.
struct BoxView {
    const Camera* camera;
    std::span<const EdgePoint> outline;
};

/// What is known of a box beforehand: of its centre, of its extent or of both.
struct BoxPrior {
    Box box;
    Matrix6 information;  ///< of centre and half extent, 1/m^2; 0 for what is not known
};

struct BoxFix {
    Box box;
    Matrix6 covariance;  ///< of centre and half extent, m^2, from the normal matrix
    double sigma_px;     ///< robust spread of the edge points around the outline
    int inliers;         ///< edge points that agree, all views
};

/// The outline of a box for one camera: the convex hull of its corners. Pixels of an ideal pinhole camera with the same
/// focal length, from its principal point.
struct Silhouette {
    std::array<Eigen::Vector2d, 8> corners;  ///< in order around the outline
    std::size_t count = 0;
    double focal_px = 1.0;

    [[nodiscard]] double area_px() const;
    /// A corner as direction in the optical frame.
    [[nodiscard]] Eigen::Vector3d ray_of(std::size_t corner) const;
    /// Half of the larger side of its bounds.
    [[nodiscard]] double radius_px() const;
    /// How far a ray passes outside of the outline, pixels; negative inside. Exact but beside the corners, where
    /// it is less.
    [[nodiscard]] double distance_px(const Eigen::Vector2d& point) const;
};

/// Returns nothing when a corner is not in front of the camera.
[[nodiscard]] std::optional<Silhouette> silhouette(const Camera& camera, const Box& box);

/// Fits centre and extent of one box to its outlines in all views together: Levenberg-Marquardt on the distances of all
/// edge points, with Tukey weights, from `start`. One view does not tell how far away a box of unknown extent is: it
/// needs a prior.
/// Returns nothing when it does not converge in front of every camera or when a number is not determined to
/// kMaxBoxSigma.
[[nodiscard]] std::optional<BoxFix> fit_box(std::span<const BoxView> views, const Box& start,
                                            const std::optional<BoxPrior>& prior = std::nullopt);

inline constexpr double kMaxBoxSigma = 0.3;  ///< metres, one standard deviation

/// True when edge points lie along every side of the box's outline: none of it is hidden.
[[nodiscard]] bool is_outlined(const BoxView& view, const Box& box, double tolerance_px);

/// Share of a view's edge points within `tolerance_px` of the box's outline; 0 without points.
[[nodiscard]] double agreement(const BoxView& view, const Box& box, double tolerance_px);

}  // namespace armsight::vision
