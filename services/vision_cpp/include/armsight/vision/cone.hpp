#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>

#include "armsight/vision/edges.hpp"

namespace armsight::vision {

/// Cone of the rays that touch a sphere, in the optical frame of the camera that sees it. Unlike the centroid of the
/// sphere's image, its axis goes through the sphere's centre without bias.
struct Cone {
    Eigen::Vector3d axis;  ///< unit vector towards the centre
    double half_angle;     ///< rad; distance = radius / sin(half_angle)
    int inliers;           ///< edge points that agree
    double residual_px;    ///< root mean square of these
};

struct ConeOptions {
    int min_inliers = 8;        ///< fewer may agree by chance
    double tolerance_px = 0.7;  ///< how far an edge point may lie from the outline
};

/// Fits the cone on which every boundary ray d of one sphere lies: d . m = 1 with m = axis / cos(half_angle), linear in
/// m, so that any arc will do. Edge points that belong to something else are voted out. Deterministic.
/// Returns nothing when fewer than `options.min_inliers` agree or when they do not make a cone.
[[nodiscard]] std::optional<Cone> fit_cone(std::span<const EdgePoint> points, const ConeOptions& options = {});

/// The cone of the points near a cone that is known already; nothing when too few are.
[[nodiscard]] std::optional<Cone> refine_cone(std::span<const EdgePoint> points, const Cone& known,
                                              const ConeOptions& options = {});

}  // namespace armsight::vision
